"""Follow an MCAP file that is still being written: no index, no footer, the last chunk incomplete.

Reading goes on where complete records end, so a record is decoded once, when all of it is there. That also
covers writers that come back to a chunk to fill its length in: until then the length reaches beyond the file.
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
from magyc_gtsam.io.mcap_records import HEAD, MAGIC, Damage, Record, block_of, broken_up, parsed, unpacked
from magyc_gtsam.io.mcap_topics import Topics
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_sources import FOUND_BY_TYPE, SensorSource, choose, needed, unknown
from magyc_gtsam.live.source import SENSORS, NewSamples, none
from magyc_gtsam.recording import Samples

_AT_ONCE = 1 << 20  # bytes after which a batch is handed over, so that catching up with a long file can be watched
_POLL = 0.05  # s between looks at a file that does not grow


class McapFollower:
    """The magnetometer and gyroscope samples of a growing file; a `LiveSource`.

    Stamps are seconds on the log's own clock (for ROS since 1970), not counted from its first row.

    Args:
        path: the file; it must exist, and may be empty so far.
        request: topics, units and stamps, as for `read`.

    Raises:
        MagycError: here or from `read`: no such file, not MCAP, several topics that could be meant, a topic that
            cannot be read, or a file that shrank.
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
            self._scale[sensor], said = request.scale(sensor)
            self.notes.extend(said)
        try:
            self._file: IO[bytes] = open(self._path, "rb", buffering=0)  # noqa: SIM115
        except OSError as error:
            raise MagycError(f"{path}: cannot be read ({error.strerror})") from None
        self._place = 0  # where complete records end
        # No channels: only what the sensors are read from.
        self._topics = Topics(needed(replace(request, channels=()), SENSORS), request, self.notes, announced=True)
        self._chosen: dict[str, SensorSource] = {}

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    @property
    def waiting_for(self) -> str:
        """The sensors without a topic so far."""
        absent = [sensor for sensor in SENSORS if sensor not in self._chosen]
        if not absent:
            return ""
        wanted = " and ".join(
            f"{sensor} ({self._request.named(sensor) or FOUND_BY_TYPE[sensor]})" for sensor in absent
        )
        found = listed([f"{t.name} ({t.schema.name})" for t in self._topics.values()])
        return f"no topic of {wanted} yet; the file has {found or 'no topic'} so far"

    def read(self, wait: float = 0.0) -> NewSamples:
        """As `LiveSource.read`."""
        until = time.monotonic() + wait
        while True:
            for record in self._records():
                if not isinstance(record, Metadata):
                    self._topics.keep(record)
            batch = self._batch()
            rest = until - time.monotonic()
            if batch or self.ended or rest <= 0:
                return batch
            time.sleep(min(_POLL, rest))

    def _records(self) -> Iterator[Record]:
        """The records that are complete and not read yet, up to some megabytes of them."""
        self.received = size = os.fstat(self._file.fileno()).st_size
        if size < self._place:
            raise MagycError(
                f"{self._path}: shrank from {self._place} to {size} bytes; was it replaced? begin anew with it"
            )
        if self._place == 0 and size >= len(MAGIC):
            if self._file.read(len(MAGIC)) != MAGIC:
                raise MagycError(
                    f"{self._path}: not an MCAP file, the only one that can be followed; for a whole log use calibrate"
                )
            self._place = len(MAGIC)
        enough = self._place + _AT_ONCE
        while 0 < self._place < enough and not self.ended:
            self._file.seek(self._place)
            head = self._read(HEAD.size)
            if len(head) < HEAD.size:
                return
            opcode, length = HEAD.unpack(head)
            if opcode == 0 or self._place + HEAD.size + length > size:
                return  # space that was set aside, or a record that is still being written
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK):
                yield from self._parsed(opcode, self._read(length))
            self.ended = opcode in (Opcode.DATA_END, Opcode.FOOTER)
            self._place += HEAD.size + length

    def _read(self, count: int) -> bytes:
        parts = []
        while count > 0 and (part := self._file.read(count)):
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def _parsed(self, opcode: int, content: bytes) -> Iterator[Record]:
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
        """Whether a topic that could be the sensor's has been seen."""
        name = self._request.named(sensor)
        if name is not None:
            own = {name.lstrip("/"), name.lstrip("/").partition(".")[0]}
            return any(topic.lstrip("/") in own for topic in self._topics)
        return any(topic.type == FOUND_BY_TYPE[sensor] for topic in self._topics.values())

    def _samples(self, sensor: str, source: SensorSource) -> Samples:
        stamp = source.topic.stamp
        if not len(stamp):
            return none()
        if unknown(source):
            raise MagycError(
                f"{source.name}: says that it has no {sensor} (covariance[0] is -1); name another topic"
            )
        return Samples(stamp / 1e9, source.topic.read(source.columns) * self._scale[sensor])
