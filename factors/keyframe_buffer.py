"""Buffer that collects the samples of both sensors and cuts a block at each keyframe."""

from __future__ import annotations

import math

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import check_delay
from magyc_gtsam.factors.keyframe_field import KeyframeField
from magyc_gtsam.factors.numbers import real_array
from magyc_gtsam.factors.pose import sensor_rotation
from magyc_gtsam.factors.units import LIMITS, check_rates, check_readings
from magyc_gtsam.factors.variables import Array


class KeyframeBuffer:
    """Collects the samples of both sensors as they arrive and cuts a block at each keyframe.

    A sample that is refused is not added, so that an application may catch the error and go on. While there is no
    magnetometer sample, `close` keeps the rates of the last 10 s only.

    Args:
        body_R_sensor: magnetometer→body.
        delay: s by which the magnetometer lags the gyroscope.
        interval_mean: whether the rates are means since the previous stamp.

    Raises:
        MagycError: a mounting that is no rotation, or a delay that is no number or longer than 10 s.
    """

    def __init__(
        self, *, body_R_sensor: gtsam.Rot3 | None = None, delay: float = 0.0, interval_mean: bool = False
    ) -> None:
        sensor_rotation(body_R_sensor)  # refused here, before any sample is lost
        check_delay("keyframe buffer", delay)
        self._mounting, self._delay, self._interval_mean = body_R_sensor, delay, interval_mean
        self._field_time: list[float] = []
        self._field: list[list[float]] = []
        self._newest = -math.inf  # s, of all magnetometer samples so far, less the delay
        self._rate_time: list[float] = []
        self._rate: list[list[float]] = []

    def add_field(self, time: ArrayLike, magnetic_field: ArrayLike) -> None:
        """Add a magnetometer sample, s and (3,) T, or a block, (N,) and (N, 3).

        Raises:
            MagycError: stamps and samples do not match, a value is not finite, the unit is implausible, or a stamp
                lies before that of an earlier sample.
        """
        one = _usual(time, magnetic_field, LIMITS.reading)
        if one is not None and one[0] - self._delay >= self._newest:
            self._newest = one[0] - self._delay
            self._field_time.append(self._newest)
            self._field.append(one[1])
            return
        stamps, samples = _block("add_field", time, magnetic_field)
        check_readings("add_field", samples)
        _check_order("add_field", stamps, [self._newest], strictly=False, delay=self._delay)
        self._field_time += (stamps - self._delay).tolist()
        self._newest = max([self._newest, *self._field_time[-1:]])
        self._field += samples.tolist()

    def add_rate(self, time: ArrayLike, angular_rate: ArrayLike) -> None:
        """Add a gyroscope sample, s and (3,) rad/s in the body frame, or a block, (N,) and (N, 3).

        Raises:
            MagycError: stamps and samples do not match, a value is not finite, the unit is implausible, or a stamp
                is not after those of all earlier samples.
        """
        one = _usual(time, angular_rate, LIMITS.rate)
        if one is not None and (not self._rate_time or one[0] > self._rate_time[-1]):
            self._rate_time.append(one[0])
            self._rate.append(one[1])
            return
        stamps, samples = _block("add_rate", time, angular_rate)
        check_rates("add_rate", samples)
        _check_order("add_rate", stamps, self._rate_time, strictly=True)
        self._rate_time += stamps.tolist()
        self._rate += samples.tolist()

    def close(self, keyframe: float, bias: ArrayLike = (0.0, 0.0, 0.0)) -> KeyframeField:
        """Return the block of all magnetometer samples that the gyroscope covers; keep later samples and drop earlier
        ones.

        Args:
            keyframe: s, the time of the attitude that the block refers to.
            bias: (3,) rad/s in the body frame, the graph's present estimate.

        Raises:
            MagycError: as `KeyframeField.from_samples`.
        """
        if not self._rate_time:
            raise MagycError("keyframe field: no gyroscope sample; close a block after the first ones")
        first = int(np.searchsorted(self._field_time, self._rate_time[0]))
        cut = int(np.searchsorted(self._field_time, self._rate_time[-1], side="right"))
        if first >= cut:
            self._drop_old_rates()
        block = KeyframeField.from_samples(
            (np.array(self._field_time[first:cut]), np.array(self._field[first:cut]).reshape(-1, 3)),
            (np.array(self._rate_time), np.array(self._rate)),
            keyframe,
            bias=bias,
            body_R_sensor=self._mounting,
            interval_mean=self._interval_mean,
        )
        del self._field_time[:cut], self._field[:cut]
        # Gyroscope samples from the newest magnetometer sample on, or from those that are kept, are still needed.
        start = min([self._newest, *self._field_time[:1]])
        keep = max(min(int(np.searchsorted(self._rate_time, start)) - 1, len(self._rate_time) - 2), 0)
        del self._rate_time[:keep], self._rate[:keep]
        return block

    def _drop_old_rates(self) -> None:
        """Drop the gyroscope samples that no magnetometer sample will need that is still to come."""
        start = self._rate_time[-1] - LIMITS.delay
        keep = max(int(np.searchsorted(self._rate_time, start, side="right")) - 1, 0)
        del self._rate_time[:keep], self._rate[:keep]


def _usual(time: ArrayLike, value: ArrayLike, limit: float) -> tuple[float, list[float]] | None:
    """Return a single sample that is finite and within the limit, without numpy's cost per call; otherwise None."""
    if not isinstance(time, float) or not isinstance(value, np.ndarray) or value.shape != (3,):
        return None
    x, y, z = row = value.tolist()
    if value.dtype.kind != "f" or not (-limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit):
        return None
    return (time, row) if math.isfinite(time) else None


def _block(name: str, time: ArrayLike, value: ArrayLike) -> tuple[Array, Array]:
    """Return stamps (N,) and samples (N, 3) of one sample or a block."""
    try:
        stamps, samples = real_array(time), real_array(value)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    if stamps.ndim > 1 or samples.shape != (*stamps.shape, 3):
        raise MagycError(
            f"{name}: samples of shape {samples.shape} for stamps of shape {stamps.shape}, expected "
            "(3,) for a number, or (N, 3) for (N,)"
        )
    if not (np.isfinite(stamps).all() and np.isfinite(samples).all()):
        raise MagycError(f"{name}: a stamp or a value is not finite; leave such samples out")
    return np.atleast_1d(stamps), np.atleast_2d(samples)


def _check_order(name: str, stamps: Array, before: list[float], *, strictly: bool, delay: float = 0.0) -> None:
    """Raise an error for stamps that do not follow each other and those before, which were taken less the delay."""
    when = np.r_[before[-1:], stamps - delay]
    back = np.flatnonzero(np.diff(when) <= 0 if strictly else np.diff(when) < 0)
    if len(back):
        earlier, at = when[back[0] : back[0] + 2] + delay
        raise MagycError(
            f"{name}: the sample at {at:.3f} s comes after one at {earlier:.3f} s; add samples in the order "
            "of their stamps, and leave out those that are late"
        )
