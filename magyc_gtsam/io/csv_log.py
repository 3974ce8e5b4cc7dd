"""Reader of text tables with commas, semicolons, tabs or blanks, and names and units in the header."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io.csv_columns import (
    Column,
    SensorColumns,
    find_sensor,
    find_time,
    parse_header,
    sensor_sets,
    time_columns,
)
from magyc_gtsam.io.csv_stamps import StampColumn
from magyc_gtsam.io.csv_table import Stamps, Table, header_hint, is_number, load
from magyc_gtsam.io.growing import GrowingColumns
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.io.units import factor, lookup
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.applied import CALIBRATED
from magyc_gtsam.recording.autopilot import Autopilot, without_parameters
from magyc_gtsam.recording.checks import NO_GYROSCOPE

Array = NDArray[np.float64]

_REGULAR = 3  # median steps in lines; between the samples of sensors of different rates there are no more
_HIGHEST_RATE = 1e6  # Hz
OPTIONS = ("time", "time_unit", "rate", "columns")
_COARSE = "give the rate in Hz in place of the stamps (rate=), or name another column of time stamps (time=)"
_SENSORS = ("magnetic_field", "angular_rate", "acceleration", "attitude")
_OF_ARDUPILOT = re.compile(r"\bMAG\d?(\[\d+\])?\.MagX$")
_OF_PX4 = "magnetometer_ga"
_CORRECTED = (
    "the columns are of {}, which were corrected in flight by parameters that a table does not tell; read the {}"
)
# Likely names by the number of columns, proposed for a file without a header.
_USUAL_NAMES = {3: "mx,my,mz", 4: "time,mx,my,mz", 6: "mx,my,mz,gx,gy,gz"}


def read(path: Path, request: Request) -> Recording:
    """Read a text table; see `magyc_gtsam.io.read`.

    Options: `time` (column of the stamps), `time_unit` ("s", "ms", "us", "ns"), `rate` (Hz, if there is no such
    column) and `columns` (names, if there is no header).

    Raises:
        MagycError: a column is missing or ambiguous, a unit is unknown, or a cell is not a number; the message has the
            number of the line.
    """
    request.only("text", *OPTIONS, clock="the stamps in its columns")
    _check(request.options)
    table = load(path, request.options.get("columns"))
    notes: list[str] = []
    groups = _sensor_columns(table, request, notes)
    time, unused = _time(table, request, notes)
    _require(table, groups.get("magnetic_field"), time, request)
    used = {c.index for group in groups.values() for c in group.columns}
    extra = _channel_columns(table, used | unused | ({time.index} if time else set()), request, notes)
    wanted = sorted(used | {c.index for c in extra})
    numbers, stamp, table_notes = _read(table, wanted, time, request)
    notes[:0] = table_notes
    if groups["magnetic_field"].label == "calibrated_magnetic_field":  # the name that `magyc-gtsam apply` writes
        notes.insert(0, CALIBRATED)
    places = {k: [wanted.index(c.index) for c in group.columns] for k, group in groups.items()}
    sensors = {}
    for sensor, group in groups.items():
        columns = places.pop(sensor)
        value: Array = numbers.together(columns, last=not any({*columns} & {*other} for other in places.values()))
        if sensor != "attitude":
            value *= _scale(sensor, group, request, notes)
        sensors[sensor] = _present(Stream(group.label, stamp, value), notes)
    channels = {
        c.written: _present(Stream(c.written, stamp, numbers.column(wanted.index(c.index))), []) for c in extra
    }
    if "angular_rate" not in sensors:
        names = listed([c.written for c in table.columns])
        notes.append(f"{NO_GYROSCOPE} among the columns {names}; name its three columns (angular_rate='x,y,z')")
    recording = assemble(
        sensors,
        {k: s for k, s in channels.items() if len(s.stamp)},
        request,
        name=path.stem,
        notes=tuple(notes),
        autopilot=_autopilot(table, groups["magnetic_field"]),
        repeated=_COARSE,
    )
    request.report(1.0)
    return recording


def _autopilot(table: Table, magnetometer: SensorColumns) -> Autopilot | None:
    """Return that no parameters can be exported, if the columns are those of an autopilot's corrected field."""
    written = [column.written for column in magnetometer.columns]
    beside = {column.written for column in table.columns}
    if any(_OF_ARDUPILOT.search(name) for name in written) or ("MagX" in written and "OfsX" in beside):
        return without_parameters(_CORRECTED.format("ArduPilot's MAG messages", ".BIN"))
    if any(_OF_PX4 in name for name in written):
        return without_parameters(_CORRECTED.format("PX4's magnetometer_ga", ".ulg"))
    return None


