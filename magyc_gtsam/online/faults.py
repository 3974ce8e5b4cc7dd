"""Add the sensor faults found online to the progress and the calibration."""

from __future__ import annotations

from dataclasses import replace

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.online.engine import Progress
from magyc_gtsam.sensor_faults.faults import SensorFaults


def refusal(faults: SensorFaults) -> str:
    """Return why the remaining samples allow no calibration; empty if they do."""
    clipped = faults.clipped, faults.clipped_field
    return "; ".join(fault.sentence for fault in clipped if fault is not None and fault.too_often)


def with_faults(progress: Progress, faults: SensorFaults) -> Progress:
    """Return the progress with the faults of the sensors."""
    every, clipped, clipped_field = faults.stuck(progress.duration), faults.clipped, faults.clipped_field
    if not every and clipped is None and clipped_field is None and not faults.dropped:
        return progress
    now, refused = faults.stuck(progress.duration, now=True), refusal(faults)
    sentence = progress.sentence
    if refused:
        sentence = refused
    elif now:
        sentence = f"{now[0].where}: it is not used until it moves"
    elif clipped is not None and faults.cut_off.now:
        sentence = f"{clipped.where}: samples are not used across it"
    return replace(
        progress,
        sentence=sentence,
        converged=progress.converged and not refused,
        stuck=every,
        clipped=clipped,
        clipped_field=clipped_field,
        left_out=progress.left_out + faults.dropped,
    )


def with_left_out(calibration: Calibration | None, faults: SensorFaults, duration: float) -> Calibration | None:
    """Return the calibration after `duration` s with what was left out, as the batch methods report it."""
    where = [
        fault.where
        for fault in (*faults.stuck(duration), faults.zeros.finding(), faults.clipped)
        if fault is not None
    ]
    refused = refusal(faults)
    if calibration is None or not (where or refused):
        return calibration
    diagnostics = {**calibration.diagnostics} | ({"left_out": where} if where else {})
    if refused:
        return replace(calibration, converged=False, message=refused, diagnostics=diagnostics)
    message = f"{calibration.message}; left out: {'; '.join(where)}"
    return replace(calibration, message=message, diagnostics=diagnostics)
