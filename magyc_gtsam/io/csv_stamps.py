"""Time stamps in text: decimal numbers, exact to the nanosecond, or calendar dates."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.csv_table import Stamps
from magyc_gtsam.io.units import factor

_FRACTION = re.compile(r"[.,](\d+)")  # of a second, in a calendar date
_ZULU = re.compile("Z$")
_LONGEST_STEP = 2.0  # s; a table with larger steps has another unit, unless its header says seconds
_LONGEST_KNOWN = 5.0  # s; with larger steps the header names a wrong unit
_FEWEST = 10  # stamps; below this the unit in the header is believed
_FIRST = 1000  # cells by which a unit is guessed
_ISO = "ISO 8601"
_LATEST = 1 << 63  # ns since 1970 that an int64 holds
_MOST_DIGITS = 18  # that an int64 holds


class StampColumn:
    """Parser of a column of stamps. It does not use float64, which resolves seconds since 1970 only to 0.2 µs.

    Args:
        path: for messages.
        unit: "s", "ms", "us" or "ns"; None if unknown, which is read as s.
    """

    def __init__(self, path: Path, unit: str | None) -> None:
        self.path = path
        self.unit = unit
        self._scale = int(factor("time", unit or "s"))

    def __call__(self, cells: list[str], numbers: Sequence[int]) -> Stamps:
        """Return the stamps (n,) ns of cells (n), which are in the lines `numbers`.

        Raises:
            MagycError: a cell is not a time stamp, or is too large for the unit.
        """
        decimals = _decimals(cells, self._scale)
        if decimals is not None:
            return decimals
        stamp = np.empty(len(cells), dtype=np.int64)
        for row, cell in enumerate(cells):
            cell = cell.strip()
            try:
                stamp[row] = int((Decimal(cell) * self._scale).to_integral_value())
            except (ArithmeticError, ValueError):  # not a decimal, or its exponent is too large
                stamp[row] = self._other(cells, row, numbers)
        return stamp

    def _other(self, cells: list[str], row: int, numbers: Sequence[int]) -> int:
        """Return the stamp of a calendar date in one of the cells."""
        cell, number = cells[row].strip(), numbers[row]
        try:
            value = Decimal(cell)
        except InvalidOperation:
            self.unit = self.unit or _ISO
            try:
                return self._calendar(cell, number)
            except MagycError:
                raise
            except ValueError:
                if row == 0 and len(cells) > 1 and not _is_stamp(cells[-1]):
                    raise self._no_stamps(cell, number) from None
                raise self._not_a_stamp(cell, number) from None
        if not value.is_finite():
            raise self._not_a_stamp(cell, number)
        step = _median_step(cells)
        likely = next((u for u, least in (("ns", 17), ("us", 14)) if value.adjusted() >= least), "ms")
        likely = likely if step is None else _likely_unit(step)
        raise MagycError(
            f"{self.path}, line {number}: time stamp {cell[:80]} is beyond any date in {self.unit or 's'}; "
            f"likely unit: {likely}; name it (time_unit='{likely}')"
        ) from None

    def _not_a_stamp(self, cell: str, number: int) -> MagycError:
        return MagycError(
            f"{self.path}, line {number}: {cell[:80]!r} is neither a number nor a date and time in ISO 8601; repair or "
            "remove the line, or name another column of time stamps (time=)"
        )

    def _no_stamps(self, cell: str, number: int) -> MagycError:
        return MagycError(
            f"{self.path}: the time stamps, {cell[:80]!r} in line {number} and the others, are neither numbers nor "
            "dates and times in ISO 8601 (as 2025-09-01T08:00:00.5); rewrite them, name another column of time stamps "
            "(time=), or give the rate in Hz in their place (rate=)"
        )

    def _calendar(self, cell: str, number: int) -> int:
        """Return the stamp (ns since 1970) of a date in ISO 8601.

        Raises:
            ValueError: it is none, or a MagycError if it is out of range.
        """
        # datetime ignores digits below the microsecond, and before Python 3.11 does not accept Z.
        fraction = _FRACTION.search(cell)
        digits = fraction[1][:9].ljust(9, "0") if fraction else "0"
        moment = _moment(cell)
        zone = moment.utcoffset()
        seconds = int(np.datetime64(moment.replace(tzinfo=None), "s").astype(np.int64))
        seconds -= int(zone.total_seconds()) if zone else 0
        stamp = seconds * 1_000_000_000 + int(digits)
        if abs(stamp) >= _LATEST:
            raise MagycError(
                f"{self.path}, line {number}: {cell[:80]!r} is not within 292 years of 1970; repair or remove the line"
            )
        return stamp

    def check(self, stamp: Stamps, name: str) -> None:
        """Check the stamps (n,) ns of the whole column.

        Raises:
            MagycError: the median step is larger than 2 s and no unit is known, or larger than 5 s in the known unit.
        """
        step = float(np.median(np.abs(np.diff(stamp)))) / 1e9 if len(stamp) > 1 else 0.0
        likely = _likely_unit(step * 1e9 / self._scale)
        if self.unit is None and step > _LONGEST_STEP:
            what = f"names no unit and has a median step of {step:g}"
        elif self.unit not in (None, _ISO, likely) and step > _LONGEST_KNOWN and len(stamp) >= _FEWEST:
            what = f"is read in {self.unit} and has a median step of {step:g} s"
        else:
            return
        raise MagycError(
            f"{self.path}: column {name} {what}; likely unit: {likely}; name it (time_unit='{likely}')"
        )


def _moment(cell: str) -> datetime:
    """Return the date and time in ISO 8601, without the fraction of the second; a ValueError if it is none."""
    return datetime.fromisoformat(_ZULU.sub("+00:00", _FRACTION.sub("", cell)))


def _is_stamp(cell: str) -> bool:
    """Return whether a cell is a number or a date and time."""
    try:
        Decimal(cell.strip())
    except InvalidOperation:
        try:
            _moment(cell.strip())
        except ValueError:
            return False
    return True


def _median_step(cells: Sequence[str]) -> float | None:
    """Return the median step between the first cells that are numbers; None if fewer than two are."""
    values = []
    for cell in cells[:_FIRST]:
        try:
            values.append(float(cell))
        except ValueError:
            continue
    steps = np.abs(np.diff([value for value in values if np.isfinite(value)]))
    return float(np.median(steps)) if len(steps) else None


def _likely_unit(step: float) -> str:
    """Return the unit in which a median step is that of a log."""
    return next((u for u, s in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)) if step / s <= _LONGEST_STEP), "ns")


def _decimals(cells: list[str], scale: int) -> Stamps | None:
    """Return `cells` times `scale`, vectorised; None if any is not a plain decimal or does not give an integer."""
    try:
        text = np.array(cells, dtype=np.bytes_)
    except (UnicodeEncodeError, ValueError):
        return None
    width = text.dtype.itemsize
    digits = text.view(np.uint8).reshape(len(cells), width)
    length = np.char.str_len(text)
    result = np.empty(len(cells), dtype=np.int64)
    for size in np.unique(length).tolist():
        alike = np.flatnonzero(length == size)
        group = digits[alike, :size]
        point = group == ord(".")
        where = np.where(point.any(axis=1), point.argmax(axis=1), size) if size else np.zeros(len(alike), int)
        for place in np.unique(where).tolist():
            rows = where == place
            whole = group[rows][:, [k for k in range(size) if k != place]].astype(np.int64) - ord("0")
            after = max(size - place - 1, 0)
            if not 0 < whole.shape[1] <= _MOST_DIGITS or whole.min() < 0 or whole.max() > 9 or scale % 10**after:
                return None
            value = whole @ 10 ** np.arange(whole.shape[1] - 1, -1, -1, dtype=np.int64)
            if int(value.max()) * (scale // 10**after) >= 2**63:
                return None
            result[alike[rows]] = value * (scale // 10**after)
    return result
