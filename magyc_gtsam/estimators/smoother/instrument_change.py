"""Detection of stretches of a recording with another instrument: a sensor that was remounted, or a log of another one.

Like a changed hard iron (`iron_change`), such stretches are rejected as disturbed, without a message if they are the
smaller part. No disturbance by the surroundings can be calibrated by itself and give another soft iron, hard iron or
misalignment with certainty.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.sensor_faults.cut_off import inside


@dataclass(frozen=True)
class _Limits:
    """When two calibrations are of two instruments."""

    misaligned: float = float(np.radians(20.0))  # prior standard deviation of the misalignment after a remounting
    distance: float = 60.0  # least squared Mahalanobis distance, 12 degrees of freedom: as 36 of 3
    smallest: float = 0.02  # least change of an element of the soft iron, of the hard iron over the field, rad


_LIMITS = _Limits()


def instrument_change(
    recording: Recording,
    stretches: Array,
    whole: Calibration,
    options: SmootherOptions,
    calibrate: Callable[[Recording, SmootherOptions], Calibration],
) -> str:
    """Return that the disturbed stretches are of another instrument, in words; "" if they are not.

    Args:
        recording: the data.
        stretches: (k, 2) s since the first row, those that the calibration rejects.
        whole: the calibration, which is trusted.
        options: of that calibration.
        calibrate: calibrates a recording without this question.
    """
    rows = inside(stretches, recording.time - recording.time[0])
    try:
        part = calibrate(recording.rows(rows), replace(options, misalignment=_LIMITS.misaligned))
    except MagycError:  # too short, or too little motion
        return ""
    if not part.trusted:
        return ""
    (here, known_here), (there, known_there) = _instrument(whole), _instrument(part)
    away, known = there - here, known_here + known_there
    if away @ np.linalg.solve(known, away) < _LIMITS.distance or np.abs(away).max() < _LIMITS.smallest:
        return ""
    first, last = stretches[0, 0], stretches[-1, 1]
    shown, unit = recording.field_shown
    moved = np.linalg.norm(part.hard_iron - whole.hard_iron) * shown
    return (
        f"the instrument is another one between {first:.0f} and {last:.0f} s (its hard iron by {moved:.2g} {unit}): a "
        "sensor that was remounted, or a log of another one? Choose an interval (start=, end=)"
    )


def _instrument(calibration: Calibration) -> tuple[Array, Array]:
    """Return soft iron, hard iron over the field and misalignment (12,), and their covariance (12, 12)."""
    covariance, strength = calibration.covariance, calibration.field_strength
    assert covariance is not None
    assert strength is not None
    unit = np.r_[np.ones(6), np.full(3, 1 / strength)]
    skew = calibration.diagnostics.get("skew")
    known = np.zeros((12, 12))
    known[:9, :9] = covariance[:9, :9] * unit * unit[:, None]
    known[9:, 9:] = np.eye(3) if skew is None else skew["covariance"]
    turn = next((term.value for term in calibration.terms if term.name == "misalignment"), np.zeros(3))
    value = np.concatenate([vech(calibration.soft_iron), calibration.hard_iron * unit[6:], turn])
    return value, known + 1e-12 * np.eye(12)
