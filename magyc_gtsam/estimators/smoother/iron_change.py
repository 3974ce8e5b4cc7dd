"""Find a stretch of a recording in which the hard iron was another one.

The robust fit leaves such a stretch out as disturbed, and says nothing of it where it is the smaller part. It does the
same with a disturbance by the place. The two differ in what explains the stretch: after a change of the instrument the
same soft iron and strength of the field with another hard iron, which the turns within the stretch determine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.facts import field_strength
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording


@dataclass(frozen=True)
class _Limits:
    """Measured on vehicles of five kinds with a jump of 3 µT an axis, and on real logs without one."""

    shortest: float = 15.0  # s of a stretch; shorter ones seldom turn enough
    disturbed: float = 0.5  # weight of a window below which it counts as disturbed
    explained: float = 0.8  # mean weight of the windows of a stretch that another hard iron explains
    noise: float = 1.5  # times the noise of the rest, at most, that remains in the stretch
    strength: float = 0.02  # relative difference of the field's strength that is none
    walk: float = 1e-3  # T, by which the hard iron may have changed
    sigmas: float = 6.0  # of the change
    smallest: float = 0.02  # of the field's strength: one degree of heading


_LIMITS = _Limits()


class IronChange(NamedTuple):
    """The hard iron of the stretch from `start` to `end` (s since the first row) less that of the rest, T (3,)."""

    start: float
    end: float
    change: Array

    def sentence(self, recording: Recording) -> str:
        """Return when and by how much, and what to do."""
        duration = recording.time[-1] - recording.time[0]
        times = [t for t in (self.start, self.end) if _LIMITS.shortest < t < duration - _LIMITS.shortest]
        listed = " and ".join(f"{t:.0f} s" for t in times) or f"{self.start:.0f} s"
        shown, unit = recording.field_shown
        return (
            f"the hard iron changed at {listed} by {np.linalg.norm(self.change) * shown:.2g} {unit}: choose an "
            "interval without the change (--start, --end), or run `magyc-gtsam gap`"
        )


def hard_iron_change(
    recording: Recording, fit: Fit, calibration: Calibration, options: SmootherOptions
) -> IronChange | None:
    """Return the stretch that another hard iron explains, None if there is no such stretch.

    Args:
        recording: the data.
        fit, calibration: of the whole recording, the calibration with covariance.
        options: of that fit.
    """
    stretch = _disturbed(fit.chain.windows.time - recording.time[0], fit.weights.window)
    if stretch is None or not fit.converged or calibration.covariance is None:
        return None
    start, end = stretch
    try:
        own = replace(
            options,
            prior=calibration,
            hard_iron_walk=_LIMITS.walk,
            soft_iron_walk=0.0,
            delay=calibration.delay,
            clock_drift=0.0,
        )
        other, _ = fit_field_chain(recording.between(start, end), own, start=fit.state.parameters, brief=True)
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
        return IronChange(start, end, change)
    return None


def _disturbed(time: Array, weight: Array) -> tuple[float, float] | None:
    """The stretch that holds the most of what is disturbed, and the least of what is not: the largest partial sum."""
    excess = np.cumsum(_LIMITS.disturbed - weight)
    before = np.minimum.accumulate(np.concatenate([[0.0], excess[:-1]]))
    last = int(np.argmax(excess - before))
    first = int(np.argmin(np.concatenate([[0.0], excess[:last]])))
    start, end = float(time[first]), float(time[last])
    return (start, end) if end - start >= _LIMITS.shortest else None
