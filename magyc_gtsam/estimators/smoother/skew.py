"""A skew between the chips: whether the data show one, and what it adds to the covariance where that is open.

With a gyroscope the full matrix B = S Exp(ε) can be observed. Whether ε is there is asked of the data: its three
angles are given the prior N(0, s²) with the deviation s itself unknown (`SkewPrior`, from 0 to 2°), and the evidence
of each s follows from one linearisation at the minimum, in closed form (Laplace; it holds the Occam factor). With θ
split into ε and the rest a, and the data's information Λ, divided by the residual's colour,

    S = Λ_εε − Λ_εa Λ_aa⁻¹ Λ_aε,   b = S ε₀ − (g_ε − Λ_εa Λ_aa⁻¹ g_a),   Q = S + 1/s²,
    ln p(data | s) / p(data | 0) = ½ bᵀ Q⁻¹ b − ½ ln |I + s² S|,   ε | s ~ N(Q⁻¹ b, Q⁻¹).

Where a skew is probable enough, its mean over all s is taken out of the readings, in the directions that the motion
resolves; that is a decision, made with more belief in aligned chips than the covariance has (`SkewPrior.aligned`).
Where not, the twelve parameters are reported as if there were none. Either way the second moment of ε about what was
taken out, over all s, is carried into their covariance by da/dε = −Λ_aa⁻¹ Λ_aε, so that the stated sigmas hold.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.skew_found import Skew
from magyc_gtsam.estimators.smoother.skew_prior import SkewPrior
from magyc_gtsam.factors.chain.chain_values import ChainState, Weights
from magyc_gtsam.factors.chain.facts import Fact, LinearFact, quadratic
from magyc_gtsam.factors.chain.field_chain import PARAMETERS, SKEW, WITH_SKEW, iron_matrix
from magyc_gtsam.factors.chain.rotations import Array, cross

_LEAST_SPLIT = 40  # windows, of a recording whose halves are compared


class Profile(NamedTuple):
    """S (3, 3) and b (3,) of ε, see above; gain and shift as `Skew`, the latter at ε = 0."""

    information: Array
    pull: Array
    gain: Array
    shift: Array


def widened(fit: Fit, prior: SkewPrior, known: LinearFact | None = None) -> Fit:
    """A fit linearised with a free skew, at 0 where it has thirteen parameters; `known` is what an earlier calibration
    says of it."""
    facts = fit.chain.facts if known is None else (*fit.chain.facts, known)
    chain = replace(fit.chain, facts=(*facts, held(prior.widest)))
    state = ChainState(with_angles(fit.state.parameters), fit.state.direction)
    free = np.append(fit.free[:PARAMETERS], np.ones(3, dtype=bool))
    return replace(fit, chain=chain, state=state, free=free, reduced=chain.eliminate(state, fit.weights))


def with_angles(parameters: Array) -> Array:
    """θ (16,): a skew that is not carried is 0."""
    return np.append(parameters, np.zeros(WITH_SKEW - len(parameters)))


class HeldSkew(LinearFact):
    """The prior of a skew that is asked for: no fact about the instrument."""


def held(deviation: float) -> HeldSkew:
    """ε ~ N(0, deviation²)."""
    return HeldSkew(np.arange(SKEW.start, SKEW.stop), np.zeros(3), np.eye(3) / deviation)


def on_skew(fact: Fact) -> bool:
    """Whether a fact concerns the skew."""
    return isinstance(fact, LinearFact) and int(fact.rows[0]) == SKEW.start


def skew_of(fit: Fit, prior: SkewPrior, factor: float, *, decide: bool = True) -> Skew:
    """What a fit of sixteen parameters, at its minimum or near it, says of a skew.

    Args:
        fit: with `held(prior.widest)` as the last fact of its chain.
        prior: what is believed of it.
        factor: by which the data's information is divided: the residual's colour, which a skew that is not fitted
            raises, and its widening.
        decide: whether it may be taken out; else it is left open, however probable.
    """
    profile = profile_of(fit, factor)
    believed = Believed.of(profile, prior)
    if not decide or believed.probability <= prior.probable:
        return believed.around(np.zeros(3), profile)
    doubt = _doubt(fit, believed.mean, prior, factor)
    return believed.around(np.zeros(3) if doubt else believed.resolved, profile, doubt)


def asked(fit: Fit, prior: SkewPrior) -> Skew:
    """What a fit of thirteen parameters at its minimum says of a skew, as undecided: one more group of columns."""
    chain, parameters = fit.chain, fit.state.parameters
    body = np.einsum("ijn,jn->in", chain.rotation(parameters), fit.state.direction)
    columns = np.einsum(
        "ij,kjn->kin", iron_matrix(parameters), cross(np.eye(3)[:, :, None], body[:, None]).swapaxes(0, 1)
    )
    beside = fit.beside
    new = beside.of(UnmodelledColumns(columns, None))
    profile = Profile(new.normal, new.score, -beside.move(new), np.zeros(PARAMETERS))
    return Believed.of(profile, prior).around(np.zeros(3), profile)


class Believed(NamedTuple):
    """ε under each deviation of a prior: how far that is believed (k,), by the weights and in a decision, mean (k, 3)
    and variance (k, 3) along the principal axes (3, 3) of the data's information; which of these are resolved; and
    the nats of the likeliest against none, and the probability that there is any, in those."""

    share: Array
    decisive: Array
    angle: Array
    variance: Array
    axes: Array
    kept: np.ndarray
    best: float
    probability: float

    @classmethod
    def of(cls, profile: Profile, prior: SkewPrior) -> Believed:
        """The prior is the same about every axis, so that all is a sum over the principal axes."""
        known, axes = np.linalg.eigh(profile.information)
        known, pull = np.maximum(known, 0.0), profile.pull @ axes
        before = np.square(prior.deviations)[:, None]
        variance = before / (1 + before * known)
        angle = variance * pull
        nats, kept = 0.5 * pull * angle - 0.5 * np.log1p(before * known), known > prior.resolved**-2
        seen = nats[:, kept].sum(axis=1)
        decisive = _normalised(prior.cautious, seen)
        probability = float(decisive[before[:, 0] > 0].sum())
        share = _normalised(np.array(prior.weights), nats.sum(axis=1))
        return cls(share, decisive, angle, variance, axes, kept, float(seen.max()), probability)

    @property
    def mean(self) -> Array:
        """(3,) over all deviations."""
        result: Array = self.axes @ (self.share @ self.angle)
        return result

    @property
    def resolved(self) -> Array:
        """(3,) what a decision takes out: the mean along the axes that are resolved."""
        result: Array = self.axes @ np.where(self.kept, self.decisive @ self.angle, 0.0)
        return result

    def around(self, value: Array, profile: Profile, doubt: str = "") -> Skew:
        """With its second moment about `value`."""
        away = self.angle @ self.axes.T - value
        second = (self.axes * (self.share @ self.variance)) @ self.axes.T + (self.share * away.T) @ away
        shift = profile.shift + profile.gain @ value
        return Skew(value, second, self.best, self.probability, profile.gain, shift, doubt)


def _normalised(weights: Array, nats: Array) -> Array:
    share = weights * np.exp(nats - nats.max())
    result: Array = share / share.sum()
    return result


def profile_of(fit: Fit, factor: float) -> Profile:
    """The data's say on ε, with all other parameters at their best for it; `factor` divides the information."""
    parameters, facts = fit.state.parameters, fit.chain.facts
    _, slope, believed = quadratic(facts, parameters)
    _, other_slope, other = quadratic(facts[:-1], parameters)
    information = (fit.reduced.information - believed) / factor + other
    gradient = (fit.reduced.gradient - slope) / factor + other_slope
    rest = np.flatnonzero(fit.free[:PARAMETERS])
    scale = 1 / np.sqrt(np.maximum(np.diag(information)[rest], 1e-300))
    inner = information[np.ix_(rest, rest)] * scale * scale[:, None] + 1e-13 * np.eye(len(rest))
    border = np.column_stack([information[rest, SKEW], gradient[rest]]) * scale[:, None]
    solved = scale[:, None] * np.linalg.solve(inner, border)
    curvature = information[SKEW, SKEW] - information[SKEW, rest] @ solved[:, :3]
    curvature = 0.5 * (curvature + curvature.T)
    skewed = parameters[SKEW]
    pull = curvature @ skewed - (gradient[SKEW] - information[SKEW, rest] @ solved[:, 3])
    gain, shift = np.zeros((PARAMETERS, 3)), np.zeros(PARAMETERS)
    gain[rest] = -solved[:, :3]
    shift[rest] = -solved[:, 3] + solved[:, :3] @ skewed
    return Profile(curvature, pull, gain, shift)


