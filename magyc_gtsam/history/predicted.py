"""Calibrations derived from a solved instrument, for each of its logs and for the next log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.noted import as_mounted
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.history.bias_scatter import predicted_bias
from magyc_gtsam.history.forward import WRONG
from magyc_gtsam.history.instrument import Instrument
from magyc_gtsam.history.log_factor import GYRO_BIAS, OBSERVED, LogFactor, calibration_of
from magyc_gtsam.history.model import HistoryModel
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


def next_calibration(factors: Sequence[LogFactor], instrument: Instrument, model: HistoryModel) -> Calibration:
    """Return the calibration for the next log: the last hard iron, its covariance widened by the walk, not by jumps."""
    mean, covariance = _without_bias(*instrument.ahead)
    mean[GYRO_BIAS], covariance[GYRO_BIAS, GYRO_BIAS] = _bias(factors, instrument)
    last = next(factors[i] for i in reversed(instrument.order) if factors[i].mean is not None)
    message = (
        f"predicted from {counted(_logs_used(factors, instrument), 'log')}; it holds unless the hard iron jumps"
    )
    return _calibration(factors, instrument, mean, covariance, message, last)


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
    scales = [factors[i].log_scale for i in instrument.order]
    known = [scale for scale in scales if scale is not None]
    diagnostics: dict[str, Any] = {
        "logs": len(instrument.order),
        "walk": instrument.walk,
        "scatter": instrument.scatter,
        "recordings": [
            factors[i].samples
            for i, label in zip(instrument.order, instrument.label, strict=True)
            if factors[i].samples and factors[i].mean is not None and label != WRONG
        ],
    }
    found = calibration_of(
        mean,
        0.5 * (covariance + covariance.T),
        delay=_delay([factors[i] for i in instrument.order]),
        terms=_misalignment([factors[i] for i in instrument.order]),
        log_scale=float(np.mean(known)) if known else 0.0,
        field_strength=log.field_strength,
        message=message,
        diagnostics=diagnostics,
    )
    return as_mounted(found, log)


def _misalignment(logs: Sequence[LogFactor]) -> tuple[Term, ...]:
    """Return the weighted mean misalignment, its covariance widened where the logs scatter beyond their sigmas."""
    rows = [log.misalignment for log in logs if log.misalignment is not None]
    if not rows:
        return ()
    each = [np.linalg.inv(log.misalignment_covariance) for log in logs if log.misalignment_covariance is not None]
    covariance = np.linalg.inv(np.sum(each, axis=0))
    mean = covariance @ np.einsum("kij,kj->i", each, rows)
    off = np.array(rows) - mean
    squares = float(np.einsum("ki,kij,kj->", off, each, off))
    widened = max(1.0, squares / max(3 * len(rows) - 3, 1))  # Birge's ratio
    return (Term("misalignment", mean, covariance * widened),)


def _delay(logs: Sequence[LogFactor]) -> tuple[float, float | None]:
    """Return the weighted mean delay and its sigma, widened where the logs scatter beyond their sigmas."""
    rows = np.array([(log.delay, log.delay_sigma) for log in logs if log.mean is not None and log.delay_sigma])
    if not len(rows):
        fixed = [log.delay for log in logs if log.mean is not None]
        return (fixed[-1] if fixed else 0.0), None
    weight = 1 / rows[:, 1] ** 2
    mean = float(weight @ rows[:, 0] / weight.sum())
    squares = float(weight @ (rows[:, 0] - mean) ** 2)
    widened = max(1.0, squares / max(len(rows) - 1, 1))  # Birge's ratio
    return mean, float(np.sqrt(widened / weight.sum()))
