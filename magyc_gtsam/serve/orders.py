"""From what the page asks to the arguments of the command line; all of it is checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.units import factor
from magyc_gtsam.serve.limits import Limits
from magyc_gtsam.serve.store import StoredLog

KINDS = ("look", "calibrate", "gap", "compare", "history")
_TEXTS = ("magnetic_field", "angular_rate")  # topics, messages or columns
_UNITS = {"magnetic_unit": "magnetic_field", "angular_unit": "angular_rate"}
_LONGEST = 200  # characters of a topic


@dataclass(frozen=True)
class Order:
    """What to run.

    Attributes:
        kind: of KINDS.
        logs: one, or several for a history.
        start, end: s of the interval; None for the whole log.
        reading: options of how the log is read, as on the command line.
    """

    kind: str
    logs: tuple[StoredLog, ...]
    start: float | None
    end: float | None
    reading: tuple[str, ...]

    @property
    def title(self) -> str:
        """What it is about."""
        return self.logs[0].name if len(self.logs) == 1 else f"{len(self.logs)} logs"

    def arguments(self, output: str | None) -> list[str]:
        """Of `magyc-gtsam`; `output` is the folder of the results."""
        interval = [f"--{n}={v!r}" for n, v in (("start", self.start), ("end", self.end)) if v is not None]
        logs = [str(log.path) for log in self.logs]
        if self.kind == "look":
            return ["info", *logs, "--json", "--strip", *self.reading]
        assert output is not None
        return [self.kind, *logs, "--json", f"--output={output}", *interval, *self.reading]


def order(asked: Any, logs: Mapping[str, StoredLog], limits: Limits) -> Order:
    """What the page asked for.

    Raises:
        MagycError: something that is not possible, or not there.
    """
    if not isinstance(asked, dict):
        raise MagycError("an object is expected")
    kind, keys = asked.get("kind"), asked.get("logs")
    if kind not in KINDS:
        raise MagycError(f"kind: none of {', '.join(KINDS)}")
    if (
        not isinstance(keys, list)
        or not 0 < len(keys) <= limits.history
        or not all(isinstance(k, str) for k in keys)
    ):
        raise MagycError(f"logs: 1 to {limits.history} are expected")
    if len(keys) > 1 and kind != "history":
        raise MagycError("several logs are for a history")
    if absent := [key for key in keys if key not in logs]:
        raise MagycError(f"{len(absent)} of the logs are not there any more; reload the page")
    start, end = (_seconds(asked, name) for name in ("start", "end"))
    return Order(kind, tuple(logs[key] for key in dict.fromkeys(keys)), start, end, tuple(reading(asked)))


def _seconds(asked: Mapping[str, Any], name: str) -> float | None:
    value = asked.get(name)
    if value is None:
        return None
    if (
        not isinstance(value, (int, float))
        or isinstance(value, bool)
        or not math.isfinite(value)
        or abs(value) > 1e9
    ):
        raise MagycError(f"{name}: a number of seconds is expected")
    return float(value)


def reading(asked: Mapping[str, Any]) -> Sequence[str]:
    """Options of the command line for `asked["reading"]`: units and topics.

    Raises:
        MagycError: other options, or values that cannot be one.
    """
    given = asked.get("reading") or {}
    if not isinstance(given, dict) or not given.keys() <= {*_TEXTS, *_UNITS}:
        raise MagycError(f"reading: only {', '.join((*_TEXTS, *_UNITS))} can be given")
    result = []
    for name, value in given.items():
        if value in (None, ""):
            continue
        if not isinstance(value, str) or len(value) > _LONGEST or not value.isprintable():
            raise MagycError(f"{name}: a short text is expected")
        if name in _UNITS:
            factor(_UNITS[name], _number_or_text(value))
        result.append(f"--{name.replace('_', '-')}={value}")
    return result


def _number_or_text(value: str) -> str | float:
    try:
        return float(value)
    except ValueError:
        return value
