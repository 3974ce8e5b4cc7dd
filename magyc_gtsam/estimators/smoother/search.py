"""From a recording to the field chain at its lowest minimum, without a start or a noise level from the user."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from magyc_gtsam.estimators.field_jumps import field_jumps
from magyc_gtsam.estimators.smoother import axes, starts
from magyc_gtsam.estimators.smoother.dip import dip_fact, dip_of, relinearised
from magyc_gtsam.estimators.smoother.fit import NEAR, PATIENCE, ROUNDS, Fit, adapt, begin, descend, misfit, weigh
from magyc_gtsam.estimators.smoother.known import Known, known_of
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.skew import AUTOMATIC, SkewPrior, asked, given, on_skew, skew_of, widened
from magyc_gtsam.factors.chain.chain_values import ChainState, SensorNoise, Weights
from magyc_gtsam.factors.chain.facts import LinearFact
from magyc_gtsam.factors.chain.field_chain import DELAY, PARAMETERS, FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording, Samples

Progress = Callable[[float], None]

_MOVED = 0.02  # rad by which bias or delay may turn a window before the gyroscope is integrated again
_TRIPLETS = 1000  # samples at which the short-term noise is taken
_EXPLAINED = 2.0  # cost per residual at the short-term noise up to which no other start is needed
_CLOSE = 1.1  # ratio of two minima's misfits from which they count as close
_EQUAL = 1.01  # ratio of misfits up to which minima count as equal
_APART = 0.05  # distance of two minima's hard irons, in field strengths, from which they differ
_UNDISTURBED = 0.97  # share of the windows' weight from which their length stays as it is
_SHORT_WINDOW = 0.5  # s, where stretches are disturbed
_LEAST_WINDOWS = 8
_MOST_DELAY = 1.0  # s, as of the option
_AGAIN = 6  # fits at the most until gyroscope and dip are close to the minimum
_ROUNDS_JUMPED = 9  # of weights and noise levels, where the field jumps
_LEAST_EVEN = 0.5  # share of the windows' weight from which a field that jumps is even but for some stretches


def fit_field_chain(
    recording: Recording,
    options: SmootherOptions | None = None,
    *,
    start: Array | None = None,
    progress: Progress = lambda _: None,
    patience: int = PATIENCE,
    **chosen: Any,
) -> tuple[Fit, Fit | None]:
    """The chain at its lowest minimum, and the best different minimum if one is close.

    Args:
        recording: with magnetometer and gyroscope.
        options: of the smoother; without them, those that are `chosen` by name, and no skew.
        start: θ near the minimum; then no other start is tried.
        progress: called with the share done.
        patience: see `Fit`.
    """
    if options is None:
        options = SmootherOptions(**{"misalignment": 0, **chosen})
    noise, delay, window, turn, reject = options.noise, options.delay, options.window, options.turn, options.reject
    known = known_of(options)
    samples = preintegrate(recording, window, turn)
    free = np.ones(PARAMETERS, dtype=bool)
    free[DELAY] = delay is None
    windows = samples.integrate(delay=delay or 0.0)
    if len(windows) < _LEAST_WINDOWS:
        raise MagycError(
            f"{len(windows)} windows of {window:g} s, at least {_LEAST_WINDOWS} are needed: "
            "record longer (a minute or more), or move"
        )
    short_term = short_term_noise(recording) if noise is None else None
    level = short_term or SensorNoise(*noise)  # type: ignore[misc]
    chain = FieldChain(windows, level, facts=(*known.facts, *dip_fact(recording, options.place)))
    skew = skew_prior(options, known)

    def skewed(fit: Fit) -> Fit:
        if skew is None:
            return fit
        return with_skew(fit, lambda wide: _adapted(samples, wide, reject, short_term), skew, known.skew)

    progress(0.2)
    if start is None:
        begun = starts.from_gyroscope(windows)
        if known.soft_iron is not None and known.hard_iron is not None:
            begun = starts.from_prior(windows, known.soft_iron, known.hard_iron, begun[9:12])
        best = _descended(samples, begin(chain, begun, free, patience))
        explained = best.converged and best.reduced.cost < 0.5 * _EXPLAINED * 3 * len(windows)
        progress(0.4)
        if not explained or level.magnetometer > 0.1 * _strength(best):
            axes.check(recording)  # the misfit is more than the sensors' noise: their axes may disagree
        jumps = not explained and bool(field_jumps(recording))
        rival = None
        if jumps:
            # Where the field jumps no start fits: the search would take many times as long and find as little.
            best = _adapted(samples, best, reject, short_term, _ROUNDS_JUMPED)
            if best.weights.window.mean() < _LEAST_EVEN:
                return best, None
        best = _adapted(samples, best, reject, short_term)
    else:
        near = begin(chain, start[:PARAMETERS], free, patience)
        best, rival, explained = refit_field_chain(samples, near, reject, short_term), None, True
    best = skewed(best)
    if not explained and best.skew is not None and best.skew.decided:
        explained = best.converged and misfit(best, level) < _EXPLAINED * 3 * len(windows)
    if start is None and (not explained or level.magnetometer > 0.1 * _strength(best)):
        # The misfit is more than the sensors' noise: the minimum may be a false one.
        fits = [best]
        for parameters in starts.others(windows, best.state.parameters[9:12]):
            progress(0.4 + 0.1 * len(fits))
            fit = _descended(samples, begin(chain, parameters, free, patience))
            if abs(fit.state.parameters[DELAY]) < _MOST_DELAY:  # else it ran away
                fits.append(_adapted(samples, fit, reject, short_term))
        best, rival = _lowest(fits)
        best = best if best is fits[0] else skewed(best)
    if reject and disturbed(best):
        progress(0.8)
        # Shorter windows lose less at the edges of disturbed stretches.
        samples = preintegrate(recording, shortened(window), turn)
        finer = _adapted(samples, _rewindowed(samples, _without_skew(best)), reject, short_term)
        others = [fit for fit in (rival, best) if fit is not None and _apart(fit, finer)]
        rival = next((fit for fit in others if _close(weigh(finer.chain, fit.state.parameters), finer)), None)
        best = skewed(finer)
    return best, rival


def skew_prior(options: SmootherOptions, known: Known) -> SkewPrior | None:
    """What is believed of a skew; None where it is held at none."""
    if options.misalignment == 0:
        return None
    if known.skew is not None:
        return given(AUTOMATIC.widest)
    return AUTOMATIC if options.misalignment == "auto" else given(float(options.misalignment))


def with_skew(fit: Fit, adapted: Callable[[Fit], Fit], prior: SkewPrior, known: LinearFact | None = None) -> Fit:
    """A fit of thirteen parameters that says what the data say of a skew; fitted with it where that is decided.

    Args:
        fit: at its minimum.
        adapted: a fit of sixteen parameters at its own, with its noise levels and weights.
        prior, known: what is believed of a skew, and what an earlier calibration says of it.
    """
    if known is None and len(fit.state.parameters) == PARAMETERS and dip_of(fit) is None:
        skew = asked(fit, prior)
        if skew.probability <= prior.tested:
            return fit.saying(skew)
    wide = widened(fit, prior, known)
    skew = skew_of(wide, prior, 1.0, decide=False)
    if skew.probability > prior.tested:
        try:
            wide = adapted(descend(wide))
        except MagycError:  # it ran away, as where the field jumps
            return fit.saying(skew_of(widened(fit, prior, known), prior, 1.0).undecided())
        skew = skew_of(wide, prior, wide.colour * wide.widening)
        if skew.decided and wide.converged and positive(wide):
            return wide.saying(skew)
    return fit.saying(skew.undecided())


def _without_skew(fit: Fit) -> Fit:
    """The same with thirteen parameters."""
    if len(fit.state.parameters) == PARAMETERS:
        return fit
    chain = replace(fit.chain, facts=tuple(f for f in fit.chain.facts if not on_skew(f)))
    state = fit.state._replace(parameters=fit.state.parameters[:PARAMETERS])
    reduced = chain.eliminate(state, fit.weights)
    return replace(fit, chain=chain, state=state, reduced=reduced, free=fit.free[:PARAMETERS], skew=None)


def disturbed(fit: Fit) -> bool:
    """Whether so much is weighed down that shorter windows lose less."""
    return bool(fit.weights.window.mean() < _UNDISTURBED)


def shortened(window: float) -> float:
    """s, the longest window where stretches are disturbed."""
    return min(0.5 * window, _SHORT_WINDOW)


def refit_field_chain(samples: Preintegration, fit: Fit, reject: bool, short_term: SensorNoise | None) -> Fit:
    """The minimum next to that of a chain over the samples' windows."""
    return _adapted(samples, _descended(samples, fit), reject, short_term)


