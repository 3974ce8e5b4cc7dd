"""Calibrations derived from a solved instrument, for each of its logs and for the next log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.noted import as_mounted
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.history.bias_scatter import predicted_bias
from magyc_gtsam.history.forward import WRONG
from magyc_gtsam.history.instrument import Instrument
from magyc_gtsam.history.log_factor import GYRO_BIAS, OBSERVED, LogFactor, calibration_of
from magyc_gtsam.history.pooled import delay_of, misalignment_of, scale_of
from magyc_gtsam.recording import Array


def log_calibration(factors: Sequence[LogFactor], instrument: Instrument, k: int) -> Calibration:
    """Return the calibration of the k-th log, with s and h from all logs and the bias conditioned on them."""
    factor = factors[instrument.order[k]]
    mean, covariance = _without_bias(*_shared_and_iron(instrument, k))
    if factor.mean is not None and factor.covariance is not None and instrument.label[k] != WRONG:
        alone = factor.covariance
        gain = alone[GYRO_BIAS, OBSERVED] @ np.linalg.inv(alone[OBSERVED, OBSERVED])
        joint = covariance[OBSERVED, OBSERVED]
        mean[GYRO_BIAS] = factor.mean[GYRO_BIAS] + gain @ (mean[OBSERVED] - factor.mean[OBSERVED])
        covariance[GYRO_BIAS, OBSERVED] = gain @ joint
        covariance[OBSERVED, GYRO_BIAS] = covariance[GYRO_BIAS, OBSERVED].T
        conditional = alone[GYRO_BIAS, GYRO_BIAS] - gain @ alone[OBSERVED, GYRO_BIAS]
        covariance[GYRO_BIAS, GYRO_BIAS] = conditional + gain @ joint @ gain.T
        others = _logs_used(factors, instrument) - 1
        message = f"with {counted(others, 'other log')} of the instrument" if others else "from this log alone"
    else:
        mean[GYRO_BIAS], covariance[GYRO_BIAS, GYRO_BIAS] = _bias(factors, instrument)
        reason = factor.problem or "its readings contradict the other logs"
        message = f"from other logs of the instrument, this one is not used ({reason})"
    return _calibration(factors, instrument, mean, covariance, message, factor)


def next_calibration(factors: Sequence[LogFactor], instrument: Instrument) -> Calibration:
    """Return the calibration for the next log: the last hard iron, its covariance widened by the walk, not by jumps."""
    mean, covariance = _without_bias(*instrument.ahead)
    mean[GYRO_BIAS], covariance[GYRO_BIAS, GYRO_BIAS] = _bias(factors, instrument)
    last = next(factors[i] for i in reversed(instrument.order) if factors[i].mean is not None)
    logs = counted(_logs_used(factors, instrument), "log")
    message = f"predicted from {logs}; it holds {_for_how_long(instrument)}, unless the hard iron jumps"
    return _calibration(factors, instrument, mean, covariance, message, last)


def _for_how_long(instrument: Instrument) -> str:
    if not instrument.bank.dated:
        return "for the next log"
    days = instrument.horizon
    return f"for {days:.0f} days after the last log" if days > 1.5 else f"for {24 * days:.2g} h after the last log"


def _logs_used(factors: Sequence[LogFactor], instrument: Instrument) -> int:
    """Return the number of logs used for the instrument."""
    wrong = instrument.label == WRONG
    return sum(factors[i].mean is not None and not bad for i, bad in zip(instrument.order, wrong, strict=True))


def _shared_and_iron(instrument: Instrument, k: int) -> tuple[Array, Array]:
    posterior, place = instrument.at(k)
    cross = posterior.cross[place]
    covariance = np.block([[posterior.shared_covariance, cross.T], [cross, posterior.covariance[place]]])
    return np.concatenate([posterior.shared, posterior.hard_iron[place]]), covariance


def _without_bias(mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Return mean and covariance with zeros in place of the bias."""
    return np.pad(mean, (0, 3)), np.pad(covariance, (0, 3))


def _bias(factors: Sequence[LogFactor], instrument: Instrument) -> tuple[Array, Array]:
    """Return mean (3,) and covariance (3, 3) of the bias in another log of the instrument, mrad/s."""
    used = [factors[i] for k, i in enumerate(instrument.order) if instrument.label[k] != WRONG]
    mean = np.array([factor.mean[GYRO_BIAS] for factor in used if factor.mean is not None])
    covariance = [factor.covariance[GYRO_BIAS, GYRO_BIAS] for factor in used if factor.covariance is not None]
    return predicted_bias(mean, np.array(covariance), instrument.model)


def _calibration(
    factors: Sequence[LogFactor],
    instrument: Instrument,
    mean: Array,
    covariance: Array,
    message: str,
    log: LogFactor,
) -> Calibration:
    """Return the calibration, with the field strength and the gyroscope's axes of `log`."""
    used = [factors[i] for i, label in zip(instrument.order, instrument.label, strict=True) if label != WRONG]
    diagnostics: dict[str, Any] = {
        "logs": len(instrument.order),
        "walk": instrument.walk,
        "walk_interval": list(instrument.walk_interval),
        "scatter": instrument.scatter,
        "recordings": [each.samples for each in used if each.samples and each.mean is not None],
    }
    found = calibration_of(
        mean,
        0.5 * (covariance + covariance.T),
        delay=delay_of(used),
        terms=misalignment_of(used),
        log_scale=scale_of(used),
        field_strength=log.field_strength,
        message=message,
        diagnostics=diagnostics,
    )
    return as_mounted(found, log)
