"""The messages of a PX4 log as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import SEEK_CUR, BufferedReader, FileIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.extras import needs
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.io.px4_calibration import Parameters

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Message:
    """One instance of a message, with its fields as arrays."""

    name: str
    instance: int
    data: Mapping[str, NDArray[Any]]

    @property
    def label(self) -> str:
        """The name, followed by the instance if it is not the first."""
        return f"{self.name}[{self.instance}]" if self.instance else self.name

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(self.data["timestamp"])

    @property
    def stamp(self) -> Stamps:
        """Stamps (n,) in µs since boot: the time of the sample if the message has it, else of its publication."""
        at = self.data.get("timestamp_sample")
        known = at is not None and bool(np.all(at > 0))
        return np.asarray(at if known else self.data["timestamp"]).astype(np.int64)

    def vector(self, fields: str) -> Array | None:
        """Return three fields (n, 3), named "xyz" or "field[{}]"; None if the message does not have them."""
        names = list(fields) if "{}" not in fields else [fields.format(k) for k in range(3)]
        if any(n not in self.data for n in names):
            return None
        return np.column_stack([self.data[n] for n in names]).astype(np.float64)


class _LogFile(BufferedReader):
    """A file in which pyulog does not go in circles.

    To step over a message of an unknown kind by one byte, pyulog goes back by the length that the message states. Where
    the file has less than that, this is back to where it was before, for ever: the bytes that were missing count too.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(FileIO(path))
        self._asked = self._missing = 0

    def read(self, size: int | None = -1) -> bytes:
        """Read, and remember what was missing."""
        data = super().read(size)
        self._asked = -1 if size is None else size
        self._missing = max(self._asked - len(data), 0)
        return data

    def seek(self, offset: int, whence: int = 0) -> int:
        """Seek; back over a header and a message as if the whole message had been there."""
        back = whence == SEEK_CUR and offset == -2 - self._asked
        return super().seek(offset + self._missing if back else offset, whence)


def load(path: Path, names: list[str] | None) -> tuple[list[Message], Parameters, tuple[str, ...]]:
    """Load the messages with these names (None for all), the parameters, and notes on damage.

    Raises:
        MagycError: pyulog is not installed, or the file is not a PX4 log.
    """
    with needs(f"{path}", "pyulog", "px4"):
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    try:
        with _LogFile(path) as file, redirect_stdout(StringIO()):  # pyulog prints warnings about damage
            log = ULog(file, names)
    except MemoryError:
        raise
    except Exception as error:  # the exceptions of pyulog on damaged bytes have no common class
        reason = shortened(error) if isinstance(error, ULogException) else f"damaged: {shortened(repr(error))}"
        raise MagycError(f"{path}: the PX4 log cannot be read ({reason})") from error
    messages = [Message(d.name, int(d.multi_id), d.data) for d in log.data_list if "timestamp" in d.data]
    parameters = _finite_numbers(log.initial_parameters)
    changes = tuple((int(at), n, float(v)) for at, n, v in log.changed_parameters if n in _finite_numbers({n: v}))
    notes = []
    if log.file_corruption:
        notes.append("the log is damaged or cut off; the readable part was read")
    if log.dropouts:
        lost = sum(d.duration for d in log.dropouts) / 1e3
        notes.append(f"the logger lost data {len(log.dropouts)} times, {lost:.2f} s in all")
    return messages, Parameters(parameters, changes), tuple(notes)


def _finite_numbers(parameters: Mapping[str, Any]) -> dict[str, float]:
    """Return the parameters that are finite numbers; damage can turn others into text or NaN."""
    return {k: v for k, v in parameters.items() if isinstance(v, int | float) and math.isfinite(v)}


def device_of(message: Message, messages: list[Message], kind: str) -> int | None:
    """Return the identifier of the sensor that a message is from; None if the log does not name it.

    Raises:
        MagycError: the log changes from one sensor to another.
    """
    if "device_id" in message.data:
        identifiers = np.unique(message.data["device_id"])
    else:
        selected = [m for m in messages if m.name == "sensor_selection" and f"{kind}_device_id" in m.data]
        if not selected:
            return None
        identifiers = np.unique(selected[0].data[f"{kind}_device_id"])
    identifiers = identifiers[identifiers != 0]
    if len(identifiers) > 1:
        raise MagycError(
            f"{message.label}: PX4 changed from one sensor to another within the log (devices "
            f"{', '.join(map(str, identifiers))}), for which one calibration is not valid; "
            f"name the message of one sensor (sensor_{kind}[0])"
        )
    return int(identifiers[0]) if len(identifiers) else None