def _rewindowed(samples: Preintegration, fit: Fit) -> Fit:
    """The same minimum with other windows, each weighed as the one it lies in."""
    parameters = fit.state.parameters
    windows = samples.integrate(parameters[9:12], parameters[DELAY])
    chain = FieldChain(windows, fit.chain.noise, facts=fit.chain.facts)
    before = fit.chain.windows.time
    nearest = np.searchsorted(0.5 * (before[1:] + before[:-1]), chain.windows.time)
    weights = Weights(fit.weights.window[nearest], chain.unweighted().link)
    state = chain.start(parameters)
    begun = replace(fit, chain=chain, state=state, weights=weights, reduced=chain.eliminate(state, weights))
    return descend(begun, NEAR)


def _lowest(fits: list[Fit]) -> tuple[Fit, Fit | None]:
    """The minimum of lowest robust misfit, and a different one within `_CLOSE` of it.

    Minima found with different noise levels and weights are compared at one noise, each residual counting
    up to its rejection threshold; a soft iron that is not positive definite counts only if all are so.
    """
    possible = [fit for fit in fits if positive(fit)] or fits
    noise = min((fit.chain.noise for fit in possible), key=lambda noise: noise.magnetometer)
    ranked = sorted(possible, key=lambda fit: misfit(fit, noise))
    # Where the motion leaves a direction open, all of its minima explain the data: take the roundest.
    equal = [fit for fit in ranked if misfit(fit, noise) < _EQUAL * misfit(ranked[0], noise)]
    best = min(equal, key=lambda fit: float(np.linalg.cond(unvech(fit.state.parameters[:6]))))
    rival = next((fit for fit in ranked if _apart(fit, best)), None)
    return best, rival if rival is not None and misfit(rival, noise) < _CLOSE * misfit(best, noise) else None