def _check(options: Mapping[str, Any]) -> None:
    """Raise a MagycError unless the options of the format have the right types."""
    for name in ("time", "time_unit", "columns"):
        value = options.get(name)
        several = name == "columns" and isinstance(value, list | tuple) and all(isinstance(v, str) for v in value)
        if not (value is None or isinstance(value, str) or several):
            raise MagycError(f"{name}: must be text, got {value!r}")
    rate = options.get("rate")
    if rate is not None and (
        isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate <= _HIGHEST_RATE
    ):
        raise MagycError(f"rate: must be a number between 0 and {_HIGHEST_RATE:g} Hz, got {rate!r}")


def _sensor_columns(table: Table, request: Request, notes: list[str]) -> dict[str, SensorColumns]:
    """Return the columns of each sensor in the table."""
    groups = {}
    for sensor in _SENSORS:
        try:
            group = find_sensor(table.columns, sensor, request.sensors.get(sensor))
        except MagycError as error:
            if sensor in ("magnetic_field", "angular_rate") or request.sensors.get(sensor):
                raise
            notes.append(f"{sensor} left out: {error}")
            continue
        if group is not None:
            groups[sensor] = group
    return groups


def info(path: Path) -> LogInfo:
    """Describe a text table; see `magyc_gtsam.io.info`, which sets `problem`."""
    table = load(path, None)
    sensors: dict[int, tuple[str, SensorColumns]] = {}  # of each column
    for sensor in _SENSORS:
        try:
            sets = sensor_sets(table.columns, sensor).values()
        except MagycError:
            continue  # two columns have one name; `problem` reports them
        sensors |= {c.index: (sensor, group) for group in sets for c in group.columns}
    time, span, stamp = None, None, None
    try:
        time = find_time(table.columns, None)
        if time is not None:
            _, stamp, notes = _read(table, [], time, Request())
            span = (0.0, float(stamp[-1] - stamp[0]) / 1e9)
    except MagycError:
        pass  # no stamps can be read; `problem` reports the reason
    if stamp is None:
        _, _, count, notes = table.read([], None, None, lambda _: None)
    else:
        count = len(stamp)
    columns = table.columns or parse_header([f"column {i + 1}" for i in range(table.width)])
    sources: dict[str, Source] = {}
    for c in columns:
        if c.written and (time is None or c.index != time.index):
            sensor, group = sensors.get(c.index, ("channel", None))
            name = c.written if group is None else group.label
            sources.setdefault(f"{sensor} {name}", Source(name, c.unit or "", count, span, (sensor,)))
    return LogInfo(
        str(path), f"CSV ({table.separator_name})", span[1] if span else 0.0, tuple(sources.values()), notes
    )


def _time(table: Table, request: Request, notes: list[str]) -> tuple[Column | None, set[int]]:
    """Return the column of time stamps, None without one, and the places of those that a rate stands for."""
    rate, named = request.options.get("rate"), request.options.get("time")
    if rate is None:
        return find_time(table.columns, named), set()
    if named is not None:
        raise MagycError(f"rate: the column {named} of time stamps (time=) was named, too; leave one of them out")
    unused = time_columns(table.columns)
    if unused:
        notes.append(f"the stamps in {listed([c.written for c in unused])} were not used: the rate is {rate:g} Hz")
    return None, {c.index for c in unused}


