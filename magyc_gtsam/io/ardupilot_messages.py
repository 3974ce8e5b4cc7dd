"""The messages of an ArduPilot log as arrays per sensor instance, with the parameters in force at each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import counted
from magyc_gtsam.io import dataflash
from magyc_gtsam.io.dataflash import Dataflash
from magyc_gtsam.io.dataflash_types import TIMES
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.streams import Stream

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_CUT = "it seems to be of several firmwares, one after the other: cut it where the vehicle was switched on"


@dataclass(frozen=True, eq=False)
class InstanceSamples:
    """The messages of one instance of a sensor.

    Attributes:
        name: as "MAG[0]".
        stamp: (n,) ns.
        columns: {field: (n,)}.
        parameters: (n,) index of the set of parameters in force, in `ArduPilotLog.parameters`.
        boot: (n,) how often the vehicle had been switched on again.
    """

    name: str
    stamp: Stamps
    columns: dict[str, Array]
    parameters: NDArray[np.int64]
    boot: NDArray[np.int64]

    def stream(self, *columns: str) -> Stream:
        """Return the given columns as a stream (n, k).

        Raises:
            MagycError: the messages have no such column.
        """
        if missing := [c for c in columns if c not in self.columns]:
            raise MagycError(f"{self.name}: has no {', '.join(missing)} in this log")
        return Stream(self.name, self.stamp, np.column_stack([self.columns[c] for c in columns]))

    def first_of(self, *choices: tuple[str, ...]) -> Array:
        """Return the first choice of columns that the messages have, (n, 3).

        Raises:
            MagycError: they have none of the choices.
        """
        present = next((c for c in choices if all(name in self.columns for name in c)), choices[0])
        return self.stream(*present).value


@dataclass
class ArduPilotLog:
    """The contents of a log.

    Attributes:
        samples: {(message, instance): samples}.
        parameters: the sets of parameters that were in force, in their order.
        last: (k,) for each set, the index of the last one before the vehicle was switched off.
        notes: remarks on damage.
    """

    samples: dict[tuple[str, int], InstanceSamples]
    parameters: list[dict[str, float]]
    last: NDArray[np.int64]
    notes: tuple[str, ...]


def load(path: Path, fields: dict[str, tuple[str, ...]] | None, request: Request) -> ArduPilotLog:
    """Load messages of an ArduPilot log.

    Args:
        path: the file.
        fields: {message: columns} to load; None for all messages with a time, without columns.
        request: for progress reports.

    Raises:
        MagycError: not an ArduPilot log.
    """
    log = dataflash.load(path)
    request.report(0.3)
    try:
        return _loaded(log, fields, request)
    finally:
        log.close()


def _loaded(log: Dataflash, fields: dict[str, tuple[str, ...]] | None, request: Request) -> ArduPilotLog:
    notes = []
    if log.skipped:
        notes.append(f"the log is damaged: {log.skipped} bytes belong to no message and were left out")
    if fields is None:
        fields = dict.fromkeys(log.kinds, ())
    notes += [
        f"{kind}: {counted(count, 'message')} left out, whose format does not fit the length"
        for kind, count in log.misfits.items()
        if kind in fields
    ]
    fields = {kind: columns for kind, columns in fields.items() if _is_one(log, kind, columns, notes)}
    present = [k for k in fields if k in log.kinds and log.kinds[k].time and log.kinds[k].fields is not None]
    notes += [
        f"{kind} left out: its format does not fit the length of its messages"
        for kind in fields
        if kind in log.kinds and log.kinds[kind].fields is None
    ]
    corrected = [log.places(kind) for kind in present if kind.startswith(("MAG", "IMU"))]
    used = np.sort(np.concatenate(corrected or [np.empty(0, int)]))
    parameters, changes = _parameters(log, used)
    samples: dict[tuple[str, int], InstanceSamples] = {}
    impossible = 0
    for done, kind in enumerate(present):
        known = log.kinds[kind]
        # Logs without units do not mark the field of the instance; in other messages "I" is an integral.
        marked = known.instance or ("I" if "I" in known.columns and kind in ("MAG", "IMU", "BARO") else None)
        marked = marked if marked and known.holds(marked, "numbers") else None  # sensors are numbered, not named
        places = log.places(kind)
        stamp, possible = log.stamps(kind, places)
        impossible += int((~possible).sum())
        places, stamp = places[possible], stamp[possible]
        instances = log.column(kind, marked, places) if marked else np.zeros(len(places), dtype=np.int64)
        name, shift = (
            (kind[:-1], int(kind[-1]) - 1) if kind[:-1] in ("MAG", "IMU") and kind[-1] in "23" else (kind, 0)
        )
        for instance in np.unique(instances).tolist():
            if not -1 < instance < 256:
                continue
            rows = instances == instance
            key = (name, int(instance) + shift)
            at = places[rows]
            with np.errstate(invalid="ignore"):  # damaged bytes can be a NaN that signals
                columns = {
                    c: log.column(kind, c, at).astype(np.float64)
                    for c in fields[kind]
                    if known.holds(c, "numbers")
                }
            if key not in samples:
                which, boot = (np.searchsorted(since, at) for since in (changes, log.boots))
                samples[key] = InstanceSamples(label(key), stamp[rows], columns, which, boot)
        request.report(0.3 + 0.7 * (done + 1) / len(present))
    if impossible:
        notes.append(f"{counted(impossible, 'message')} with impossible times left out")
    boot = np.searchsorted(log.boots, np.append(-1, changes), side="right")
    last = np.searchsorted(boot, boot, side="right") - 1
    return ArduPilotLog(samples, parameters, last, tuple(notes))


def _is_one(log: Dataflash, kind: str, columns: tuple[str, ...], notes: list[str]) -> bool:
    """Return whether the columns of a message are the same in all parts of the log; a note if they are not.

    Raises:
        MagycError: they are not, of a sensor.
    """
    partly = log.only_in_part(kind, (*TIMES, "I", *columns))
    if partly:
        what = f"{kind} is described in several ways, and only some have {', '.join(partly)}"
        if kind.startswith(("MAG", "IMU")):
            raise MagycError(f"{what}; {_CUT}")
        notes.append(f"{what}: it was left out")
    return not partly


def _parameters(log: Dataflash, used: Stamps) -> tuple[list[dict[str, float]], Stamps]:
    """Return the sets of parameters, and the place in the file at which each set but the first begins.

    Args:
        log: the log with its PARM messages.
        used: places of the messages that depend on parameters; a change between two of them begins a new set, and so
            does each time that the vehicle was switched on again.

    Raises:
        MagycError: the messages have their columns in a part of the log only.
    """
    sets: list[dict[str, float]] = [{}]
    changes: list[int] = []
    boots, begun = [place for place in log.boots.tolist() if (used > place).any()], 0
    if log.only_in_part("PARM", ("Name", "Value")):
        raise MagycError(f"PARM: the log describes it in several ways; {_CUT}")
    known = log.kinds.get("PARM")
    if known is None or not (known.holds("Name", "text") and known.holds("Value", "numbers")):
        return [*sets, *({} for _ in boots)], np.array(boots, dtype=np.int64)
    names, values = dataflash.names(log.column("PARM", "Name").tolist()), log.column("PARM", "Value").tolist()
    for place, name, value in zip(log.places("PARM").tolist(), names, values, strict=True):
        value = float(value)
        while boots and place > boots[0]:
            begun = len(sets)
            sets.append({})
            changes.append(boots.pop(0))
        if name not in sets[-1]:
            # ArduPilot logs sensors before it has logged all parameters: the first value applies from the start.
            for one in sets[begun:]:
                one[name] = value
        elif sets[-1][name] != value:
            since, until = np.searchsorted(used, [changes[-1] if changes else -1, place])
            if until > since:
                sets.append(dict(sets[-1]))
                changes.append(place)
            sets[-1][name] = value
    return [*sets, *({} for _ in boots)], np.array([*changes, *boots], dtype=np.int64)


def label(key: tuple[str, int]) -> str:
    """Return the name of an instance, as "MAG[0]"."""
    return f"{key[0]}[{key[1]}]"
