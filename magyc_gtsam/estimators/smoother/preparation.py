"""Preparation of a fit: preintegrated windows, and the sensors' short-term noise."""

from __future__ import annotations

from itertools import pairwise
from math import comb, log, sqrt
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.small import eigenvectors
from magyc_gtsam.factors.chain.stamp_errors import stamp_errors
from magyc_gtsam.factors.chain.unresolved import RateSpectrum, even
from magyc_gtsam.recording import Recording, Samples

# Ratio of the noise from third differences to that from second ones below which the latter contain motion: 10 Hz logs
# of some dives have 0.2 to 0.7, without motion in them 0.97 to 1.03.
_MOVING = 0.93
_ORDERS = (3, 4)  # of those differences
_TRIPLETS = 1000  # number of sample triplets used for the short-term noise
_LEAST_RATE_NOISE = 1e-6  # rad/s
_LEAST_SAMPLES = 200  # from which on lost ones are looked for
# Share of the turn rate lost between uneven samples from which on it counts: 0.002 to 0.005 in recordings of phones.
_LOST = 0.01
_CLOSEST = 10  # of so many samples, one is among the closest
_FEWEST = 40  # of these
_BESIDE = (0, 1, 3, 4)  # the neighbours among five samples
_ROUNDING = 1e-9  # of a value, below which a second difference is zero


def preintegrate(recording: Recording, window: float = 1.5, turn: float | None = None) -> Preintegration:
    """Return the preintegration of the recording's samples over windows of up to `window` s and `turn` rad."""
    magnetometer, gyroscope = recording.magnetometer, recording.gyroscope
    return Preintegration(
        *magnetometer,
        *gyroscope,
        interval_mean=recording.angular_rate_is == "interval-mean",
        length=window,
        turn=suitable_turn(magnetometer.value) if turn is None else turn,
        added_variance=added_variance(gyroscope),
    )


def added_variance(gyroscope: Samples) -> Array | None:
    """Return what errors of the stamps, or else the motion between lost samples, add to dt² in each step, (G − 1,) s².

    None if they add nothing.
    """
    found = stamp_errors(gyroscope.time)
    if found is not None:
        noise = _noise(gyroscope, _LEAST_RATE_NOISE)
        return found.variance(gyroscope.value, noise) / noise**2
    spectrum = _unresolved(gyroscope)
    if spectrum is None:
        return None
    return spectrum.variance(np.diff(gyroscope.time)) / _noise_of_closest(gyroscope, _LEAST_RATE_NOISE) ** 2


def _unresolved(gyroscope: Samples) -> RateSpectrum | None:
    """Return the spectrum of a turn rate of which a part is lost with samples; None if none is."""
    if len(gyroscope.time) < _LEAST_SAMPLES or even(gyroscope.time) or stamp_errors(gyroscope.time) is not None:
        return None
    spectrum = RateSpectrum.of(*gyroscope)
    return spectrum if spectrum.lost >= _LOST else None


def stamps_remark(gyroscope: Samples) -> str:
    """Return a sentence on errors of the gyroscope's stamps that widen the sigmas; "" if there are none."""
    found = stamp_errors(gyroscope.time)
    if found is None:
        return ""
    return (
        f"the gyroscope's samples come in batches of some {found.count.mean():.0f}, whose stamps are off by "
        f"{1e3 * found.spread:.2g} ms (1σ) from batch to batch, which widens the sigmas: record each sample's own stamp"
    )


