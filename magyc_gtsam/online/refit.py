"""A refit: all windows kept, fitted afresh as the batch method does it, noise levels and weights with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from magyc_gtsam.estimators.model_error import ModelError, model_error
from magyc_gtsam.estimators.smoother.clock_drift import Drift, find_drift, slowed, with_drift
from magyc_gtsam.estimators.smoother.fit import Fit, begin
from magyc_gtsam.estimators.smoother.search import (
    fit_field_chain,
    preintegrate,
    refit_field_chain,
    short_term_noise,
    shortened,
    with_skew,
)
from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.factors.chain.field_chain import DELAY, PARAMETERS, SKEW
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.change_point import Step, find_earlier_change, find_step
from magyc_gtsam.online.engine import Change
from magyc_gtsam.online.marginal import BIAS, ContinuedChain
from magyc_gtsam.online.random_walk import filter_walk, fit_random_walk
from magyc_gtsam.online.state import FIRST, Estimate, SmootherState, continued, observable
from magyc_gtsam.recording import Array, Recording, Samples

_MOVED = 3.0  # total spread of the field, in its short-term noise, below which nothing turned
SHORTEST_TAIL = 24  # windows
REFIT_GROWTH, _SEARCH = 1.25, 1.5  # growth between two refits, and between two searches for the start
_STILL = 1.5  # sigma of the refit before by which a parameter may have moved for convergence
_LEAST_STABLE = 80  # windows, below which the noise levels are too uncertain to look for steps and clock drift
_NOISE_WINDOWS = 60  # after a step, before the noise levels are estimated again
_MOST_LOOKED_BACK = 400  # windows that are searched for steps when the estimate has converged


def on_one_clock(online: SmootherState, magnetometer: Samples) -> Samples:
    """With the stamps that a known drift leaves."""
    m, drift = online.belief, online.settings.clock_drift
    if not drift or not len(magnetometer.time):
        return magnetometer
    if np.isnan(m.clock_start):
        m.clock_start = float(magnetometer.time[0])
    return Samples(slowed(magnetometer.time, m.clock_start, drift), magnetometer.value)


def testable(online: SmootherState, windows: int) -> bool:
    """Whether so many windows are all there is, and enough."""
    return online.belief.past is None and not online.settings.walks and windows >= _LEAST_STABLE


def drift_of(online: SmootherState, recording: Recording, fit: Fit, trusted: bool) -> Drift | None:
    """How the sensors' clocks drift apart in all windows kept, as `find_drift` says; None where they keep step.

    It is asked at every refit, and when something is read if the refit before found nothing. Where the clocks keep
    step that costs one solve, else some ten fits. A result that the drift harms has not converged: nothing is
    marginalised then, and no step in hard iron is looked for. Once something has been marginalised (after an hour, or
    a step), and where parameters walk, what comes later is not tested.
    """

    def fit_again(again: Recording, start: Array | None) -> tuple[Fit, bool]:
        fit, rival = fit_field_chain(again, **online.settings.fit, **online.known, start=start)
        return fit, online.result(again, fit, rival).converged

    known = online.belief.drift
    drift = find_drift(recording, fit, trusted, fit_again, 0.0 if known is None else known.rate)
    return None if drift is None else drift._replace(known=online.settings.clock_drift)


def fit_batch(
    recording: Recording, start: Array | None, options: Mapping[str, Any]
) -> tuple[Fit, Fit | None, Preintegration]:
    """The fit, a close rival, and the windows; from `start` (13,), or from several starts.

    Raises:
        MagycError: axes that disagree, or data too short.
    """
    fit, rival = fit_field_chain(recording, start=start, **options)
    samples = preintegrate(recording, options["window"], options["turn"])
    if len(samples.starts) != len(fit.chain.windows):  # disturbed stretches were found, so shorter windows taken
        samples = preintegrate(recording, shortened(options["window"]), options["turn"])
    return fit, rival, samples


def nothing_turned(recording: Recording) -> str:
    """Why there is nothing to fit; empty where the field varied by more than its noise."""
    field = recording.magnetometer.value
    spread, noise = float(np.sqrt(field.var(axis=0).mean())), short_term_noise(recording).magnetometer
    return "" if spread > _MOVED * noise else "too little motion: nothing turned yet"


def restart(online: SmootherState, numbers: Array, step: Step) -> None:
    """The hard iron is another one since `step` in the windows `numbers`; all else that is known still holds."""
    m = online.belief
    recording = online.recording(int(numbers[step.window]), int(numbers[0]))
    before = online.result(recording, step.before, None, int(numbers[0]), online.last)
    known = observable(before)
    # Where nothing was known before, the step is known no better than the hard iron was.
    sigma = step.sigma if known else np.hypot(step.sigma, before.sigma["hard_iron"])
    m.changes.append(Change(step.time, step.time_sigma, step.value, sigma, before, None))
    if not known:
        online.begin_at(int(numbers[step.window]))
        return
    m.head, m.tail = step.past, int(numbers[step.window - 1])
    online.close()
    after = step.after
    m.estimate = online.last._replace(parameters=after.state.parameters, covariance=after.covariance)
    m.front, m.undecided = None, False
    m.refitted, m.stable, m.settled, m.next_refit = None, False, False, FIRST


def restart_after_change(online: SmootherState) -> bool:
    """Begin afresh where the log begins to fit, if it does not as a whole but its second half does.

    What is before is left out: the hard iron was another one, which is a change, or the field of the place.
    """
    numbers, done, options = online.numbers(), online.belief.done, online.settings.fit
    middle = int(numbers[len(numbers) // 2])
    recording = online.recording(done, middle)
    try:
        fit, rival, _ = fit_batch(recording, None, options)
        now = online.result(recording, fit, rival)
        parameters = fit.state.parameters
        windows = online.buffer.windows(int(numbers[0]), done, parameters[DELAY])
        chain = ContinuedChain(windows.integrate(parameters[BIAS], parameters[DELAY]), fit.chain.noise)
        found = find_earlier_change(chain, parameters) if now.converged else None
    except MagycError:
        return False  # nor does the half; more data will tell
    if found is None:
        return False
    if found.in_sensor:
        sigma = np.hypot(found.sigma, now.sigma["hard_iron"])
        before = replace(
            now,
            hard_iron=now.hard_iron - found.step,
            converged=False,
            message="the soft iron and the bias since the step, and the hard iron that the field before it suggests",
        )
        online.belief.changes.append(Change(found.time, found.time_sigma, found.step, sigma, before, None))
    online.begin_at(int(numbers[found.window]))
    return True


def refit(online: SmootherState) -> None:
    """Fit all windows kept; then head and tail anew."""
    m, buffer, settings = online.belief, online.buffer, online.settings
    count = len(online.numbers())
    search = m.past is None and (m.estimate is None or (not m.stable and count >= m.next_search))
    few = m.estimate is None or m.front is not None
    m.next_refit = max(int((_SEARCH if few else REFIT_GROWTH) * count), count + 8)
    if search:
        m.next_search = int(_SEARCH * count)
    if m.front is not None:
        _walk(online)
        return
    later = search and settings.detect_changes and _LEAST_STABLE <= count <= _MOST_LOOKED_BACK
    recording = online.recording(m.done)
    m.problem = nothing_turned(recording) if m.estimate is None else ""
    if m.problem:
        return
    try:
        fit, rival, samples = fit_samples(online, recording, search)
    except MagycError as problem:  # axes that disagree, too little motion: said, and tried again with more data
        m.problem, m.head, m.estimate, m.stable = str(problem), None, None, False
        if later:
            restart_after_change(online)
        return
    estimate = Estimate(fit.state.parameters, fit.covariance, fit.chain.noise, fit.colour, fit.noise_freedom)
    if settings.walks:  # what a walk leaves of them hangs together
        estimate = estimate._replace(colour=1.0)
    m.doubt = "" if fit.skew is None else fit.skew.doubt
    if not settings.walks:
        found = model_error(fit, recording)
        if m.past is None or m.unexplained is None or _hard_iron(found) > _hard_iron(m.unexplained):
            m.unexplained = found  # that of the past stays in what was marginalised
    m.report = online.result(recording, fit, rival, refitted=estimate)
    if testable(online, count):
        m.drift = drift_of(online, recording, fit, m.report.converged)
        m.report = with_drift(m.report, m.drift)
    if later and not m.report.converged and m.drift is None and restart_after_change(online):
        return
    if m.past is None and not observable(m.report):
        m.head, m.estimate, m.stable = None, None, False  # nothing to continue from
        return
    tail = max(SHORTEST_TAIL, len(online.numbers(m.tail)) if m.undecided else 0)
    if (samples.length, samples.turn) != (buffer.length, buffer.turn):
        buffer.cut_windows(samples.length, samples.turn)
        m.done = int(buffer.numbers[len(samples.magnetometer_time) - 1])
    m.origin = np.append(fit.chain.windows.bias, fit.chain.windows.delay)
    numbers, chain = online.numbers(), continued(fit)
    first = max(len(numbers) - tail, 2)
    m.head, m.tail = chain.marginalise(fit.state, fit.weights, first), int(numbers[first])
    m.estimate = estimate
    if settings.walks and count >= _LEAST_STABLE:
        _walk(online)
        return
    was_stable, m.stable = m.stable, m.report.converged and count >= _LEAST_STABLE and _is_stable(online, fit)
    m.refitted = np.array([m.estimate.parameters, np.sqrt(np.diag(m.estimate.covariance))])
    if settings.detect_changes and m.stable and not was_stable and len(numbers) <= _MOST_LOOKED_BACK:
        # Steps before the estimate was good enough to see them.
        held = settings.free(fit.state.parameters)
        step, _ = find_step(replace(fit, chain=chain, free=held), m.estimate.colour)
        if step is not None:
            restart(online, numbers, step)


def fit_samples(
    online: SmootherState, recording: Recording, search: bool
) -> tuple[Fit, Fit | None, Preintegration]:
    """Fit all samples kept; from several starts or from the estimate."""
    m, settings = online.belief, online.settings
    if m.past is None:
        start = None if search or m.estimate is None else m.estimate.parameters
        return fit_batch(recording, start, settings.fit | online.known)
    parameters, noise = online.last.parameters[:PARAMETERS], online.last.noise
    samples = online.buffer.windows(int(online.buffer.numbers[0]), m.done, online.delay)
    fewer = len(samples.starts) < _NOISE_WINDOWS or settings.noise is not None
    short_term = None if fewer else short_term_noise(recording)
    windows = samples.integrate(parameters[BIAS], online.delay)
    begun = begin(ContinuedChain(windows, short_term or noise, m.past), parameters, settings.free(parameters))

    def refitted(fit: Fit) -> Fit:
        return refit_field_chain(samples, fit, settings.reject, short_term)

    fit, (prior, known) = refitted(begun), online.skew
    return fit if prior is None else with_skew(fit, refitted, prior, known), None, samples


def _hard_iron(error: ModelError) -> float:
    """T², by how much the hard iron may have been moved."""
    return float(np.trace(error.covariance[6:9, 6:9]))


def _walk(online: SmootherState) -> None:
    """The same where parameters walk: everything is passed anew."""
    m = online.belief
    filter_walk(online)
    fit = fit_random_walk(online, m.done)
    m.estimate = online.last._replace(parameters=fit.state.parameters, covariance=fit.covariance)
    m.report = online.result(online.recording(m.done, m.tail), fit, None, m.tail, online.last)
    m.stable = m.report.converged and _is_stable(online, fit)
    m.refitted = np.array([m.estimate.parameters, np.sqrt(np.diag(m.estimate.covariance))])


def _is_stable(online: SmootherState, fit: Fit) -> bool:
    """Whether no parameter moved by more than sigmas of the refit before, and what it may walk.

    Seen with the skew of the refit before: what one that is decided otherwise moves is in the covariance of both.
    """
    m, estimate = online.belief, online.last
    if m.refitted is None:
        return False
    factor = 2 if m.stable else 1  # convergence is not given up lightly
    variance = estimate.colour * m.refitted[1] ** 2
    hours = (online.buffer.magnetometer.time[-1] - online.buffer.magnetometer.time[0]) / 3600
    for rows, walk in online.settings.walks:
        variance[rows] += walk**2 * hours
    moved = estimate.parameters[:DELAY] - m.refitted[0][:DELAY]
    if fit.skew is not None:
        angles = [with_angles(parameters)[SKEW] for parameters in (m.refitted[0], estimate.parameters)]
        moved += fit.skew.gain[:DELAY] @ (angles[0] - angles[1])
    return bool((np.abs(moved) <= factor * _STILL * np.sqrt(variance[:DELAY])).all())