def _require(table: Table, magnetometer: SensorColumns | None, time: Column | None, request: Request) -> None:
    """Raise a MagycError unless the table has a magnetometer and either time stamps or a rate."""
    rate = request.options.get("rate")
    if not table.columns:
        names = _USUAL_NAMES.get(table.width, "time,mx,my,mz,gx,gy,gz")
        clock = "" if rate is not None else ", and give the rate in Hz (rate=) if none of them is a time"
        raise MagycError(
            f"{table.path}: {table.width} columns of numbers without a header; name the columns in their order "
            f"(such as columns='{names}'){clock}"
        )
    unclocked = time is None and rate is None
    if magnetometer is None:
        clock = ", and the column of time stamps (time=) or the rate in Hz (rate=)" if unclocked else ""
        raise MagycError(
            f"{table.path}: no magnetometer among the columns {listed([c.written for c in table.columns])}; name its "
            f"three columns (magnetic_field='x,y,z'){clock}{header_hint(table.path)}"
        )
    if unclocked:
        raise MagycError(
            f"{table.path}: no column of time stamps; name it (time=), or give the rate in Hz (rate=)"
        )


def _read(
    table: Table, wanted: list[int], time: Column | None, request: Request
) -> tuple[GrowingColumns[np.float64], Stamps, tuple[str, ...]]:
    """Return the numbers of the wanted columns, the stamps of all lines in ns, and notes."""
    if time is None:
        numbers, _, count, notes = table.read(wanted, None, None, request.report)
        return numbers, np.round(np.arange(count) * (1e9 / request.options["rate"])).astype(np.int64), notes
    unit = request.options.get("time_unit") or time.unit or {"timeus": "us", "timems": "ms"}.get(time.name)
    column = StampColumn(table.path, unit)
    numbers, stamp, _, notes = table.read(wanted, time.index, column, request.report)
    column.check(stamp, time.written)
    return numbers, stamp, notes


def _channel_columns(table: Table, used: set[int], request: Request, notes: list[str]) -> list[Column]:
    """Return the columns of channels: those that the caller named, else all that are not `used` and hold numbers.

    A column without a name, as of a comma at the end of each line, is none.
    """
    free = [c for c in table.columns if c.index not in used and c.written]
    if request.channels is not None:
        missing = [w for w in request.channels if w not in {c.written for c in free}]
        if missing:
            raise MagycError(f"channels: no column {missing[0]!r}; free are {listed([c.written for c in free])}")
        return [c for c in free if c.written in request.channels]
    first = table.first
    text = [c for c in free if first[c.index].strip() and not is_number(first[c.index])]
    if text:
        notes.append(f"columns with text were left out: {listed([c.written for c in text])}")
    return [c for c in free if c not in text]


def _scale(sensor: str, group: SensorColumns, request: Request, notes: list[str]) -> float:
    """Return the factor to SI units, by the unit of the request or else the header."""
    if request.units.get(sensor) is None:
        return factor(sensor, group.unit_of(sensor))
    scale = request.scale(sensor, notes=notes)
    if any(lookup(sensor, unit) != scale for unit in group.units):
        notes[-1] += f", though the header says {listed(group.units)}"
    return scale


def _present(stream: Stream, notes: list[str]) -> Stream:
    """Drop the lines in which all cells of the sensor are empty, as where sensors of different rates share a table.

    Samples that are missing, other than the lines of the other sensors between two samples, are noted.
    """
    absent = np.isnan(stream.value)
    if not absent.any():
        return stream
    empty = np.asarray(absent.reshape(len(stream.stamp), -1).all(axis=1))
    # A sensor that is absent throughout is refused by the checks of `assemble`.
    if not empty.any() or empty.all():
        return stream
    steps = np.diff(np.flatnonzero(~empty))
    if len(steps) and steps.max() > _REGULAR * np.median(steps):
        notes.append(f"{stream.name}: {empty.sum()} of {len(empty)} lines have no value")
    return stream.rows(~empty)
