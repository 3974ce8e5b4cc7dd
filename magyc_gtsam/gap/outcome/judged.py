"""The covariance and verdict of a gap's calibration, with the misfit that the model and its terms do not explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.gauge import IronScale, doubt_strength
from magyc_gtsam.estimators.model_error import ModelError, model_error
from magyc_gtsam.estimators.smoother.columns import EstimatedTerms, UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.judged import Posterior, judge
from magyc_gtsam.estimators.smoother.skew import skew_from_score
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.foreign_text import cause_and_action, clauses
from magyc_gtsam.gap.effects.world import turned
from magyc_gtsam.gap.model.descent import prior_of
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.result import Doubt
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.level_turn import MisalignmentError
from magyc_gtsam.recording import Recording

_MIRRORED = "the fit with the effects ended at a mirrored field: choose an interval without them (start=, end=)"
_HARD_IRON = slice(6, 9)  # of the parameters
_OF_ALL_MODES = np.pi**2 / 6  # sum of 1 / k²
_SKEW = "misalignment"  # the term that is the skew of the chips, which is then not estimated a second time


def judged(
    calibration: Calibration,
    result: Refit,
    recording: Recording,
    strength: float | None,
    beyond: Refit | None = None,
) -> tuple[Calibration, Doubt | None]:
    """Return a calibration with covariance and verdict as in `calibrate`, and the reason not to use it, if any.

    Args:
        calibration: of `result`.
        result: the model at its minimum, with a covariance widened by the colour of the misfit.
        recording: the fitted data.
        strength: of the field, T, if it was given.
        beyond: the model with effects that are present but not corrected: its parameters are as probable, or more.
    """
    model, fit = result.model, fit_of(result.twin)
    if all(term.name != _SKEW for term in model.terms):
        fit = fit.with_skew_estimate(skew_from_score(fit, AUTOMATIC))
    sensors = _reaching(beyond or result, model)
    sensors[_HARD_IRON, _HARD_IRON] += _faster_walk(result) * np.eye(3)
    if fit.skew is not None:
        sensors += fit.skew.gain @ fit.skew.covariance @ fit.skew.gain.T
    known, error = Posterior(model.parameters, sensors, fit.skew), model_error(fit, recording)
    soft_iron = unvech(model.parameters[:6])
    unit = IronScale.of(soft_iron, strength).strength
    judgement = judge(known, error, recording, recording, strength, named=_misalignment_error(result, error, unit))
    observability = judgement.observability
    jump = _of_last_jump(result)
    reasons, doubt = [*judgement.reasons, *([jump] if jump else [])], None
    if reasons:
        doubt = Doubt(*cause_and_action(clauses(reasons[0])[0]))
    if not observability.observable:
        weakest = observability.weak[0]
        reasons.insert(0, f"too little motion: {weakest.sentence}")
        doubt = Doubt(f"too little motion to determine the {weakest.what}", weakest.remedy)
    elif wrong := doubt_strength(IronScale.of(soft_iron).strength, None):
        reasons.insert(0, wrong)
        doubt = Doubt(*cause_and_action(wrong))
    if np.linalg.eigvalsh(soft_iron)[0] <= 0:  # and −A and −g explain all readings as A and g do
        reasons.insert(0, _MIRRORED)
        doubt = Doubt(*cause_and_action(_MIRRORED))
    told = [*reasons, calibration.message] if reasons else [calibration.message, judgement.remark]
    late = calibration.delay_sigma is not None
    whole = replace(
        calibration,
        covariance=judgement.reported,
        terms=_widened_terms(calibration.terms, result, error, judgement.delay_variance),
        noise_covariance=judgement.of_sensors,
        delay_sigma=float(np.sqrt(judgement.delay_variance)) if late else None,
        converged=calibration.converged and not reasons,
        message="; ".join(filter(None, told)),
        observability=observability,
        diagnostics={**calibration.diagnostics, **judgement.diagnostics},
    )
    return whole, doubt


def _of_last_jump(result: Refit) -> str:
    """Return why the iron after the last jump of a model is uncertain, with a remedy; "" if it is not.

    After a jump the vehicle may not turn any more, as where it is put down or moored before the recording is stopped.
    If the field of the place changed, and not the iron, the hard iron is what it was before.
    """
    jumps = [t for t in result.model.terms if t.name == "hard-iron-step" and "until" not in t.setting]
    if not jumps:
        return ""
    last = max(jumps, key=lambda term: term.setting["time"])
    time = last.setting["time"]
    changed = float(np.linalg.norm(np.sum([term.value for term in jumps], axis=0)))
    moved = float(turned(result.twin, np.array([time]), np.array([np.inf]))[0])
    if moved > RULES.stay_turns or changed < RULES.taken_off * float(np.linalg.norm(last.value)):
        return ""
    return (
        f"the hard iron jumped at {time:.0f} s, or the field of the place changed: turn a full circle after it, or "
        "choose an interval without it (start=, end=)"
    )


def _reaching(result: Refit, model: Model) -> Array:
    """Return the covariance (13, 13) of a model's parameters by a fit of it or of another one, and of the distance."""
    free, count = result.model.free, int(result.model.free.sum())
    apart = result.model.parameters - model.parameters
    sensors = np.outer(apart, apart)
    sensors[np.ix_(free, free)] += result.covariance[:count, :count]
    return sensors


