"""The windows of all samples kept, integrated block by block, each block once.

Reading a calibration needs the windows, not the samples. They are integrated where the last sweep integrated them,
rounded, so that this seldom changes; the chain corrects for what is left. Everything here follows from samples and
memory alone: it is no part of the state, and when it was computed makes no difference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.preintegration import FieldWindows
from magyc_gtsam.online.kept import Kept
from magyc_gtsam.recording import Array

_BLOCK = 64  # windows
_STEP = 1e-3  # rad/s and s to which the point of integration is rounded


class CompressedWindows:
    """Blocks of windows, kept from one reading to the next as long as they hold."""

    def __init__(self) -> None:
        self._key: tuple[float, ...] = ()
        self._blocks: list[FieldWindows] = []

    def current(self, kept: Kept) -> FieldWindows:
        """All windows kept, the open one with them, in one world frame; there was a sweep."""
        buffer = kept.buffer
        origin = _STEP * np.round(kept.memory.origin / _STEP)
        bias, delay = origin[:3], float(origin[3])
        key = (*bias, delay, buffer.length, buffer.turn, float(buffer.magnetometer.time[0]))
        if key != self._key:
            self._key, self._blocks = key, []
        numbers, closed = np.unique(buffer.numbers), buffer.closed(delay)
        parts = self._blocks[: len(numbers) // _BLOCK]
        for first in range(_BLOCK * len(parts), len(numbers), _BLOCK):
            last = min(first + _BLOCK, len(numbers))
            begin = int(numbers[max(first - 1, 0)])  # the block before ends with this window
            part = buffer.windows(begin, int(numbers[last - 1]) + 1, delay).integrate(bias, delay)
            if parts:
                part = in_frame_of(parts[-1], part)
            parts.append(part)
            if last == first + _BLOCK and numbers[last - 1] < closed:
                self._blocks.append(part)
        return joined(parts)


def in_frame_of(before: FieldWindows, after: FieldWindows) -> FieldWindows:
    """`after`, whose first window is the last one of `before`, in the world frame of `before`."""
    # R' = Qᵀ R for all samples, so that the windows' means M = mean Rᵀ read M' = M Q.
    left, _, right = np.linalg.svd(np.linalg.solve(before.rotation[:, :, -1], after.rotation[:, :, 0]))
    turn = left @ right
    return replace(
        after,
        rotation=np.einsum("ijn,kj->ikn", after.rotation, turn),
        rotation_bias=np.einsum("ijbn,kj->ikbn", after.rotation_bias, turn),
        rotation_rate=np.einsum("ijn,kj->ikn", after.rotation_rate, turn),
        lever=np.einsum("ij,jkn->ikn", turn, after.lever),
    )


def joined(parts: list[FieldWindows]) -> FieldWindows:
    """One chain of parts in one frame, each but the first beginning with the last window of the one before."""

    def windows(name: str) -> Array:
        return np.concatenate([getattr(part, name)[..., min(i, 1) :] for i, part in enumerate(parts)], axis=-1)

    def links(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts], axis=-1)

    return FieldWindows(
        **{
            name: windows(name)
            for name in ("time", "count", "field", "rotation", "rotation_bias", "rotation_rate")
        },
        **{name: links(name) for name in ("lever", "link_time", "linked")},
        bias=parts[0].bias,
        delay=parts[0].delay,
    )