def _doubt(fit: Fit, angle: Array, prior: SkewPrior, factor: float) -> str:
    """Why a skew that the data ask for is none of the chips: too large for one, or not there all the time."""
    size = float(np.degrees(np.linalg.norm(angle)))
    most = float(np.degrees(prior.most))
    remedy = "calibrate where it is even, away from steel and in one place"
    if np.linalg.norm(angle) > prior.most:
        return (
            f"the field varies along the way: it would take chips that are {size:.1f}° askew, and boards are within "
            f"{most:.0f}°; {remedy}, or say that they are (misalignment={np.ceil(size):.0f}°)"
        )
    count = len(fit.chain.windows)
    if count < _LEAST_SPLIT:
        return ""
    first, second = (_of_part(fit, rows, factor) for rows in (slice(0, count // 2), slice(count // 2, count)))
    apart = first.value - second.value
    if float(apart @ np.linalg.solve(first.covariance + second.covariance, apart)) < prior.apart:
        return ""
    one, two = (np.degrees(part.value).round(1).tolist() for part in (first, second))
    return (
        f"the field varies along the way: the first half of the recording shows chips that are askew by {one}° about "
        f"x, y, z, the second half by {two}°; {remedy}"
    )


class _Angle(NamedTuple):
    """ε (3,) and its covariance (3, 3)."""

    value: Array
    covariance: Array


def _of_part(fit: Fit, rows: slice, factor: float) -> _Angle:
    """ε of some of the windows alone, held by the widest prior."""
    links = slice(rows.start, rows.stop - 1)
    chain = fit.chain.part(rows.start, rows.stop)
    state = ChainState(fit.state.parameters, fit.state.direction[:, rows])
    weights = Weights(fit.weights.window[rows], fit.weights.link[links])
    _, reduced = chain.settle(state, weights)
    part = replace(fit, chain=chain, state=state, weights=weights, reduced=reduced)
    profile = profile_of(part, factor)
    held_by = quadratic(chain.facts[-1:], state.parameters)[2][SKEW, SKEW]
    covariance = np.linalg.inv(profile.information + held_by).astype(np.float64)
    return _Angle(covariance @ profile.pull, covariance)
