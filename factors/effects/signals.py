"""The signals that the formulas of extra effects depend on: fields, rates and other channels, sample by sample."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.turning import Turning
from magyc_gtsam.factors.errors import MagycError

STANDARD_GRAVITY = 9.80665  # m/s² in a g


@dataclass(frozen=True, eq=False)
class Signals:
    """The signals of a recording, sample by sample along the last axis; unknown ones are None.

    Attributes:
        time: (n,) s, as in the recording.
        field: (3, n) T, soft iron times the true field: the reading less hard iron and noise.
        field_rate: (3, n) T/s, its time derivative.
        span: (n,) s, the length of each window, where the rows are means over windows.
        within: (3, n, k) T, the field at k instants of each window, where the rows are means over windows.
        hard_iron: (3,) T.
        rate: (3, n) rad/s, true angular rate.
        turning: the same from sample to sample, where the rows are means over windows.
        to_sensor: (3, 3, n) rotation of a world frame into the sensor's.
        soft_iron: (3, 3) in any unit.
        acceleration: (3, n) m/s².
        channels: {"current" | "temperature" | "position": (k, n)}.
    """

    time: Array
    field: Array | None = None
    field_rate: Array | None = None
    span: Array | None = None
    within: Array | None = None
    hard_iron: Array | None = None
    rate: Array | None = None
    turning: Turning | None = None
    to_sensor: Array | None = None
    soft_iron: Array | None = None
    acceleration: Array | None = None
    channels: Mapping[str, Array] = dataclasses.field(default_factory=dict)

    def need(self, name: str) -> Array:
        """Return a signal, or the channel of that name.

        Raises:
            MagycError: it is not available.
        """
        value = getattr(self, name, None) if name not in CHANNELS else self.channels.get(name)
        if value is None or (name == "time" and np.isnan(value).any()):
            raise MagycError(
                f"{name}: a term of the calibration reads it, and the data do not hold it: "
                "give the recording of a log that does, or take the term out of the calibration"
            )
        array: Array = value
        return array

    @cached_property
    def world_axes(self) -> Array:
        """Return what a field of one unit along each axis of the world adds to the reading: (axis, component, n).

        It passes through the soft iron, whose determinant is taken as 1.
        """
        soft = self.need("soft_iron")
        axes: Array = np.einsum("ij,jkn->kin", soft / np.cbrt(np.linalg.det(soft)), self.need("to_sensor"))
        return axes

    @property
    def turns(self) -> Turning:
        """Return the turns of the sensor within the last moments of each row."""
        return self.turning or Turning(self.need("time"), self.need("rate"), self.time)

    @property
    def path(self) -> Array:
        """Return the field (3, n, k) within each row, for an effect that is not linear in it."""
        return self.need("field")[:, :, None] if self.within is None else self.within


CHANNELS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "current": ("current", "curr", "amp", "amps", "motor"),
        "temperature": ("temperature", "temp"),
        "position": ("position", "depth", "altitude", "height"),
    }
)
"""Words in a channel's name by which it counts as one of a kind; long words may be part of a word, short ones
may not.
"""
INSTEAD: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "current": ("throttle", "thrust", "CTUN.ThO", "actuator_controls_0.control[3]"),
        "temperature": ("IMU.T",),
    }
)
"""Words, and whole names of autopilots, of what stands for a kind where no channel of that kind changes."""
_NO_UNIT = "motor"  # says nothing of what is logged: a motor's throttle is a throttle
_LONG = 5  # letters from which a word is long
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_INSTANCE = re.compile(r"\[\d+\](?=\.)")  # in "IMU[1].T"


def channels_by_kind(channels: Mapping[str, Array]) -> dict[str, Array]:
    """Return {kind: (k, n)} from {name: (n,) or (n, k)}, with the names in alphabetical order.

    A throttle counts as a current, and the thermometer of an inertial sensor as a temperature, only where no other
    channel of that kind changes.
    """
    return {kind: np.stack(list(rows.values())) for kind, rows in _rows(channels).items()}


def rows_by_kind(channels: Mapping[str, Array]) -> dict[str, tuple[str, ...]]:
    """Return {kind: (k,)}, the names of the rows of `channels_by_kind`."""
    return {kind: tuple(rows) for kind, rows in _rows(channels).items()}


def _rows(channels: Mapping[str, Array]) -> dict[str, dict[str, Array]]:
    result = {}
    for kind in CHANNELS:
        called: dict[bool, dict[str, Array]] = {False: {}, True: {}}
        for name in sorted(channels):
            if kind in kinds(name):
                called[stands_in(name, kind)] |= rows_of(name, channels[name])
        own, instead = called[False], called[True]
        chosen = instead if not own or (_change(instead) and not _change(own)) else own
        if chosen:
            result[kind] = chosen
    return result


def rows_of(name: str, value: Array) -> dict[str, Array]:
    """Return {name: (n,)} of a channel (n,), or {"name 1": (n,), …} of one with several columns (n, k)."""
    columns = np.atleast_2d(np.asarray(value, dtype=float).T)
    if len(columns) == 1:
        return {name: columns[0]}
    return {f"{name} {number}": column for number, column in enumerate(columns, start=1)}


def _change(rows: Mapping[str, Array]) -> bool:
    known = (row[np.isfinite(row)] for row in rows.values())
    return any(len(row) > 0 and np.ptp(row) > 0 for row in known)


def kinds(name: str) -> tuple[str, ...]:
    """Return the kinds that a channel of this name counts as, or can stand for."""
    return tuple(kind for kind in CHANNELS if _is_called(name, CHANNELS[kind]) or stands_in(name, kind))


def stands_in(name: str, kind: str) -> bool:
    """Return whether a channel of this name is none of a kind, but can stand for one."""
    instead = INSTEAD.get(kind, ())
    return (_INSTANCE.sub("", name) in instead or _is_called(name, instead)) and not is_one(name, kind)


def is_one(name: str, kind: str) -> bool:
    """Return whether a channel's name says that it is of a kind: a motor's may be a current or an output."""
    return _is_called(name, [word for word in CHANNELS[kind] if word != _NO_UNIT])


def _is_called(name: str, words: Sequence[str]) -> bool:
    """Whether a channel's name contains one of the words; "timestamp" does not contain "amp"."""
    parts = [part.lower() for part in _WORDS.findall(name)]
    return any(word in part if len(word) >= _LONG else word == part for word in words for part in parts)
