"""The lines and cells of a text table: separators, header, comments, and lines that are cut off."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.csv_columns import Column, parse_header

Array = NDArray[np.float64]

_SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab", None: "blanks"}


@dataclass(frozen=True)
class Table:
    """The lines that hold data, the columns, and what was left out.

    Args:
        numbers: line number in the file of each line, from 1.
        lines: of data.
        separator: None for blanks.
        columns: empty where the file has no header.
    """

    path: Path
    numbers: list[int]
    lines: list[str]
    separator: str | None
    columns: tuple[Column, ...]
    notes: tuple[str, ...]

    @property
    def separator_name(self) -> str:
        """In words."""
        return _SEPARATORS[self.separator]

    def cells(self, line: str) -> list[str]:
        """The cells of a line."""
        return _split(line, self.separator)

    def array(self, columns: Sequence[int]) -> Array:
        """The cells of the columns, (n, len(columns)); empty cells are NaN."""
        try:
            return np.loadtxt(
                self.lines, delimiter=self.separator, usecols=columns, comments=None, ndmin=2, quotechar='"'
            )
        except ValueError:
            pass  # an empty cell, or no number: looked at one by one, to say where
        result = np.empty((len(self.lines), len(columns)))
        for row, line in enumerate(self.lines):
            cells = self.cells(line)
            for k, column in enumerate(columns):
                cell = cells[column].strip()
                try:
                    result[row, k] = float(cell) if cell else np.nan
                except ValueError:
                    raise MagycError(
                        f"{self.path}, line {self.numbers[row]}: {cell!r} in column {column + 1} is not a "
                        "number; repair or remove the line"
                    ) from None
        return result


def load(path: Path, names: str | Sequence[str] | None) -> Table:
    """The table in a file.

    Args:
        path: of the file.
        names: of the columns, where the file has no header; None for the header's.

    Raises:
        MagycError: there is no data, or a line has more or fewer cells than the header.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    numbers: list[int] = []
    lines: list[str] = []
    comment = ""
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("#"):
            comment = line.lstrip().lstrip("#").strip() if not lines else comment
        elif line.strip():
            numbers.append(number)
            lines.append(line)
    if not lines:
        raise MagycError(f"{path}: holds no data, only {len(text.splitlines())} empty or comment lines")
    separator = _separator(lines)
    header = _split(lines[0], separator)
    columns: tuple[Column, ...] = ()
    if names is not None:
        columns = parse_header(names.replace(",", " ").split() if isinstance(names, str) else names)
    if not _is_row(header):
        columns = columns or parse_header(header)
        numbers, lines = numbers[1:], lines[1:]
    elif not columns and len(_split(comment, separator)) == len(header):
        columns = parse_header(_split(comment, separator))
    if not lines:
        raise MagycError(f"{path}: holds a header but no data")
    notes: tuple[str, ...] = ()
    width = len(columns) or len(_split(lines[0], separator))
    if len(lines) > 1 and len(_split(lines[-1], separator)) < width:
        notes = (f"line {numbers[-1]}, the last, is cut off and was left out",)
        numbers, lines = numbers[:-1], lines[:-1]
    if separator == ";" and any("," in line for line in lines):
        lines = [line.replace(",", ".") for line in lines]
        notes = (*notes, "commas in the numbers were read as decimal points")
    for number, line in zip(numbers, lines, strict=True):
        count = len(_split(line, separator))
        if count != width:
            raise MagycError(f"{path}, line {number}: {count} values, expected {width}; repair or remove the line")
    return Table(path, numbers, lines, separator, columns, notes)


def _separator(lines: Sequence[str]) -> str | None:
    return next((s for s in ("\t", ";", ",") if all(s in line for line in lines[:2])), None)


def _split(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return next(csv.reader([line], delimiter=separator)) if '"' in line else line.split(separator)


def _is_row(cells: Sequence[str]) -> bool:
    """Whether a line is data rather than names: at least one cell is a number."""
    return any(is_number(c) for c in cells)


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, with a point or a comma."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True
