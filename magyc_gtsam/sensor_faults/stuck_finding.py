"""The finding on stuck axes: which axes, when, and at what value, with the limit and the remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from magyc_gtsam.recording.checks import MAGNETOMETER_ALONE
from magyc_gtsam.sensor_faults.stuck import Stretch

MOST = 0.5  # share of the recording above which no calibration is attempted
SMALL = 0.005  # share up to which no method is harmed
_ALL = 0.95  # share above which no interval without it is long enough
_NAMES = {"magnetic_field": "magnetometer", "angular_rate": "gyroscope"}


@dataclass(frozen=True)
class Stuck:
    """Stuck axes of one sensor.

    Attributes:
        sensor: "magnetic_field" or "angular_rate".
        axes: the stuck axes, of "xyz".
        value: the reading of the first stretch, as text with its unit: µT, counts or mrad/s.
        stretches: (from, to) in s, the longest first.
        share: share of the recording's duration.
    """

    sensor: str
    axes: str
    value: str
    stretches: tuple[tuple[float, float], ...]
    share: float

    @property
    def where(self) -> str:
        """The stuck axes, the times and the evidence, as text."""
        start, end = self.stretches[0]
        more = f" and {len(self.stretches) - 1} more times" if len(self.stretches) > 1 else ""
        one = f"axis {self.axes} of the {_NAMES[self.sensor]} is"
        subject = one if len(self.axes) == 1 else f"axes {', '.join(self.axes)} are"
        turned = "the gyroscope turned" if self.sensor == "magnetic_field" else "the field turned"
        others = {1: "its other axes show noise", 2: "its other axis shows noise", 3: turned}
        return (
            f"{self.sensor}: {subject} stuck at {self.value} from {start:.1f} to {end:.1f} s{more}, "
            f"{self.share:.0%} of the recording, while {others[len(self.axes)]}"
        )

    @property
    def sentence(self) -> str:
        """The message: `where`, the limit and the remedy."""
        spare = ""
        if self.sensor == "angular_rate":
            spare = f", or {MAGNETOMETER_ALONE}"
        interval = "" if self.share > _ALL else " choose an interval without it (start=, end=),"
        return (
            f"{self.where} (at most {MOST:.0%} can be left out): name another source ({self.sensor}=),{interval} "
            f"or have the sensor repaired{spare}"
        )


def named(
    sensor: str, stretches: Sequence[Stretch], duration: float, shown: float, unit: str
) -> tuple[Stuck, ...]:
    """Return one finding per set of axes of a sensor; messages show a value times `shown` in `unit`."""
    result = []
    for axes in dict.fromkeys(stretch.axes for stretch in stretches):
        group = sorted((s for s in stretches if s.axes == axes), key=lambda s: s.start - s.end)
        first = min(group, key=lambda s: s.start)
        at = ", ".join(f"{value * shown + 0.0:.4g}" for value, flag in zip(first.value, axes, strict=True) if flag)
        share = min(sum(s.end - s.start for s in group) / max(duration, 1e-9), 1.0)
        names = "".join(axis for axis, flag in zip("xyz", axes, strict=True) if flag)
        result.append(Stuck(sensor, names, f"{at} {unit}", tuple((s.start, s.end) for s in group), share))
    return tuple(result)
