"""Channels (current, temperature, depth, ...) from any ROS 2 message with numbers in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.ros2 import NANOSECONDS
from magyc_gtsam.io.streams import Stream

LARGEST = 2048  # bytes; images, clouds and scans are no channels
_LONGEST_ARRAY = 16


def channels_of(
    topic: str,
    schema: Schema,
    encoding: str,
    messages: Sequence[bytes],
    log_time: Sequence[int],
    by_log_time: bool,
) -> dict[str, Stream]:
    """The numbers in the messages of one topic, by topic without slash, and field where there are several.

    Messages with a header are stamped by it, others by the time of recording.

    Raises:
        MagycError: the messages cannot be decoded, hold no number, or are encoded in another way.
    """
    try:
        decoder: Callable[[bytes], Any] | None = DecoderFactory().decoder_for(encoding, schema)
        decoded = [decoder(data) for data in messages] if decoder else []
    except Exception as error:  # the library's schema parser raises direct children of Exception
        raise MagycError(f"{topic} ({schema.name}): {error}") from error
    if not decoded:
        raise MagycError(
            f"{topic} ({schema.name}): {encoding} with a schema in {schema.encoding!r} is not decoded"
        )
    fields = list(_numbers(decoded[0]))
    if not fields:
        raise MagycError(f"{topic} ({schema.name}): holds no number")
    stamp = np.asarray(log_time, dtype=np.int64)
    header = getattr(decoded[0], "header", None)
    if header is not None and not by_log_time:
        stamps = [m.header.stamp for m in decoded]
        stamp = np.array([s.sec * NANOSECONDS + s.nanosec for s in stamps], dtype=np.int64)
    base = topic.lstrip("/")
    result = {}
    for field in fields:
        values = [_at(message, field) for message in decoded]
        lengths = {len(v) for v in values if isinstance(v, list | tuple)}
        if len(lengths) > 1:
            raise MagycError(f"{topic} ({schema.name}): the length of {field} changes")
        name = base if len(fields) == 1 else f"{base}.{field}"
        result[name] = Stream(name, stamp, np.array(values, dtype=np.float64))
    return result


def _numbers(message: Any, prefix: str = "") -> Iterator[str]:
    """Paths of the numbers and short arrays of numbers in a decoded message."""
    for name in message.__slots__:
        value = getattr(message, name)
        path = f"{prefix}{name}"
        if isinstance(value, bool | int | float):
            yield path
        elif hasattr(value, "__slots__"):
            if name not in ("header", "stamp", "layout"):
                yield from _numbers(value, f"{path}.")
        elif _is_array(value) and "covariance" not in name:
            yield path


def _is_array(value: Any) -> bool:
    return (
        not isinstance(value, str | bytes)
        and hasattr(value, "__len__")
        and 0 < len(value) <= _LONGEST_ARRAY
        and isinstance(value[0], bool | int | float)
    )


def _at(message: Any, path: str) -> Any:
    for name in path.split("."):
        message = getattr(message, name)
    return list(message) if hasattr(message, "__len__") else message
