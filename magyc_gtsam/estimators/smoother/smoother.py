"""`smoother`: the maximum-likelihood calibration under the sensor model (docs/field_chain.md), the default.

The field's direction is a Markov chain under the gyroscope. Eliminating the directions leaves thirteen parameters:
soft iron (times field strength), hard iron, gyroscope bias and the magnetometer's delay; and, if the data support
them, three misalignment angles between the two chips. The user supplies no start, no attitude and no noise level.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.gauge import IronScale, doubt_strength, fix_scale
from magyc_gtsam.estimators.model_error import ModelError, model_error
from magyc_gtsam.estimators.model_error.physical import LATE_DRIFT
from magyc_gtsam.estimators.model_error.recent_change import RECENT, recent_change
from magyc_gtsam.estimators.model_error.verdict import variation
from magyc_gtsam.estimators.smoother.clock_drift import find_drift, restamped, with_drift
from magyc_gtsam.estimators.smoother.fit import Fit, inverse_information
from magyc_gtsam.estimators.smoother.gyroscope_scale import scale_of, with_scale
from magyc_gtsam.estimators.smoother.iron_change import disturbed_stretches, hard_iron_change, instrument_change
from magyc_gtsam.estimators.smoother.judged import Posterior, judge
from magyc_gtsam.estimators.smoother.known import (
    contradictions,
    doubtful_strength,
    is_worse,
    known_of,
    remedies,
)
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.preparation import Streams, stamps_remark
from magyc_gtsam.estimators.smoother.reasons import contradicted_options, disturbed_end, doubts_of, jumped
from magyc_gtsam.estimators.smoother.search import Progress, fit_field_chain
from magyc_gtsam.estimators.smoother.skew import on_skew
from magyc_gtsam.estimators.smoother.truncated import with_truncation, without_truncation
from magyc_gtsam.estimators.smoother.vertical import upright_facts
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS
from magyc_gtsam.factors.chain.facts import quadratic, strength_of
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.observability import assess
from magyc_gtsam.recording import Array, Recording


def calibrate_smoother(recording: Recording, *, progress: Progress | None = None, **chosen: Any) -> Calibration:
    """Calibrate with the field smoother; `chosen` are `SmootherOptions`.

    Args:
        recording: with magnetometer and gyroscope.
        progress: called with the share done, 0 to 1.

    Raises:
        MagycError: no gyroscope, too few samples, inconsistent axes or units of the sensors, or an option out of range.
    """
    options = SmootherOptions(**chosen)
    report = progress or (lambda _: None)
    report(0.0)
    if options.clock_drift:
        recording = restamped(recording, options.clock_drift)
    fit = fit_field_chain(recording, options, progress=report)
    near = fit.state.parameters
    recording, fit, truncated = without_truncation(
        recording, fit, lambda again: fit_field_chain(again, options, start=near)
    )
    unexplained = _unexplained(fit, recording)
    doubts = prior_contradictions(recording, options, fit, unexplained)
    calibration = calibration_of(recording, fit, options, doubts=doubts, unexplained=unexplained)
    stretches = disturbed_stretches(recording, fit, options)
    changed = hard_iron_change(recording, stretches, fit, calibration, options)
    doubt = "" if changed is None else changed.sentence(recording)
    if not doubt and len(stretches):
        # A drift or a change towards the end would be the very change.
        others = unexplained.without(LATE_DRIFT).without(RECENT)
        whole = calibration_of(recording, fit, options, unexplained=others)
        doubt = instrument_change(recording, stretches, whole, options, _of) if whole.trusted else ""
    if not doubt and calibration.trusted:
        doubt = disturbed_end(fit, float(recording.time[0]))
    if doubt:
        doubts = [doubt, *doubts]
        calibration = calibration_of(recording, fit, options, doubts=doubts, unexplained=unexplained)

    def refit(again: Recording, start: Array | None) -> tuple[Fit, Callable[[], bool]]:
        fit = fit_field_chain(again, options, start=start, brief=True)
        return fit, lambda: calibration_of(again, fit, options).converged

    drift = find_drift(recording, fit, calibration.converged, refit)
    drift = None if drift is None else drift._replace(known=options.clock_drift)
    if options.gyroscope_scale and changed is None and not (drift is not None and drift.harms):
        corrected, fit, doubt = with_scale(recording, fit, options)
        doubts = [doubt, *doubts] if doubt else doubts
        unexplained = _unexplained(fit, corrected)
        calibration = calibration_of(corrected, fit, options, doubts=doubts, unexplained=unexplained)
    report(1.0)
    return with_truncation(with_drift(calibration, drift), truncated)


def _unexplained(fit: Fit, recording: Recording) -> ModelError:
    """Return the model error, with that by a change of the instrument if the fit rejects windows or links."""
    error = model_error(fit, recording)
    change = recent_change(fit) if fit.rejects else None
    return error if change is None else error.beside(change)


def _of(recording: Recording, options: SmootherOptions) -> Calibration:
    return calibration_of(recording, fit_field_chain(recording, options, brief=True), options)


def prior_contradictions(
    recording: Recording, options: SmootherOptions, fit: Fit, unexplained: ModelError | None = None
) -> list[str]:
    """Return where the data without it contradict the earlier calibration; the posterior would hide it as noise.

    The uncertainty of the data alone counts an effect if the fit with the prior shows it, too: beside little motion,
    far from the minimum, effects resemble anything. For the same reason the fit must also be worse with the prior.

    Args:
        recording: what was fitted.
        options: with the prior.
        fit: with the prior.
        unexplained: the model error of that fit; None computes it.
    """
    if options.prior is None:
        return []
    without = replace(options, prior=None, hard_iron_walk=0.0, soft_iron_walk=0.0)
    with suppress(MagycError):  # without the prior the data do not determine a calibration
        fit_alone = fit_field_chain(recording, without)
        if not is_worse(fit, fit_alone, options):
            return []
        error = model_error(fit_alone, recording)
        shown = model_error(fit, recording) if unexplained is None else unexplained
        confirmed = error.only({component.name for component in shown.components})
        alone = calibration_of(recording, fit_alone, without, unexplained=confirmed)
        sufficient = calibration_of(recording, fit_alone, without, unexplained=error).trusted
        return contradictions(alone, options, sufficient)
    return []


def posterior(fit: Fit, factor: float) -> Posterior:
    """Return the posterior of θ: the data's information divided by `factor`, plus the unscaled facts."""
    facts = tuple(fact for fact in fit.chain.facts if not on_skew(fact))
    rows = np.arange(PARAMETERS)
    parameters = fit.state.parameters[rows]
    free = fit.free[rows]
    if not facts and len(fit.free) == PARAMETERS:
        covariance = fit.covariance * factor
    else:
        _, slope, known = quadratic(facts, fit.state.parameters)
        _, all_slope, all_known = quadratic(fit.chain.facts, fit.state.parameters)
        information = ((fit.reduced.information - all_known) / factor + known)[np.ix_(rows, rows)]
        covariance = inverse_information(information, free)
        if len(fit.free) == PARAMETERS:
            gradient = (fit.reduced.gradient - all_slope) / factor + slope
            parameters = parameters - covariance @ gradient
    if fit.skew is not None:
        gain = fit.skew.gain
        covariance = covariance + gain @ fit.skew.covariance @ gain.T
        if fit.skew.decided:
            parameters = parameters + fit.skew.shift
    scale = scale_of(fit, factor)
    if scale is not None:
        parameters = parameters + scale.shift
        covariance = covariance + scale.cross @ scale.gain.T
    return Posterior(parameters, covariance, fit.skew, scale)


