"""A table that grows at its end, each column an array of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", bound=np.generic)


class GrowingColumns(Generic[Number]):
    """Columns to which rows are added block by block, with room for a quarter more.

    Args:
        width: number of columns.
        kind: of the numbers.
    """

    def __init__(self, width: int, kind: type[Number]) -> None:
        self._rows = 0
        self._columns: list[NDArray[Number]] = [np.empty(0, dtype=kind) for _ in range(width)]

    def add(self, rows: NDArray[Number]) -> None:
        """Put rows (n, width), or (n,) of a single column, behind the others."""
        needed = self._rows + len(rows)
        for column, more in zip(self._columns, rows.reshape(len(rows), len(self._columns)).T, strict=True):
            if needed > len(column):
                column.resize(needed + needed // 4, refcheck=False)
            column[self._rows : needed] = more
        self._rows = needed

    def column(self, number: int) -> NDArray[Number]:
        """(n,) a column; no more rows can be added."""
        self._columns[number].resize(self._rows, refcheck=False)
        return self._columns[number]

    def together(self, numbers: Sequence[int], last: bool = False) -> NDArray[Number]:
        """(n, len(numbers)) columns side by side; those asked for the `last` time are given up."""
        result = np.stack([self.column(k) for k in numbers], axis=1)
        for k in numbers if last else ():
            self._columns[k] = self._columns[k][:0].copy()
        return result
