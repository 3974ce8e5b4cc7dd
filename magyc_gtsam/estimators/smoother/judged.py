"""The assessment of a calibration: its covariance with the model error, and reasons not to trust it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.estimators.gauge import IronScale
from magyc_gtsam.estimators.model_error import ModelError
from magyc_gtsam.estimators.model_error.samples import flickers, in_bursts, too_slow
from magyc_gtsam.estimators.model_error.verdict import diagnostics, reason, remark
from magyc_gtsam.estimators.smoother.gyroscope_scale import GyroscopeScale
from magyc_gtsam.estimators.smoother.preparation import Streams
from magyc_gtsam.estimators.smoother.skew_prior import Skew
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS, SKEW
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.level_turn import MisalignmentError
from magyc_gtsam.observability import Assessor, Observability
from magyc_gtsam.recording import Array, Recording


class Posterior(NamedTuple):
    """The posterior of θ by the sensors.

    Attributes:
        parameters: (13,) θ.
        covariance: (13, 13), including the contributions of misalignment and gyroscope scale.
        skew, scale: the estimates of these; None if not estimated.
    """

    parameters: Array
    covariance: Array
    skew: Skew | None
    scale: GyroscopeScale | None = None


class Judgement(NamedTuple):
    """A calibration and its assessment.

    Attributes:
        soft_iron: (3, 3); strength: T.
        reported: (12, 12) covariance of soft iron, hard iron and bias; of_sensors: its part by the sensors' noise.
        delay_variance: s².
        observability: computed from `of_sensors`, except its heading_sigma, which is from `reported`.
        reasons: reasons not to trust it, beyond observability.
        remark: on the composition of its sigmas.
        diagnostics: JSON types.
        misalignment: uncertainty of the misalignment, with the model error; None if it is not estimated.
    """

    soft_iron: Array
    strength: float
    reported: Array
    of_sensors: Array
    delay_variance: float
    observability: Observability
    reasons: tuple[str, ...]
    remark: str
    diagnostics: dict[str, Any]
    misalignment: MisalignmentError | None = None


def judge(
    known: Posterior,
    unexplained: ModelError,
    recording: Recording,
    samples: Streams,
    strength: float | None = None,
    strength_sigma: float = 0.0,
    named: MisalignmentError | None = None,
) -> Judgement:
    """Assess the posterior of θ.

    Args:
        known: the posterior by the sensors alone.
        unexplained: the model error of the same fit.
        recording: the motion; samples: those of both sensors, which may be fewer.
        strength: T, known field strength, or None; strength_sigma: its standard deviation.
        named: uncertainty of a misalignment that is a term of the model, without the gyroscope's axes.
    """
    parameters, sensors, skew, _ = known
    scale = IronScale.of(unvech(parameters[:6]), strength, strength_sigma)
    soft_iron, unit = scale.soft_iron, scale.strength
    covariance = sensors + unexplained.covariance[:PARAMETERS, :PARAMETERS]
    reported, of_sensors = scale.covariance(covariance[:12, :12]), scale.covariance(sensors[:12, :12])
    misalignment = _misalignment_error(skew, scale, unexplained)
    if named is not None:
        misalignment = named if misalignment is None else named._replace(gyroscope=misalignment.gyroscope)
    assessor = Assessor(soft_iron, unit, recording, parameters[6:9], misalignment)
    sensors_alone = not unexplained.covariance.any()
    whole = observability = assessor.of(of_sensors, heading=sensors_alone)
    if not sensors_alone:
        whole = assessor.of(reported, _of_rotation(unexplained.covariance))
    probable = whole
    if (
        whole.weak and unexplained.possible
    ):  # merely possible effects widen the sigmas without changing the verdict
        of_probable = sensors + unexplained.probable[:PARAMETERS, :PARAMETERS]
        rotation = _of_rotation(unexplained.probable)
        probable = assessor.of(scale.covariance(of_probable[:12, :12]), rotation, heading=False)
    reasons = (
        flickers(samples),
        too_slow(samples),
        in_bursts(samples),
        reason(unexplained, probable, observability),
    )
    told: dict[str, Any] = {"model_error": diagnostics(unexplained)}
    if misalignment is not None:
        told["gyroscope_axes"] = misalignment.gyroscope.tolist()
        if skew is not None or named is not None:
            told["skew"] = {} if skew is None else {"evidence": skew.evidence}
            told["skew"] |= {"covariance": misalignment.covariance.tolist(), "cross": misalignment.cross.tolist()}
    return Judgement(
        soft_iron,
        unit,
        reported,
        of_sensors,
        float(covariance[DELAY, DELAY]),
        replace(observability, heading_sigma=whole.heading_sigma),
        tuple(filter(None, reasons)),
        remark(unexplained, of_sensors, reported),
        told,
        misalignment,
    )


def _of_rotation(covariance: Array) -> Array | None:
    """Return the block (3, 3) of the misalignment; None if it is not a parameter."""
    return covariance[SKEW, SKEW] if len(covariance) > PARAMETERS else None


def _misalignment_error(skew: Skew | None, scale: IronScale, unexplained: ModelError) -> MisalignmentError | None:
    """Return the contribution of the sensors' axes to the heading error, None if it is 0.

    The model error adds to that of ε if ε is part of θ.
    """
    axes = unexplained.of_gyroscope_axes
    if skew is None and not axes.any():
        return None
    covariance, cross = np.zeros((3, 3)), np.zeros((9, 3))
    if skew is not None:
        covariance, cross = skew.covariance, skew.gain[:9] @ skew.covariance
    of_axes = np.zeros((12, 12))
    of_axes[:9, :9] = scale.covariance(axes[:12, :12])[:9, :9]
    if len(axes) > PARAMETERS:
        covariance, cross = (
            covariance + unexplained.covariance[SKEW, SKEW],
            cross + unexplained.covariance[:9, SKEW],
        )
        of_axes[9:, 9:], of_axes[:9, 9:] = axes[SKEW, SKEW], axes[:9, SKEW]
    for each in (cross, of_axes[:, 9:]):
        each[:6] /= scale.strength
    of_axes[9:, :9] = of_axes[:9, 9:].T
    return MisalignmentError(covariance, cross, of_axes)
