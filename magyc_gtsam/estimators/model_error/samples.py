"""Tests for errors within windows that window means hide: one-sided outliers, coarse steps, slow sampling and
shared stamps.

All compare neighbouring samples, between which motion contributes little if it is sampled fast enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from magyc_gtsam.estimators.smoother.preparation import Streams, magnetometer_noise
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.unresolved import RateSpectrum, even
from magyc_gtsam.sensor_faults.noise import white_noise

_MOST = 20000  # most samples used, from the middle of longer logs
_LEAST = 200  # samples
_CERTAIN = 6.0  # standard deviations of the mean from which one-sided outliers count; real logs reach 1.7
_BESIDE = 4  # neighbours on either side in the median after outliers were found
_OFF = 6.0  # multiple of the median distance from which a sample is an outlier; four standard deviations of noise
_ROUNDS = 2  # finds 98 to 100 % of a shift by 5 to 20 % of the samples; one round finds 94 to 99 %
_ENOUGH = 2000  # samples used to find the step
_ROUNDING = 1e-3  # share of the mean change below which a change is rounding by a unit conversion and no step
# Ratio of step to noise. With normal noise of two fifths of a step, 4 % of the rounding error remains in a mean.
_COARSE = 2.0
_TOO_SLOW = 0.1  # share of the turn rate lost between samples; up to 0.09 all results were right
_BLOCK = 50  # samples; an axis with noise has only two values in them once in 10¹⁵
_MOVING = 0.9  # quantile of the blocks' ranges that is typical: an axis may be stuck for most of a log
_NARROW = 0.5  # share of the typical range below which a block is examined
_NOISY = 1.5  # ratio of noise to the distance of the two values from which noise would give more values
_LOST = 0.01  # share of the recording
_TOGETHER = 0.1  # share of the mean interval below which two samples are stamped together
_LEAST_BURSTS = 20
_CONSTANT = 1e-12  # share of the mean square below which a variance is rounding
_STANDING = 3.0  # times the noise's variance by which values change in a burst if they are one after the other
# Ratio of the mean square of second differences to the variance below which the lost share is less than `_TOO_SLOW`.
_ROUGH = 16 * _TOO_SLOW**2


class Outliers(NamedTuple):
    """One-sided outliers: the shift (3,) T of the mean that they cause, and its standard deviation (3,) T."""

    shift: Array
    sigma: Array

    @property
    def size(self) -> float:
        """The shift in T."""
        return float(np.linalg.norm(self.shift))

    @property
    def gain(self) -> float:
        """Gain in log-likelihood."""
        return 0.5 * float(np.square(self.shift / self.sigma).sum())

    @property
    def second(self) -> Array:
        """(3, 3) T², second moment of the shift."""
        return np.outer(self.shift, self.shift)

    @property
    def sentence(self) -> str:
        """The shift in words."""
        return f"the magnetometer's outliers lie to one side and shift its mean by {1e6 * self.size:.2g} µT"


def one_sided(recording: Streams) -> Outliers | None:
    """Return the shift of the magnetometer's mean by one-sided outliers; None if it is not significant.

    The statistic is each sample less the median of the five around it, which is zero for a monotonic field and
    symmetric for noise. Many outliers also affect the medians (with 20 % of the samples a third of the shift was
    missed): samples far off along the shift found so far are then excluded from the medians.
    """
    time, field = _stretch(*recording.magnetometer)
    if len(time) < _LEAST:
        return None
    found = _beside_medians(field)
    if np.abs(found.shift / found.sigma).max() <= _CERTAIN:
        return None
    axes = np.ascontiguousarray(field.T)
    standing = axes[:, _BESIDE:-_BESIDE] - _median_of_five(axes)[:, _BESIDE - 2 : 2 - _BESIDE]
    about = sliding_window_view(axes, 2 * _BESIDE + 1, axis=1)
    for _ in range(_ROUNDS):
        along = found.shift @ standing
        along -= np.median(along)
        off = np.abs(along) > _OFF * np.median(np.abs(along))
        kept = ~sliding_window_view(np.pad(off, _BESIDE), about.shape[2])
        standing = axes[:, _BESIDE:-_BESIDE] - _median_of_kept(about, kept | ~kept.any(axis=1, keepdims=True))
        found = _mean_of(standing)
    return found


def _beside_medians(field: Array) -> Outliers:
    """Return the mean of samples (n, 3) less the median of the five around each."""
    if compiled.loops:
        shift, scatter = np.empty(3), np.empty(3)
        compiled.loops.stand_out(len(field), compiled.given(field), shift, scatter)
        return _outliers(shift, scatter, len(field) - 4)
    axes = np.ascontiguousarray(field.T)
    return _mean_of(axes[:, 2:-2] - _median_of_five(axes))


def _mean_of(standing: Array) -> Outliers:
    """Return the mean (3,) of (3, n), and its standard deviation."""
    shift = standing.mean(axis=1)
    about = standing - shift[:, None]
    scatter = np.sqrt(np.einsum("in,in->i", about, about) / about.shape[1])
    return _outliers(shift, scatter, about.shape[1])


def _outliers(shift: Array, scatter: Array, count: int) -> Outliers:
    return Outliers(shift, np.maximum(scatter, 1e-12) / np.sqrt(count))


def _median_of_kept(about: Array, kept: np.ndarray) -> Array:
    """Return (3, n) medians of the neighbours (3, n, k) that are kept (n, k), at least one per sample."""
    ordered, count = np.sort(np.where(kept, about, np.inf), axis=2), kept.sum(axis=1)
    row = np.arange(len(count))
    return np.asarray(0.5 * (ordered[:, row, (count - 1) // 2] + ordered[:, row, count // 2]))


def coarse_step(recording: Streams) -> float:
    """Return the step, in T, of a magnetometer whose noise does not spread readings over several steps; 0 otherwise."""
    _, field = _stretch(*recording.magnetometer)
    change = np.abs(np.diff(field[:_ENOUGH], axis=0))
    real = np.count_nonzero(change)
    if not real:
        return 0.0
    step = float(change[change > _ROUNDING * change.sum() / real].min())
    return step if step > _COARSE * magnetometer_noise(recording) else 0.0


def flickers(recording: Streams) -> str:
    """Return a sentence on an axis that has only two values for long but noise elsewhere; "" if there is none."""
    for name, samples in (("magnetometer", recording.magnetometer), ("gyroscope", recording.gyroscope)):
        for letter, share in zip("xyz", _shares_of_two_values(samples.value), strict=True):
            if share:
                return (
                    f"axis {letter} of the {name} has only two values in {share:.0%} of the recording, but noise "
                    "elsewhere: it is stuck"
                )
    return ""


def _shares_of_two_values(values: Array) -> list[float]:
    """Return, for each axis of (n, 3), the share of blocks with only two values while it shows noise elsewhere.

    Shares below `_LOST` are returned as 0.
    """
    count = len(values) // _BLOCK
    blocks = values[: count * _BLOCK].reshape(count, _BLOCK, values.shape[1])
    result = [0.0] * values.shape[1]
    one, other, third = (blocks[:, k] for k in range(3))  # of any three samples of such a block two are equal
    alike = (one == other) | (other == third) | (third == one)
    for axis in np.flatnonzero(alike.any(axis=0)).tolist():
        own = blocks[:, :, axis]
        low, high = own.min(axis=1), own.max(axis=1)
        step = high - low
        typical = np.partition(step, int(_MOVING * count))[int(_MOVING * count)]
        narrow = np.flatnonzero((step > 0) & (step < _NARROW * typical))
        seen = own[narrow]
        two = narrow[((seen == low[narrow, None]) | (seen == high[narrow, None])).all(axis=1)]
        if len(two) < max(_LOST * count, 1):
            continue
        noise = white_noise(np.delete(own, two, axis=0).reshape(-1, 1))
        if noise >= _NOISY * float(np.median(step[two])):
            result[axis] = len(two) / count
    return result


def too_slow(recording: Streams) -> str:
    """Return why the gyroscope's samples are too few for the motion; "" if they are not."""
    time, rate = _stretch(*recording.gyroscope)
    if len(time) < _LEAST:
        return ""
    regular = even(time)
    if regular:
        rough, whole = _roughness(rate)
        if rough < _ROUGH * whole:
            return ""
    spectrum = RateSpectrum.of(time, rate)
    lost = spectrum.lost
    if lost < _TOO_SLOW:
        return ""
    apart, remedy = ("", "") if regular else (f", up to {spectrum.step[-1]:.2g} s apart,", " and lose no samples")
    return (
        f"the gyroscope's {(len(time) - 1) / (time[-1] - time[0]):.3g} samples a second{apart} are too few for this "
        f"motion ({lost:.0%} of its turn rate is lost between them, at most {_TOO_SLOW:.0%} is tolerated): "
        f"record faster{remedy}"
    )


