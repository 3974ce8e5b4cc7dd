"""Check what the page requests and turn it into arguments of the command line."""

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
_TEXTS = ("magnetic_field", "angular_rate")  # options that name topics, messages or columns
_UNITS = {"magnetic_unit": "magnetic_field", "angular_unit": "angular_rate"}
_LONGEST = 200  # most characters of a topic


@dataclass(frozen=True)
class JobRequest:
    """A checked request for a job.

    Attributes:
        kind: one of `KINDS`.
        logs: one log, or several for a history.
        start, end: limits of the interval, s; None for those of the log.
        reading: options of the command line on how to read the log.
    """

    kind: str
    logs: tuple[StoredLog, ...]
    start: float | None
    end: float | None
    reading: tuple[str, ...]

    @property
    def title(self) -> str:
        """Return the log's name, or the number of logs."""
        return self.logs[0].name if len(self.logs) == 1 else f"{len(self.logs)} logs"

    def arguments(self, output: str | None) -> list[str]:
        """Return the arguments of `magyc-gtsam`; `output` is the folder of the results, None for a "look"."""
        interval = [f"--{n}={v!r}" for n, v in (("start", self.start), ("end", self.end)) if v is not None]
        logs = [str(log.path) for log in self.logs]
        if self.kind == "look":
            return ["info", *logs, "--json", "--strip", *self.reading]
        assert output is not None
        return [self.kind, *logs, "--json", f"--output={output}", *interval, *self.reading]


def order(asked: Any, logs: Mapping[str, StoredLog], limits: Limits) -> JobRequest:
    """Return the job that the page requested.

    Raises:
        MagycError: the request is malformed or names a log that does not exist.
    """
    if not isinstance(asked, dict):
        raise MagycError("the request must be an object")
    kind, keys = asked.get("kind"), asked.get("logs")
    if kind not in KINDS:
        raise MagycError(f"kind: must be one of {', '.join(KINDS)}")
    if (
        not isinstance(keys, list)
        or not 0 < len(keys) <= limits.history
        or not all(isinstance(k, str) for k in keys)
    ):
        raise MagycError(f"logs: must be a list of 1 to {limits.history} keys")
    if len(keys) > 1 and kind != "history":
        raise MagycError(f"logs: only a history takes several, {kind} takes one")
    if absent := [key for key in keys if key not in logs]:
        raise MagycError(f"logs: {len(absent)} no longer exist; reload the page")
    start, end = (_seconds(asked, name) for name in ("start", "end"))
    return JobRequest(kind, tuple(logs[key] for key in dict.fromkeys(keys)), start, end, tuple(reading(asked)))


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
        raise MagycError(f"{name}: must be a finite number of seconds")
    return float(value)


def reading(asked: Mapping[str, Any]) -> Sequence[str]:
    """Return the options of the command line for `asked["reading"]`: units and topics.

    Raises:
        MagycError: an unknown option or an invalid value.
    """
    options = asked.get("reading") or {}
    if not isinstance(options, dict) or not options.keys() <= {*_TEXTS, *_UNITS}:
        raise MagycError(f"reading: only {', '.join((*_TEXTS, *_UNITS))} can be set")
    result = []
    for name, value in options.items():
        if value in (None, ""):
            continue
        if not isinstance(value, str) or len(value) > _LONGEST or not value.isprintable():
            raise MagycError(f"{name}: must be printable text of at most {_LONGEST} characters")
        if name in _UNITS:
            factor(_UNITS[name], _number_or_text(value))
        result.append(f"--{name.replace('_', '-')}={value}")
    return result


def _number_or_text(value: str) -> str | float:
    try:
        return float(value)
    except ValueError:
        return value
