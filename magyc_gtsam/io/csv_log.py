"""Read text tables: commas, semicolons, tabs or blanks, with names and units in the header."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io.csv_columns import Column, SensorColumns, find_sensor, find_time, parse_header
from magyc_gtsam.io.csv_stamps import StampColumn
from magyc_gtsam.io.csv_table import Stamps, Table, is_number, load
from magyc_gtsam.io.growing import GrowingColumns
from magyc_gtsam.io.log_info import LogInfo, Source
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream, assemble
from magyc_gtsam.io.units import factor
from magyc_gtsam.recording import Recording

Array = NDArray[np.float64]

_HIGHEST_RATE = 1e6  # Hz
OPTIONS = ("time", "time_unit", "rate", "columns")
_USUAL_NAMES = {3: "mx,my,mz", 4: "time,mx,my,mz", 6: "mx,my,mz,gx,gy,gz"}  # of so many columns without a header


def read(path: Path, request: Request) -> Recording:
    """As `magyc_gtsam.io.read`, of a text table.

    Options: `time` (column of the stamps), `time_unit` ("s", "ms", "us", "ns"), `rate` (Hz, where there is no
    such column) and `columns` (names, where there is no header).

    Raises:
        MagycError: columns that are missing or ambiguous, units that are not known, and lines that are no
            numbers, with their number in the file.
    """
    request.only("text", *OPTIONS)
    _check(request.options)
    table = load(path, request.options.get("columns"))
    notes: list[str] = []
    found: dict[str, SensorColumns | None] = {}
    for sensor in (*_TARGETS, "attitude"):
        try:
            found[sensor] = find_sensor(table.columns, sensor, request.sensors.get(sensor))
        except MagycError as error:
            if sensor in ("magnetic_field", "angular_rate") or request.sensors.get(sensor):
                raise
            notes.append(f"{sensor} left out: {error}")  # most methods need none
    time = find_time(table.columns, request.options.get("time"))
    _require(table, found["magnetic_field"], time, request)
    used = {c.index for g in found.values() if g for c in g.columns} | ({time.index} if time else set())
    extra = _channel_columns(table, used, request, notes)
    wanted = sorted({c.index for g in found.values() if g for c in g.columns} | {c.index for c in extra})
    numbers, stamp, said = _read(table, wanted, time, request)
    notes[:0] = said
    places = {k: [wanted.index(c.index) for c in group.columns] for k, group in found.items() if group}
    sensors = {}
    for sensor, group in found.items():
        if group is None:
            continue
        own = places.pop(sensor)
        value: Array = numbers.together(own, last=not any({*own} & {*other} for other in places.values()))
        if sensor != "attitude":
            scale, said = _scale(sensor, group, request)
            value *= scale
            notes.extend(said)
        sensors[sensor] = _present(Stream(group.label, stamp, value))
    channels = {
        c.written: _present(Stream(c.written, stamp, numbers.column(wanted.index(c.index)))) for c in extra
    }
    if "angular_rate" not in sensors:
        notes.append("no gyroscope: no columns are named like one")
    recording = assemble(
        sensors,
        {k: s for k, s in channels.items() if len(s.stamp)},
        request,
        name=path.stem,
        notes=tuple(notes),
    )
    request.report(1.0)
    return recording


def _check(options: Mapping[str, Any]) -> None:
    for name in ("time", "time_unit", "columns"):
        value = options.get(name)
        several = name == "columns" and isinstance(value, list | tuple) and all(isinstance(v, str) for v in value)
        if not (value is None or isinstance(value, str) or several):
            raise MagycError(f"{name}: {value!r} is no text")
    rate = options.get("rate")
    if rate is not None and (
        isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate <= _HIGHEST_RATE
    ):
        raise MagycError(f"rate: {rate!r} is no number of Hz between 0 and {_HIGHEST_RATE:g}")


_TARGETS = ("magnetic_field", "angular_rate", "acceleration")


def info(path: Path) -> LogInfo:
    """As `magyc_gtsam.io.info`, of a text table; `problem` is left to the caller."""
    table = load(path, None)
    serves: dict[int, str] = {}
    for sensor in (*_TARGETS, "attitude"):
        try:
            group = find_sensor(table.columns, sensor, None)
        except MagycError:
            continue  # `problem` says it: which columns are meant is for the caller of `read` to say
        serves |= {c.index: sensor for c in group.columns} if group else {}
    time, span, stamp = None, None, None
    try:
        time = find_time(table.columns, None)
        if time is not None:
            _, stamp, notes = _read(table, [], time, Request())
            span = (0.0, float(stamp[-1] - stamp[0]) / 1e9)
    except MagycError:
        pass  # likewise
    if stamp is None:
        _, _, count, notes = table.read([], None, None, lambda _: None)
    else:
        count = len(stamp)
    columns = table.columns or parse_header([f"column {i + 1}" for i in range(table.width)])
    sources = tuple(
        Source(c.written, c.unit or "", count, span, (serves.get(c.index, "channel"),))
        for c in columns
        if time is None or c.index != time.index
    )
    return LogInfo(str(path), f"CSV ({table.separator_name})", span[1] if span else 0.0, sources, notes)


def _require(table: Table, magnetometer: SensorColumns | None, time: Column | None, request: Request) -> None:
    rate = request.options.get("rate")
    if time is not None and rate is not None:
        raise MagycError(f"rate: {table.path} has the time stamps of {time.written}; leave the rate out")
    if not table.columns:
        names = _USUAL_NAMES.get(table.width, "time,mx,my,mz,gx,gy,gz")
        clock = "" if rate is not None else ", and the rate in Hz (rate=) where none of them is a time"
        raise MagycError(
            f"{table.path}: {table.width} columns of numbers without a header; name the columns in their order "
            f"(columns='{names}' or alike){clock}"
        )
    unclocked = time is None and rate is None
    if magnetometer is None:
        clock = ", and the column of time stamps (time=) or the rate in Hz (rate=)" if unclocked else ""
        raise MagycError(
            f"{table.path}: no magnetometer among the columns {listed([c.written for c in table.columns])}; name its "
            f"three columns (magnetic_field='x,y,z'){clock}"
        )
    if unclocked:
        raise MagycError(
            f"{table.path}: no column of time stamps; name it (time=), or give the rate in Hz (rate=)"
        )


def _read(
    table: Table, wanted: list[int], time: Column | None, request: Request
) -> tuple[GrowingColumns[np.float64], Stamps, tuple[str, ...]]:
    """The cells of the columns, the stamps of all lines in ns, and notes."""
    if time is None:
        numbers, _, count, notes = table.read(wanted, None, None, request.report)
        return numbers, np.round(np.arange(count) * (1e9 / request.options["rate"])).astype(np.int64), notes
    unit = request.options.get("time_unit") or time.unit or {"timeus": "us", "timems": "ms"}.get(time.name)
    column = StampColumn(table.path, unit)
    numbers, stamp, _, notes = table.read(wanted, time.index, column, request.report)
    column.check(stamp, time.written)
    return numbers, stamp, notes


def _channel_columns(table: Table, used: set[int], request: Request, notes: list[str]) -> list[Column]:
    free = [c for c in table.columns if c.index not in used]
    if request.channels is not None:
        missing = [w for w in request.channels if w not in {c.written for c in free}]
        if missing:
            raise MagycError(f"channels: no column {missing[0]!r}; free are {listed([c.written for c in free])}")
        return [c for c in free if c.written in request.channels]
    first = table.first
    text = [c for c in free if first[c.index].strip() and not is_number(first[c.index])]
    if text:
        notes.append(f"columns left out, which hold text: {listed([c.written for c in text])}")
    return [c for c in free if c not in text]


def _scale(sensor: str, group: SensorColumns, request: Request) -> tuple[float, tuple[str, ...]]:
    unit, asked = group.unit, request.units.get(sensor)
    if asked is not None:
        scale, said = request.scale(sensor)
        differs = unit is not None and (
            not isinstance(asked, str) or factor(sensor, unit) != factor(sensor, asked)
        )
        return scale, (f"{said[0]}, though the header says {unit}",) if differs else said
    return factor(sensor, unit), ()


def _present(stream: Stream) -> Stream:
    """Without the lines that leave all cells of the sensor empty: sensors of other rates share the table."""
    absent = np.isnan(stream.value)
    if not absent.any():
        return stream
    empty = np.asarray(absent.reshape(len(stream.stamp), -1).all(axis=1))
    # A sensor that is absent throughout is for the checks behind to refuse.
    return stream.rows(~empty) if empty.any() and not empty.all() else stream
