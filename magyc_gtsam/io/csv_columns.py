"""Which columns of a text file are time, magnetometer, gyroscope and accelerometer, and in what unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed, shortened
from magyc_gtsam.io.request import Selection
from magyc_gtsam.io.units import lookup

# Words for a sensor, after lower-casing; a single letter counts only where nothing stands before it.
_WORDS = {
    "magnetic_field": (r"mag(?:netic|netometer|netom)?(?:[ _.]?field)?", r"m"),
    "angular_rate": (r"gyro(?:scope)?|gyr|ang(?:ular)?[ _.]?(?:rate|vel(?:ocity)?)|omega", r"[gw]"),
    "acceleration": (
        r"acc(?:el(?:erometer|eration)?)?|linear[ _.]?acceleration|specific[ _.]?force",
        r"[af]",
    ),
}
_TIME = re.compile(r"^%?(?:time[ _.]?stamp|stamp|time|t|sec(?:ond)?s?)$")
_QUATERNION = re.compile(r"^(.*?)(?:q|quat|quaternion|orientation)[ _.]?([xyzw])$")
_LONGEST_NAME = 200  # characters; a longer one is of no sensor, and is not looked through for a unit
_MOST_COLUMNS = 10_000  # of a table
_BRACKETS = re.compile(r"^(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]\s*$")


@dataclass(frozen=True)
class Column:
    """A column of the file: its place, its name as written and without the unit, and the unit as written."""

    index: int
    written: str
    name: str
    unit: str | None


@dataclass(frozen=True)
class SensorColumns:
    """The columns of a sensor in the order x, y, z (attitude x, y, z, w), and what they have in common."""

    label: str
    columns: tuple[Column, ...]

    @property
    def unit(self) -> str | None:
        """The unit that the header names.

        Raises:
            MagycError: the columns name different units.
        """
        units = {c.unit for c in self.columns}
        if len(units) > 1:
            raise MagycError(f"columns {self.label}: different units in the header ({units})")
        return units.pop()


def parse_header(fields: Sequence[str]) -> tuple[Column, ...]:
    """Names and units, from "Gyroscope X (deg/s)", "mag_x [uT]", "magnetic_field_x_T", "timestamp_ns", ...

    Raises:
        MagycError: more columns than a log has.
    """
    if len(fields) > _MOST_COLUMNS:
        raise MagycError(f"{len(fields)} columns in the header, at most {_MOST_COLUMNS} are read; is it a log?")
    columns = []
    for index, raw in enumerate(fields):
        written = raw.strip().strip('"').strip()
        name, unit = written, None
        if len(written) > _LONGEST_NAME:
            name = ""
        elif match := _BRACKETS.match(written):
            name, unit = match[1], match[2] or None
        else:
            for quantity, words in (("time", (r"t|time|stamp|time[ _.]?stamp",)), *_WORDS.items()):
                axis = "" if quantity == "time" else r"[ _.\-/]?[xyz]"
                pattern = rf"^(.*(?:{'|'.join(words)}){axis})[ _.\-]([a-z0-9µμ°/²^_]+)$"
                if (match := re.match(pattern, written, re.IGNORECASE)) and lookup(quantity, match[2]) is not None:
                    name, unit = match[1], match[2]
                    break
        columns.append(Column(index, written, name.lower(), unit))
    return tuple(columns)


def find_time(columns: Sequence[Column], named: str | None) -> Column | None:
    """The column of time stamps; None where there is none.

    Raises:
        MagycError: the column that the caller named does not exist, or several could be meant.
    """
    if named is not None:
        return _named(columns, named)
    found = [c for c in columns if _TIME.match(c.name) or re.match(r"^time(?:us|ms)$", c.name)]
    if len(found) > 1:
        raise MagycError(f"time: columns {_listed(found)} could be meant; name one (time=)")
    return found[0] if found else None


def find_sensor(columns: Sequence[Column], sensor: str, selection: Selection) -> SensorColumns | None:
    """The three columns of a sensor (four of the attitude); None where there are none.

    Args:
        columns: of the file.
        sensor: "magnetic_field", "angular_rate", "acceleration" or "attitude".
        selection: what the caller named: the columns (a list, or separated by commas), or the beginning
            that they share.

    Raises:
        MagycError: columns that do not exist, or several sensors that could be meant.
    """
    axes = "xyzw" if sensor == "attitude" else "xyz"
    if isinstance(selection, str) and "," not in selection:
        prefix = selection.lower()
        groups = _groups(columns, re.compile(rf"^({re.escape(prefix)}.*?)[ _.\-/]?([{axes}])$"), axes)
        if prefix in groups:
            return groups[prefix]
        groups = {k: v for k, v in groups.items() if k.startswith(prefix)}
        if not groups:
            raise MagycError(
                f"{sensor}: no columns {selection!r} with axes {', '.join(axes)}; the file has {_listed(columns)}"
            )
    elif selection is not None:
        names = selection.split(",") if isinstance(selection, str) else selection
        if len(names) != len(axes):
            raise MagycError(f"{sensor}: {len(names)} columns named, {len(axes)} are needed ({', '.join(axes)})")
        found = tuple(_named(columns, n) for n in names)
        return SensorColumns(_listed(found), found)
    elif sensor == "attitude":
        groups = _groups(columns, _QUATERNION, axes)
    else:
        word, letter = _WORDS[sensor]
        pattern = re.compile(rf"^((?:(?:.*[^a-z])?(?:{word})|{letter}))[ _.\-/]?([xyz])$")
        groups = _groups(columns, pattern, axes)
    if len(groups) > 1:
        sets = listed([", ".join(c.written for c in g.columns) for g in groups.values()], "; ")
        raise MagycError(f"{sensor}: {len(groups)} sets of columns could be meant: {sets}; name one ({sensor}=)")
    return next(iter(groups.values()), None)


def _groups(columns: Sequence[Column], pattern: re.Pattern[str], axes: str) -> dict[str, SensorColumns]:
    """Complete sets of axes, by the beginning that their names share."""
    found: dict[str, dict[str, Column]] = {}
    for column in columns:
        if match := pattern.match(column.name):
            group = found.setdefault(match[1], {})
            if match[2] in group:
                raise MagycError(
                    f"the columns {shortened(group[match[2]].written)} and {shortened(column.written)} have one name; "
                    "which one is meant? name all columns anew (columns=)"
                )
            group[match[2]] = column
    return {k: SensorColumns(k, tuple(v[a] for a in axes)) for k, v in found.items() if len(v) == len(axes)}


def _named(columns: Sequence[Column], name: str) -> Column:
    wanted = name.strip().lower()
    for column in columns:
        if wanted in (column.written.lower(), column.name):
            return column
    raise MagycError(f"no column {name!r}; the file has {_listed(columns)}")


def _listed(columns: Sequence[Column]) -> str:
    return listed([c.written for c in columns])
