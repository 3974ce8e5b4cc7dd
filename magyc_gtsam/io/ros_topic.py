"""A topic of a ROS log, which collects the numbers of its messages."""

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

LARGEST = 2048  # bytes of a message that can be a channel; images, clouds and scans are larger
_BLOCK = 1 << 22  # bytes of messages that are read together
_NO_TIME = 1 << 63  # later than any stamp


class Topic:
    """A topic with the number and time span of its messages, and their numbers if they are `wanted`.

    Args:
        name, encoding, schema: of its first channel.
        wanted: whether to read the messages, or only count them.
        by_log_time: use the times of recording as stamps instead of the headers.
        attitude: whether to read an attitude in a message that has other sensors too.
        grant: called with the number of bytes before they are kept; raises if they exceed the limit.
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
        # The last fields declare whether a sensor has an estimate; they are evaluated at once and not kept.
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
        """The type of the messages, without the "/msg/" of ROS 2."""
        return short_type(self.schema.name)

    @property
    def columns(self) -> list[tuple[str, int | None]]:
        """The path of each field that is kept, and its number of elements; None for a single number."""
        columns = (self._reader.columns if self._reader else None) or []
        return columns[: len(columns) - len(self._marks)]

    def add(self, data: NDArray[np.uint8], start: Stamps, length: Stamps, log_time: Stamps) -> None:
        """Add messages; see `FieldReader.read` for the arguments."""
        if not self.count:
            self.largest_first = int(length[0])
        self.count += len(start)
        self.span = (min(self.span[0], int(log_time.min())), max(self.span[1], int(log_time.max())))
        if not self.wanted or self.problem is not None:
            return
        rows = max(_BLOCK // int(length.max()), 1) if length.any() else len(start)
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
        """Return the reader of the messages."""
        kind = self.type
        unsupported = MagycError(
            f"{self.name} ({self.schema.name}): {self.encoding} with a schema in {self.schema.encoding!r} "
            "is not decoded"
        )
        if self.encoding not in ("cdr", "ros1"):
            raise unsupported
        if kind in SENSOR_FIELDS:
            types = known_types(kind, ros1=self.encoding == "ros1")
            return FieldReader(self.name, kind, types, self.encoding, self.fields)
        if self.largest_first > LARGEST:
            raise MagycError(
                f"{self.name} ({self.schema.name}): a channel has at most {LARGEST} bytes per message, this topic has "
                f"{self.largest_first}"
            )
        if self.schema.encoding not in ("ros2msg", "ros1msg"):
            raise unsupported
        try:
            types = parse_types(kind, self.schema.data.decode("utf-8", errors="replace"))
        except MagycError as error:
            raise MagycError(f"{self.name} ({self.schema.name}): {error}") from None
        return FieldReader(self.name, kind, types, self.encoding)

    @property
    def stamp(self) -> Stamps:
        """Stamps (n,) of the messages, ns.

        Raises:
            MagycError: the messages cannot be read.
        """
        if self.problem is not None:
            raise self.problem
        return np.empty(0, dtype=np.int64) if self._stamp is None else self._stamp.column(0)

    def read(self, columns: Sequence[int], last: bool = False) -> Array:
        """Return the numbers (n, len(columns)) of columns, and release their memory if this is the `last` use.

        Raises:
            MagycError: the messages cannot be read.
        """
        if self.problem is not None:
            raise self.problem
        if self._value is None:
            return np.empty((0, len(columns)))
        return self._value.together(columns, last)

    def unknown(self, mark: str) -> bool:
        """Return whether the field `mark` is -1 in all messages, which declares that there is no estimate."""
        return mark not in self._estimated

    def forget(self) -> None:
        """Drop the numbers collected so far."""
        self._stamp = self._value = None
        self._estimated = set()

    def channels(self) -> dict[str, Stream]:
        """Return the numbers as streams, named by the topic without slash, and by the field if there are several.

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
