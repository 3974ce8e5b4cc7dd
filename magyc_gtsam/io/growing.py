"""A table that grows at its end, with one array per column."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

_AT_ONCE = 1 << 18  # rows
Number = TypeVar("Number", bound=np.generic)


class GrowingColumns(Generic[Number]):
    """Columns to which blocks of rows are appended; each reserves a quarter more than it holds.

    Args:
        width: number of columns.
        kind: type of the numbers.
    """

    def __init__(self, width: int, kind: type[Number]) -> None:
        self._rows = 0
        self._columns: list[NDArray[Number]] = [np.empty(0, dtype=kind) for _ in range(width)]

    def add(self, rows: NDArray[Number]) -> None:
        """Append rows (n, width), or (n,) for a single column."""
        needed = self._rows + len(rows)
        for column, more in zip(self._columns, rows.reshape(len(rows), len(self._columns)).T, strict=True):
            if needed > len(column):
                column.resize(needed + needed // 4, refcheck=False)
            column[self._rows : needed] = more
        self._rows = needed

    def column(self, number: int) -> NDArray[Number]:
        """Return a column (n,); afterwards no rows can be added."""
        self._columns[number].resize(self._rows, refcheck=False)
        return self._columns[number]

    def together(self, numbers: Sequence[int], last: bool = False) -> NDArray[Number]:
        """Return columns (n, len(numbers)) side by side, and release their memory if this is the `last` use.

        From the end, so that what was copied is given back before the next rows take memory.
        """
        columns = [self.column(k) for k in numbers]
        result = np.empty((self._rows, len(columns)), dtype=self._columns[0].dtype)
        for end in range(self._rows, 0, -_AT_ONCE):
            rows = slice(max(end - _AT_ONCE, 0), end)
            for place, column in enumerate(columns):
                result[rows, place] = column[rows]
            if last:
                for k in {*numbers}:
                    self._columns[k].resize(rows.start, refcheck=False)
        return result
