"""Test for a reading whose samples alternate between two values, which the means of the windows hide.

Calibrated and raw readings in one topic, two magnetometers in one, or a bridge that is set and reset for every sample
alternate by ±a. The windows then hold the mean of both, and a calibration of the mean is off by a for every sample.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.preparation import Streams
from magyc_gtsam.factors.chain import compiled

_BLOCK = 64  # samples after which the order of the two may have changed, by a lost sample
_BLOCKS = 300  # most blocks used, evenly from the whole log
_LEAST = 256  # samples
_SHARE = 3 / 8  # variance of a sample's alternation by itself over that of its noise
_SIGNIFICANT = 18.0  # gain in log-likelihood; 29 real logs reach 1.6, 240 simulated ones 6.7


class Alternation(NamedTuple):
    """An alternation by ±a: its second moment E[a aᵀ] (3, 3) T² over the recording, and its gain in log-likelihood."""

    second: np.ndarray
    gain: float

    @property
    def size(self) -> float:
        """Root mean square of a, T."""
        return float(np.sqrt(np.trace(self.second)))

    @property
    def sentence(self) -> str:
        """The alternation in words."""
        return (
            f"every second sample of the magnetometer differs by {2e6 * self.size:.2g} µT from those between: two "
            "sensors, or raw and calibrated readings, in one stream?"
        )


def alternating(recording: Streams) -> Alternation | None:
    """Return the alternation of the magnetometer's samples; None if it is not significant.

    Each sample less the mean of its neighbours holds the alternation twice, and of motion its curvature, which does
    not alternate. Its mean over a block has the variance of white noise if there is no alternation.
    """
    value = recording.magnetometer.value
    if len(value) < _LEAST:
        return None
    first = _BLOCK * np.arange((len(value) - 2) // _BLOCK)
    if len(first) > _BLOCKS:
        first = first[np.linspace(0, len(first) - 1, _BLOCKS).astype(int)]
    mean, inside = _of_blocks(value, first)
    noise = inside / ((_BLOCK - 3) * _SHARE * _BLOCK)  # T², variance of `mean`
    square = np.square(mean)
    ratio = float(np.divide(square, noise, out=np.zeros_like(square), where=noise > 1e-30).mean())
    gain = 0.5 * mean.size * (ratio - 1 - np.log(ratio)) if ratio > 1 else 0.0
    if gain < _SIGNIFICANT:
        return None
    return Alternation(mean @ mean.T / mean.shape[1], gain)


def _of_blocks(value: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (3, blocks) the alternation in each block, and the sum of squares about it.

    By each block's own scatter: that of rounded readings is in a few blocks, where one is near a step.
    """
    if compiled.loops:
        mean, inside = np.empty((3, len(first))), np.empty((3, len(first)))
        inputs = map(compiled.given, (value, first.astype(np.int64)))
        compiled.loops.alternate(_BLOCK, *inputs, mean, inside)
        return mean, inside
    field = value.T[:, first[:, None] + np.arange(_BLOCK + 2)]  # axes, blocks, samples with their neighbours
    blocks = 0.5 * field[..., 1:-1] - 0.25 * (field[..., :-2] + field[..., 2:])
    blocks[..., 1::2] *= -1
    mean = blocks.mean(axis=2)
    return mean, np.square(blocks - mean[:, :, None]).sum(axis=2)
