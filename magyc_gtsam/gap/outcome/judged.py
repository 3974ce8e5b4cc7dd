"""The covariance and verdict of a gap's calibration, with the misfit that the model and its terms do not explain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error import model_error
from magyc_gtsam.estimators.smoother.columns import EstimatedTerms, UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.judged import Posterior, judge
from magyc_gtsam.estimators.smoother.skew import skew_from_score
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC
from magyc_gtsam.factors.chain.field_chain import PARAMETERS
from magyc_gtsam.foreign_text import cause_and_action, clauses
from magyc_gtsam.gap.model.descent import prior_of
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.result import Doubt
from magyc_gtsam.recording import Recording

_SKEW = "misalignment"  # the term that is the skew of the chips, which is then not estimated a second time


def judged(
    calibration: Calibration, result: Refit, recording: Recording, strength: float | None
) -> tuple[Calibration, Doubt | None]:
    """Return a calibration with covariance and verdict as in `calibrate`, and the reason not to use it, if any.

    Args:
        calibration: of `result`.
        result: the model at its minimum, with a covariance widened by the colour of the misfit.
        recording: the fitted data.
        strength: of the field, T, if it was given.
    """
    model, fit = result.model, fit_of(result.twin)
    if all(term.name != _SKEW for term in model.terms):
        fit = fit.with_skew_estimate(skew_from_score(fit, AUTOMATIC))
    count = int(model.free.sum())
    sensors = np.zeros((PARAMETERS, PARAMETERS))
    sensors[np.ix_(model.free, model.free)] = result.covariance[:count, :count]
    if fit.skew is not None:
        sensors += fit.skew.gain @ fit.skew.covariance @ fit.skew.gain.T
    known = Posterior(model.parameters, sensors, fit.skew)
    judgement = judge(known, model_error(fit, recording), recording, recording, strength)
    observability = judgement.observability
    reasons, doubt = list(judgement.reasons), None
    if reasons:
        doubt = Doubt(*cause_and_action(clauses(reasons[0])[0]))
    if not observability.observable:
        weakest = observability.weak[0]
        reasons.insert(0, f"too little motion: {weakest.sentence}")
        doubt = Doubt(f"too little motion to determine the {weakest.what}", weakest.remedy)
    told = [*reasons, calibration.message] if reasons else [calibration.message, judgement.remark]
    late = calibration.delay_sigma is not None
    whole = replace(
        calibration,
        covariance=judgement.reported,
        noise_covariance=judgement.of_sensors,
        delay_sigma=float(np.sqrt(judgement.delay_variance)) if late else None,
        converged=calibration.converged and not reasons,
        message="; ".join(filter(None, told)),
        observability=observability,
        diagnostics={**calibration.diagnostics, **judgement.diagnostics},
    )
    return whole, doubt


def fit_of(twin: Twin) -> Fit:
    """Return the field chain of a twin, with the terms of its model beside θ."""
    weights = twin.chain.unweighted()
    return Fit(twin.chain, twin.state, weights, twin.reduced, twin.model.free, terms=_terms(twin))


def _terms(twin: Twin) -> EstimatedTerms | None:
    estimated = twin.model.estimated
    if not estimated:
        return None
    parts = [twin.columns(term.name, term.setting) for term in estimated]
    window = np.concatenate([part.window for part in parts])
    links = [np.zeros((*part.window.shape[:2], twin.n - 1)) if part.link is None else part.link for part in parts]
    precision, value = (rows[int(twin.model.free.sum()) :] for rows in prior_of(twin))
    return EstimatedTerms(UnmodelledColumns(window, np.concatenate(links)), value, precision)