def suitable_turn(field: Array) -> float:
    """Return the largest rotation inside a window, in rad, from the spread of the measured field (N, 3).

    Rotation inside a window loses information unless it is small relative to the field's spread over the whole log; at
    these values it costs 1 to 6 % of the hard iron's sigma (docs/field_chain_measured.md).
    """
    some = np.ascontiguousarray(field[:: max(len(field) // 500, 1)].T)
    some -= some.mean(axis=1)[:, None]
    spread = eigenvectors(some @ some.T)[0] / (some.shape[1] - 1)
    turn = 1.7 * np.sqrt(max(spread[0], 0.0) / max(spread.sum(), 1e-30))
    # Discrete values: two segmentations of a log differ by up to a third of a sigma, and a few more samples must not
    # change the segmentation.
    steps = round(log(max(turn, 0.1) / 0.15) / log(1.2))
    return min(max(0.15 * 1.2**steps, 0.15), 0.4)


class Streams(Protocol):
    """The samples of both sensors, as in a `Recording`."""

    @property
    def magnetometer(self) -> Samples: ...

    @property
    def gyroscope(self) -> Samples: ...


def short_term_noise(recording: Streams) -> SensorNoise:
    """Estimate the noise per sample and axis from second differences, which smooth motion hardly affects.

    Where third ones are smaller and fourth ones as large as those, the second contain the motion, and the third count.
    Where samples of the gyroscope are lost and motion with them, its noise is that between the closest samples.
    """
    gyroscope = recording.gyroscope
    lost = _unresolved(gyroscope) is not None
    level = (_noise_of_closest if lost else _noise)(gyroscope, _LEAST_RATE_NOISE)
    return SensorNoise(magnetometer_noise(recording), level)


def magnetometer_noise(recording: Streams) -> float:
    """Return the magnetometer's part of `short_term_noise`, T."""
    return _noise(recording.magnetometer, 1e-10)


def _noise(samples: Samples, least: float) -> float:
    value = samples.value
    stride = len(value) // _TRIPLETS | 1  # odd: with two rows per interpolated sample the triplets hit both
    square, size = _second_differences(value, stride)
    # Upper quartile of sqrt(χ²₃/3), because half of the differences are zero with drivers that interpolate; if more,
    # the median of those that are not zero.
    real = np.count_nonzero(square > 18 * _ROUNDING**2 * size)
    upper = max(3 * (len(square) - 1) // 4, len(square) - 1 - real // 2)
    found = _at(square, upper, 2)
    # Otherwise a driver interpolates, which higher differences show more.
    if real == len(square) and len(value) > _ORDERS[-1]:
        third, fourth = _higher_differences(value, stride)
        smaller = _at(third, upper, 3)
        # White noise is the same in both; of filtered noise ever less remains.
        if smaller < _MOVING * found and _at(fourth, upper, 4) > _MOVING * smaller:
            found = smaller
    return max(found, least)


def _noise_of_closest(samples: Samples, least: float) -> float:
    """Return the noise by which samples differ from the cubic through their four neighbours, where these are closest.

    Differences over uneven steps contain the motion: at a period of 2 s and 10 Hz they give five times the noise if
    half of the samples are lost.
    """
    time = sliding_window_view(samples.time, 5)
    time = time[np.argsort(time[:, 4] - time[:, 0], kind="stable")[: max(len(time) // _CLOSEST, _FEWEST)]]
    rows = np.searchsorted(samples.time, time[:, 0])
    residual, gain = samples.value[rows + 2], np.ones(len(rows))
    for i in _BESIDE:
        others = [j for j in _BESIDE if j != i]
        weight = np.prod([(time[:, 2] - time[:, j]) / (time[:, i] - time[:, j]) for j in others], axis=0)
        residual = residual - weight[:, None] * samples.value[rows + i]
        gain += weight**2
    square = np.einsum("ni,ni->n", residual, residual) / gain
    return max(_at(square, 3 * len(square) // 4, 0), least)


def _at(square: Array, place: int, order: int) -> float:
    """Return the standard deviation of noise of whose squared differences one is in a place of their order.

    The squares are put in another order.
    """
    place = min(place, len(square) - 1)
    square.partition(place)
    return sqrt(square[place] / (3 * comb(2 * order, order))) / 1.170


def _second_differences(value: Array, stride: int) -> tuple[Array, float]:
    """Return the squares of every stride-th second difference of (n, 3), and the mean square in their middles."""
    if compiled.loops:
        square = np.empty(-(-(len(value) - 2) // stride))
        return square, compiled.loops.second_differences(stride, compiled.given(value), square)
    first, middle, last = (np.ascontiguousarray(value[k : len(value) - 2 + k : stride].T) for k in range(3))
    second = first - 2 * middle + last
    return np.einsum("in,in->n", second, second), float(np.square(middle).mean())


def _higher_differences(value: Array, stride: int) -> list[Array]:
    """Return the squares of every stride-th third and every stride-th fourth difference of (n, 3)."""
    if compiled.loops:
        squares = [np.empty(-(-(len(value) - order) // stride)) for order in _ORDERS]
        compiled.loops.higher_differences(stride, compiled.given(value), *squares)
        return squares
    result = []
    for order in _ORDERS:
        parts = [value[k : len(value) - order + k : stride] for k in range(order + 1)]
        while len(parts) > 1:
            parts = [after - before for before, after in pairwise(parts)]
        result.append(np.asarray(np.einsum("ni,ni->n", parts[0], parts[0])))
    return result