def _close(fit: Fit, best: Fit) -> bool:
    """Whether another calibration explains the windows of `best` almost as well."""
    noise = best.chain.noise
    return misfit(fit, noise) < _CLOSE * misfit(best, noise)


def _adapted(
    samples: Preintegration, fit: Fit, reject: bool, short_term: SensorNoise | None, rounds: int = ROUNDS
) -> Fit:
    """At the minimum with its own noise and weights, the gyroscope integrated, and a dip linearised, close to it."""
    for _ in range(_AGAIN):
        fit = adapt(fit, reject, short_term, rounds)
        if rounds < ROUNDS:
            return _upright(fit)
        fit, settled = relinearised(_upright(fit))
        if settled and not moved(fit):
            return fit
        if fit.hopeless:
            break
        fit = _descended(samples, fit)
    return replace(_upright(fit), converged=False)


def positive(fit: Fit) -> bool:
    """Whether the soft iron is positive definite."""
    return bool(np.linalg.eigvalsh(unvech(fit.state.parameters[:6]))[0] > 0)


def preintegrate(recording: Recording, window: float = 1.5, turn: float | None = None) -> Preintegration:
    """The recording's samples, cut into windows."""
    magnetometer, gyroscope = recording.magnetometer, recording.gyroscope
    return Preintegration(
        *magnetometer,
        *gyroscope,
        interval_mean=recording.angular_rate_is == "interval-mean",
        length=window,
        turn=suitable_turn(magnetometer.value) if turn is None else turn,
    )


