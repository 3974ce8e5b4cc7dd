"""Read an MCAP file while it is written: without index and footer, and with an incomplete last chunk.

Reading continues where the complete records end, so that a record is decoded once it is complete. This also covers
writers that fill in the length of a chunk later: until then the length reaches beyond the end of the file.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO

from mcap.opcode import Opcode
from mcap.records import Metadata

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed, shortened
from magyc_gtsam.io.mcap_compression import Damage
from magyc_gtsam.io.mcap_records import (
    CALIBRATED_TOPIC,
    HEAD,
    MAGIC,
    METADATA,
    Record,
    block_of,
    broken_up,
    parsed,
    unfinished,
    unpacked,
)
from magyc_gtsam.io.mcap_topics import Topics
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_sources import FOUND_BY_TYPE, SensorSource, choose, needed, unknown
from magyc_gtsam.live.source import MEANS, SENSORS, NewSamples, none
from magyc_gtsam.recording import Samples
from magyc_gtsam.recording.applied import CALIBRATED

_BATCH = 1 << 20  # bytes after which a batch is returned, so that catching up with a long file shows progress
_POLL = 0.05  # s between checks of a file that does not grow


class McapFollower:
    """The magnetometer and gyroscope samples of a growing file; a `LiveSource`.

    Stamps are seconds on the clock of the log (for ROS since 1970), not counted from its first row.

    Attributes:
        calibrated: whether the field is that of `magyc-gtsam apply`.

    Args:
        path: the file; it must exist, but may be empty.
        request: topics, units and stamps, as for `read`.

    Raises:
        MagycError: here or from `read`: the file does not exist, is not MCAP or shrank; a topic cannot be read; or
            several topics match.
    """

    def __init__(self, path: str | os.PathLike[str], request: Request) -> None:
        self.name = Path(path).name
        self.ended = False
        self.received = 0
        self.lost = 0
        self.notes: list[str] = []
        self._path = Path(path)
        self._request = request
        self._scale = {}
        for sensor in SENSORS:
            self._scale[sensor] = request.scale(sensor, notes=self.notes)
        try:
            self._file: IO[bytes] = open(self._path, "rb", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
        self.calibrated = False
        self._calibrated: set[str] = set()  # keys of the topics that are calibrated
        self._place = 0  # byte at which the complete records end
        self._declared = 0  # bytes of the record there, which is incomplete
        # Only the topics of the two sensors are needed, not those of channels.
        self._topics = Topics(needed(replace(request, channels=()), SENSORS), request, self.notes, announced=True)
        self._chosen: dict[str, SensorSource] = {}

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def waiting_for(self) -> str:
        """The sensors without a topic so far, and the topics in the file; see `LiveSource`."""
        absent = [sensor for sensor in SENSORS if sensor not in self._chosen]
        if not absent:
            return ""
        wanted = " and ".join(
            f"{sensor} ({self._request.named(sensor) or FOUND_BY_TYPE[sensor]})" for sensor in absent
        )
        present = listed([f"{t.name} ({t.schema.name})" for t in self._topics.values()])
        return f"no topic of {wanted} yet; the file has {present or 'no topic'} so far"

    @property
    def unfinished(self) -> str:
        """Why the file has no end, if nothing more is written to it; "" if it has one, or no content."""
        return "" if self.ended or not self.received else unfinished(self._place, self.received, self._declared)

    def read(self, wait: float = 0.0) -> NewSamples:
        """Return the new samples; see `LiveSource.read`."""
        until = time.monotonic() + wait
        while True:
            for record in self._records():
                if not isinstance(record, Metadata):
                    self._topics.keep(record)
                elif record.name == METADATA:
                    self._calibrated |= record.metadata.keys()
                    if record.metadata.get("angular_rate_is") == "interval-mean":
                        self.notes.append(MEANS)
            batch = self._batch()
            self._note_calibrated()
            remaining = until - time.monotonic()
            if batch or self.ended or remaining <= 0:
                return batch
            time.sleep(min(_POLL, remaining))

    def _note_calibrated(self) -> None:
        """Note it once if the field is that of `apply`, which says so anywhere in its file."""
        source = self._chosen.get("magnetic_field")
        if source is not None and not self.calibrated and CALIBRATED_TOPIC + source.topic.name in self._calibrated:
            self.calibrated = True
            self.notes.append(CALIBRATED)

    def _records(self) -> Iterator[Record]:
        """Yield the complete records that have not been read yet, up to some megabytes."""
        self.received = size = os.fstat(self._file.fileno()).st_size
        if size < self._place:
            raise MagycError(
                f"{self._path}: shrank from {self._place} to {size} bytes, so it was replaced; start again"
            )
        if self._place == 0 and size >= len(MAGIC):
            if self._file.read(len(MAGIC)) != MAGIC:
                raise MagycError(
                    f"{self._path}: not an MCAP file, and only these can be read while they grow; use calibrate for a "
                    "complete log"
                )
            self._place = len(MAGIC)
        batch_end = self._place + _BATCH
        while 0 < self._place < batch_end and not self.ended:
            self._file.seek(self._place)
            head = self._read(HEAD.size)
            if len(head) < HEAD.size:
                return
            opcode, length = HEAD.unpack(head)
            self._declared = length
            if opcode == 0 or self._place + HEAD.size + length > size:
                return  # reserved space, or a record that is still being written
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA):
                yield from self._parsed(opcode, self._read(length))
            self.ended = opcode in (Opcode.DATA_END, Opcode.FOOTER)
            self._place += HEAD.size + length

    def _read(self, count: int) -> bytes:
        """Return the next `count` bytes, or fewer at the end of the file."""
        parts = []
        while count > 0 and (part := self._file.read(count)):
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def _parsed(self, opcode: int, content: bytes) -> Iterator[Record]:
        """Yield the records of a record's content; damaged content is left out with a note."""
        try:
            if opcode == Opcode.MESSAGE:
                yield from block_of(content, [0], [len(content)])
            elif opcode == Opcode.CHUNK:
                yield from broken_up(unpacked(content))
            else:
                yield parsed(opcode, content)
        except Damage as error:
            self.lost += 1
            what = "chunk" if opcode == Opcode.CHUNK else "record"
            self.notes.append(f"a {what} at byte {self._place} is damaged and was left out ({shortened(error)})")

    def _batch(self) -> NewSamples:
        """Return the samples of the messages that the topics hold, and empty the topics."""
        for sensor in SENSORS:
            if sensor not in self._chosen and self._present(sensor):
                source = choose(self._topics, sensor, self._request, self.notes)
                assert source is not None
                self._chosen[sensor] = source
        samples = {sensor: self._samples(sensor, source) for sensor, source in self._chosen.items()}
        for source in self._chosen.values():  # one topic may hold both sensors
            source.topic.forget()
        return NewSamples(*(samples.get(sensor, none()) for sensor in SENSORS))

    def _present(self, sensor: str) -> bool:
        """Return whether a topic that matches the sensor has appeared."""
        name = self._request.named(sensor)
        if name is not None:
            names = {name.lstrip("/"), name.lstrip("/").partition(".")[0]}
            return any(topic.lstrip("/") in names for topic in self._topics)
        return any(topic.type == FOUND_BY_TYPE[sensor] for topic in self._topics.values())

    def _samples(self, sensor: str, source: SensorSource) -> Samples:
        stamp = source.topic.stamp
        if not len(stamp):
            return none()
        if unknown(source):
            raise MagycError(
                f"{source.name}: declares that it has no {sensor} (covariance[0] is -1); name another topic"
            )
        return Samples(stamp / 1e9, source.topic.read(source.columns) * self._scale[sensor])
