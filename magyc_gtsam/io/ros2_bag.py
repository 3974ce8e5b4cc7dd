"""Reader of a ROS 2 bag: a folder with metadata.yaml and the files, .mcap or .db3, into which it was split."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.records import Channel, Metadata, Schema

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import listed
from magyc_gtsam.io.log_info import LogInfo
from magyc_gtsam.io.mcap_records import MAGIC, METADATA, Block, Record, records
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros_bag import SQLITE, refuse_packed, sqlite_records
from magyc_gtsam.io.ros_log import RosLog, collected, info_of, recording_of
from magyc_gtsam.recording import Recording
from magyc_gtsam.storage.files import natural
from magyc_gtsam.storage.mapping import load_mapping

_DESCRIPTION = "metadata.yaml"
_KEY = "rosbag2_bagfile_information"
_SUFFIXES = (".mcap", ".db3", ".zstd")
_NUMBERED = re.compile(r"(?P<name>.+)_(?P<number>\d{1,6})(?P<suffix>\.mcap|\.db3)")
_MOST_CHANNELS = 1 << 16  # of all files, as in a `Block`


def is_bag(folder: Path) -> bool:
    """Return whether a folder is a ROS 2 bag, by the first lines of its metadata.yaml."""
    try:
        with open(folder / _DESCRIPTION, "rb") as file:
            return _KEY.encode() in file.read(512)
    except OSError:
        return False


def files_without_metadata(folder: Path) -> list[Path]:
    """Return the files NAME_0, NAME_1, … of a bag in a folder without its metadata.yaml; [] where there are none."""
    if is_bag(folder):
        return []
    numbered = {file: _NUMBERED.fullmatch(file.name) for file in folder.iterdir()}
    bags: dict[tuple[str, str], dict[int, Path]] = {}
    for file, match in numbered.items():
        if match:
            bags.setdefault((match["name"], match["suffix"]), {})[int(match["number"])] = file
    found = max((bag for bag in bags.values() if {0, 1} <= bag.keys()), key=len, default={})
    return [found[number] for number in sorted(found)]


def read(path: Path, request: Request) -> Recording:
    """Read a bag; see `magyc_gtsam.io.read`.

    Raises:
        MagycError: none of its files is there.
    """
    request.only("ROS bag")
    return recording_of(_load, path, request)


def info(path: Path) -> LogInfo:
    """Describe a bag; see `magyc_gtsam.io.info`, which sets `problem`."""
    return info_of(_load, path, "bag")


def _load(path: Path, request: Request, wanted: Callable[[str, str], bool]) -> RosLog:
    """Load the topics of a bag; see `ros_log.Load`."""
    notes: list[str] = []
    parts = _parts(path, notes)
    metadata: dict[str, str] = {}

    def every() -> Iterator[Schema | Channel | Block]:
        numbers = _Numbers()
        for k, part in enumerate(parts):
            own: list[str] = []
            for record in _records(part, own, lambda share, k=k: request.report((k + share) / len(parts))):  # type: ignore[misc]
                if not isinstance(record, Metadata):
                    yield numbers.anew(record)
                elif record.name == METADATA:
                    metadata.update(record.metadata)
            numbers.forget()
            notes.extend(f"{part.name}: {note}" for note in own)

    return collected(path, every(), request, wanted, notes, metadata)


def _parts(folder: Path, notes: list[str]) -> list[Path]:
    """Return the files of a bag in their order, and note those that are missing.

    Raises:
        MagycError: there is none.
    """
    there = sorted((file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES), key=natural)
    try:
        names = load_mapping(folder / _DESCRIPTION, "metadata.yaml of a bag")[_KEY]["relative_file_paths"]
        named = list(dict.fromkeys(folder / Path(str(name)).name for name in names))
    except (MagycError, KeyError, TypeError):
        notes.append(f"{_DESCRIPTION} does not list the files, which are taken in the order of their names")
        named = there
    parts = [file for file in named if file.is_file()]
    if not parts:
        raise MagycError(f"{folder}: none of the files of this bag is there ({listed([f.name for f in named])})")
    missing = [file.name for file in named if file not in parts]
    if missing:
        notes.append(f"files that {_DESCRIPTION} lists are missing: {listed(missing)}")
    more = [file.name for file in there if file not in named]
    if more:
        notes.append(f"files that {_DESCRIPTION} does not list are left out: {listed(more)}")
    return parts


def _records(part: Path, notes: list[str], report: Callable[[float], None]) -> Iterator[Record]:
    """Yield the records of one file of a bag; a file that is none is left out with a note."""
    with open(part, "rb") as file:
        head = file.read(len(SQLITE))
    refuse_packed(part, head)
    if head.startswith(MAGIC):
        yield from records(part, notes, report)
    elif head == SQLITE:
        yield from sqlite_records(part, notes, report)
    else:
        notes.append("left out, it is " + ("no file of a bag" if head else "empty"))


class _Numbers:
    """Numbers of channels and schemas that differ between the files of a bag, each of which counts from one."""

    def __init__(self) -> None:
        self._channels: dict[int, int] = {}
        self._schemas: dict[int, int] = {}
        self._given = 0

    def forget(self) -> None:
        """Begin another file."""
        self._channels, self._schemas = {}, {}

    def anew(self, record: Schema | Channel | Block) -> Schema | Channel | Block:
        """Return the record with the numbers that it has in the whole bag."""
        if isinstance(record, Schema):
            return replace(record, id=self._of(record.id, self._schemas))
        if isinstance(record, Channel):
            schema = record.schema_id and self._of(record.schema_id, self._schemas)
            return replace(record, id=self._of(record.id, self._channels), schema_id=schema)
        own, place = np.unique(record.channel, return_inverse=True)
        anew = np.array([self._of(number, self._channels) for number in own.tolist()], dtype=np.uint16)
        return replace(record, channel=anew[place])

    def _of(self, number: int, known: dict[int, int]) -> int:
        if number not in known:
            self._given += 1
            if self._given >= _MOST_CHANNELS:
                raise MagycError(f"a bag with more than {_MOST_CHANNELS} channels; read its files one by one")
            known[number] = self._given
        return known[number]
