"""Tests for effects that change the noise instead of the reading, on the innovations sample by sample.

Their evidence is the gain in log-likelihood, nats, less the gain expected by chance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d
from scipy.special import gammaincc

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.held import HELD, RepeatedEntries

COUNTED = 1e6  # nats of an effect that is counted, not estimated
_MEDIAN = 2.674  # of Gamma(3)
_SMOOTH = 201  # bins of the periodogram's running median
_NEAR = 10  # bins on each side of a line that must be far below it; otherwise it is a resonance of the noise
_LEAKS = 2  # bins on each side of a line that its spectral leakage reaches
_CELLS = 4  # of the grid per sample; at half the sampling rate, rounding to them loses 3 % of an amplitude
_LONGEST = 8.0  # longest duration, in median steps per sample, for which gaps in the recording are kept
_ROUNDING = 1e-12  # power of rounding errors, per sample, which have no lines
_FLAT = 1e-6  # of the largest variance, below which a direction contains no information


@dataclass(frozen=True, eq=False)
class NoiseScore:
    """The test of an effect on the noise.

    Attributes:
        name: of the catalogue.
        statistic: twice the gain in log-likelihood.
        evidence: nats beyond chance.
        strong: whether that is more than noise alone would reach.
        significant: whether it is, and of the form of the effect.
        value, sigma: (k,) SI.
        setting: frequency Hz, correlation time s, …
        rows: mask of the samples of `Fine` that are affected (spikes).
    """

    name: str
    statistic: float
    evidence: float
    strong: bool
    significant: bool
    value: Array
    sigma: Array
    setting: Mapping[str, float]
    rows: np.ndarray | None = None

    @property
    def shown(self) -> tuple[str, float]:
        """Return the unit in which its values are shown, and the factor from SI; rows and axes have none."""
        return ("", 1.0) if self.name in ("sample-hold", "axis-order") else ("µT", 1e6)

    @classmethod
    def counted(
        cls, name: str, statistic: float, strong: bool, there: bool, value: Array, setting: Mapping[str, float]
    ) -> NoiseScore:
        """Return the test of an effect that is counted, not estimated: it is certainly there, or not there."""
        return cls(name, statistic, COUNTED * there, strong, there, value, np.zeros(len(value)), setting)


def tone(innovation: Array, time: Array, level: float, limit: float, edge: float = 0.0) -> NoiseScore:
    """Test for a line in the spectrum of innovations; see `lines`."""
    return next(lines(innovation, time, level, limit, edge))


def lines(innovation: Array, time: Array, level: float, limit: float, edge: float = 0.0) -> Iterator[NoiseScore]:
    """Yield the tests for a line in the spectrum of innovations, the strongest first, each in another place.

    Below `edge` Hz any missing effect causes lines at the frequencies of the motion; a line there is not named a tone.
    A misfit may be larger in one direction than in the others, whose noise would then hardly count; therefore all
    directions are scaled to unit variance.

    Args:
        innovation: (3, n) of unit variance.
        time: (n,) s.
        level: T per unit of the innovations.
        limit: nats of evidence.
        edge: Hz.
    """
    power, frequency = _periodogram_of(_isotropic(innovation), time, edge)
    floor = np.maximum(_running_median(power), _beside(power)) / _MEDIAN
    height = power / np.maximum(floor, 0.3)
    surprise = -np.log(np.maximum(gammaincc(3, np.minimum(height, 600)), 1e-280)) + np.maximum(height - 600, 0)
    surprise[: RULES.lowest_bins] = 0.0
    read, _ = _periodogram_of(innovation, time, edge)
    of_noise = 3 * _beside(read) / _MEDIAN
    while True:
        best = int(np.argmax(surprise))
        evidence = float(surprise[best] - np.log(len(frequency)))
        strong = evidence > limit + RULES.unsure_line
        amplitude = 2 * np.sqrt(max(read[best] - of_noise[best], 0.0) / innovation.shape[1]) * level
        yield NoiseScore(
            "tone",
            2 * float(height[best]),
            evidence,
            strong,
            strong and frequency[best] > edge,
            np.array([amplitude]),
            np.array([amplitude / np.sqrt(max(2 * height[best], 1e-9))]),
            {"frequency": float(frequency[best])},
        )
        surprise[in_place_of(frequency, float(frequency[best]), float(frequency[0]))] = 0.0


def in_place_of(frequency: Array, line: float, bin_width: float) -> np.ndarray:
    """Return (n,) whether frequencies are in the place of a line, among the bins that its test compares, Hz."""
    result: np.ndarray = np.abs(frequency - line) < (_NEAR + 0.5) * bin_width
    return result


def _isotropic(innovation: Array) -> Array:
    """Return the innovations (3, n) scaled to unit variance in every direction."""
    variance, direction = np.linalg.eigh(innovation @ innovation.T / innovation.shape[1])
    scale = np.sqrt(np.maximum(variance, max(_FLAT * variance[-1], np.finfo(float).tiny)))
    result: Array = (direction / scale).T @ innovation
    return result


def _periodogram_of(innovation: Array, time: Array, edge: float) -> tuple[Array, Array]:
    """Return the periodogram as `_periodogram`, below half the sampling rate, of samples at uneven times.

    Each sample is put in the nearest cell of a fine grid. Gaps are empty cells, across which a line keeps its phase. If
    the times are uneven in a pattern, its frequencies are excluded: what is constant, or depends on how late a sample
    is, has lines there. The signal below `edge` Hz is removed first, because it has aliases beside them.
    """
    step = float(np.median(np.diff(time))) / _CELLS
    cell = np.round((time - time[0]) / step).astype(int)
    if cell[-1] > _LONGEST * _CELLS * len(time):
        cell = _CELLS * np.arange(len(time))  # mostly gaps, across which no line keeps its phase
    elif edge and (np.diff(cell) != _CELLS).any():
        rows = max(int(0.5 / edge * len(time) / (time[-1] - time[0])), 1)
        innovation = innovation - uniform_filter1d(innovation, rows, axis=1)
    grid = np.zeros((5, next_fast_len(int(cell[-1]) + _CELLS)))
    np.add.at(grid.T, cell, np.concatenate([innovation, np.ones((1, len(time))), [_lateness(cell)]]).T)
    power, frequency = _periodogram(grid[:3], 1 / step)
    # A line that leaks across half the sampling rate meets its own alias there.
    below = frequency < 0.5 / (_CELLS * step) - (_LEAKS + 0.5) * frequency[0]
    frequency, of_pattern = frequency[below], np.zeros(below.sum(), dtype=bool)
    for signal in grid[3:]:
        pattern = _periodogram(signal[None], 1 / step)[0][below]
        level = np.maximum(np.maximum(np.median(pattern), _running_median(pattern)), _ROUNDING * len(time))
        of_pattern |= maximum_filter1d(pattern / level, 2 * _LEAKS + 1) > RULES.pattern
    return np.where(of_pattern, 0.0, power[below] * grid.shape[1] / len(time)), frequency


def _lateness(cell: Array) -> Array:
    """Return by how much of a sample's step each sample is later than evenly spaced ones, at most one."""
    late = cell / np.diff(cell).mean() - np.arange(len(cell))
    result: Array = np.clip(late - uniform_filter1d(late, _SMOOTH), -1, 1)
    return result


