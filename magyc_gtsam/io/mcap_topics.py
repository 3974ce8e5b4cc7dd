"""The topics of a ROS log, collected from its records in any order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io.mcap_records import Block
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_topic import Topic
from magyc_gtsam.io.ros_types import short_type

_OVERHEAD = 34  # bytes for each message that is kept, besides its data
NO_SCHEMA = Schema(id=0, data=b"", encoding="", name="")


class Topics(dict[str, Topic]):
    """The topics of a file by name, collected from its records.

    Args:
        wanted: returns whether to read the numbers of a topic, by name and type.
        request: for the kind of stamps and the attitude.
        notes: list to which remarks on omissions are appended.
        announced: whether a channel without messages counts as a topic.
        grant: called with the number of bytes before they are kept; raises if they exceed the limit.
    """

    def __init__(
        self,
        wanted: Callable[[str, str], bool],
        request: Request,
        notes: list[str],
        announced: bool = False,
        grant: Callable[[int], None] = lambda _: None,
    ) -> None:
        super().__init__()
        self._grant = grant
        self._announced = announced
        self._wanted, self._by_log_time, self._notes = wanted, request.stamps == "log", notes
        self._attitude = request.named("attitude") is not None
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._early: dict[int, list[Block]] = {}

    def keep(self, record: Schema | Channel | Block) -> None:
        """Add a record."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
            if self._announced:
                self._topic(record)
        else:
            order = np.argsort(record.channel, kind="stable")
            ends = np.flatnonzero(np.diff(record.channel[order])) + 1
            for rows in np.split(order, ends):
                block = Block(
                    record.data,
                    record.channel[rows],
                    record.log_time[rows],
                    record.start[rows],
                    record.length[rows],
                )
                self._messages(int(block.channel[0]), block)

    def _messages(self, identifier: int, block: Block) -> None:
        """Add the messages of one channel, or keep them until its record comes."""
        channel = self._channels.get(identifier)
        if channel is None or (channel.schema_id and channel.schema_id not in self._schemas):
            # The channels of a damaged chunk are only in the summary, at the end of the file.
            self._grant(int(block.length.sum()) + _OVERHEAD * len(block.length))
            self._early.setdefault(identifier, []).append(_compact(block))
            return
        for early in self._early.pop(identifier, []):
            self._add(channel, early)
        self._add(channel, block)

    def _topic(self, channel: Channel) -> Topic:
        """Return the topic of a channel, and create it if needed."""
        topic = self.get(channel.topic)
        if topic is None:
            schema = self._schemas.get(channel.schema_id, NO_SCHEMA)
            wanted = self._wanted(channel.topic, short_type(schema.name))
            topic = self[channel.topic] = Topic(
                channel.topic,
                channel.message_encoding,
                schema,
                wanted,
                self._by_log_time,
                self._attitude,
                self._grant,
            )
        return topic

    def _add(self, channel: Channel, block: Block) -> None:
        """Add the messages of a known channel to its topic."""
        schema = self._schemas.get(channel.schema_id, NO_SCHEMA)
        topic = self._topic(channel)
        # Two publishers of one topic have two channels in the file.
        if (topic.schema.name, topic.encoding) == (schema.name, channel.message_encoding):
            topic.add(block.data, block.start, block.length, block.log_time)
        else:
            other = f"type {schema.name}, encoding {channel.message_encoding}"
            note = f"{channel.topic} has messages of two types or encodings; those of {other} were left out"
            if note not in self._notes:
                self._notes.append(note)

    def finish(self) -> None:
        """Add the messages whose schema never came, and note those whose channel never came."""
        lost: dict[int, int] = {}
        for identifier, blocks in self._early.items():
            channel = self._channels.get(identifier)
            if channel is None:
                lost[identifier] = sum(len(b.start) for b in blocks)
                continue
            for block in blocks:
                self._add(channel, block)
        self._early = {}
        if lost:
            channels = f"{'a channel' if len(lost) == 1 else 'channels'} without a record ({listed([*lost])})"
            self._notes.append(f"{sum(lost.values())} messages of {channels} were left out")


def _compact(block: Block) -> Block:
    """Return the block without the bytes between its messages."""
    start = np.concatenate([[0], np.cumsum(block.length)[:-1]])
    size = int(block.length[0])
    if (block.length == size).all():
        everywhere: NDArray[np.uint8] = np.ndarray(
            (len(block.data) - size + 1, size), dtype=np.uint8, buffer=block.data, strides=(1, 1)
        )
        data = everywhere[block.start].ravel()
    else:
        data = np.empty(int(block.length.sum()), dtype=np.uint8)
        for to, place, length in zip(start, block.start, block.length, strict=True):
            data[to : to + length] = block.data[place : place + length]
    return Block(data, block.channel, block.log_time, start, block.length)
