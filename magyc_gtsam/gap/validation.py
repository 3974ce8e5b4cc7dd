"""Validation of a calibration on a recording that it was not made from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.elsewhere import elsewhere
from magyc_gtsam.calibration.followed import followed
from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.base import base_model, needs_gyroscope
from magyc_gtsam.gap.model.field_variation import field_variation
from magyc_gtsam.gap.model.problem import Active, Model, Problem
from magyc_gtsam.gap.model.refit import widened
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.outcome.agreement import Metrics
from magyc_gtsam.gap.outcome.corrected import as_calibration
from magyc_gtsam.gap.outcome.judged import judged
from magyc_gtsam.gap.outcome.metrics import measure
from magyc_gtsam.gap.outcome.moved import against
from magyc_gtsam.gap.preparation.channel_holes import without_channel_holes
from magyc_gtsam.gap.preparation.discrete import settled
from magyc_gtsam.gap.result import Moved
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.turned import with_turned_gyroscope
from magyc_gtsam.sensor_faults.usable import without_faults

_BIAS = slice(9, 12)
_STEPS = 6
_SETTLED = 1e-3  # squared length of a step, in sigmas
SWEPT = 0.5  # share of the field; smallest sweep of a recording that can validate


@one_thread
def agreement(recording: Recording, *calibrations: Calibration) -> tuple[Metrics, ...]:
    """Return how well calibrations with their terms agree with another recording of the same instrument.

    All parameters are fixed except the gyroscope's bias, which changes between switch-ons. Of the terms that are dated
    in the recording they were found in, jumps count as set in, and others (a drift, a passed object) are left out. All
    have the noise of the last and the field variation that it leaves, so that they differ in what they predict.

    Raises:
        MagycError: no gyroscope; no bias, noise or field strength in a calibration; or a term needs a channel that the
            recording lacks.
    """
    noise = calibrations[-1].noise  # a poorer model attributes its misfit to noise
    calibrations = tuple(elsewhere(each)[0] for each in calibrations)
    found = [(each, _predicted(recording, replace(each, noise=noise))) for each in calibrations]
    variation = field_variation(found[-1][1])
    return tuple(
        measure(
            twin,
            replace(calibration, gyro_bias=twin.model.parameters[_BIAS], converged=False),  # with any bias
            fitted=_of_bias(twin),
            variation=variation if variation.evident else None,
        )
        for calibration, twin in found
    )


def _predicted(recording: Recording, calibration: Calibration) -> Twin:
    """Return the twin of a recording with the parameters and terms of a calibration."""
    needed = {"magnetic_field", "angular_rate"} - calibration.noise.keys()
    if calibration.gyro_bias is None or calibration.field_strength is None or needed:
        raise MagycError(
            f"the calibration of method {calibration.method!r} lacks gyroscope bias, field strength or noise, "
            "without which it predicts nothing; calibrate with smoother"
        )
    recording = _prepared(recording, calibration)
    calibration = replace(calibration, field_strength=_strength_at(recording, calibration))
    problem = Problem.of(recording, preintegrate(recording, RULES.window))
    return _own_bias(problem, as_model(problem, calibration))


def _strength_at(recording: Recording, calibration: Calibration) -> float:
    """Return the strength of the calibrated field in a recording, T: it is that of its place."""
    field = np.linalg.solve(calibration.soft_iron, (recording.magnetometer.value - calibration.hard_iron).T)
    return float(np.median(np.linalg.norm(field, axis=0)))


@one_thread
def differences(recording: Recording, calibration: Calibration) -> tuple[Moved, ...]:
    """Return the parameters that differ when another recording of the same instrument is fitted, largest first.

    Iron and delay are compared. A difference must exceed the sigmas of both and the size that matters: 2 % of the
    field, or a rotation of 0.01 rad (root mean square) within the delay. The field strength belongs to the place, and
    is not compared.

    Raises:
        MagycError: no gyroscope, no uncertainty or field strength in the calibration, or data that cannot be fitted.
    """
    calibration = elsewhere(calibration)[0]
    recording = _prepared(recording, calibration)
    if calibration.field_strength is None or calibration.covariance is None:
        raise MagycError(
            f"the calibration of method {calibration.method!r} states no field strength or no uncertainty, without "
            "which a difference has no size; calibrate with smoother"
        )
    terms = tuple(t for t in calibration.terms if t.side is not None)
    if not any(t.name == "timing" for t in terms):
        known = calibration.delay_sigma or 0.0
        terms = (*terms, Term("timing", np.array([calibration.delay]), np.array([[known**2]]), {}))
    given = replace(calibration, terms=terms)
    model = widened(base_model(recording, given, short_term_noise(recording)))
    fitted = judged(as_calibration(model, None), model, recording, None)[0]
    field, rate = calibration.field_strength, recording.gyroscope.value
    turn = float(np.sqrt((np.square(rate).sum(axis=1)).mean()))
    matters = {"soft iron": 100 * RULES.field_differs, "hard iron": RULES.field_differs * field * 1e6}
    matters[TERMS["timing"].label] = RULES.late / turn * TERMS["timing"].scale
    return tuple(
        row
        for row in against(_without_strength(given), fitted)
        if any(
            row.name.startswith(name) and abs(row.after - row.before) > least for name, least in matters.items()
        )
    )


def _without_strength(calibration: Calibration) -> Calibration:
    """Return the calibration with a soft iron of determinant 1."""
    assert calibration.covariance is not None
    soft_iron, _, covariance = fix_scale(_symmetric(calibration.soft_iron), calibration.covariance)
    return replace(calibration, soft_iron=soft_iron, covariance=covariance)


def _symmetric(soft_iron: Array) -> Array:
    """Return the symmetric part, which is all that the model knows; after a jump the soft iron has a small other."""
    part: Array = 0.5 * (soft_iron + soft_iron.T)
    return part


def _prepared(recording: Recording, calibration: Calibration) -> Recording:
    """Return the recording with the gyroscope in the axes of the calibration, and held samples at their own times."""
    needs_gyroscope(recording)
    recording = without_faults(recording).recording
    recording = replace(recording, channels=followed(recording.channels, calibration.terms))
    for term in calibration.terms:
        if term.name == "axis-order":
            recording = with_turned_gyroscope(recording, np.reshape(term.value, (3, 3)))
    return settled(without_channel_holes(recording)[0], ())[0]


def swept(recording: Recording) -> float:
    """Return the range of the field on the axis where it is largest, T, without the outer 1 % at each end."""
    low, high = np.quantile(recording.magnetic_field, (0.01, 0.99), axis=0)
    return float((high - low).max())


def as_model(problem: Problem, calibration: Calibration) -> Model:
    """Return the model of a calibration with free bias, and its terms on readings."""
    assert calibration.field_strength is not None
    free = np.zeros(PARAMETERS, dtype=bool)
    free[_BIAS] = True
    terms = tuple(Active(t.name, t.setting, t.value) for t in calibration.terms if t.side is not None)
    for term in terms:
        known = {
            *problem.magnetometer.channels,
            *(["acceleration"] * (problem.recording.acceleration is not None)),
        }
        lacking = [channel for channel in TERMS[term.name].channels if channel not in known]
        if lacking:
            raise MagycError(
                f"recording {problem.recording.name!r}: no {lacking[0]} channel, which the term {term.name!r} of the "
                "calibration needs"
            )
    parameters: Array = np.concatenate(
        [
            vech(_symmetric(calibration.soft_iron) * calibration.field_strength),
            calibration.hard_iron,
            np.zeros(3) if calibration.gyro_bias is None else calibration.gyro_bias,
            [calibration.delay],
        ]
    )
    noise = SensorNoise(calibration.noise["magnetic_field"], calibration.noise["angular_rate"])
    return Model(parameters, free, noise, terms)


def _of_bias(twin: Twin) -> Array:
    """Return the columns (3, 3n) of the bias: those of the terms follow, whose values are the calibration's."""
    return twin.base_columns[:3]


def _own_bias(problem: Problem, model: Model) -> Twin:
    """Return the twin with the bias at its minimum."""
    twin = Twin.of(problem, model)
    for _ in range(_STEPS):
        columns = _of_bias(twin)
        step = -np.linalg.solve(columns @ columns.T, columns @ twin.residual().ravel())
        if float(step @ (columns @ columns.T) @ step) < _SETTLED:
            break
        parameters = model.parameters.copy()
        parameters[_BIAS] += step
        model = replace(model, parameters=parameters)
        twin = Twin.of(problem, model)
    return twin