def _faster_walk(result: Refit) -> float:
    """Return the variance of an axis of the hard iron at the end, T², by the modes of a walk that a drift lacks.

    The cosines of half periods are the modes of a random walk, that of order k with a variance of q / k². Those of the
    drift give q, and the faster ones, which are in no term, add up at the end to that of all beyond its order.
    """
    variance = 0.0
    for index, term in enumerate(result.model.terms):
        order = int(term.setting.get("order", 0))
        if term.name != "hard-iron-drift" or not order:
            continue
        value, covariance = result.value_of(index)
        of_modes = 1 / np.arange(1.0, order + 1) ** 2
        walk = max(float((value**2 - np.diag(covariance)).sum()), 0.0) / (3 * of_modes.sum())
        variance += walk * (_OF_ALL_MODES - float(of_modes.sum()))
    return variance


def _misalignment_error(result: Refit, error: ModelError, strength: float) -> MisalignmentError | None:
    """Return the uncertainty of a misalignment that is a term of the model, by the sensors and by the model error."""
    model = result.model
    index = next((i for i, term in enumerate(model.terms) if term.name == _SKEW), None)
    if index is None:
        return None
    rows, count = result.rows_of(index), int(model.free.sum())
    own = rows - count
    cross = error.of_terms[:PARAMETERS, own]
    cross[model.free] += result.covariance[:count, rows]
    cross = -cross[:9]  # the term turns the gyroscope, ε the magnetometer
    cross[:6] /= strength
    rotation = result.covariance[np.ix_(rows, rows)] + error.of_terms[PARAMETERS + own][:, own]
    return MisalignmentError(rotation, cross, np.zeros((12, 12)))


def _widened_terms(
    terms: Sequence[Term], result: Refit, error: ModelError, delay_variance: float
) -> tuple[Term, ...]:
    """Return the terms, of which those of the model come first, with the model error in their covariance."""
    count, widened = int(result.model.free.sum()), list(terms)
    for index, term in enumerate(result.model.terms):
        if term.name == "timing":  # the delay of θ
            covariance = np.array([[delay_variance]])
        else:
            own = result.rows_of(index) - count
            covariance = terms[index].covariance + error.of_terms[PARAMETERS + own][:, own]
        widened[index] = replace(terms[index], covariance=covariance)
    return tuple(widened)


def fit_of(twin: Twin) -> Fit:
    """Return the field chain of a twin, with the terms of its model beside θ."""
    estimated = twin.model.estimated
    if not estimated:
        return twin.fit()
    parts = [twin.columns(term.name, term.setting) for term in estimated]
    window = np.concatenate([part.window for part in parts])
    links = [np.zeros((*part.window.shape[:2], twin.n - 1)) if part.link is None else part.link for part in parts]
    precision, value = (rows[int(twin.model.free.sum()) :] for rows in prior_of(twin))
    return twin.fit(terms=EstimatedTerms(UnmodelledColumns(window, np.concatenate(links)), value, precision))
