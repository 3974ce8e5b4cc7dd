"""The search for the lowest minimum of a recording's field chain, without a start or noise level from the user."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from magyc_gtsam.estimators.smoother import axes, starts
from magyc_gtsam.estimators.smoother.dip import dip_fact
from magyc_gtsam.estimators.smoother.fit import BRIEF, NEAR, PATIENCE, Fit, begin, descend
from magyc_gtsam.estimators.smoother.heading import heading_fact
from magyc_gtsam.estimators.smoother.known import PriorKnowledge, known_of
from magyc_gtsam.estimators.smoother.minima import apart, by_a_part, lower, positive, strength
from magyc_gtsam.estimators.smoother.noise_levels import adapt, misfit
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.estimators.smoother.skew import on_skew, skew_from_score, skew_of, widened
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC, SkewPrior, given
from magyc_gtsam.estimators.smoother.vertical import relinearised, upright_facts
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS, ChainState, SensorNoise, Weights
from magyc_gtsam.factors.chain.facts import LinearFact
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.recording import Recording

Progress = Callable[[float], None]

_MOVED = 0.02  # rad; a change of bias or delay that rotates a window by more requires a new integration
_EXPLAINED = 2.0  # cost per residual at the short-term noise up to which the data are explained
_UNDISTURBED = 0.97  # mean weight of the windows from which their length is kept
_SHORT_WINDOW = 0.5  # s, longest window if stretches are disturbed
_LEAST_WINDOWS = 8
_AGAIN = 6  # most fits until the linearisation of gyroscope and dip is close to the minimum


def fit_field_chain(
    recording: Recording,
    options: SmootherOptions | None = None,
    *,
    start: Array | None = None,
    progress: Progress = lambda _: None,
    brief: bool = False,
    **chosen: Any,
) -> Fit:
    """Return the chain at its lowest minimum.

    Args:
        recording: with magnetometer and gyroscope.
        options: of the smoother; None takes the options `chosen` by name, and no misalignment.
        start: θ near the minimum; no start from a part of the recording is tried.
        progress: called with the share done.
        brief: for an auxiliary fit beside a calibration: likewise, the sensors' axes are not compared once more, and a
            descent that does not converge is abandoned earlier.

    Raises:
        MagycError: too few windows, inconsistent axes or units of the sensors, or, if brief, no minimum.
    """
    if options is None:
        options = SmootherOptions(**{"misalignment": 0, **chosen})
    noise, delay, window, turn, reject = options.noise, options.delay, options.window, options.turn, options.reject
    known = known_of(options)
    samples = preintegrate(recording, window, turn)
    patience = BRIEF if brief else PATIENCE
    free = np.ones(PARAMETERS, dtype=bool)
    free[DELAY] = delay is None
    windows = samples.integrate(delay=delay or 0.0)
    if len(windows) < _LEAST_WINDOWS:
        raise MagycError(
            f"{counted(len(windows), 'window')} of {window:g} s, at least {_LEAST_WINDOWS} are needed: "
            "record longer (a minute or more), or move"
        )
    short_term = short_term_noise(recording) if noise is None else None
    level = short_term or SensorNoise(*noise)  # type: ignore[misc]
    upright = (*dip_fact(recording, options.place), *heading_fact(recording, options.known_heading))
    chain = FieldChain(windows, level, facts=(*known.facts, *upright))
    skew = skew_prior(options, known)

    def skewed(fit: Fit) -> Fit:
        if skew is None:
            return fit
        return with_skew(fit, lambda wide: _adapted(samples, wide, reject, short_term), skew, known.skew)

    progress(0.2)
    if start is None:
        begun = begin(chain, starts.from_gyroscope(windows), free, patience)
        if known.soft_iron is not None and known.hard_iron is not None:
            # The earlier hard iron, or the one of these data (it may have changed by far): whichever costs less.
            _, iron, bias = np.split(begun.state.parameters[:12], [6, 9])
            places = (starts.from_prior(windows, known.soft_iron, each, bias) for each in (known.hard_iron, iron))
            begun = min((begin(chain, each, free, patience) for each in places), key=lambda fit: fit.reduced.cost)
        near = descend(begun, NEAR)
        if not near.converged and not brief:
            axes.check(recording)
        best = _reintegrated(samples, near)
        explained = best.converged and best.reduced.cost < 0.5 * _EXPLAINED * 3 * len(windows)
        progress(0.4)
        if near.converged and not brief and (not explained or level.magnetometer > 0.1 * strength(best)):
            axes.check(recording)  # the misfit exceeds the sensors' noise: their axes may be inconsistent
        best = _adapted(samples, best, reject, short_term)
    else:
        begun = begin(chain, start[:PARAMETERS], free, patience)
        best, explained = refit_field_chain(samples, begun, reject, short_term), True
    if best.hopeless:
        if brief:
            raise MagycError(f"no minimum within {best.iterations} iterations")
        return best
    best = skewed(best)
    if not explained and not brief and reject and disturbed(best):
        progress(0.6)
        alone = _without_skew(best)
        part = by_a_part(alone, level, misfit(best, level))
        part = None if part is None else _adapted(samples, part, reject, short_term)
        if part is not None and apart(part, best) and lower(part, best):
            best = skewed(part)
    if reject and disturbed(best):
        progress(0.8)
        # With shorter windows fewer data are lost at the edges of disturbed stretches.
        samples = preintegrate(recording, shortened(window), turn)
        best = skewed(_adapted(samples, _rewindowed(samples, _without_skew(best)), reject, short_term))
    return best


def skew_prior(options: SmootherOptions, known: PriorKnowledge) -> SkewPrior | None:
    """Return the prior of the misalignment; None if it is fixed at zero."""
    if options.misalignment == 0:
        return None
    if known.skew is not None:
        return given(AUTOMATIC.widest)
    return AUTOMATIC if options.misalignment == "auto" else given(float(options.misalignment))


def with_skew(fit: Fit, adapted: Callable[[Fit], Fit], prior: SkewPrior, known: LinearFact | None = None) -> Fit:
    """Return the fit with its misalignment result; with sixteen parameters if the misalignment is to be corrected.

    Args:
        fit: at its minimum, with thirteen parameters.
        adapted: moves a fit of sixteen parameters to its minimum, with its own noise levels and weights.
        prior: of the misalignment.
        known: an earlier calibration's constraint on it.
    """
    if known is None and len(fit.state.parameters) == PARAMETERS and not upright_facts(fit):
        skew = skew_from_score(fit, prior)
        if skew.probability <= prior.probable:
            return fit.with_skew_estimate(skew)
        wide = widened(fit, prior)
    else:
        wide = widened(fit, prior, known)
        skew = skew_of(wide, prior, 1.0, decide=False)
    if skew.probability > prior.probable:
        try:
            wide = adapted(descend(wide, NEAR))
        except MagycError:  # the descent diverged, which happens if the field jumps
            return fit.with_skew_estimate(skew_of(widened(fit, prior, known), prior, 1.0).undecided())
        skew = skew_of(wide, prior, wide.colour * wide.widening)
        if skew.decided and wide.converged and positive(wide):
            return wide.with_skew_estimate(skew)
    return fit.with_skew_estimate(skew.undecided())


def _without_skew(fit: Fit) -> Fit:
    """Return the fit with thirteen parameters, without misalignment."""
    if len(fit.state.parameters) == PARAMETERS:
        return fit
    chain = replace(fit.chain, facts=tuple(f for f in fit.chain.facts if not on_skew(f)))
    state = fit.state._replace(parameters=fit.state.parameters[:PARAMETERS])
    reduced = chain.eliminate(state, fit.weights)
    return replace(fit, chain=chain, state=state, reduced=reduced, free=fit.free[:PARAMETERS], skew=None)


def disturbed(fit: Fit) -> bool:
    """Return whether so many windows are down-weighted that shorter ones would lose fewer data."""
    return fit.trusted_share < _UNDISTURBED


def shortened(window: float) -> float:
    """Return the longest window, in s, for a recording with disturbed stretches."""
    return min(0.5 * window, _SHORT_WINDOW)


def refit_field_chain(samples: Preintegration, fit: Fit, reject: bool, short_term: SensorNoise | None) -> Fit:
    """Descend from a fit to the minimum over the samples' windows, with its own noise levels and weights."""
    return _adapted(samples, _reintegrated(samples, descend(fit, NEAR)), reject, short_term)