def suitable_turn(field: Array) -> float:
    """rad, the largest rotation inside a window, from the spread of the measured field (N, 3).

    Rotation inside a window costs information where it is not small against the field's spread over the whole log;
    at these values some 2 % of the weakest parameter's sigma.
    """
    some = np.ascontiguousarray(field[:: max(len(field) // 500, 1)].T)
    some -= some.mean(axis=1)[:, None]
    spread = np.linalg.eigvalsh(some @ some.T) / (some.shape[1] - 1)
    turn = 1.7 * np.sqrt(max(spread[0], 0.0) / max(spread.sum(), 1e-30))
    # In steps: two ways of cutting a log differ by up to a third of a sigma, which a few samples more must not cause.
    steps = np.round(np.log(max(turn, 0.1) / 0.15) / np.log(1.2))
    return float(np.clip(0.15 * 1.2**steps, 0.15, 0.4))


class Streams(Protocol):
    """Both sensors' own samples, as a `Recording` holds them."""

    @property
    def magnetometer(self) -> Samples: ...

    @property
    def gyroscope(self) -> Samples: ...


def short_term_noise(recording: Streams) -> SensorNoise:
    """Noise per sample and axis from second differences, which smooth motion does not enter."""

    def level(samples: Samples, least: float) -> float:
        value = samples.value
        stride = len(value) // _TRIPLETS | 1  # odd, or every triplet may fall on the same of two interpolated rows
        second = value[2::stride] - 2 * value[1:-1:stride] + value[:-2:stride]
        square = np.einsum("ni,ni->n", second, second) / 18
        # Upper quartile of sqrt(χ²₃/3): drivers that interpolate leave half of the differences at zero.
        upper = 3 * (len(square) - 1) // 4
        return max(float(np.sqrt(np.partition(square, upper)[upper])) / 1.170, least)

    return SensorNoise(level(recording.magnetometer, 1e-10), level(recording.gyroscope, 1e-6))


def _descended(samples: Preintegration, fit: Fit) -> Fit:
    """At the minimum for the noise and weights at hand, the gyroscope integrated close to it."""
    fit = descend(fit, settled=NEAR)
    for _ in range(8):
        if not moved(fit) or fit.hopeless:
            break
        parameters = fit.state.parameters
        chain = replace(fit.chain, windows=samples.integrate(parameters[9:12], parameters[DELAY]))
        state = chain.start(parameters)
        fit = replace(fit, chain=chain, state=state, reduced=chain.eliminate(state, fit.weights))
        fit = descend(fit, settled=NEAR)
    return _upright(fit)


def moved(fit: Fit) -> bool:
    """Whether bias or delay are so far from where the gyroscope was integrated that second order matters."""
    windows, parameters = fit.chain.windows, fit.state.parameters
    turned = np.einsum("ijn,j->in", windows.lever[:, :, windows.linked], parameters[9:12] - windows.bias)
    slid = windows.rotation_rate * (parameters[DELAY] - windows.delay)
    return bool(np.abs(turned).max(initial=0.0) > _MOVED or np.abs(slid).max() > _MOVED)


def _upright(fit: Fit) -> Fit:
    """(B, g) and (−B, −g) are one solution: take the one with positive soft iron."""
    parameters, direction = fit.state
    if parameters[[0, 3, 5]].sum() >= 0:
        return fit
    flipped = parameters.copy()
    flipped[:6] *= -1
    state = ChainState(flipped, -direction)
    return replace(fit, state=state, reduced=fit.chain.eliminate(state, fit.weights))


def _strength(fit: Fit) -> float:
    return float(np.cbrt(abs(np.linalg.det(unvech(fit.state.parameters[:6])))))


def _apart(fit: Fit, other: Fit) -> bool:
    distance = np.linalg.norm(fit.state.parameters[6:9] - other.state.parameters[6:9])
    return bool(distance > _APART * _strength(other))
