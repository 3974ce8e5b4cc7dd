"""Detection of stretches of a recording with a different hard iron.

The robust fit rejects such stretches as disturbed, without a message if they are the smaller part. It does the same
with disturbances by the surroundings. The two can be told apart: after a change of the instrument, the stretches fit
with the same soft iron and field strength and another hard iron, which the rotation within them determines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.facts import field_strength
from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.sensor_faults.cut_off import inside


@dataclass(frozen=True)
class _Limits:
    """Thresholds, set on vehicles of five kinds with a jump of 3 µT per axis, and on real logs without a jump."""

    shortest: float = 15.0  # s of a stretch, and of a break between two; shorter ones seldom turn enough
    disturbed: float = 0.5  # weight of a window below which it counts as disturbed
    smoothed: float = 5.0  # s, length of the median filter of the weights
    explained: float = 0.8  # least mean weight of the windows of a stretch that another hard iron explains
    noise: float = 1.5  # largest noise in the stretch, as a multiple of that in the rest
    strength: float = 0.02  # largest relative difference of the field strength
    walk: float = 1e-3  # T, prior standard deviation of the change of the hard iron
    sigmas: float = 6.0  # least Mahalanobis distance of the change
    smallest: float = 0.02  # least change, as a share of the field strength; one degree of heading


_LIMITS = _Limits()


class IronChange(NamedTuple):
    """The change (3,) T of the hard iron in `stretches` (k, 2), from and to in s since the first row."""

    stretches: Array
    change: Array

    def sentence(self, recording: Recording) -> str:
        """Return the times and the size of the change in words, with the remedy."""
        duration = recording.time[-1] - recording.time[0]
        times = [t for t in self.stretches.ravel() if _LIMITS.shortest < t < duration - _LIMITS.shortest]
        listed = " and ".join(f"{t:.0f} s" for t in times[:2]) or f"{self.stretches[0, 0]:.0f} s"
        if len(times) > 2:
            listed += f" and {len(times) - 2} more times"
        shown, unit = recording.field_shown
        return (
            f"the hard iron changed at {listed} by {np.linalg.norm(self.change) * shown:.2g} {unit}: choose an "
            "interval without the change (--start, --end), or run `magyc-gtsam gap`"
        )


def hard_iron_change(
    recording: Recording, fit: Fit, calibration: Calibration, options: SmootherOptions
) -> IronChange | None:
    """Return the stretches that another hard iron explains; None if there are none.

    Args:
        recording: the data.
        fit, calibration: of the whole recording.
        options: of that fit.
    """
    stretches = _disturbed(fit.chain.windows.time - recording.time[0], fit.weights.window)
    if not len(stretches) or not fit.converged or calibration.covariance is None:
        return None
    try:
        own = replace(
            options,
            prior=calibration,
            hard_iron_walk=_LIMITS.walk,
            soft_iron_walk=0.0,
            delay=calibration.delay,
            clock_drift=0.0,
        )
        other, _ = fit_field_chain(
            recording.rows(inside(stretches, recording.time - recording.time[0])),
            own,
            start=fit.state.parameters,
            brief=True,
        )
    except MagycError:  # too short or too little motion to determine a hard iron, or no convergence
        return None
    strength, size = (field_strength(each.state.parameters[:6])[0] for each in (fit, other))
    change = other.state.parameters[6:9] - fit.state.parameters[6:9]
    covariance = other.covariance[6:9, 6:9] + fit.covariance[6:9, 6:9]
    explained = (
        other.weights.window.mean() >= _LIMITS.explained
        and other.chain.noise.magnetometer <= _LIMITS.noise * fit.chain.noise.magnetometer
        and abs(size / strength - 1) <= _LIMITS.strength
    )
    apart = change @ np.linalg.solve(covariance, change) > _LIMITS.sigmas**2
    if explained and apart and np.linalg.norm(change) > _LIMITS.smallest * strength:
        return IronChange(stretches, change)
    return None


def _disturbed(time: Array, weight: Array) -> Array:
    """Return the stretches (k, 2) s with a low running median of the weights, merged across short breaks."""
    size = round(_LIMITS.smoothed / max(median(np.diff(time)), 1e-9)) | 1
    low = np.flatnonzero(median_filter(weight, size, mode="nearest") < _LIMITS.disturbed)
    if not len(low):
        return np.empty((0, 2))
    breaks = np.flatnonzero(np.diff(time[low]) >= _LIMITS.shortest)
    first, last = low[np.append(0, breaks + 1)], low[np.append(breaks, len(low) - 1)]
    stretches = np.column_stack([time[first], time[last]])
    return stretches[stretches[:, 1] - stretches[:, 0] >= _LIMITS.shortest]
