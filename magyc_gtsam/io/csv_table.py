"""The lines and cells of a text table: separator, header, comments, and an incomplete last line.

The file is read in pieces, so that only the numbers of the wanted columns take memory.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.csv_columns import Column, parse_header, sensor_sets
from magyc_gtsam.io.csv_lines import COMMENT, DataLines, lines_of, pieces_of
from magyc_gtsam.io.growing import GrowingColumns

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab", None: "blanks"}
_LATEST_HEADER = 100  # line, and columns, in which a header is searched for a message
_SHOWN = 80  # characters of a cell in a message


# Converts the cells of the time column and the numbers of their lines to stamps (ns).
ToStamps = Callable[[list[str], Sequence[int]], Stamps]


@dataclass(frozen=True)
class Table:
    """The layout of a text table.

    Attributes:
        path: the file.
        separator: None for blanks.
        columns: empty if the file has no header.
        width: number of cells per line of data, with an empty one behind a separator at the end.
        first: cells of the first line of data.
        header: number of the header line; 0 without one.
    """

    path: Path
    separator: str | None
    columns: tuple[Column, ...]
    width: int
    first: list[str]
    header: int

    @property
    def separator_name(self) -> str:
        """The separator in words."""
        return _SEPARATORS[self.separator]

    def read(
        self, wanted: Sequence[int], time: int | None, to_stamps: ToStamps | None, report: Callable[[float], None]
    ) -> tuple[GrowingColumns[np.float64], Stamps, int, tuple[str, ...]]:
        """Read the data.

        Args:
            wanted: places of the columns to read.
            time: place of the column of stamps; None without one.
            to_stamps: converts the cells of that column.
            report: called with the fraction done.

        Returns:
            The numbers of the columns, NaN for empty cells; the stamps (ns); the number of lines; notes.

        Raises:
            MagycError: a line has more or fewer cells than the header, or a cell is not a number.
        """
        numbers, stamps = GrowingColumns(len(wanted), np.float64), GrowingColumns(1, np.int64)
        notes: list[str] = []
        count = 0
        size = max(self.path.stat().st_size, 1)
        for lines, last, place in self._data():
            lines = self._whole(lines, last, count, notes)
            if not lines.text:
                continue
            if self.separator != "," and any("," in line for line in lines.text):
                lines = lines._replace(text=[line.replace(",", ".") for line in lines.text])
                note = "commas in the numbers were read as decimal points"
                notes += [note] if note not in notes else []
            numbers.add(self._numbers(lines, wanted))
            if time is not None and to_stamps is not None:
                stamps.add(to_stamps(self._column(lines, time), lines.numbers))
            count += len(lines.text)
            report(place / size)
        return numbers, stamps.column(0), count, tuple(notes)

    def _data(self) -> Iterator[tuple[DataLines, bool, int]]:
        """Yield lines of data, whether they are the last, and the number of bytes read."""
        pieces = pieces_of(self.path)
        piece = next(pieces, None)
        while piece is not None:
            following = next(pieces, None)
            lines, place = piece
            if lines.numbers and lines.numbers[0] <= self.header:
                kept = [k for k, number in enumerate(lines.numbers) if number > self.header]
                lines = DataLines([lines.numbers[k] for k in kept], [lines.text[k] for k in kept], lines.quoted)
            yield lines, following is None, place
            piece = following

    def _whole(self, lines: DataLines, last: bool, before: int, notes: list[str]) -> DataLines:
        """Check that all lines have the same number of cells; drop the last line of the file if it is incomplete."""
        if self.separator is None:
            counts = list(map(len, map(str.split, lines.text)))
        elif lines.quoted:
            counts = [len(_split(line, self.separator)) for line in lines.text]
        else:
            counts = [1 + n for n in map(str.count, lines.text, repeat(self.separator))]
        if last and counts and before + len(counts) > 1 and counts[-1] < self.width:
            notes.append(f"line {lines.numbers[-1]}, the last, is incomplete and was left out")
            counts.pop()
            lines = DataLines(lines.numbers[:-1], lines.text[:-1], lines.quoted)
        if counts.count(self.width) != len(counts):
            row = next(k for k, n in enumerate(counts) if n != self.width)
            raise MagycError(
                f"{self.path}, line {lines.numbers[row]}: {counts[row]} values, expected {self.width}; "
                f"repair or remove the line{header_hint(self.path)}"
            )
        return lines

    def _column(self, lines: DataLines, column: int) -> list[str]:
        """Return the cells of one column."""
        if self.separator is None or lines.quoted:
            return [_split(line, self.separator)[column] for line in lines.text]
        return [line.split(self.separator, column + 1)[column] for line in lines.text]

    def _numbers(self, lines: DataLines, wanted: Sequence[int]) -> Array:
        """Return the numbers (n, len(wanted)) of columns, NaN for empty cells."""
        if not wanted:
            return np.empty((len(lines.text), 0))
        try:
            return np.loadtxt(
                lines.text, delimiter=self.separator, usecols=wanted, comments=None, ndmin=2, quotechar='"'
            )
        except ValueError:
            pass  # a cell is empty or not a number; the cells are parsed singly below
        result = np.empty((len(lines.text), len(wanted)))
        for k, column in enumerate(wanted):
            for row, cell in enumerate(self._column(lines, column)):
                try:
                    result[row, k] = float(cell) if cell.strip() else np.nan
                except ValueError:
                    raise MagycError(
                        f"{self.path}, line {lines.numbers[row]}: {cell.strip()[:_SHOWN]!r} in column {column + 1} "
                        "is not a number; repair or remove the line"
                    ) from None
        return result


def load(path: Path, names: str | Sequence[str] | None) -> Table:
    """Find the layout of the table in a file.

    Args:
        path: the file.
        names: names of the columns, for a file without a header; None for those of the header.

    Raises:
        MagycError: the file holds no data.
    """
    head: list[tuple[int, str]] = []
    comment = ""
    lines = 0
    for number, line in lines_of(path):
        lines = number
        if line.lstrip().startswith(COMMENT):
            comment = line.strip(" \t#/") if not head else comment
        elif line.strip():
            head.append((number, line))
            if len(head) == 2:
                break
    if not head:
        raise MagycError(f"{path}: holds no data, only {lines} empty or comment lines")
    separator = _separator([line for _, line in head])
    header = _split(head[0][1], separator)
    columns: tuple[Column, ...] = ()
    if names is not None:
        columns = parse_header(names.replace(",", " ").split() if isinstance(names, str) else names)
    header_line = 0
    if not _is_row(header):
        columns = columns or parse_header(header)
        header_line = head.pop(0)[0]
    elif not columns and len(_split(comment, separator)) == len(header):
        columns = parse_header(_split(comment, separator))
    if not head:
        raise MagycError(f"{path}: holds a header but no data")
    first = _split(head[0][1], separator)
    ended = separator is not None and not first[-1].strip()  # a separator behind the last value of each line
    if columns and len(first) - ended != len(columns) != len(first):
        remedy = "repair or remove the line" if names is None else "name every column of the table (columns=)"
        raise MagycError(
            f"{path}, line {head[0][0]}: {len(first)} values, expected {len(columns)}; {remedy}{header_hint(path)}"
        )
    return Table(path, separator, columns, len(first), first, header_line)


def header_hint(path: Path) -> str:
    """Return the line that looks like the header of a table whose first line is none, as text; "" without one."""
    for number, line in islice(lines_of(path), _LATEST_HEADER):
        for separator in filter(None, _SEPARATORS):
            cells = line.split(separator)
            if number > 1 and 4 <= len(cells) <= _LATEST_HEADER and _has_field(cells):
                return f"; line {number} looks like the header: remove the lines above it, or begin them with #"
    return ""


def _has_field(names: Sequence[str]) -> bool:
    """Return whether names of columns include those of a magnetometer."""
    try:
        return bool(sensor_sets(parse_header(names), "magnetic_field"))
    except MagycError:  # two columns have one name
        return False


def _separator(lines: Sequence[str]) -> str | None:
    """Return the separator that the first two lines contain; None for blanks."""
    return next((s for s in ("\t", ";", ",") if all(s in line for line in lines[:2])), None)


def _split(line: str, separator: str | None) -> list[str]:
    """Split a line into cells, some of which may be in quotation marks."""
    if separator is None:
        return line.split()
    if '"' not in line:
        return line.split(separator)
    try:
        return next(csv.reader([line], delimiter=separator))
    except csv.Error as error:  # a quotation mark is not closed
        raise MagycError(f"a line cannot be split into cells ({error}): {shortened(line)}") from None


def _is_row(cells: Sequence[str]) -> bool:
    """Return whether a line is data rather than names: at least one cell is a number."""
    return any(is_number(c) for c in cells)


def is_number(cell: str) -> bool:
    """Return whether a cell holds a number, with a decimal point or comma."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True
