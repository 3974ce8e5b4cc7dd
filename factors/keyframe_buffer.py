"""Buffer that collects the samples of both sensors and cuts a block at each keyframe."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.keyframe_field import KeyframeField


class KeyframeBuffer:
    """Collects the samples of both sensors as they arrive and cuts a block at each keyframe.

    Args:
        body_R_sensor: magnetometer→body.
        delay: s by which the magnetometer lags the gyroscope.
        interval_mean: whether the rates are means since the previous stamp.
    """

    def __init__(
        self, *, body_R_sensor: gtsam.Rot3 | None = None, delay: float = 0.0, interval_mean: bool = False
    ) -> None:
        self._mounting, self._delay, self._interval_mean = body_R_sensor, delay, interval_mean
        self._field_time: list[float] = []
        self._field: list[Sequence[float]] = []
        self._rate_time: list[float] = []
        self._rate: list[Sequence[float]] = []

    def add_field(self, time: float, magnetic_field: Sequence[float]) -> None:
        """Add a magnetometer sample: s, (3,) T."""
        self._field_time.append(time - self._delay)
        self._field.append(magnetic_field)

    def add_rate(self, time: float, angular_rate: Sequence[float]) -> None:
        """Add a gyroscope sample: s, (3,) rad/s, body frame."""
        self._rate_time.append(time)
        self._rate.append(angular_rate)

    def close(self, keyframe: float, bias: ArrayLike = (0.0, 0.0, 0.0)) -> KeyframeField:
        """Return the block of all magnetometer samples that the gyroscope covers; keep later samples and drop earlier
        ones.

        Args:
            keyframe: s, the time of the attitude that the block refers to.
            bias: (3,) rad/s, the graph's present estimate.

        Raises:
            MagycError: as `KeyframeField.from_samples`.
        """
        if not self._rate_time:
            raise MagycError("keyframe field: no gyroscope sample; close a block after the first ones")
        first = int(np.searchsorted(self._field_time, self._rate_time[0]))
        cut = int(np.searchsorted(self._field_time, self._rate_time[-1], side="right"))
        block = KeyframeField.from_samples(
            (np.array(self._field_time[first:cut]), np.array(self._field[first:cut]).reshape(-1, 3)),
            (np.array(self._rate_time), np.array(self._rate)),
            keyframe,
            bias=bias,
            body_R_sensor=self._mounting,
            interval_mean=self._interval_mean,
        )
        del self._field_time[:cut], self._field[:cut]
        # Gyroscope samples up to the next magnetometer sample, or the next keyframe, are still needed.
        keep = max(len(self._rate_time) - 2, 0)
        if self._field_time:
            keep = min(keep, max(int(np.searchsorted(self._rate_time, self._field_time[0])) - 1, 0))
        del self._rate_time[:keep], self._rate[:keep]
        return block
