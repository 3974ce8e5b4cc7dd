"""Detect spikes of the gyroscope: single samples that the motion around them does not explain.

The detector is a median filter with a threshold (Hampel 1974, doi:10.1080/01621459.1974.10482962). A spike must exceed
a multiple of the neighbours' spread, which includes motion up to the Nyquist frequency, and a multiple of the sensor's
noise just before.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.sensor_faults.single_samples import SingleSamples

_BESIDE = 6  # neighbours on either side
# The spread is the distance of this rank among the twelve neighbours' distances from their median; up to three may be
# spikes themselves. With rank 9 an oscillation of any frequency and sampling exceeds at most 3.3 spreads; with rank 8 a
# sinusoid of three samples per period has no spread.
_RANK = 9
# Spreads, and standard deviations of noise, from which a sample is a spike. Real logs, complete and thinned to 50, 25
# and 10 Hz, reach 13.5 and 27 in the half on which the thresholds were chosen (docs/fault_study.md).
_SPREADS, _NOISES = 15.0, 30.0
_BLOCK = 64  # samples from which the noise for the next block is estimated
_PIECE = 256 * _BLOCK  # samples of a whole recording that are examined at a time, which bounds the memory
_QUARTILE = 0.3186 * np.sqrt(
    6
)  # lower quartile of absolute second differences of normal noise with unit deviation


class Spikes(SingleSamples):
    """Find the spikes of the gyroscope, from its 65th sample on; a sample that jumps is undecided for six more."""

    def __init__(self) -> None:
        super().__init__("angular_rate", "are spikes of the gyroscope, beyond the motion around them")
        self._rows = np.empty((0, 4))  # time and value, from the block before the undecided samples on
        self._noise = np.empty((0, 3))  # rad/s, of the full blocks of these rows
        self._undecided = 0  # index of the first undecided sample in these rows

    def observe(self, block: Samples) -> None:
        """Take the next samples."""
        rows = np.vstack([self._rows, np.column_stack(block)])
        if len(rows) // _BLOCK > len(self._noise):
            self._noise = _noise_of_blocks(rows[:, 1:])
        spikes, waiting = _spikes(rows[:, 1:], self._noise, self._undecided)
        self.pending = float(rows[waiting[0], 0]) if len(waiting) else np.inf
        self.found(rows[spikes, 0], len(block.time))
        undecided = max(len(rows) - _BESIDE, 0)
        given_up = max(undecided // _BLOCK - 1, 0)
        self._rows, self._undecided = rows[given_up * _BLOCK :].copy(), undecided - given_up * _BLOCK
        self._noise = self._noise[given_up:]

    def state(self) -> Mapping[str, Array]:
        """Return the state for `restore`."""
        own = {"rows": self._rows, "noise": self._noise, "undecided": np.array(self._undecided)}
        return {**super().state(), **own}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        super().restore(state)
        self._rows, self._noise, self._undecided = state["rows"], state["noise"], int(state["undecided"])


def has_spikes(value: Array) -> bool:
    """Return whether any sample of value (n, 3) is a spike."""
    starts = range(0, len(value) - _BLOCK, _PIECE)
    pieces = (value[start : start + _BLOCK + _PIECE + _BESIDE] for start in starts)
    return any(
        _may_stand_out(piece) and len(_spikes(piece, _noise_of_blocks(piece), _BLOCK)[0]) for piece in pieces
    )


def _may_stand_out(value: Array) -> bool:
    """Return whether the largest change of an axis of value (n, 3) exceeds the threshold by the noise of any block.

    The quartile of `_noise_of_blocks` is below a limit if more differences are than its rank, which needs no sorting.
    """
    if compiled.loops:
        share, block = np.array([_QUARTILE / _NOISES]), np.array([float(_BLOCK)])
        return bool(compiled.loops.calm_blocks(len(value), compiled.given(value), share, block))
    change, axes = _changes(value), np.ascontiguousarray(value.T)
    second = np.abs(change[..., 1:] - change[..., :-1])
    limit = np.abs(axes[:, 1:] - axes[:, :-1]).max(axis=1) * (_QUARTILE / _NOISES)
    low = (second < limit[:, None, None]) & (second > 0)
    return bool((low.sum(axis=2, dtype=np.uint8) > np.count_nonzero(second, axis=2) // 4).any())


def _spikes(value: Array, noise: Array, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of value (n, 3) from `first` on that are spikes, and those with too few rows after them.

    `noise` (b, 3) is that of the full blocks. Samples with a smaller change from the sample before are skipped.
    """
    first = max(first, _BLOCK)
    before = np.arange(first, len(value)) // _BLOCK - 1
    change = np.abs(value[first:] - value[first - 1 : -1])
    jumps = np.unique(np.flatnonzero(change > (_NOISES * noise).take(before, axis=0)) // value.shape[1])
    if not len(jumps):
        return jumps, jumps
    decided = jumps[first + jumps + _BESIDE < len(value)]
    rows, waiting = first + decided, first + jumps[len(decided) :]
    return rows[_stand_out(value, rows, noise[before[decided]])], waiting


def _noise_of_blocks(value: Array) -> Array:
    """Return the noise (b, 3) of the full blocks of value (n, 3), at least the smallest change in each.

    The estimate is a lower quartile, because spikes in 20 % of the samples affect half of the second differences. Zero
    differences, from samples that are held or cut off, carry no information on the noise and are excluded.
    """
    change = _changes(value)
    second = np.abs(change[..., 1:] - change[..., :-1])
    place = np.count_nonzero(second, axis=2, keepdims=True) // 4
    ordered = np.sort(np.where(second > 0, second, np.inf))
    quartile = np.take_along_axis(ordered, place, axis=2)[..., 0]
    step = np.where(change != 0, np.abs(change), np.inf).min(axis=2)
    result: Array = np.maximum(quartile / _QUARTILE, step).T
    return result


def _changes(value: Array) -> Array:
    """Return the changes (3, b, _BLOCK − 1) from sample to sample inside the full blocks of value (n, 3)."""
    count = len(value) // _BLOCK
    blocks = np.ascontiguousarray(value[: count * _BLOCK].T).reshape(value.shape[1], count, _BLOCK)
    changes: Array = blocks[..., 1:] - blocks[..., :-1]
    return changes


def _stand_out(value: Array, rows: np.ndarray, noise: Array) -> np.ndarray:
    """Return (k,) bool: which rows (k,) of value (n, 3) exceed the thresholds by neighbours and by noise (k, 3)."""
    beside = np.concatenate([np.arange(-_BESIDE, 0), np.arange(1, _BESIDE + 1)])
    neighbours = value[rows[:, None] + beside]
    median = np.median(neighbours, axis=1)
    distance = np.abs(neighbours - median[:, None])
    spread = np.partition(distance, _RANK - 1, axis=1)[:, _RANK - 1]
    standing = np.abs(value[rows] - median)
    result: np.ndarray = ((standing > _SPREADS * spread) & (standing > _NOISES * noise)).any(axis=1)
    return result