def calibration_of(
    recording: Recording,
    fit: Fit,
    options: SmootherOptions,
    colour: float | None = None,
    doubts: Sequence[str] = (),
    unexplained: ModelError | None = None,
    samples: Streams | None = None,
) -> Calibration:
    """Return the calibration of a fit, with its covariance and any reasons not to trust it.

    Args:
        recording: what was fitted.
        fit: the lowest minimum.
        options: the smoother's options.
        colour, unexplained: replace the values of the fit if it holds only the end of a longer chain.
        doubts: reasons for distrust known before.
        samples: replace those of `recording` if it holds only the end of a longer one.
    """
    samples = recording if samples is None else samples
    colour = fit.colour if colour is None else colour
    known = posterior(fit, colour * fit.widening)
    contradicted, wider = doubtful_strength(known.parameters, known.covariance, options)
    known = known._replace(covariance=known.covariance + wider)
    unexplained = model_error(fit, samples) if unexplained is None else unexplained
    strength = options.known_strength, options.strength_sigma
    judgement = judge(known, unexplained, recording, samples, *strength)
    parameters, _, skew, scale = known
    unit, observability = judgement.strength, judgement.observability
    reasons = list(doubts) if skew is None or not skew.doubt else [*doubts, skew.doubt]
    reasons += contradicted + contradicted_options(fit, options, unexplained, unit)
    reasons += jumped(fit, recording) + doubts_of(fit, unit, observability)
    if not observability.observable:

        def enough(covariance: Array) -> bool:
            given = fix_scale(unvech(parameters[:6]), covariance[:12, :12], *strength)[2]
            return assess(given, judgement.soft_iron, unit, recording, parameters[6:9]).observable

        reasons += remedies(fit, colour * fit.widening, enough, options, recording)
    elif wrong := doubt_strength(strength_of(unvech(parameters[:6])), strength[0]):
        reasons.insert(0, wrong)
    reasons += judgement.reasons
    upright = upright_facts(fit)
    remarks = [fact.sentence for fact in upright if fact.contradiction]
    remarks.append(stamps_remark(samples.gyroscope))
    told = [
        f"converged in {fit.iterations} iterations",
        known_of(options).note,
        *remarks,
        judgement.remark,
    ]
    noise = fit.chain.noise
    terms: tuple[Term, ...] = ()
    if skew is not None and skew.decided:
        assert judgement.misalignment is not None
        skew = replace(skew, covariance=judgement.misalignment.covariance)
        terms = (Term("misalignment", -skew.value, skew.covariance),)
        told.insert(1, skew.sentence)
    with_scales: dict[str, Any] = {}
    if scale is not None:
        terms = (*terms, scale.term)
        normalised = IronScale.of(unvech(parameters[:6]), *strength).of_parameters(scale.cross[:12])
        with_scales = {"gyroscope_scale": normalised.tolist()}
    return Calibration(
        soft_iron=judgement.soft_iron,
        hard_iron=parameters[6:9],
        gyro_bias=parameters[9:12],
        covariance=judgement.reported,
        noise_covariance=judgement.of_sensors,
        delay=float(parameters[DELAY]),
        delay_sigma=float(np.sqrt(judgement.delay_variance)) if fit.free[DELAY] else None,
        terms=terms,
        converged=not reasons,
        message="; ".join(filter(None, [*reasons, *remarks, variation(unexplained)] if reasons else told)),
        method="smoother",
        noise={"magnetic_field": noise.magnetometer, "angular_rate": noise.gyroscope},
        field_strength=unit,
        observability=observability,
        diagnostics={
            "windows": len(fit.chain.windows),
            "iterations": fit.iterations,
            "cost": fit.reduced.cost,
            "trusted_share": fit.trusted_share,
            "colour": colour,
            "widening": fit.widening,
            "disturbed": _disturbed(fit),
        }
        | judgement.diagnostics
        | with_scales
        | {name: said for fact in upright for name, said in fact.diagnostics.items()},
        configuration=dict(options.configuration),
    )


def _disturbed(fit: Fit) -> list[list[float]]:
    """Return the intervals [from, to] in s of windows with weights below 0.5, merged and sorted longest first."""
    low = np.flatnonzero(fit.weights.window < 0.5)
    if not len(low):
        return []
    time = fit.chain.windows.time
    groups = np.split(low, np.flatnonzero(np.diff(low) > 2) + 1)
    stretches = [[float(time[group[0]]), float(time[group[-1]])] for group in groups]
    return sorted(stretches, key=lambda pair: pair[0] - pair[1])[:20]
