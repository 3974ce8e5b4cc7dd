"""A field beyond the magnetometer's full scale, noticed while the samples come in, so that nothing is trusted with it.

The batch's question (`estimators.clipped_field`) is asked of the last samples, every so many. From then on what reads
the level that it finds is counted; the engine has learnt from it, so that the estimate is not converged while too much
of all that came was cut off.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magyc_gtsam.estimators.clipped_field import ClippedField, at_level, clipped_field, clipped_levels
from magyc_gtsam.online.buffers import Rows
from magyc_gtsam.recording import Array

_KEPT = 6000  # samples that are looked at
_EVERY = 300  # samples after which that is done


class ClippedFieldWatch:
    """The watch over the magnetometer's extremes; what it finds does not depend on how samples are cut into calls."""

    def __init__(self) -> None:
        self._rows = Rows(3)
        self._levels = np.full((3, 2), np.nan)
        self._taken = self._count = 0  # samples; and of them, those at a level

    def take(self, value: Array) -> None:
        """Take new samples (n, 3) T."""
        while len(value):
            now, value = np.split(value, [_EVERY - self._taken % _EVERY])
            self._rows.append(now)
            self._taken += len(now)
            self._count += int(at_level(now, self._levels).sum())
            if self._taken % _EVERY == 0:
                self._look()

    @property
    def levels(self) -> Array:
        """(3, 2) T, lowest and highest reading of each axis where it was cut off; NaN where it was not."""
        return self._levels if self.clipped is not None else np.full((3, 2), np.nan)

    @property
    def clipped(self) -> ClippedField | None:
        """What was cut off so far, if it is enough to do harm."""
        found = clipped_field(self._levels, self._count, max(self._taken, 1), 1e6, "µT")
        return found if found is not None and found.too_often else None

    def _look(self) -> None:
        """Ask the batch's question of what is kept; a level that was found stays one until something is beyond it."""
        if len(self._rows) > _KEPT:
            self._rows.cut(len(self._rows) - _KEPT)
        rows = self._rows.rows
        beyond = np.stack([rows.min(axis=0) < self._levels[:, 0], rows.max(axis=0) > self._levels[:, 1]], axis=1)
        levels = np.where(beyond, np.nan, self._levels)
        levels = np.where(np.isnan(levels), clipped_levels(rows), levels)
        if np.array_equal(levels, self._levels, equal_nan=True):
            return
        known = (
            0 if beyond.any() else self._count - int(at_level(rows, self._levels).sum())
        )  # of what is kept no more
        self._count = known + int(at_level(rows, levels).sum())
        self._levels = levels

    def state(self) -> Mapping[str, Array]:
        """For `restore`."""
        counts = np.array([self._taken, self._count])
        return {"rows": self._rows.rows.copy(), "levels": self._levels.copy(), "counts": counts}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from `state`."""
        self._rows.append(state["rows"])
        self._levels = state["levels"].copy()
        self._taken, self._count = (int(v) for v in state["counts"])
