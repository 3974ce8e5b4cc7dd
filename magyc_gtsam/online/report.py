"""The reports of the online smoother: calibration, convergence, progress and changes."""

from __future__ import annotations

from dataclasses import replace

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.smoother.clock_drift import drift_is_significant, with_drift
from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, begin, descend
from magyc_gtsam.estimators.smoother.noise_levels import adapt
from magyc_gtsam.estimators.smoother.preparation import short_term_noise, suitable_turn
from magyc_gtsam.estimators.smoother.search import disturbed, moved, with_skew
from magyc_gtsam.estimators.smoother.smoother import prior_contradictions
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.online.all_samples import fit_samples
from magyc_gtsam.online.belief import FIRST
from magyc_gtsam.online.buffers import IntegratedWindows
from magyc_gtsam.online.change_point import LARGE
from magyc_gtsam.online.engine import Change, Progress
from magyc_gtsam.online.excitation import coverage
from magyc_gtsam.online.random_walk import fit_random_walk
from magyc_gtsam.online.recent_change import recent_change
from magyc_gtsam.online.refit import REFIT_GROWTH, drift_of, testable
from magyc_gtsam.online.state import SmootherState

_MOST_REFITTED = (
    2400  # largest number of windows fitted at reading; a longer log keeps the noise levels of the last refit
)
_UNDECIDED = (
    f"the hard iron may have changed by more than {LARGE:.0%} of the field in the last seconds: "
    "keep turning until that is decided"
)
_LEAST_CONVERGED = 120  # fewest windows of the last refit; noise levels from fewer give no reliable covariance


def current_calibration(online: SmootherState, integrated: IntegratedWindows) -> Calibration | None:
    """Return the calibration from all samples so far, or in a long log that of the tail given all windows before.

    While a large step is possible but not decided, the calibration would mix the hard irons before and after it and
    is not trusted.
    """
    calibration = _of_samples_so_far(online, integrated)
    if calibration is None or not calibration.converged or not online.belief.waiting:
        return calibration
    return replace(calibration, converged=False, message=_UNDECIDED)


def _of_samples_so_far(online: SmootherState, integrated: IntegratedWindows) -> Calibration | None:
    belief = online.belief
    if belief.head is None:
        return belief.report
    ending = online.recording(None, belief.tail)
    if belief.past is None and belief.front is None and len(online.numbers()) <= _MOST_REFITTED:
        well_cut = (
            online.settings.turn is not None
            or suitable_turn(online.buffer.magnetometer.value) == online.buffer.turn
        )
        doubts = prior_contradictions(online.recording(None), online.fit_options) if online.prior_applies else []
        fit = _refit_all(online, integrated.of(online.buffer, belief.origin)) if well_cut else None
        recording = ending
        if fit is None:
            recording = online.recording(None)
            fit, _ = fit_samples(online, recording, False)
        change = _recent_change(online, fit)
        return _with_clocks(online, online.result(recording, fit, change=change, doubts=doubts), fit)
    stop = int(online.buffer.numbers[-1]) + 1
    fit = online.fit_tail(stop) if belief.front is None else fit_random_walk(online, stop)
    change = _recent_change(online, fit)
    calibration = online.result(ending, fit, belief.tail, online.last, change, belief.contradictions)
    return with_drift(calibration, belief.drift)


def _recent_change(online: SmootherState, fit: Fit) -> Component | None:
    """Return the error by a recent change of the iron; None if it is not looked for, or walks at random."""
    looked_for = online.settings.detect_changes and not online.settings.walks
    return recent_change(fit) if looked_for else None


def _with_clocks(online: SmootherState, calibration: Calibration, fit: Fit) -> Calibration:
    """Return the calibration with the clock drift of the last refit, or of all windows if that found none."""
    drift = online.belief.drift
    if drift is None and testable(online, len(fit.chain.windows)) and drift_is_significant(fit):
        drift = drift_of(online, online.recording(None), fit, calibration.converged)
    return with_drift(calibration, drift)


def _refit_all(online: SmootherState, windows: FieldWindows) -> Fit | None:
    """Fit all windows with their noise levels and weights; return None if they must be cut or integrated again."""
    settings, parameters = online.settings, online.last.parameters[:PARAMETERS]
    short_term = short_term_noise(online.buffer) if settings.noise is None else None
    # Start from the sensors' short-term noise, as the batch method does, so that both end at the same tolerance.
    chain = FieldChain(windows, short_term or online.last.noise, facts=online.facts())
    initial = begin(chain, parameters, settings.free(parameters))
    fit = adapt(descend(initial, NEAR), settings.reject, short_term)
    # Descend once more, since a start this near leaves the directions at their initial values.
    fit = descend(replace(fit, reduced=fit.chain.eliminate(fit.state, fit.weights)))
    prior, known = online.skew
    if prior is not None:
        fit = with_skew(fit, lambda wide: adapt(wide, settings.reject, short_term), prior, known)
    newly_disturbed = online.buffer.length == settings.window and disturbed(fit)
    return None if moved(fit) or (settings.reject and newly_disturbed) else fit


def has_converged(online: SmootherState) -> bool:
    """Return whether the last refit had enough windows and changed the estimate little."""
    return online.belief.stable and online.belief.next_refit >= int(REFIT_GROWTH * _LEAST_CONVERGED)


def progress_of(online: SmootherState, calibration: Calibration | None) -> Progress:
    """Return the progress, given the current calibration."""
    belief = online.belief
    windows = belief.given_up + len(online.numbers())
    seen = 0.0 if calibration is None else coverage(calibration, online.buffer.magnetometer.value)
    weak = calibration.observability.weak if calibration and calibration.observability else ()
    converged = has_converged(online) and not belief.waiting
    if belief.problem:
        sentence = belief.problem
    elif calibration is None:
        sentence = f"collecting: {windows} of {FIRST} windows"
    elif not calibration.converged:
        sentence = calibration.message
    elif not converged:
        sentence = f"the estimate still changes: {weak[0].sentence if weak else 'keep turning'}"
    else:
        sentence = "converged"
    return Progress(None, 0.0, windows, converged, sentence, weak, seen)


def changes_until(online: SmootherState, calibration: Calibration | None) -> tuple[Change, ...]:
    """Return the steps found, each with the calibration that followed it."""
    changes = online.belief.changes
    after = [change.before for change in changes[1:]] + [calibration]
    return tuple(replace(change, after=now) for change, now in zip(changes, after[: len(changes)], strict=True))
