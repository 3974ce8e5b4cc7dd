"""Recognition of the time and sensor columns of a text table, and of their units, by the header."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed, shortened
from magyc_gtsam.io.request import Selection
from magyc_gtsam.io.units import lookup

# Names of a sensor in lower case: words that may follow other text, and letters that may not.
_WORDS = {
    "magnetic_field": (r"mag(?:netic|netometer|netom)?(?:[ _.]?field)?", r"m"),
    "angular_rate": (r"gyro(?:scope)?|gyr|ang(?:ular)?[ _.]?(?:rate|vel(?:ocity)?)|omega", r"[gw]"),
    "acceleration": (
        r"acc(?:el(?:erometer|eration)?)?|linear[ _.]?acceleration|specific[ _.]?force",
        r"[af]",
    ),
}
_NUMBER = r"(?:[ _.\-]?\d{1,2})?"  # of a sensor of which there are several
_TIME = re.compile(r"^%?(?:time[ _.]?stamp|stamp|time|t|sec(?:ond)?s?)$")
_QUATERNION = re.compile(r"^(.*?)(?:q|quat|quaternion|orientation)[ _.]?([xyzw])$")
_LONGEST_NAME = 200  # characters; a longer name is not searched for a sensor and a unit
_MOST_COLUMNS = 10_000  # of a table
_BRACKETS = re.compile(r"^(.*?)\s*[(\[]\s*([^)\]]*?)\s*[)\]]\s*$")


@dataclass(frozen=True)
class Column:
    """A column of the file.

    Attributes:
        index: place in the line, from 0.
        written: name as written.
        name: name in lower case, without the unit.
        unit: unit as written; None without one.
    """

    index: int
    written: str
    name: str
    unit: str | None


@dataclass(frozen=True)
class SensorColumns:
    """The columns of a sensor in the order x, y, z (attitude: x, y, z, w), and a label that selects them."""

    label: str
    columns: tuple[Column, ...]

    @property
    def units(self) -> list[str]:
        """Return the units that the header names, as written, each once."""
        return list(dict.fromkeys(c.unit for c in self.columns if c.unit is not None))

    def unit_of(self, sensor: str) -> str | None:
        """Return the unit of all columns; None if the header names none.

        Raises:
            MagycError: the columns have different units, or some have none.
        """
        if not self.units:
            return None
        if len({c.unit and lookup(sensor, c.unit) for c in self.columns}) > 1:
            written = ", ".join(c.written for c in self.columns)
            option = f"{sensor.partition('_')[0]}_unit="
            raise MagycError(
                f"columns {shortened(written)}: different units in the header; name the unit of all ({option})"
            )
        return self.units[0]


def parse_header(fields: Sequence[str]) -> tuple[Column, ...]:
    """Split names such as "Gyroscope X (deg/s)", "mag_x [uT]", "magnetic_field_x_T", "timestamp_ns" into name and unit.

    Raises:
        MagycError: more than 10,000 columns.
    """
    if len(fields) > _MOST_COLUMNS:
        raise MagycError(f"header: at most {_MOST_COLUMNS} columns are read, got {len(fields)}; is it a log?")
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
                number = "" if quantity == "time" else _NUMBER
                pattern = rf"^(.*(?:{'|'.join(words)}){number}{axis})[ _.\-]([a-z0-9µμ°/²^_]+)$"
                if (match := re.match(pattern, written, re.IGNORECASE)) and lookup(quantity, match[2]) is not None:
                    name, unit = match[1], match[2]
                    break
        columns.append(Column(index, written, name.lower(), unit))
    return tuple(columns)


def time_columns(columns: Sequence[Column]) -> list[Column]:
    """Return the columns with the name of time stamps."""
    return [c for c in columns if _TIME.match(c.name) or re.match(r"^time(?:us|ms)$", c.name)]


def find_time(columns: Sequence[Column], named: str | None) -> Column | None:
    """Return the column of time stamps: the one with the name `named`, else the only candidate; None without any.

    Raises:
        MagycError: there is no column `named`, or there are several candidates.
    """
    if named is not None:
        return _named(columns, named)
    candidates = time_columns(columns)
    if len(candidates) > 1:
        raise MagycError(f"time: columns {_listed(candidates)} could be meant; name one (time=)")
    return candidates[0] if candidates else None


def find_sensor(columns: Sequence[Column], sensor: str, selection: Selection) -> SensorColumns | None:
    """Return the three columns of a sensor (four of the attitude); None if there are none.

    Args:
        columns: all columns of the file.
        sensor: "magnetic_field", "angular_rate", "acceleration" or "attitude".
        selection: names of the columns (a list, or separated by commas) or their common prefix; None to search.

    Raises:
        MagycError: a column does not exist, or several sets of columns match.
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
            raise MagycError(f"{sensor}: expected {len(axes)} columns ({', '.join(axes)}), got {len(names)}")
        selected = tuple(_named(columns, n) for n in names)
        return SensorColumns(_listed(selected), selected)
    else:
        groups = sensor_sets(columns, sensor)
    if len(groups) > 1:
        sets = listed([", ".join(c.written for c in g.columns) for g in groups.values()], "; ")
        raise MagycError(f"{sensor}: {len(groups)} sets of columns could be meant: {sets}; name one ({sensor}=)")
    return next(iter(groups.values()), None)


def sensor_sets(columns: Sequence[Column], sensor: str) -> dict[str, SensorColumns]:
    """Return every set of columns whose names are those of a sensor, by its prefix, which `find_sensor` accepts.

    Raises:
        MagycError: two columns have the same name.
    """
    if sensor == "attitude":
        return _groups(columns, _QUATERNION, "xyzw")
    word, letter = _WORDS[sensor]
    pattern = re.compile(rf"^((?:(?:.*[^a-z])?(?:{word})|{letter}){_NUMBER})[ _.\-/]?([xyz])$")
    return _groups(columns, pattern, "xyz")


def _groups(columns: Sequence[Column], pattern: re.Pattern[str], axes: str) -> dict[str, SensorColumns]:
    """Return the complete sets of axes by the common prefix of their names."""
    groups: dict[str, dict[str, Column]] = {}
    for column in columns:
        if match := pattern.match(column.name):
            group = groups.setdefault(match[1], {})
            if match[2] in group:
                raise MagycError(
                    f"the columns {shortened(group[match[2]].written)} and {shortened(column.written)} have the same "
                    "name; rename the columns (columns=)"
                )
            group[match[2]] = column
    whole = {k: tuple(v[a] for a in axes) for k, v in groups.items() if len(v) == len(axes)}
    return {k: SensorColumns(k or _listed(found), found) for k, found in whole.items()}


def _named(columns: Sequence[Column], name: str) -> Column:
    """Return the column with a name, as written or without its unit, in any case."""
    wanted = name.strip().lower()
    for column in columns:
        if wanted in (column.written.lower(), column.name):
            return column
    raise MagycError(f"no column {name!r}; the file has {_listed(columns)}")


def _listed(columns: Sequence[Column]) -> str:
    return listed([c.written for c in columns])
