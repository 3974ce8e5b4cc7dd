"""Lines of text that carry samples, whatever brings them: a pipe, datagrams or a serial port.

    {"time": 12.34, "magnetic_field": [2.1e-5, 0.3e-5, 4.0e-5], "angular_rate": [0.01, 0.0, 0.2]}

Either sensor may be absent from a line (or null); other keys are not looked at. Where it is asked for, also what
MotionCal reads (https://www.pjrc.com/store/prop_shield.html, imuread.h):

    Raw:ax,ay,az,gx,gy,gz,mx,my,mz

in counts of 1/8192 g, 1/16 °/s and 0.1 µT. Such a line has no stamp, and gets that of its arrival.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any, TypeGuard

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.source import SENSORS, NewSamples, none
from magyc_gtsam.recording import Samples

_LONGEST = 1 << 20  # bytes of a line
_RAW = b"Raw:"
_PER_COUNT = {"magnetic_field": 0.1e-6, "angular_rate": math.pi / 180 / 16}  # T and rad/s, of MotionCal's lines


class Lines:
    """Samples from lines; one that cannot be used is left out, and `notes` says which and why.

    Args:
        name: what to call where they come from.
        request: units.
        notes: where to say what was left out.
        arrival: gives the stamp of a MotionCal line that has just come, s; None where such lines are not expected.
    """

    def __init__(
        self, name: str, request: Request, notes: list[str], arrival: Callable[[], float] | None = None
    ) -> None:
        self.count = 0
        self.refused = 0
        self._name, self._notes, self._arrival = name, notes, arrival
        self._scale = {sensor: request.scale(sensor)[0] for sensor in SENSORS}
        self._raw_scale = {sensor: request.scale(sensor, _PER_COUNT[sensor])[0] for sensor in SENSORS}
        self._seen: set[str] = set()
        self._rest = b""

    @property
    def waiting_for(self) -> str:
        """The sensors that no line has had so far."""
        absent = [sensor for sensor in SENSORS if sensor not in self._seen]
        return f"no {' and no '.join(absent)} in {self.count} lines so far" if absent else ""

    def take(self, data: bytes, last: bool = False) -> NewSamples:
        """The samples of the lines that these bytes complete; `last`, where no more of the last line will come.

        Raises:
            MagycError: a line without an end.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if last and self._rest:
            lines, self._rest = [*lines, self._rest], b""
        if len(self._rest) > _LONGEST:
            raise MagycError(
                f"{self._name}, line {self.count + len(lines) + 1}: longer than {_LONGEST} bytes; "
                "one JSON object per line is expected"
            )
        rows: dict[str, list[list[float]]] = {sensor: [] for sensor in SENSORS}
        for line in lines:
            self.count += 1
            if line.strip():
                try:
                    found = self._parse(line)
                except MagycError as problem:
                    self.refused += 1
                    self._notes.append(f"{self._name}, line {self.count}: {problem}; left out")
                    continue
                for sensor, row in found.items():
                    rows[sensor].append(row)
        self._seen |= {sensor for sensor in SENSORS if rows[sensor]}
        return NewSamples(*(_samples(rows[sensor]) for sensor in SENSORS))

    def _parse(self, line: bytes) -> dict[str, list[float]]:
        """{sensor: [time, x, y, z]}, SI units."""
        if self._arrival is not None and line.lstrip().startswith(_RAW):
            return self._parse_raw(line.strip()[len(_RAW) :], self._arrival())
        try:
            values = json.loads(line, parse_int=float)  # an integer of any length: too large is infinite
        except (ValueError, RecursionError) as problem:  # not UTF-8 and nested without end among them
            raise MagycError(f"not JSON ({problem})") from None
        if not isinstance(values, dict):
            raise MagycError('not an object {"time": …, "magnetic_field": […], "angular_rate": […]}')
        time = values.get("time")
        if not _is_number(time) or not math.isfinite(time):
            raise MagycError(f'"time" is {json.dumps(time)[:80]}, a number of seconds is needed')
        result = {}
        for sensor in SENSORS:
            vector = values.get(sensor)
            if vector is None:
                continue
            if not isinstance(vector, list) or len(vector) != 3 or not all(map(_is_number, vector)):
                raise MagycError(f'"{sensor}" is {json.dumps(vector)[:80]}, three numbers are needed')
            result[sensor] = [time, *(value * self._scale[sensor] for value in vector)]
        if not result:
            raise MagycError('neither "magnetic_field" nor "angular_rate"')
        return result

    def _parse_raw(self, text: bytes, time: float) -> dict[str, list[float]]:
        try:
            counts = [int(part) for part in text.split(b",")]
        except ValueError:
            counts = []
        if len(counts) != 9 or max(map(abs, counts)) > 1 << 20:
            raise MagycError("not nine whole numbers Raw:ax,ay,az,gx,gy,gz,mx,my,mz")
        parts = {"magnetic_field": counts[6:], "angular_rate": counts[3:6]}
        return {s: [time, *(count * self._raw_scale[s] for count in parts[s])] for s in SENSORS}


def _samples(rows: list[list[float]]) -> Samples:
    if not rows:
        return none()
    table = np.array(rows)
    return Samples(table[:, 0], table[:, 1:])


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, float)


class SourceOfLines:
    """What sources of lines have in common: a `LiveSource` but for `read` and `close`.

    Args:
        name, request, arrival: as of `Lines`.
    """

    def __init__(self, name: str, request: Request, arrival: Callable[[], float] | None = None) -> None:
        self.name = name
        self.ended = False
        self.received = 0
        self.notes: list[str] = []
        self._lines = Lines(name, request, self.notes, arrival)

    @property
    def lost(self) -> int:
        """Lines that could not be used."""
        return self._lines.refused

    @property
    def waiting_for(self) -> str:
        """As `LiveSource.waiting_for`."""
        return self._lines.waiting_for
