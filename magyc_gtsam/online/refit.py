"""Refit of all windows kept, as in the batch method, including noise levels and robust weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error import ModelError, model_error
from magyc_gtsam.estimators.smoother import axes
from magyc_gtsam.estimators.smoother.clock_drift import with_drift
from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.marginal import BIAS, ContinuedChain, continued
from magyc_gtsam.estimators.smoother.noise_levels import adapt
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.preparation import (
    magnetometer_noise,
    preintegrate,
    short_term_noise,
    suitable_turn,
)
from magyc_gtsam.estimators.smoother.search import (
    disturbed,
    fit_field_chain,
    moved,
    refit_field_chain,
    shortened,
    with_skew,
)
from magyc_gtsam.estimators.smoother.smoother import prior_contradictions
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.buffers import IntegratedWindows
from magyc_gtsam.online.random_walk import filter_walk, fit_random_walk
from magyc_gtsam.online.report import LEAST_STABLE, drift_of, observable, report_of, testable
from magyc_gtsam.online.restart import restart_after_change, restart_at_convergence
from magyc_gtsam.online.soft_iron_change import soft_iron_change
from magyc_gtsam.online.stability import agree, is_stable, to_compare
from magyc_gtsam.online.state import Estimate, SmootherState
from magyc_gtsam.recording import Array, Recording

_MOVED = 3.0  # ratio of the field's spread to its short-term noise below which the sensor has not turned
SHORTEST_TAIL = 24  # windows
REFIT_GROWTH = 1.25  # growth of the windows between two refits
_SEARCH = 1.5  # growth of the windows between two fits that do not begin at the estimate
_NOISE_WINDOWS = 60  # fewest windows after a step for which noise levels are estimated
_MOST_LOOKED_BACK = 400  # largest number of windows that are searched for steps when the estimate has converged


def nothing_turned(recording: Recording) -> str:
    """Return the reason why there is nothing to fit; empty if the field varied by more than its noise."""
    field = recording.magnetometer.value
    spread, noise = float(np.sqrt(field.var(axis=0).mean())), magnetometer_noise(recording)
    return "" if spread > _MOVED * noise else "too little motion: nothing turned yet"


def fit_batch(recording: Recording, start: Array | None, options: SmootherOptions) -> tuple[Fit, Preintegration]:
    """Return the fit and the windows, from `start` (13,) or without a start.

    Raises:
        MagycError: the axes of the sensors disagree, or there are too few data.
    """
    fit = fit_field_chain(recording, options, start=start)
    samples = preintegrate(recording, options.window, options.turn)
    if len(samples.starts) != len(fit.chain.windows):  # windows are shorter in disturbed stretches
        samples = preintegrate(recording, shortened(options.window), options.turn)
    return fit, samples


def fit_samples(online: SmootherState, recording: Recording, search: bool) -> tuple[Fit, Preintegration]:
    """Fit all samples kept, from the estimate or, for a search, without a start; return the fit and the windows."""
    belief, settings = online.belief, online.settings
    if belief.past is None:
        start = None if search or belief.estimate is None else belief.estimate.parameters
        return fit_batch(recording, start, online.fit_options)
    parameters, noise = online.last.parameters[:PARAMETERS], online.last.noise
    samples = online.buffer.windows(int(online.buffer.numbers[0]), belief.done, online.delay)
    fewer = len(samples.starts) < _NOISE_WINDOWS or settings.noise is not None
    short_term = None if fewer else short_term_noise(recording)
    windows = samples.integrate(parameters[BIAS], online.delay)
    initial = begin(
        ContinuedChain(windows, short_term or noise, belief.past), parameters, settings.free(parameters)
    )

    def refitted(fit: Fit) -> Fit:
        return refit_field_chain(samples, fit, settings.reject, short_term)

    fit, (prior, known) = refitted(initial), online.skew
    return fit if prior is None else with_skew(fit, refitted, prior, known), samples


def refit_from_windows(online: SmootherState, integrated: IntegratedWindows) -> Fit | None:
    """Fit all windows with their noise levels and weights; return None if they must be cut or integrated again."""
    settings, buffer = online.settings, online.buffer
    if settings.turn is None and suitable_turn(buffer.magnetometer.value) != buffer.turn:
        return None
    windows, parameters = (
        integrated.of(buffer, online.belief.origin),
        online.last.parameters[:PARAMETERS],
    )
    short_term = short_term_noise(buffer) if settings.noise is None else None
    # Start from the sensors' short-term noise, as the batch method does, so that both end at the same tolerance.
    chain = FieldChain(windows, short_term or online.last.noise, facts=online.facts())
    initial = begin(chain, parameters, settings.free(parameters))
    fit = adapt(descend(initial, NEAR), settings.reject, short_term)
    # Descend once more, since a start this near leaves the directions at their initial values.
    fit = descend(replace(fit, reduced=fit.chain.eliminate(fit.state, fit.weights)))
    prior, known = online.skew
    if prior is not None:
        fit = with_skew(fit, lambda wide: adapt(wide, settings.reject, short_term), prior, known)
    newly_disturbed = buffer.length == settings.window and disturbed(fit)
    return None if moved(fit) or (settings.reject and newly_disturbed) else fit


def refit(online: SmootherState) -> None:
    """Fit all windows kept, and form head and tail again."""
    belief, settings = online.belief, online.settings
    count = len(online.numbers())
    search = _plan_next(online, count)
    if belief.front is not None:
        _walk(online)
        return
    later = search and settings.detect_changes and count >= LEAST_STABLE
    recording = online.recording(belief.done)
    belief.problem, belief.disagree = nothing_turned(recording) if belief.estimate is None else "", False
    if belief.problem:
        return
    try:
        fit, samples = fit_samples(online, recording, search)
        if belief.past is not None:
            fit, samples = _with_soft_iron_of_now(online, recording, fit, samples)
        estimate, report = _report(online, recording, fit, count)
        if belief.past is not None and count >= LEAST_STABLE and not (report.converged and belief.stable):
            alone = _without_past(online, recording, report)
            if alone is not None:
                fit, samples = alone
                estimate, report = _report(online, recording, fit, count)
    except MagycError as problem:
        _give_up(online, problem)
        if later:
            restart_after_change(online, online.middle)
        return
    if not report.converged and belief.past is None:
        try:
            axes.check(recording)  # a fit that starts at an earlier one leaves it out
        except MagycError as problem:
            _give_up(online, problem)
            return
    if later and not report.converged and belief.drift is None and restart_after_change(online, online.middle):
        return
    judged_by = to_compare(online, fit, report)
    if belief.past is None and not observable(report):
        belief.head, belief.estimate, belief.stable = None, None, False  # nothing to continue from
        belief.refitted = None if judged_by is None else belief.refitted
        return
    numbers = _form_head_and_tail(online, fit, samples)
    belief.estimate = estimate
    if settings.walks and count >= LEAST_STABLE:
        _walk(online)
        return
    was_stable, belief.stable = (
        belief.stable,
        report.converged and count >= LEAST_STABLE and is_stable(online, fit),
    )
    belief.refitted = judged_by
    if settings.detect_changes and belief.stable and not was_stable and len(numbers) <= _MOST_LOOKED_BACK:
        restart_at_convergence(online, fit, report)


def _with_soft_iron_of_now(
    online: SmootherState, recording: Recording, fit: Fit, samples: Preintegration
) -> tuple[Fit, Preintegration]:
    """Return fit and windows since a step, the past widened if the soft iron changed; store what else it may cause."""
    belief, colour = online.belief, online.last.colour
    change = soft_iron_change(fit, colour)
    if change is not None and change.probable:
        belief.past = change.past
        fit, samples = fit_samples(online, recording, False)
        change = soft_iron_change(fit, colour)
    # Parameters that walk replace what the model does not explain.
    belief.iron_change = None if change is None or online.settings.walks else change.component
    return fit, samples


def _without_past(
    online: SmootherState, recording: Recording, report: Calibration
) -> tuple[Fit, Preintegration] | None:
    """Drop the past if the windows kept are trusted without it but contradict it, as after a sensor was replaced.

    Args:
        online: the state of the smoother.
        recording: the samples of the windows kept.
        report: the calibration of these windows with the past.

    Returns:
        Their fit and windows; None if the past is kept.
    """
    belief, kept = online.belief, (online.belief.past, online.belief.unexplained, online.belief.iron_change)
    belief.past = belief.unexplained = belief.iron_change = None
    try:
        fit, samples = fit_batch(recording, None, online.fit_options)
        alone = report_of(online, recording, fit)
        if alone.converged and not (report.converged and agree(report, alone)):
            return fit, samples
    except MagycError:  # they do not determine a calibration
        pass
    belief.past, belief.unexplained, belief.iron_change = kept
    return None


def _give_up(online: SmootherState, problem: MagycError) -> None:
    """Report axes that disagree, or too little motion; the next refit tries again with more data."""
    belief = online.belief
    belief.problem, belief.head, belief.stable = str(problem), None, False
    if belief.past is None:  # otherwise the next refit begins at the estimate
        belief.estimate = None
    belief.disagree = isinstance(problem, axes.SensorsDisagree)
    belief.report = None  # of a fit that the problem contradicts


def _plan_next(online: SmootherState, count: int) -> bool:
    """Set the windows at which the next refit and search are due; return whether the present refit searches."""
    belief = online.belief
    search = belief.past is None and (
        belief.estimate is None or (not belief.stable and count >= belief.next_search)
    )
    restarted = belief.given_up > 0 and count >= LEAST_STABLE  # with windows enough to converge at the next refit
    few = (belief.estimate is None and not restarted) or belief.front is not None
    belief.next_refit = max(int((_SEARCH if few else REFIT_GROWTH) * count), count + 8)
    if search:
        belief.next_search = int(_SEARCH * count)
    return search


def _report(online: SmootherState, recording: Recording, fit: Fit, count: int) -> tuple[Estimate, Calibration]:
    """Store doubt, model error, clock drift and calibration for the reader; return estimate and calibration."""
    belief = online.belief
    estimate = Estimate(fit.state.parameters, fit.covariance, fit.chain.noise, fit.colour, fit.noise_freedom)
    belief.doubt = "" if fit.skew is None else fit.skew.doubt
    if belief.past is None:
        belief.contradictions = prior_contradictions(recording, online.fit_options, fit)
    if online.settings.walks:  # the residuals' correlation includes that of the walk
        estimate = estimate._replace(colour=1.0)
    else:
        unexplained = model_error(fit, recording)
        if (
            belief.past is None
            or belief.unexplained is None
            or _hard_iron(unexplained) > _hard_iron(belief.unexplained)
        ):
            belief.unexplained = unexplained  # the larger one, since marginalised windows keep that of the past
    belief.report = report = report_of(online, recording, fit, refitted=estimate, doubts=belief.contradictions)
    if testable(online, count):
        belief.drift = drift_of(online, recording, fit, report.converged)
        belief.report = report = with_drift(report, belief.drift)
    return estimate, report


def _form_head_and_tail(online: SmootherState, fit: Fit, samples: Preintegration) -> Array:
    """Marginalise the windows before the tail; return the numbers of all windows kept."""
    belief, buffer = online.belief, online.buffer
    tail = max(SHORTEST_TAIL, len(online.numbers(belief.tail)) if belief.undecided else 0)
    if (samples.length, samples.turn) != (buffer.length, buffer.turn):
        buffer.cut_windows(samples.length, samples.turn)
        belief.done = int(buffer.numbers[len(samples.magnetometer_time) - 1])
        belief.misfit_from = None  # the windows have other numbers
    belief.origin = np.append(fit.chain.windows.bias, fit.chain.windows.delay)
    numbers = online.numbers()
    first = max(len(numbers) - tail, 2)
    belief.head, belief.tail = (
        continued(fit).marginalise(fit.state, fit.weights, first),
        int(numbers[first]),
    )
    return numbers


def _hard_iron(error: ModelError) -> float:
    """Return the variance of the hard iron by the model error, T²."""
    return float(np.trace(error.covariance[6:9, 6:9]))


def _walk(online: SmootherState) -> None:
    """Refit where parameters walk at random, by filtering all windows again."""
    belief = online.belief
    filter_walk(online)
    fit = fit_random_walk(online, belief.done)
    belief.estimate = online.last._replace(parameters=fit.state.parameters, covariance=fit.covariance)
    belief.report = report_of(online, online.recording(belief.done, belief.tail), fit, belief.tail, online.last)
    belief.stable = belief.report.converged and is_stable(online, fit)
    belief.refitted = np.array([belief.estimate.parameters, np.sqrt(np.diag(belief.estimate.covariance))])