def _roughness(rate: Array) -> tuple[float, float]:
    """Return the mean squared norm of the second differences of rates (n, 3), and their variance over all axes."""
    if compiled.loops:
        result = np.empty(2)
        compiled.loops.roughness(len(rate), compiled.given(rate), result)
        return float(result[0]), float(result[1])
    axes = np.ascontiguousarray(rate.T)
    second = axes[:, 2:] - 2 * axes[:, 1:-1] + axes[:, :-2]
    return float(np.vdot(second, second)) / second.shape[1], float(axes.var(axis=1).sum())


def in_bursts(recording: Streams) -> str:
    """Return why stamps that the magnetometer's samples share are too few for the motion; "" if they are not.

    Samples that are read out together have stamps close to each other, although the sensor took them one after the
    other: their values differ by more than noise. What the turn rate has beside its mean from burst to burst is lost.
    """
    time, field = _stretch(*recording.magnetometer)
    if len(time) < _LEAST:
        return ""
    apart = np.diff(time)
    within = apart < _TOGETHER * (time[-1] - time[0]) / len(apart)
    if len(within) > 2 * np.count_nonzero(within):
        return ""
    first = np.flatnonzero(~within) + 1
    if len(first) < _LEAST_BURSTS:
        return ""
    change = field[first[1:] - 1] - field[first[:-1]]
    if float(np.square(change).mean()) < _STANDING * 2 * magnetometer_noise(recording) ** 2:
        return ""
    between = float(np.median(np.diff(time[first])))
    at, rate = _stretch(*recording.gyroscope)
    angle = summed_rate(at, rate)
    kept = np.stack([np.interp(at + 0.5 * between, at, a) - np.interp(at - 0.5 * between, at, a) for a in angle.T])
    own = slice(*np.searchsorted(at, [at[0] + between, at[-1] - between]))
    fast = (rate - kept.T / between)[own].var(axis=0).sum() - rate.shape[1] * white_noise(rate) ** 2
    whole = rate.var(axis=0).sum()
    if whole <= _CONSTANT * np.square(rate).mean(axis=0).sum():  # a constant rate loses nothing
        return ""
    lost = float(np.sqrt(max(fast, 0.0) / whole))
    if lost < _TOO_SLOW:
        return ""
    return (
        f"the magnetometer's samples are stamped together every {between:.2g} s, which is too seldom for this motion "
        f"({lost:.0%} of its turn rate is lost, at most {_TOO_SLOW:.0%} is tolerated): record each sample's own stamp"
    )


def _median_of_five(values: Array) -> Array:
    """Return (3, n − 4) running medians of five of (3, n), by comparisons of two pairs and the fifth."""
    a, b, c, d, e = (values[:, k : values.shape[1] - 4 + k] for k in range(5))
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    result: Array = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))
    return result


def _stretch(time: Array, value: Array) -> tuple[Array, Array]:
    first = max((len(time) - _MOST) // 2, 0)
    return time[first : first + _MOST], value[first : first + _MOST]
