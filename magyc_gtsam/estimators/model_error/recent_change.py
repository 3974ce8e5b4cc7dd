"""The parameter error that a change of the instrument within the newest windows may cause.

A robust fit rejects the windows after a change as disturbed, or a single link where the field's direction jumps, and
keeps the calibration from before it, as certain as it was, until they are many; if the change is small, it mixes both.
At the end of a log, and at a reading online, a change is therefore looked for before the newest 2, 4, 8, … windows, by
its score, all windows since counting alike, and where the windows or links that are rejected begin. From where one is
possible, the windows are fitted again, given the marginal of those before them, with each of

    iron    another soft and hard iron. Steel beside a sensor need not have a symmetric soft iron: it may turn the field
            as well, which is a misalignment of the chips;
    turn    a magnetometer that was turned against the gyroscope, as by a blow;
    place   another field of the place, which explains as much until the sensor turns.

With p the probability of a change of the instrument, rather than of the place, or a disturbance, and θ' and C' the
parameters and their covariance if it changed,

    p (C' + d dᵀ),   d = θ' − θ,

is added to the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.components import likeliest
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain, Marginal, continued, fitted
from magyc_gtsam.estimators.smoother.noise_levels import truncated
from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.factors.chain.banded import forward_solved
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, SKEW, WITH_SKEW, Weights
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError

RECENT = "recent change"
_IRON = slice(0, 9)  # soft iron times field strength, and hard iron: T
_FEWEST = 3  # windows before a change
_ALIGNED = 1e-5  # rad, standard deviation of a misalignment that was not corrected, before a change
_KNOWN = 1e9  # degrees of freedom of a noise level that is known


@dataclass(frozen=True)
class _Belief:
    """What is believed of a change before the newest windows are known, and when it is tested."""

    windows: tuple[int, ...] = (2, 4, 8, 16, 32, 64, 128)  # since the change
    # Prior odds of a change at each of these, where windows do not fit, against a disturbance: of the iron, of the
    # sensor's attitude, and of the field of the place.
    odds: float = 0.03
    odds_of_turn: float = 0.03
    odds_of_place: float = 1.0
    # Standard deviation of an element of a change, as a share of the field strength: the least, and the largest
    least: float = 0.02
    most: float = 0.04  # larger steps of the hard iron are found online after a few windows, or by `iron_change`
    turn: float = 0.1  # rad an axis, the same of a turn; of the place, a share of the field, as its rival
    broken: int = 2400  # newest windows in which a change is looked for where windows or links are rejected
    unlikely: float = -7.0  # logarithm of the odds below which a change is left out
    possible: float = 5.0  # gain in log-likelihood from which a change is possible
    share: float = 0.5  # of the largest gain, from which a change at another time is considered


_BELIEF = _Belief()
_ODDS = {"iron": _BELIEF.odds, "turn": _BELIEF.odds_of_turn, "place": _BELIEF.odds_of_place}
_REJECTED = 16.27  # χ² of 3 degrees of freedom at 99.9 %, from which a window or link does not fit


def recent_change(fit: Fit, colour: float | None = None) -> Component | None:
    """Return the error that a recent change of the instrument may cause; None if the newest windows exclude it.

    Args:
        fit: of all windows, or of the last ones given those before, at its minimum.
        colour: correlation factor of the residuals; None for that of the fit. In a short tail a change itself makes
            the residuals correlated, which would hide it.
    """
    colour = fit.colour if colour is None else colour
    chain = continued(fit)
    strength = float(np.cbrt(abs(np.linalg.det(unvech(fit.state.parameters[:6])))))
    changes = _possible(fit, chain, strength, colour)
    of_place = np.array([change.what == "place" for change in changes], dtype=bool)
    if of_place.all():
        return None
    prior = np.log([_ODDS[change.what] for change in changes])
    nats = np.append(prior + [change.evidence for change in changes], 0.0)
    share = np.exp(nats - nats.max())
    share = (share / share.sum())[:-1][~of_place]
    found = [change for change in changes if change.what != "place"]
    best = found[int(np.argmax(share))]
    second = np.einsum("k,kij->ij", share, [each.second for each in found])
    size, words = _described(best, strength)
    return Component(RECENT, words, size, best.evidence, second, share=float(share.sum()))


def _described(change: _Change, strength: float) -> tuple[float, str]:
    """Return the size of a change of the instrument, T, and what happened in words."""
    within = f"in the last {change.duration:.0f} s"
    if change.what == "turn":
        angle = float(np.linalg.norm(change.away[SKEW]))
        words = f"the magnetometer may have turned by {np.degrees(angle):.2g}° against the gyroscope {within}"
        return angle * strength, words
    return float(np.linalg.norm(change.away[_IRON])), f"soft or hard iron may have changed {within}"


def _possible(fit: Fit, chain: ContinuedChain, strength: float, colour: float) -> list[_Change]:
    """Return the changes that the newest windows do not exclude, each fitted."""
    scores = _scores(fit, chain, strength, colour)
    least = max(_BELIEF.possible, _BELIEF.share * max((score.gain for score in scores), default=0.0))
    count = len(chain.windows)
    tried = [("iron", count - score.windows, score.sigma / strength) for score in scores if score.gain >= least]
    tried += [("turn", first, _BELIEF.turn) for first in _broken(fit, chain)]
    return [each for what, first, share in tried for each in _changes(fit, chain, what, first, share, colour)]


def _broken(fit: Fit, chain: ContinuedChain) -> set[int]:
    """Return the newest window whose link to the one before is broken most, and that from which most do not fit."""
    oldest = max(len(chain.windows) - _BELIEF.broken, _FEWEST)
    window, link = chain.squares(fit.residuals)
    window, link = window[oldest:], link[oldest - 1 :]
    misfit = np.minimum(window, _REJECTED) + np.minimum(link, _REJECTED)
    gain = np.cumsum((misfit - 0.5 * _REJECTED)[::-1])[::-1]
    result = set()
    for found in (link, gain):
        first = int(np.argmax(found)) if len(found) else 0
        if first < len(found) - 1 and found[first] > _REJECTED:
            result.add(oldest + first)
    return result


class _Score(NamedTuple):
    """The score test of a change of the iron before the newest `windows`.

    Attributes:
        gain: in log-likelihood, at the likeliest size.
        sigma: that size, T: the standard deviation of an element of the change.
    """

    windows: int
    gain: float
    sigma: float


def _scores(fit: Fit, chain: ContinuedChain, strength: float, colour: float) -> list[_Score]:
    """Return the scores of a change before several of the newest windows, which count alike."""
    count = len(chain.windows)
    numbers = [k for k in _BELIEF.windows if k <= count - _FEWEST]
    if not numbers:
        return []
    weights = Weights(fit.weights.window.copy(), fit.weights.link.copy())
    weights.window[-numbers[-1] :] = weights.link[-numbers[-1] :] = 1.0
    reduced = chain.eliminate(fit.state, weights)
    residual = fit.residuals.window * chain.window_scale * np.sqrt(weights.window)
    later = np.arange(count) >= count - np.array(numbers)[:, None]
    columns = (later[:, None, None] * reduced.on_parameters[_IRON]).reshape(-1, 3, count)
    border = np.einsum("ian,kin->kan", reduced.on_direction, columns)
    absorbed = forward_solved(reduced.band_factor, border)
    cross = np.einsum("kin,pin->kp", columns, reduced.on_parameters) - absorbed @ reduced.half[:, :-1]
    gradient = np.einsum("kin,in->k", columns, residual) - absorbed @ reduced.half[:, -1]
    explained = cross @ replace(fit, reduced=reduced).covariance
    gradient -= explained @ reduced.gradient
    result = []
    for i, k in enumerate(numbers):
        own = slice(9 * i, 9 * i + 9)
        flat = columns[own].reshape(9, -1)
        information = flat @ flat.T - absorbed[own] @ absorbed[own].T - explained[own] @ cross[own].T
        most = (_BELIEF.most * strength) ** 2
        found = likeliest(information / colour, gradient[own] / colour, _KNOWN, _KNOWN, most)
        result.append(_Score(k, found.gain, max(float(np.sqrt(found.variance)), _BELIEF.least * strength)))
    return result


def _aligned(past: Marginal) -> Marginal:
    """Return the marginal without a misalignment."""
    kept = np.ones(len(past.gradient))
    kept[SKEW] = 0.0
    return past._replace(
        information=past.information * np.outer(kept, kept) + np.diag((1 - kept) / _ALIGNED**2),
        gradient=past.gradient * kept,
    )


class _Change(NamedTuple):
    """A change `duration` s ago.

    Attributes:
        what: "iron", "turn" or "place".
        evidence: log-likelihood ratio against none.
        away: (16,) θ with it less θ without it; second: (16, 16) its second moment.
    """

    what: str
    duration: float
    evidence: float
    away: Array
    second: Array


def _changes(fit: Fit, chain: ContinuedChain, what: str, first: int, share: float, colour: float) -> list[_Change]:
    """Return a change of the instrument before window `first`, and one of the field of the place of the same size.

    The latter is left out where the former is unlikely anyway, and each if the windows determine no fit.

    Args:
        fit, chain: of all windows.
        what: "iron" or "turn".
        first: window.
        share: standard deviation of an element, as a share of the field strength, or in rad.
        colour: correlation factor of the residuals.
    """
    past = chain.marginalise(fit.state, fit.weights, first - 1)
    if len(fit.state.parameters) == PARAMETERS:
        past = _aligned(past)
    soft_iron, size = fit.state.parameters[:6], len(past.gradient)
    if what == "turn":
        instrument = np.zeros((size, 3))
        instrument[SKEW] = np.eye(3)
    else:
        instrument = np.zeros((size, 12))
        instrument[_IRON, :9] = float(np.cbrt(abs(np.linalg.det(unvech(soft_iron))))) * np.eye(9)
        # What is not symmetric of a soft iron turns the field.
        instrument[SKEW, 9:] = np.sqrt(0.5) * np.eye(3)
    changed = _change(fit, chain, past, first, share * instrument, what, colour)
    if changed is None or changed.evidence + np.log(_ODDS[what]) < _BELIEF.unlikely:
        return []
    place = np.zeros((size, 3))
    place[:6, 0] = soft_iron  # the strength of the field
    place[WITH_SKEW:, 1:] = np.eye(2)  # its direction
    rival = _change(fit, chain, past, first, share * place, "place", colour)
    return [changed] if rival is None else [changed, rival]


def _change(
    fit: Fit, chain: ContinuedChain, past: Marginal, first: int, columns: Array, what: str, colour: float
) -> _Change | None:
    """Return the change before window `first` by `columns` (18, k) of standard deviation one each."""
    last = first - 1
    before_it = with_angles(fit.state.parameters)
    inside = np.eye(columns.shape[1]) + columns.T @ past.information @ columns
    windows = chain.windows.part(last, len(chain.windows))
    newest = replace(chain, windows=windows, past=past.changed(columns), facts=())
    try:
        free = np.append(fit.free[:PARAMETERS], np.ones(3, dtype=bool))
        changed = fitted(newest, before_it, free)
    except MagycError:  # a direction without curvature
        return None
    window, link = truncated(chain, fit.residuals)
    before = float(window[first:].sum() + link[last:].sum())
    after = sum(float(part.sum()) for part in truncated(newest, changed.residuals))
    slope = columns.T @ past.gradient
    by_past = 2 * newest.past_cost(changed.state) - float(slope @ np.linalg.solve(inside, slope))
    volume = _log_volume(changed) - _log_volume(fit) - float(np.linalg.slogdet(inside)[1])
    volume -= 2 * (len(before_it) - len(fit.state.parameters)) * float(np.log(_ALIGNED))
    away = changed.state.parameters - before_it
    second = colour * changed.covariance + np.outer(away, away)
    evidence = 0.5 * ((before - after - by_past) / colour + volume)
    return _Change(what, float(windows.time[-1] - windows.time[0]), evidence, away, second)


def _log_volume(fit: Fit) -> float:
    """Return the log-determinant of the covariance of the free parameters."""
    return float(np.linalg.slogdet(fit.covariance[np.ix_(fit.free, fit.free)])[1])