def _rewindowed(samples: Preintegration, fit: Fit) -> Fit:
    """Return the minimum over other windows, each with the weight of the nearest earlier window."""
    parameters = fit.state.parameters
    windows = samples.integrate(parameters[9:12], parameters[DELAY])
    chain = FieldChain(windows, fit.chain.noise, facts=fit.chain.facts)
    before = fit.chain.windows.time
    nearest = np.searchsorted(0.5 * (before[1:] + before[:-1]), chain.windows.time)
    weights = Weights(fit.weights.window[nearest], chain.unweighted().link)
    state = chain.start(parameters)
    begun = replace(fit, chain=chain, state=state, weights=weights, reduced=chain.eliminate(state, weights))
    return descend(begun, NEAR)


def _adapted(samples: Preintegration, fit: Fit, reject: bool, short_term: SensorNoise | None) -> Fit:
    """Return the fit at the minimum for its own noise levels and weights, with integration and dip linearised there."""
    for _ in range(_AGAIN):
        fit, settled = relinearised(_upright(adapt(fit, reject, short_term)))
        if settled and not moved(fit):
            return fit
        if fit.hopeless:
            break
        fit = _reintegrated(samples, fit)
    return replace(_upright(fit), converged=False)


def _reintegrated(samples: Preintegration, fit: Fit) -> Fit:
    """Return the minimum with the gyroscope integrated near it, from the minimum `fit` of an integration elsewhere."""
    for _ in range(8):
        if not moved(fit) or fit.hopeless:
            break
        parameters = fit.state.parameters
        chain = replace(fit.chain, windows=samples.integrate(parameters[9:12], parameters[DELAY]))
        state = chain.start(parameters)
        fit = replace(fit, chain=chain, state=state, reduced=chain.eliminate(state, fit.weights))
        fit = descend(fit, NEAR)
    return _upright(fit)


def moved(fit: Fit) -> bool:
    """Return whether bias or delay are so far from the point of integration that second-order terms matter."""
    windows, parameters = fit.chain.windows, fit.state.parameters
    turned = np.abs((parameters[9:12] - windows.bias) @ windows.lever) * windows.linked
    slid = np.abs(windows.rotation_rate).max() * abs(parameters[DELAY] - windows.delay)
    return bool(turned.max() > _MOVED or slid > _MOVED)


def _upright(fit: Fit) -> Fit:
    """Return the equivalent solution with positive soft iron: (B, g) and (−B, −g) fit equally."""
    parameters, direction = fit.state
    if parameters[[0, 3, 5]].sum() >= 0:
        return fit
    flipped = parameters.copy()
    flipped[:6] *= -1
    state = ChainState(flipped, -direction)
    return replace(fit, state=state, reduced=fit.chain.eliminate(state, fit.weights))
