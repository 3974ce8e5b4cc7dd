"""Store logs and results on the disk. Names in requests are looked up among existing files, never used as paths."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import SUFFIXES
from magyc_gtsam.serve.limits import Limits
from magyc_gtsam.storage.files import write_text

RECORD = "serve.json"  # the server's record of a result
_UPLOADS = ".magyc-gtsam-uploads"
_MOST_LISTED = 500
_KINDS = {
    "gap.json": "gap",
    "comparison.json": "compare",
    "history.yaml": "history",
    "calibration.yaml": "calibrate",
}
_LIVE = "live.json"


class StoreFull(MagycError):
    """The disk, or the number of uploads, is at its limit."""


@dataclass(frozen=True)
class StoredLog:
    """A log that can be calibrated.

    Attributes:
        key: identifier that the page uses.
        name: file name.
        path: path of the file.
        size: size in bytes.
        uploaded: whether it was uploaded through the page and can be removed.
    """

    key: str
    name: str
    path: Path
    size: int
    uploaded: bool

    def to_dict(self) -> dict[str, Any]:
        """Return the log as JSON types, without the path."""
        return {"key": self.key, "name": self.name, "size": self.size, "uploaded": self.uploaded}


def safe_name(name: str) -> str:
    """Return a file name that resembles `name` and has only letters, digits, `.`, `_` and `-`."""
    last = Path(re.split(r"[/\\]", name)[-1])
    stem = _plain(last.stem).lstrip("._-")[:80] or "log"
    return stem + _plain(last.suffix)[:11]


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text)


def _inside(folder: Path) -> list[tuple[Path, os.stat_result]]:
    """Return what a folder holds, each with its state; nothing of what is removed meanwhile, the folder included."""
    found = []
    with suppress(FileNotFoundError, NotADirectoryError):
        for path in folder.iterdir():
            with suppress(OSError):  # removed since it was listed, or a link that leads nowhere
                found.append((path, path.stat()))
    return found


class Store:
    """A folder with its logs, uploads in a hidden subfolder, and `results/`.

    Args:
        folder: an existing folder.
        limits: bounds on uploads.
    """

    def __init__(self, folder: Path, limits: Limits) -> None:
        self.folder = folder.resolve()
        self.results = self.folder / "results"
        self._uploads = self.folder / _UPLOADS
        self._limits = limits
        self._arriving: set[Path] = set()
        self.remove_old()

    def logs(self) -> dict[str, StoredLog]:
        """Return logs by key: uploads, the latest first, then the logs of the folder by name."""
        return {log.key: log for log in (*self._uploaded(), *self._in_folder())}

    def _in_folder(self) -> list[StoredLog]:
        files = sorted(
            (path, state.st_size)
            for path, state in _inside(self.folder)
            if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and S_ISREG(state.st_mode)
        )
        return [
            StoredLog(f"f{hashlib.sha256(path.name.encode()).hexdigest()[:16]}", path.name, path, size, False)
            for path, size in files[:_MOST_LISTED]
        ]

    def _uploaded(self) -> list[StoredLog]:
        logs: list[StoredLog] = []
        for place, _ in sorted(_inside(self._uploads), key=lambda found: -found[1].st_mtime):
            files = [] if place in self._arriving else [f for f in _inside(place) if S_ISREG(f[1].st_mode)]
            logs += [
                StoredLog(f"u{place.name}", file.name, file, state.st_size, True) for file, state in files[:1]
            ]
        return logs

    @contextmanager
    def arriving(self, name: str, size: int | None) -> Iterator[tuple[str, Path]]:
        """Yield key and path for a log that is being uploaded; remove it if the block fails.

        Raises:
            StoreFull: there are too many uploads, or the log is too large for the disk.
        """
        if len(self._uploaded()) + len(self._arriving) >= self._limits.uploads:
            raise StoreFull(f"at most {self._limits.uploads} uploaded logs are kept; remove one first")
        self.room_for(size or 0)
        key = secrets.token_hex(8)
        place = self._uploads / key
        place.mkdir(parents=True)
        self._arriving.add(place)
        try:
            yield f"u{key}", place / safe_name(name)
        except BaseException:  # also a cancelled request: nothing incomplete stays
            shutil.rmtree(place, ignore_errors=True)
            raise
        finally:
            self._arriving.discard(place)

    def room_for(self, size: int) -> None:
        """Check that `size` more bytes fit on the disk.

        Raises:
            StoreFull: they would leave less than the spare space.
        """
        if shutil.disk_usage(self.folder).free < size + self._limits.spare:
            raise StoreFull("the disk of the server is full; remove logs or results")

    def remove(self, key: str) -> bool:
        """Remove an upload and return whether it existed."""
        log = self.logs().get(key)
        if log is None or not log.uploaded:
            return False
        shutil.rmtree(log.path.parent, ignore_errors=True)
        return True

    def remove_old(self, age: float | None = None) -> None:
        """Remove uploads older than `age` s (default: the limit), complete or not."""
        limit = time.time() - (self._limits.upload_age if age is None else age)
        for place, state in _inside(self._uploads):
            if place not in self._arriving and state.st_mtime <= limit:
                shutil.rmtree(place, ignore_errors=True)
        if self._uploads.is_dir() and not any(self._uploads.iterdir()):
            self._uploads.rmdir()

    def new_result(self, name: str, kind: str) -> Path:
        """Create and return a new folder for a result."""
        stamp = time.strftime("%Y%m%d-%H%M%S")
        stem = safe_name(name).rpartition(".")[0] or safe_name(name)
        base = f"{stem}{'' if kind == 'calibrate' else f'-{kind}'}-{stamp}"
        names = (base if not k else f"{base}-{k + 1}" for k in range(1000))
        path = next(self.results / each for each in names if not (self.results / each).exists())
        path.mkdir(parents=True)  # at once, so that no other result takes the name
        return path

    def keep(self, folder: Path, record: dict[str, Any]) -> None:
        """Write the server's record of a result, unless its folder is empty."""
        if folder.is_dir() and any(folder.iterdir()):
            write_text(folder / RECORD, json.dumps(record, indent=1, ensure_ascii=False))

    def discard_empty(self, folder: Path) -> None:
        """Remove the folder of a job that wrote nothing."""
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()

    def result_folders(self) -> dict[str, Path]:
        """Return {key: folder} of all results, the latest first."""
        folders = sorted(_inside(self.results), key=lambda found: -found[1].st_mtime)
        visible = (path for path, _ in folders if not path.name.startswith("."))
        written = [p for p in visible if any((p / name).exists() for name in (*_KINDS, _LIVE, RECORD))]
        return {p.name: p for p in written[:_MOST_LISTED]}

    def record(self, folder: Path) -> dict[str, Any]:
        """Return the server's record of a result; {} for a result of the command line, which has none."""
        try:
            record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return record if isinstance(record, dict) else {}

    def described(self, folder: Path) -> dict[str, Any]:
        """Return the record of a result as JSON types, without reading its numbers; {} if it was removed."""
        try:
            changed = folder.stat().st_mtime
        except FileNotFoundError:
            return {}
        kind = next((kind for name, kind in _KINDS.items() if (folder / name).exists()), "live")
        record = self.record(folder)
        return {
            "key": folder.name,
            "kind": kind,
            "time": changed,
            "page": (folder / "report.html").exists(),
            **{name: record.get(name) for name in ("logs", "sentence", "trusted", "interval")},
        }
