"""A topic of a ROS log: what its messages are, and their numbers as they come in."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from mcap.records import Schema
from numpy.typing import NDArray

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.growing import GrowingColumns
from magyc_gtsam.io.ros2 import SENSOR_FIELDS, UNKNOWN, fields_of, known_types
from magyc_gtsam.io.ros_fields import Array, FieldReader, Stamps
from magyc_gtsam.io.ros_types import parse_types, short_type
from magyc_gtsam.io.streams import Stream

LARGEST = 2048  # bytes of a message; images, clouds and scans are no channels
_AT_ONCE = 1 << 22  # bytes of messages that are read together
_NO_TIME = 1 << 63  # beyond all stamps


class Topic:
    """One topic: what its messages are, and their numbers where they are `wanted`.

    Args:
        name, encoding, schema: of its first channel.
        wanted: whether to read the messages, or only to count them.
        by_log_time: stamp them by the time of recording, whatever their headers say.
        attitude: whether one that stands beside other sensors is of interest.
        grant: asked for the bytes of numbers before they are kept; raises where there are too many.
    """

    def __init__(
        self,
        name: str,
        encoding: str,
        schema: Schema,
        wanted: bool,
        by_log_time: bool = False,
        attitude: bool = True,
        grant: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._grant = grant
        self.name, self.encoding, self.schema, self.wanted = name, encoding, schema, wanted
        self.fields = fields_of(self.type, attitude) if self.type in SENSOR_FIELDS else ()
        # The last fields, which say whether there is an estimate of a sensor: looked at as they come, and not kept.
        self._marks = [path for path in self.fields if path in UNKNOWN.get(self.type, {}).values()]
        self._estimated: set[str] = set()
        self.count = 0
        self.span = (_NO_TIME, -_NO_TIME)  # ns, times of recording
        self.largest_first = 0  # bytes of the first message
        self.problem: MagycError | None = None  # why the messages cannot be read
        self._by_log_time = by_log_time
        self._reader: FieldReader | None = None
        self._stamp: GrowingColumns[np.int64] | None = None
        self._value: GrowingColumns[np.float64] | None = None

    @property
    def type(self) -> str:
        """Of its messages, without the "/msg/" of ROS 2."""
        return short_type(self.schema.name)

    @property
    def columns(self) -> list[tuple[str, int | None]]:
        """The numbers that are kept: the path of each, and for arrays how many it is."""
        found = (self._reader.columns if self._reader else None) or []
        return found[: len(found) - len(self._marks)]

    def add(self, data: NDArray[np.uint8], start: Stamps, length: Stamps, log_time: Stamps) -> None:
        """Messages that lie in `data`; see `FieldReader.read`."""
        if not self.count:
            self.largest_first = int(length[0])
        self.count += len(start)
        self.span = (min(self.span[0], int(log_time.min())), max(self.span[1], int(log_time.max())))
        if not self.wanted or self.problem is not None:
            return
        rows = max(_AT_ONCE // int(length.max()), 1) if length.any() else len(start)
        for first in range(0, len(start), rows):
            part = slice(first, first + rows)
            try:
                if self._reader is None:
                    self._reader = self._field_reader()
                stamp, value = self._reader.read(data, start[part], length[part])
            except MagycError as error:
                self.problem = error
                self._stamp = self._value = None
                return
            width = self._reader.width - len(self._marks)
            for path, mark in zip(self._marks, value[:, width:].T, strict=True):
                if (mark != -1).any():
                    self._estimated.add(path)
            self._grant(value[:, :width].nbytes + stamp.nbytes)
            if self._by_log_time or not self._reader.stamped:
                stamp = log_time[part]
            if self._stamp is None or self._value is None:
                self._stamp = GrowingColumns(1, np.int64)
                self._value = GrowingColumns(width, np.float64)
            self._stamp.add(stamp)
            self._value.add(value[:, :width])

    def _field_reader(self) -> FieldReader:
        kind = self.type
        if self.encoding not in ("cdr", "ros1"):
            raise MagycError(
                f"{self.name} ({self.schema.name}): {self.encoding} with a schema in {self.schema.encoding!r} "
                "is not decoded"
            )
        if kind in SENSOR_FIELDS:
            types = known_types(kind, ros1=self.encoding == "ros1")
            return FieldReader(self.name, kind, types, self.encoding, self.fields)
        if self.largest_first > LARGEST:
            raise MagycError(
                f"{self.name} ({self.schema.name}): {self.largest_first} bytes, too large for numbers"
            )
        if self.schema.encoding not in ("ros2msg", "ros1msg"):
            raise MagycError(
                f"{self.name} ({self.schema.name}): {self.encoding} with a schema in {self.schema.encoding!r} "
                "is not decoded"
            )
        try:
            types = parse_types(kind, self.schema.data.decode("utf-8", errors="replace"))
        except MagycError as error:
            raise MagycError(f"{self.name} ({self.schema.name}): {error}") from None
        return FieldReader(self.name, kind, types, self.encoding)

    @property
    def stamp(self) -> Stamps:
        """(n,) ns of the messages.

        Raises:
            MagycError: the messages cannot be read.
        """
        if self.problem is not None:
            raise self.problem
        return np.empty(0, dtype=np.int64) if self._stamp is None else self._stamp.column(0)

    def read(self, columns: Sequence[int], last: bool = False) -> Array:
        """(n, len(columns)) numbers, in the order of `columns`; they are given up where asked for the `last` time.

        Raises:
            MagycError: the messages cannot be read.
        """
        if self.problem is not None:
            raise self.problem
        if self._value is None:
            return np.empty((0, len(columns)))
        return self._value.together(columns, last)

    def unknown(self, mark: str) -> bool:
        """Whether all messages say by this field that they have no estimate: it is -1 (sensor_msgs/Imu)."""
        return mark not in self._estimated

    def forget(self) -> None:
        """Begin anew with what comes next."""
        self._stamp = self._value = None
        self._estimated = set()

    def channels(self) -> dict[str, Stream]:
        """The numbers by topic without slash, and field where there are several.

        Raises:
            MagycError: the messages cannot be read, or hold no number.
        """
        stamp = self.stamp
        if not self.columns:
            raise MagycError(f"{self.name} ({self.schema.name}): holds no number")
        base = self.name.lstrip("/")
        result = {}
        first = 0
        for path, count in self.columns:
            name = base if len(self.columns) == 1 else f"{base}.{path}"
            width = 1 if count is None else count
            value = self.read(range(first, first + width), last=True)
            result[name] = Stream(name, stamp, value[:, 0] if count is None else value)
            first += width
        return result
