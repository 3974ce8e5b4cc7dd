"""Samples as lines of JSON, as another program pipes them in:

    {"time": 12.34, "magnetic_field": [2.1e-5, 0.3e-5, 4.0e-5], "angular_rate": [0.01, 0.0, 0.2]}

Either sensor may be absent from a line (or null); other keys are not looked at.
"""

from __future__ import annotations

import json
import math
import os
import select
from typing import Any, TypeGuard

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.live import Batch, none
from magyc_gtsam.io.request import Request
from magyc_gtsam.recording import Samples

_AT_ONCE = 1 << 16  # bytes
_LONGEST = 1 << 20  # bytes of a line
_SENSORS = ("magnetic_field", "angular_rate")


class JsonLines:
    """Samples from a pipe, a terminal or a file of JSON lines; a `LiveSource`.

    A line that cannot be used is left out, and `notes` says which and why.

    Args:
        descriptor: of the open file, read without buffering; 0 for standard input.
        request: units.
        name: what to call it.
    """

    def __init__(self, descriptor: int, request: Request, name: str = "standard input") -> None:
        self.name = name
        self.ended = False
        self.received = 0
        self.notes: list[str] = []
        self.lines = 0
        self.refused = 0
        self._descriptor = descriptor
        self._scale = {sensor: request.scale(sensor)[0] for sensor in _SENSORS}
        self._seen: set[str] = set()
        self._rest = b""

    @property
    def waiting_for(self) -> str:
        """The sensors that no line has had so far."""
        absent = [sensor for sensor in _SENSORS if sensor not in self._seen]
        return f"no {' and no '.join(absent)} in {self.lines} lines so far" if absent else ""

    def read(self, wait: float = 0.0) -> Batch:
        """As `LiveSource.read`."""
        if not select.select([self._descriptor], [], [], wait)[0]:
            return Batch(none(), none())
        data = os.read(self._descriptor, _AT_ONCE)
        self.ended = not data
        self.received += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        if self.ended and self._rest:
            lines, self._rest = [*lines, self._rest], b""
        if len(self._rest) > _LONGEST:
            raise MagycError(
                f"{self.name}, line {self.lines + len(lines) + 1}: longer than {_LONGEST} bytes; "
                "one JSON object per line is expected"
            )
        rows: dict[str, list[list[float]]] = {sensor: [] for sensor in _SENSORS}
        for line in lines:
            self.lines += 1
            if line.strip():
                try:
                    found = self._parse(line)
                except MagycError as problem:
                    self.refused += 1
                    self.notes.append(f"{self.name}, line {self.lines}: {problem}; left out")
                    continue
                for sensor, row in found.items():
                    rows[sensor].append(row)
        self._seen |= {sensor for sensor in _SENSORS if rows[sensor]}
        return Batch(*(self._samples(sensor, rows[sensor]) for sensor in _SENSORS))

    def _parse(self, line: bytes) -> dict[str, list[float]]:
        """{sensor: [time, x, y, z]}."""
        try:
            values = json.loads(line, parse_int=float)  # an integer of any length: too large is infinite
        except (ValueError, RecursionError) as problem:  # not UTF-8 and nested without end among them
            raise MagycError(f"not JSON ({problem})") from None
        if not isinstance(values, dict):
            raise MagycError('not an object {"time": …, "magnetic_field": […], "angular_rate": […]}')
        time = values.get("time")
        if not _is_number(time) or not math.isfinite(time):
            raise MagycError(f'"time" is {json.dumps(time)}, a number of seconds is needed')
        result = {}
        for sensor in _SENSORS:
            vector = values.get(sensor)
            if vector is None:
                continue
            if not isinstance(vector, list) or len(vector) != 3 or not all(map(_is_number, vector)):
                raise MagycError(f'"{sensor}" is {json.dumps(vector)[:80]}, three numbers are needed')
            result[sensor] = [time, *vector]
        if not result:
            raise MagycError('neither "magnetic_field" nor "angular_rate"')
        return result

    def _samples(self, sensor: str, rows: list[list[float]]) -> Samples:
        if not rows:
            return none()
        table = np.array(rows)
        return Samples(table[:, 0], table[:, 1:] * self._scale[sensor])


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, float)
