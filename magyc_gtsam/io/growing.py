"""An array that grows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Growing:
    """Rows that are added block by block to one array, with room for a quarter more."""

    def __init__(self, width: int | None, kind: type) -> None:
        self._rows = 0
        self._array: NDArray[np.generic] = np.empty((0,) if width is None else (0, width), dtype=kind)

    def add(self, rows: NDArray[np.generic]) -> None:
        """Put them behind the others."""
        needed = self._rows + len(rows)
        if needed > len(self._array):
            self._array.resize((needed + needed // 4, *self._array.shape[1:]), refcheck=False)
        self._array[self._rows : needed] = rows
        self._rows = needed

    @property
    def taken(self) -> NDArray[np.generic]:
        """All rows; no more can be added."""
        self._array.resize((self._rows, *self._array.shape[1:]), refcheck=False)
        return self._array