def _periodogram(innovation: Array, rate: float) -> tuple[Array, Array]:
    """Return the power summed over the axes, Gamma(3) for white noise of unit variance, without the mean; and Hz."""
    spectrum = np.fft.rfft(innovation, axis=1)[:, 1:]
    n = innovation.shape[1]
    if n % 2 == 0:
        spectrum = spectrum[:, :-1]
    frequency = np.arange(1, spectrum.shape[1] + 1) * rate / n
    return (np.abs(spectrum) ** 2).sum(axis=0) / n, frequency


def _running_median(values: Array) -> Array:
    """Return the median over `_SMOOTH` bins, fewer for a short spectrum."""
    size = min(_SMOOTH, len(values) // 4 * 2 + 1)
    return np.asarray(median_filter(values, size=size, mode="reflect"), dtype=float)


def _beside(values: Array) -> Array:
    """Return the median over the bins beside each, except those that the leakage of a line there reaches."""
    around = np.ones(2 * _NEAR + 1, dtype=bool)
    around[_NEAR - _LEAKS : _NEAR + _LEAKS + 1] = False
    return np.asarray(median_filter(values, footprint=around, mode="reflect"), dtype=float)


def coloured_noise(innovation: Array, rate: float, level: float, limit: float) -> NoiseScore:
    """Test white noise plus noise of one correlation time with Whittle's likelihood of the periodogram."""
    power, frequency = _periodogram(innovation, rate)
    power = np.minimum(power, 12 * np.maximum(_running_median(power) / _MEDIAN, 0.3))  # limits lines
    scale = power.mean() / 3
    best = (0.0, 0.0, 0.0, 1.0)
    for corner in np.geomspace(3 * frequency[0], 0.35 * rate, 14):
        shape = 1 / (1 + (frequency / corner) ** 2)
        for strength in np.geomspace(0.01, 300, 45):
            model = 1 + strength * shape
            white = float((power / model).mean() / 3)
            gain = 3 * len(power) * np.log(scale / white) - 3 * float(np.log(model).sum())
            if gain > best[0]:
                best = (gain, corner, strength, white)
    gain, corner, strength, white = best
    evidence = gain - RULES.chance
    duration = innovation.shape[1] / rate
    time_constant = 1 / (2 * np.pi * corner) if corner else 0.0
    slow = np.fft.rfft(innovation, axis=1)[:, 1 : max(int(corner * duration), 8) + 1]
    excess = np.linalg.eigvalsh(
        (slow @ slow.conj().T).real / innovation.shape[1] / slow.shape[1] - white * np.eye(3)
    )
    one_way = float(excess[-1] / max(np.maximum(excess, 0).sum(), 1e-12))
    # Standard deviation of the coloured part, from the area under its spectrum.
    shape = 1 / (1 + (frequency / corner) ** 2) if corner else np.zeros(1)
    deviation = float(np.sqrt(strength * white * shape.mean())) * level
    noise = time_constant < RULES.longest_colour and one_way < RULES.one_way
    return NoiseScore(
        "coloured-noise",
        2 * gain,
        evidence,
        evidence > limit,
        evidence > limit and noise,
        np.array([deviation]),
        np.array([deviation / np.sqrt(max(2 * gain, 1.0))]),
        {"correlation_time": time_constant, "one_way": one_way},
    )


def quantisation(recording: Recording, noise: float) -> NoiseScore:
    """Test for readings on a lattice whose step is not small relative to the noise (T per sample)."""
    value = recording.magnetometer.value
    steps = np.array([lattice(axis) for axis in value.T])
    step = float(steps.max())
    ratio = step / max(noise, 1e-15)
    coarse, setting = ratio > RULES.coarse, {"ratio": ratio}
    return NoiseScore.counted("quantisation", ratio, coarse, coarse, np.array([step]), setting)


def truncating(quantised: NoiseScore) -> NoiseScore:
    """Return the test of readings that were truncated towards zero, from that of readings on a lattice."""
    setting = {**quantised.setting, "truncated": 1.0}
    return NoiseScore.counted("quantisation", quantised.statistic, True, True, quantised.value, setting)


def lattice(values: Array) -> float:
    """Return the step of the lattice of the values; 0 if they lie on none."""
    distinct = np.unique(values)
    if len(distinct) > RULES.lattice_distinct * len(values) or len(distinct) < 3:
        return 0.0
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-6 * gaps.max()]
    step = float(gaps.min())
    multiples = gaps / step
    return step if float(np.abs(multiples - np.round(multiples)).max()) < RULES.lattice_off else 0.0


def sample_hold(recording: Recording) -> NoiseScore:
    """Test for entries of the magnetometer's log that exactly repeat the one before them (`recording.held`)."""
    repeats, fresh = RepeatedEntries.of(recording), recording.magnetic_field_fresh.sum()
    rows = repeats.repetition.rows
    if np.isinf(rows):
        rows = recording.magnetic_field_stamped.sum() / max(int(fresh), 1)
    value, setting = np.array([rows]), {"share": repeats.share}
    return NoiseScore.counted("sample-hold", repeats.share, repeats.share >= HELD, repeats.held, value, setting)
