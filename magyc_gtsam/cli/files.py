"""Atomic writing of files and folders of results, also when runs are killed or share a folder."""

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

from magyc_gtsam.cli.own_files import remove_results
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.storage.files import copied_into, is_stream, link_target

try:
    import fcntl
except ImportError:  # Windows has no such locks; temporary directories of killed runs are not removed there
    fcntl = None  # type: ignore[assignment]

_PREFIX = ".magyc-gtsam-"
_LOCK = "lock"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary file that replaces `path` when the block ends, and is removed if the block raises.

    Of a link the target is replaced; a device or a pipe stays, and the data is written into it.

    Raises:
        OSError: `path` is a folder, or cannot be written; it names `path`.
    """
    _refuse_folder(path)
    if is_stream(path):
        with copied_into(path) as part:
            yield part
        return
    path = link_target(path)
    with _temporary(path.parent) as directory:
        part = directory / path.name
        with _called(part, path):
            yield part
            os.replace(part, path)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder that becomes `path` when the block ends, and is removed if the block raises.

    If `path` exists, the new files replace all that commands wrote into it before, and other files stay.
    """
    _refuse_files((path,))
    if path.parent.is_dir():
        with _one_at_a_time(path.parent):
            _remove_orphans(path.parent)  # left by runs before the folder existed
    with _temporary(path if path.exists() else path.parent) as directory:
        part = directory / "folder"
        part.mkdir()
        with _called(part, path):
            yield part
        with _one_at_a_time(path.parent):  # of two runs into one folder the later one leaves all its files
            with contextlib.suppress(OSError):  # the folder exists: replace its files below
                os.rename(part, path)
                return
            remove_results(path)
            for file in (each for each in sorted(part.rglob("*")) if not each.is_dir()):
                (path / file.relative_to(part)).parent.mkdir(parents=True, exist_ok=True)
                os.replace(file, path / file.relative_to(part))


def refuse_unwritable(file: Path) -> None:
    """Make the folder of a file that will be written later, and check that files can be written there.

    Raises:
        OSError: they cannot, or `file` is a folder.
    """
    _refuse_folder(file)
    if is_stream(file):
        return
    file = link_target(file)
    _refuse_files(file.parents)
    file.parent.mkdir(parents=True, exist_ok=True)
    # The file is unnamed if the system supports it, so that nothing can remain.
    with _named(file.parent), tempfile.TemporaryFile(dir=file.parent):
        pass


@contextmanager
def _called(part: Path, path: Path) -> Iterator[None]:
    """Raise the failures of the block with the name of a result in place of that of its temporary file or folder."""
    try:
        yield
    except OSError as error:
        # A full disk is reported without a name.
        if error.filename is None or str(error.filename).startswith(str(part)):
            name = str(error.filename or path).replace(str(part), str(path))
            raise OSError(error.errno, error.strerror, name) from None
        raise
    except MagycError as error:
        raise MagycError(str(error).replace(str(part), str(path))) from None


@contextmanager
def _named(folder: Path) -> Iterator[None]:
    """Raise an OSError of the block with the folder's name in place of that of a temporary file in it."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None


@contextmanager
def made(place: Path) -> Iterator[None]:
    """Make a folder with its parents for the block; those that are empty after it are removed again."""
    missing = [p for p in (place, *place.parents) if not p.exists()]
    _refuse_files((place, *place.parents))
    try:
        place.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        with _unstoppable():
            for folder in missing:
                with contextlib.suppress(OSError):  # it is in use, or another run removed it
                    folder.rmdir()


@contextmanager
def _temporary(place: Path) -> Iterator[Path]:
    """Yield a temporary directory in `place`, which is made as by `made`."""
    directory: Path | None = None
    with made(place), contextlib.ExitStack() as open_files:
        try:
            # Another process that looks for orphans must not see the directory without its lock.
            with _one_at_a_time(place), _unstoppable():
                _remove_orphans(place)
                with _named(place):
                    directory = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=place))
                _lock(open_files.enter_context(open(directory / _LOCK, "wb")))
            yield directory
        except BaseException:
            with _unstoppable():
                if directory is not None:
                    shutil.rmtree(directory, ignore_errors=True)
            raise
        with _unstoppable():
            shutil.rmtree(directory, ignore_errors=True)


def _lock(file: IO[bytes]) -> None:
    """Lock a file until it is closed."""
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX)


def _remove_orphans(place: Path) -> None:
    """Remove the directories of killed runs, whose lock nobody holds; called inside `_one_at_a_time`."""
    for directory in place.glob(f"{_PREFIX}*") if fcntl is not None else ():
        with contextlib.suppress(OSError):  # it belongs to a run at work or to another user, or is gone
            if not directory.is_dir() or directory.is_symlink():
                continue
            if not (directory / _LOCK).exists():  # the run was killed before it locked
                shutil.rmtree(directory, ignore_errors=True)
                continue
            with open(directory / _LOCK, "rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # BlockingIOError if the run is at work
                shutil.rmtree(directory, ignore_errors=True)


@contextmanager
def _one_at_a_time(place: Path) -> Iterator[None]:
    """Let only one process at a time be inside such a block for a folder."""
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
    """Defer SIGINT and SIGTERM until the end of the block."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _refuse_folder(file: Path) -> None:
    """Raise an IsADirectoryError if the path of a file is a folder."""
    if file.is_dir():
        raise IsADirectoryError(errno.EISDIR, "expected a file, this is a folder", str(file))


def _refuse_files(folders: Iterable[Path]) -> None:
    """Raise a NotADirectoryError if one of the paths is a file."""
    for folder in folders:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "expected a folder, this is a file", str(folder))
