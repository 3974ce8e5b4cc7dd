"""Samples in lines of text from a pipe, datagrams or a serial port.

    {"time": 12.34, "magnetic_field": [2.1e-5, 0.3e-5, 4.0e-5], "angular_rate": [0.01, 0.0, 0.2]}

Either sensor may be absent from a line (or null); other keys are ignored. On request the lines of MotionCal
(https://www.pjrc.com/store/prop_shield.html, imuread.h) are read too:

    Raw:ax,ay,az,gx,gy,gz,mx,my,mz

in counts of 1/8192 g, 1/16 °/s and 0.1 µT. Such a line has no stamp; its time of arrival is used.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any, TypeGuard

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.source import SENSORS, NewSamples, samples_of

_LONGEST = 1 << 20  # bytes of a line
_RAW = b"Raw:"
_PER_COUNT = {"magnetic_field": 0.1e-6, "angular_rate": math.pi / 180 / 16}  # T and rad/s, of MotionCal's lines


class Lines:
    """Parser of lines with samples. Invalid lines are left out, and `notes` lists each with the reason.

    Args:
        name: the source's name in messages.
        request: units.
        notes: list to which remarks on invalid lines are appended.
        arrival: returns the stamp (s) of a MotionCal line at its arrival; None if such lines are not accepted.
    """

    def __init__(
        self, name: str, request: Request, notes: list[str], arrival: Callable[[], float] | None = None
    ) -> None:
        self.count = 0
        self.refused = 0
        self._name, self._notes, self._arrival = name, notes, arrival
        self._scale = {sensor: request.scale(sensor) for sensor in SENSORS}
        self._raw_scale = {sensor: request.scale(sensor, _PER_COUNT[sensor]) for sensor in SENSORS}
        self._seen: set[str] = set()
        self._incomplete = b""

    @property
    def waiting_for(self) -> str:
        """The sensors that no line contained so far, in words; "" for none."""
        absent = [sensor for sensor in SENSORS if sensor not in self._seen]
        return f"no {' and no '.join(absent)} in {counted(self.count, 'line')} so far" if absent else ""

    def take(self, data: bytes, last: bool = False) -> NewSamples:
        """Return the samples of the lines that `data` completes.

        Args:
            data: the next bytes.
            last: whether these are the last bytes, so that the last line needs no newline.

        Raises:
            MagycError: a line is longer than 1 MiB.
        """
        *lines, self._incomplete = (self._incomplete + data).split(b"\n")
        if last and self._incomplete:
            lines, self._incomplete = [*lines, self._incomplete], b""
        if len(self._incomplete) > _LONGEST:
            raise MagycError(
                f"{self._name}, line {self.count + len(lines) + 1}: longer than {_LONGEST} bytes; "
                "expected one JSON object per line"
            )
        rows: dict[str, list[list[float]]] = {sensor: [] for sensor in SENSORS}
        for line in lines:
            self.count += 1
            if line.strip():
                try:
                    parsed = self._parse(line)
                except MagycError as problem:
                    self.refused += 1
                    self._notes.append(f"{self._name}, line {self.count}: {problem}; left out")
                    continue
                for sensor, row in parsed.items():
                    rows[sensor].append(row)
        self._seen |= {sensor for sensor in SENSORS if rows[sensor]}
        return NewSamples(*(samples_of(rows[sensor]) for sensor in SENSORS))

    def _parse(self, line: bytes) -> dict[str, list[float]]:
        """Return {sensor: [time, x, y, z]} of a line, in SI units."""
        if self._arrival is not None and line.lstrip().startswith(_RAW):
            return self._parse_raw(line.strip()[len(_RAW) :], self._arrival())
        try:
            values = json.loads(line, parse_int=float)  # an integer that is too large becomes infinite
        except (ValueError, RecursionError) as problem:  # includes bytes that are not UTF-8, and deep nesting
            raise MagycError(f"not JSON ({problem})") from None
        if not isinstance(values, dict):
            raise MagycError('expected an object {"time": …, "magnetic_field": […], "angular_rate": […]}')
        time = values.get("time")
        if not _is_number(time) or not math.isfinite(time):
            raise MagycError(f'"time" must be a number of seconds, got {json.dumps(time)[:80]}')
        result = {}
        for sensor in SENSORS:
            vector = values.get(sensor)
            if vector is None:
                continue
            if not isinstance(vector, list) or len(vector) != 3 or not all(map(_is_number, vector)):
                raise MagycError(f'"{sensor}" must be three numbers, got {json.dumps(vector)[:80]}')
            result[sensor] = [time, *(value * self._scale[sensor] for value in vector)]
        if not result:
            raise MagycError('neither "magnetic_field" nor "angular_rate"')
        return result

    def _parse_raw(self, text: bytes, time: float) -> dict[str, list[float]]:
        """Return {sensor: [time, x, y, z]} of the counts of a MotionCal line, in SI units."""
        try:
            counts = [int(part) for part in text.split(b",")]
        except ValueError:
            counts = []  # refused below
        if len(counts) != 9 or max(map(abs, counts)) > 1 << 20:
            raise MagycError("expected nine whole numbers Raw:ax,ay,az,gx,gy,gz,mx,my,mz")
        parts = {"magnetic_field": counts[6:], "angular_rate": counts[3:6]}
        return {s: [time, *(count * self._raw_scale[s] for count in parts[s])] for s in SENSORS}


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, float)


class SourceOfLines:
    """Base class of the sources that deliver lines: a `LiveSource` without `read` and `close`.

    Args:
        name, request, arrival: see `Lines`.
    """

    def __init__(self, name: str, request: Request, arrival: Callable[[], float] | None = None) -> None:
        self.name = name
        self.ended = False
        self.received = 0
        self.notes: list[str] = []
        self._lines = Lines(name, request, self.notes, arrival)

    @property
    def lost(self) -> int:
        """Number of invalid lines."""
        return self._lines.refused

    @property
    def waiting_for(self) -> str:
        """The sensors without a sample so far; see `LiveSource`."""
        return self._lines.waiting_for
