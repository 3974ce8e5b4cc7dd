"""The lines of a text file, decoded in pieces so that a large file takes little memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from magyc_gtsam.factors.errors import MagycError

_PIECE = 1 << 20  # bytes read at once
_HEAD = 1 << 14  # bytes read at once to find the header
_LONGEST = 1 << 20  # characters of a line
_LONGEST_BYTES = 1 << 25  # of a line, before it is decoded
COMMENT = ("#", "//")  # the second is that of Xsens


class DataLines(NamedTuple):
    """Lines of data, and the number of each in the file, from 1."""

    numbers: Sequence[int]
    text: list[str]
    quoted: bool  # whether a cell may be in quotation marks


def _text(data: bytes, path: Path, number: int) -> list[str]:
    """Decode bytes, UTF-8 or else Latin-1, into lines; `number` lines precede them in the file."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    lines = text.splitlines()
    if max(map(len, lines), default=0) > _LONGEST:
        raise MagycError(
            f"{path}: a line after line {number} is longer than {_LONGEST} characters; not a text table"
        )
    return lines


def _raw(path: Path, size: int) -> Iterator[tuple[bytes, int]]:
    """Yield the file in pieces of complete lines, and the number of bytes read."""
    incomplete = b""  # the start of a line whose end is in the next piece
    place = 0
    with open(path, "rb") as file:
        while data := file.read(size):
            if place == 0:
                data = data.removeprefix(b"\xef\xbb\xbf")
            place = file.tell()
            end = data.rfind(b"\n") + 1
            if not end:
                incomplete += data
                if len(incomplete) > _LONGEST_BYTES:
                    raise MagycError(f"{path}: a line is longer than {_LONGEST_BYTES} bytes; not a text table")
                continue
            yield incomplete + data[:end], place
            incomplete = data[end:]
    if incomplete:
        yield incomplete, place


def lines_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield all lines with their numbers, from 1."""
    number = 0
    for data, _ in _raw(path, _HEAD):
        for line in _text(data, path, number):
            number += 1
            yield number, line


def pieces_of(path: Path) -> Iterator[tuple[DataLines, int]]:
    """Yield the lines that are neither empty nor comments, in pieces, and the number of bytes read."""
    number = 0
    for data, place in _raw(path, _PIECE):
        text = _text(data, path, number)
        numbers: Sequence[int] = range(number + 1, number + len(text) + 1)
        number += len(text)
        if b"#" in data or b"//" in data or not all(map(str.strip, text)):
            kept = [k for k, line in enumerate(text) if line.strip() and not line.lstrip().startswith(COMMENT)]
            text, numbers = [text[k] for k in kept], [numbers[k] for k in kept]
        if text:
            yield DataLines(numbers, text, b'"' in data), place
