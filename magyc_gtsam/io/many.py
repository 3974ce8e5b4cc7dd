"""Any number of logs: which files they are, and a sequence that reads each when it is asked for."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, overload

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import read
from magyc_gtsam.recording import Recording

SUFFIXES = (".mcap", ".ulg", ".bin", ".csv", ".txt", ".tsv", ".dat", ".log")
_PATTERN = ("*", "?", "[")

Paths = str | PathLike[str] | Iterable[str | PathLike[str]]


def find_logs(paths: Paths) -> tuple[Path, ...]:
    """The logs that files, folders with all that is below them, and patterns name; each once.

    A file that is named is taken whatever it is called; of a folder or a pattern those with a log's suffix are. Files
    whose name begins with a dot are left out.

    Raises:
        MagycError: a path that does not exist, a pattern or a folder without a log.
    """
    given = [paths] if isinstance(paths, str | PathLike) else list(paths)
    found: dict[Path, None] = {}
    for each in given:
        path = Path(each)
        if path.is_dir():
            inside = [file for file in sorted(path.rglob("*")) if _is_log(file)]
            if not inside:
                raise MagycError(f"{path}: no logs in this folder ({', '.join(SUFFIXES)})")
            found |= dict.fromkeys(inside)
        elif path.exists():
            found[path] = None
        elif any(mark in str(each) for mark in _PATTERN):
            matching = [Path(name) for name in sorted(glob.glob(str(each), recursive=True)) if _is_log(Path(name))]
            if not matching:
                raise MagycError(f"{each}: no logs match this pattern")
            found |= dict.fromkeys(matching)
        else:
            raise MagycError(f"{path}: no such file or folder")
    return tuple(found)


def _is_log(file: Path) -> bool:
    return file.is_file() and file.suffix.lower() in SUFFIXES and not file.name.startswith(".")


class Logs(Sequence[Recording]):
    """Recordings of files; each is read when it is indexed or iterated over, and not kept.

    Attributes:
        paths: of the logs.
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
        """Of a log, without reading it."""
        return self.paths[index].name


def read_many(paths: Paths, **options: Any) -> Logs:
    """Recordings of many logs, each read when it is asked for.

    Args:
        paths: a file, a folder with all that is below it, a pattern ("dives/*.mcap"), or several of these.
        options: of `read`, for every log.

    Raises:
        MagycError: a path that does not exist, or a folder without a log. What is wrong with a log is said when it is
            read.
    """
    return Logs(find_logs(paths), options)
