"""What a gyroscope's samples do not show of the motion between them, at even and at uneven steps.

The spectrum of the turn rate is that of Blackman and Tukey (1958), the Fourier transform of the autocovariance, whose
lags are the distances of all pairs of samples. Samples lost at random leave pairs at every lag, so that the spectrum
reaches up to half the rate of the shortest steps, and the motion across a longer step is known in size, although not in
its course. What the integral over a step of h s has of an oscillation at f Hz, with x = π f h, follows in closed form.

- Exactly it is sin x / x of h times the rate in the step's middle, by the trapezoidal rule cos x, and by
  `rotations.increments` in addition the end correction, with the derivatives of a parabola. The difference is an error
  of random phase, whose variance belongs to the turn across that step.
- The trapezoidal rule retains x / tan x of the oscillation, and nothing from x = π/2 on. The mean over all steps, each
  by its duration, is what the recording retains of its size. What it does not, acts as a wrong scale of the turn.
"""

from __future__ import annotations

from math import ceil, log2
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.preintegration import interruptions
from magyc_gtsam.factors.chain.rotations import Array, Complex

_MOST = 20000  # most samples used, from the middle of longer logs
_EVEN = 1.5  # ratio of the longest to the shortest step up to which steps are even
_LAGS = 256  # most lags of the autocovariance
_SHORTEST = 0.1  # quantile of the steps that is the interval of the lags
_FINEST = 0.125  # least interval of the lags as a share of the mean step: samples may be stamped together
_FLOOR = 8.0  # standard deviations above the spectrum's median below which it counts as noise
_NORMAL = 1.4826  # ratio of standard deviation to median deviation
_LENGTHS = 64  # step lengths for which losses are computed
_NEIGHBOURS = 6  # lengths of neighbouring steps
_CLOSEST = 0.1  # of a step, distance to the third sample of a parabola from its ends, as in `rotations`


class RateSpectrum(NamedTuple):
    """The spectrum of a turn rate above its noise, and the steps between the samples.

    Attributes:
        frequency: (k,) Hz, those with power above the noise.
        power: (k,) rad²/s², variance per axis at each frequency.
        step: (m,) s, ascending; without those across which the rotation is not known.
    """

    frequency: Array
    power: Array
    step: Array

    @classmethod
    def of(cls, time: Array, rate: Array) -> RateSpectrum:
        """Return that of rates (n, 3) rad/s at ascending stamps (n,) s."""
        first = max((len(time) - _MOST) // 2, 0)
        time, rate = time[first : first + _MOST], rate[first : first + _MOST]
        step = np.diff(time)
        known = np.sort(np.delete(step, interruptions(time)))
        interval = max(float(known[int(_SHORTEST * len(known))]), _FINEST * float(known.mean()))
        power = _above_noise(_autocovariance(step, rate, interval))[1:]
        power /= rate.shape[1] * len(power)
        power[-1] *= 0.5  # the Nyquist frequency has one bin, the others two
        frequency = np.arange(1, len(power) + 1) / (2 * len(power) * interval)
        seen = power > 0
        return cls(frequency[seen], power[seen], known)

    @property
    def lost(self) -> float:
        """The share of the turn rate that is lost between the samples, 0 to 1."""
        passed = np.cumsum(self.step)
        middle = (np.arange(_LENGTHS) + 0.5) / _LENGTHS
        length = self.step[np.searchsorted(passed, passed[-1] * middle)]
        x = np.minimum(np.pi * np.outer(length, self.frequency), 0.5 * np.pi)
        lost = 1 - (x / np.tan(x)).mean(axis=0)
        return float(np.sqrt(self.power @ lost**2 / max(self.power.sum(), 1e-300)))

    def variance(self, step: Array) -> Array:
        """Return the variance (n,) per axis, rad², of the error of the turn across steps (n,) s.

        It is the mean over the steps that may be their neighbours.
        """
        length = np.linspace(0.0, float(self.step[-1]), _LENGTHS + 1)
        h, x = length[1:, None], np.pi * np.outer(length[1:], self.frequency)
        square, trapezoid = np.zeros_like(x), np.cos(x)
        for near in self.step[((np.arange(_NEIGHBOURS) + 0.5) / _NEIGHBOURS * len(self.step)).astype(int)]:
            beside = np.maximum(near, _CLOSEST * h)
            # By how much the third sample of the parabola differs.
            third = np.cos(x + 2 * np.pi * self.frequency * beside) - trapezoid
            square += (np.sin(x) / x - trapezoid + third * h**2 / (6 * beside * (h + beside))) ** 2
        return np.interp(step, length, np.append(0.0, length[1:] ** 2 * (square @ self.power) / _NEIGHBOURS))


def even(time: Array) -> bool:
    """Return whether no step between stamps (n,) is much longer than another."""
    step = np.diff(time)
    return bool(step.max() <= _EVEN * step.min())


def _autocovariance(step: Array, rate: Array, interval: float) -> Array:
    """Return the autocovariance of rates (n, 3), summed over the axes, at multiples of `interval` from 0 on."""
    lags = min(_LAGS, len(rate) // 4)
    # Samples farther apart than the longest lag make no pair; holes may last for hours.
    time = np.cumsum(np.minimum(np.append(0.0, step), lags * interval)) / interval
    place = np.rint(time).astype(np.int64)
    size = 2 ** ceil(log2(place[-1] + 1 + lags))

    def transformed(value: Array) -> Complex:
        return np.fft.rfft(np.bincount(place, value), size)

    def over_pairs(product: Complex | Array) -> Array:
        return np.fft.irfft(product, size)[: lags + 1]

    sampled, off = transformed(np.ones(len(rate))), transformed(time - place)
    count = np.rint(over_pairs(np.abs(sampled) ** 2))
    product = np.sum([over_pairs(np.abs(transformed(axis - axis.mean())) ** 2) for axis in rate.T], axis=0)
    found = np.flatnonzero(count)
    # The mean distance of the pairs at a lag differs from it where stamps are between its multiples.
    lag = found + over_pairs(2j * (sampled.conj() * off).imag)[found] / count[found]
    return np.interp(np.arange(lags + 1), lag, product[found] / count[found])


def _above_noise(covariance: Array) -> Array:
    """Return the spectrum (k,) above its noise floor, at even frequencies from 0 on, of covariances (k,)."""
    lags = len(covariance) - 1
    tapered = covariance * np.cos(0.5 * np.pi * np.arange(lags + 1) / lags) ** 2
    power = np.fft.rfft(np.concatenate([tapered, tapered[-2:0:-1]])).real
    middle = np.median(power)
    scatter = _NORMAL * np.median(np.abs(power - middle))
    result: Array = np.maximum(power - middle - _FLOOR * scatter, 0.0)
    return result
