"""An array that grows at its end and is cut at its front, as a stream of samples does."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording.checks import Array


class GrowingRows:
    """Rows (n, width): appended at the end, cut at the front, both at amortised constant cost."""

    def __init__(self, width: int) -> None:
        self._data = np.empty((256, width))
        self._first = self._stop = 0

    def __len__(self) -> int:
        return self._stop - self._first

    @property
    def rows(self) -> Array:
        """(n, width), a view that is valid until the next change."""
        return self._data[self._first : self._stop]

    def append(self, rows: Array) -> None:
        """Add rows at the end."""
        stop = self._stop + len(rows)
        if stop > len(self._data):
            kept = self.rows
            size = max(len(self._data), 2 * (len(kept) + len(rows)))
            data = np.empty((size, self._data.shape[1])) if size > len(self._data) else self._data
            data[: len(kept)] = kept.copy() if data is self._data else kept
            self._data, self._first, self._stop = data, 0, len(kept)
            stop = self._stop + len(rows)
        self._data[self._stop : stop] = rows
        self._stop = stop

    def cut(self, count: int) -> None:
        """Drop rows at the front."""
        self._first += count

    def keep(self, first: int, wanted: np.ndarray) -> None:
        """Of the rows from `first` on, keep those that are `wanted`."""
        kept = self.rows[first:][wanted]
        self._stop = self._first + first + len(kept)
        self.rows[first:] = kept
