"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import signal
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # Windows: without locks, directories of killed runs stay, and so do those of runs at work
    fcntl = None  # type: ignore[assignment]

_PREFIX = ".magyc-gtsam-"
_LOCK = "lock"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write to; it takes the place of `path` if the block ends well, and is removed otherwise."""
    with _temporary(path.parent) as directory:
        part = directory / path.name
        yield part
        os.replace(part, path)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Likewise a folder; where `path` exists, the new files take their places in it one by one."""
    _refuse_files((path,))
    if path.parent.is_dir():
        with _one_at_a_time(path.parent):
            _remove_orphans(path.parent)  # from before the folder was there
    with _temporary(path if path.exists() else path.parent) as directory:
        part = directory / "folder"
        part.mkdir()
        yield part
        with _one_at_a_time(path.parent):  # two runs into one folder leave the files of the later
            with contextlib.suppress(OSError):  # it exists, or another run has made it since
                os.rename(part, path)
                return
            for file in part.iterdir():
                os.replace(file, path / file.name)


def refuse_unwritable(file: Path) -> None:
    """Make the folder of a file that will be written later, and see that it takes files.

    Raises:
        OSError: it does not, or `file` is a folder.
    """
    if file.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder, a file is expected", str(file))
    _refuse_files(file.parents)
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=file.parent):  # without a name, where the system can: nothing to leave behind
        pass


@contextmanager
def _temporary(place: Path) -> Iterator[Path]:
    """A directory in `place`, which is made where it is missing, and unmade if the block fails."""
    missing = [p for p in (place, *place.parents) if not p.exists()]
    _refuse_files((place, *place.parents))
    place.mkdir(parents=True, exist_ok=True)
    directory: Path | None = None
    with contextlib.ExitStack() as open_files:
        try:
            # Whoever looks for orphans sees the directory with its lock, or not at all.
            with _one_at_a_time(place), _unstoppable():
                _remove_orphans(place)
                directory = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=place))
                _lock(open_files.enter_context(open(directory / _LOCK, "wb")))
            yield directory
        except BaseException:
            with _unstoppable():
                if directory is not None:
                    shutil.rmtree(directory, ignore_errors=True)
                for folder in missing:
                    if folder.exists() and not any(folder.iterdir()):
                        folder.rmdir()
            raise
        with _unstoppable():
            shutil.rmtree(directory, ignore_errors=True)


def _lock(file: IO[bytes]) -> None:
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX)


def _remove_orphans(place: Path) -> None:
    """Remove what killed runs left behind, of which nobody holds the lock; the caller has the place to himself."""
    for directory in place.glob(f"{_PREFIX}*") if fcntl is not None else ():
        with contextlib.suppress(OSError):
            if not directory.is_dir() or directory.is_symlink():
                continue
            if not (directory / _LOCK).exists():  # killed before it had one
                shutil.rmtree(directory, ignore_errors=True)
                continue
            with open(directory / _LOCK, "rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # BlockingIOError: it is at work
                shutil.rmtree(directory, ignore_errors=True)


@contextmanager
def _one_at_a_time(place: Path) -> Iterator[None]:
    """Only one process at a time is in such a block of one place."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(place, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _unstoppable() -> Iterator[None]:
    """Requests to end wait until the block is done."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _refuse_files(folders: Iterable[Path]) -> None:
    for folder in folders:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "is a file, a folder is expected", str(folder))
