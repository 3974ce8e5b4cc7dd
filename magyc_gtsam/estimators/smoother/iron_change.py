"""Find stretches of a recording in which the hard iron was another one.

The robust fit leaves them out as disturbed, and says nothing of them where they are the smaller part. It does the same
with disturbances by the place. The two differ in what explains the stretches: after a change of the instrument the same
soft iron and strength of the field with another hard iron, which the turns within the stretches determine.
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
    """Measured on vehicles of five kinds with a jump of 3 µT an axis, and on real logs without one."""

    shortest: float = 15.0  # s of a stretch, and of a break between two; shorter ones seldom turn enough
    disturbed: float = 0.5  # weight of a window below which it counts as disturbed
    smoothed: float = 5.0  # s, in which the most of the windows decide
    explained: float = 0.8  # mean weight of the windows of a stretch that another hard iron explains
    noise: float = 1.5  # times the noise of the rest, at most, that remains in the stretch
    strength: float = 0.02  # relative difference of the field's strength that is none
    walk: float = 1e-3  # T, by which the hard iron may have changed
    sigmas: float = 6.0  # of the change
    smallest: float = 0.02  # of the field's strength: one degree of heading


_LIMITS = _Limits()


class IronChange(NamedTuple):
    """The hard iron of `stretches` (k, 2), from and to in s since the first row, less that of the rest, T (3,)."""

    stretches: Array
    change: Array

    def sentence(self, recording: Recording) -> str:
        """Return when and by how much, and what to do."""
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
    """Return the stretches that another hard iron explains, None if there are none.

    Args:
        recording: the data.
        fit, calibration: of the whole recording, the calibration with covariance.
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
    except MagycError:  # too short, or without motion: it determines no hard iron; or the fit is none
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
    """The stretches (k, 2) s in which most of what a few seconds hold is disturbed, joined over short breaks."""
    size = round(_LIMITS.smoothed / max(median(np.diff(time)), 1e-9)) | 1
    low = np.flatnonzero(median_filter(weight, size, mode="nearest") < _LIMITS.disturbed)
    if not len(low):
        return np.empty((0, 2))
    breaks = np.flatnonzero(np.diff(time[low]) >= _LIMITS.shortest)
    first, last = low[np.append(0, breaks + 1)], low[np.append(breaks, len(low) - 1)]
    stretches = np.column_stack([time[first], time[last]])
    return stretches[stretches[:, 1] - stretches[:, 0] >= _LIMITS.shortest]
