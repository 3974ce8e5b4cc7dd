"""Sets of logs: the files that paths and patterns name, and a sequence that reads each on demand."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, overload

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import SUFFIXES, read
from magyc_gtsam.io.ros2_bag import is_bag
from magyc_gtsam.recording import Recording
from magyc_gtsam.storage.files import expect_path, natural

_PATTERN = ("*", "?", "[")
# Results of the command line with the suffix of a log, and a file that each is beside.
_RESULTS = {
    "vectornav.txt": ("calibration.yaml", "next.yaml"),
    "calibrations.csv": ("index.html",),
    "comparison.csv": ("comparison.json",),
}

Paths = str | PathLike[str] | Iterable[str | PathLike[str]]


def find_logs(paths: Paths) -> tuple[Path, ...]:
    """Return the logs that files, folders (recursively) and patterns name, each once.

    A folder that is a ROS 2 bag, with its metadata.yaml, is one log. A file is accepted with any suffix; from folders
    and patterns only files with the suffix of a log are, and none whose name, or whose folder's, begins with a dot, or
    that is a result of the command line.

    Raises:
        MagycError: a path does not exist, or a folder or pattern has no logs.
    """
    logs: dict[Path, None] = {}
    listed: Iterable[Any] = (
        paths if isinstance(paths, Iterable) and not isinstance(paths, str | bytes) else [paths]
    )
    for each in listed:
        path = expect_path("read_many", each)
        if path.is_dir() and not is_bag(path):
            every = sorted(path.rglob("*"), key=natural)
            bags = {file.parent for file in every if file.name == "metadata.yaml" and is_bag(file.parent)}
            inside = [
                file
                for file in every
                if (file in bags or (_is_log(file) and file.parent not in bags))
                and not any(part.startswith(".") for part in file.relative_to(path).parts)
            ]
            if not inside:
                raise MagycError(f"{path}: no logs in this folder ({', '.join(SUFFIXES)})")
            logs |= dict.fromkeys(inside)
        elif path.exists():
            logs[path] = None
        elif any(mark in str(each) for mark in _PATTERN):
            named = sorted(map(Path, glob.glob(str(each), recursive=True)), key=natural)
            matching = [file for file in named if _is_log(file) or (file.is_dir() and is_bag(file))]
            matching = [file for file in matching if file.parent not in matching]
            if not matching:
                raise MagycError(f"{each}: no logs match this pattern")
            logs |= dict.fromkeys(matching)
        else:
            raise MagycError(f"{path}: no such file or folder")
    return tuple(logs)


def _is_log(file: Path) -> bool:
    beside = _RESULTS.get(file.name, ())
    return (
        file.is_file()
        and file.suffix.lower() in SUFFIXES
        and not file.name.startswith(".")
        and not any(file.with_name(name).exists() for name in beside)
    )


class Logs(Sequence[Recording]):
    """A sequence of recordings, each read from its file when it is accessed, and not cached.

    Attributes:
        paths: the logs.
    """

    def __init__(self, paths: Sequence[Path], options: dict[str, Any]) -> None:
        self.paths = tuple(paths)
        self._options = options

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, index: int) -> Recording: ...

    @overload
    def __getitem__(self, index: slice) -> Logs: ...

    def __getitem__(self, index: int | slice) -> Recording | Logs:
        if isinstance(index, slice):
            return Logs(self.paths[index], self._options)
        return read(self.paths[index], **self._options)

    def name(self, index: int) -> str:
        """Return the file name of a log without reading it."""
        return self.paths[index].name


def read_many(paths: Paths, **options: Any) -> Logs:
    """Return the recordings of many logs, each read on access.

    Args:
        paths: a file, a folder (searched recursively), a pattern ("dives/*.mcap"), or several of these.
        options: arguments of `read` for every log.

    Raises:
        MagycError: a path does not exist, or a folder or pattern has no logs. Errors in a log are raised on access.
    """
    return Logs(find_logs(paths), options)
