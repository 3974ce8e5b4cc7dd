"""An array of samples that grows at its end and is trimmed at its front."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.recording.checks import Array


class GrowingRows:
    """Rows (n, width) that are appended at the end and dropped at the front, both at amortised constant cost."""

    def __init__(self, width: int) -> None:
        self._data = np.empty((256, width))
        self._first = self._stop = 0

    def __len__(self) -> int:
        return self._stop - self._first

    @property
    def rows(self) -> Array:
        """The rows (n, width), as a view that is valid until the next change."""
        return self._data[self._first : self._stop]

    def append(self, rows: Array) -> None:
        """Append rows (k, width)."""
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
        """Drop the first `count` rows."""
        self._first += count

    def keep(self, first: int, wanted: np.ndarray) -> None:
        """Drop the rows from `first` on that the mask `wanted` does not select."""
        kept = self.rows[first:][wanted]
        self._stop = self._first + first + len(kept)
        self.rows[first:] = kept
