"""Files of the package: atomic writing, also by several processes at once; checksums, sizes and the check of paths."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from magyc_gtsam.factors.errors import MagycError

try:
    import fcntl
except ImportError:  # Windows has no such locks; two processes must not write one file there
    fcntl = None  # type: ignore[assignment]


@contextmanager
def whole_file(file: Path) -> Iterator[Path]:
    """Yield a temporary file that replaces `file` when the block ends, and is removed if the block raises.

    The folder is created if it does not exist. Writers of the same file wait for each other, so that each file is one
    of theirs. The temporary file that a killed process leaves behind is overwritten by the next run. Of a link the
    target is replaced; a device or a pipe stays, and the data is written into it.

    Raises:
        MagycError: the file cannot be written.
    """
    try:
        if file.is_dir():
            raise IsADirectoryError(None, "it is a folder")
        if is_stream(file):
            with copied_into(file) as part:
                yield part
            return
        file = link_target(file)
        part = file.with_name(file.name + ".part")
        file.parent.mkdir(parents=True, exist_ok=True)
        with _own(part):
            try:
                yield part
                os.replace(part, file)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
    except OSError as error:
        raise MagycError(
            f"{file}: cannot be written ({error.strerror or error}); check the path, its permissions and the space left"
        ) from None


def is_stream(file: Path) -> bool:
    """Return whether a path is a device, a pipe or a socket, or a link to one, which a new file must not replace."""
    return file.exists() and not file.is_file() and not file.is_dir()


def link_target(file: Path) -> Path:
    """Return the file that a link leads to, which need not exist; any other path unchanged.

    Raises:
        OSError: links lead to each other.
    """
    target = Path(os.path.realpath(file)) if file.is_symlink() else file
    if target.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(file))
    return target


@contextmanager
def copied_into(stream: Path) -> Iterator[Path]:
    """Yield a temporary file whose data is written into a device or a pipe when the block ends without an error."""
    with tempfile.TemporaryDirectory() as directory:
        part = Path(directory) / stream.name
        yield part
        with open(part, "rb") as data, open(stream, "wb") as opened:
            shutil.copyfileobj(data, opened)


@contextmanager
def _own(part: Path) -> Iterator[None]:
    """Create a file, and let only one process or thread at a time be inside such a block for it."""
    while True:
        descriptor = os.open(part, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if fcntl is not None:
                with suppress(OSError):  # a file system without locks
                    fcntl.flock(descriptor, fcntl.LOCK_EX)
            if _is_still(descriptor, part):
                yield
                return
        finally:
            os.close(descriptor)


def _is_still(descriptor: int, file: Path) -> bool:
    """Return whether an open file has its name still; the one who had it before has renamed or removed it otherwise."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(file))
    except FileNotFoundError:
        return False


def write_text(file: Path, text: str) -> None:
    """Write or replace a text file (UTF-8) in one step."""
    with whole_file(file) as part:
        part.write_text(text, encoding="utf-8", errors="backslashreplace")


_BLOCK = 1 << 20  # bytes read at a time


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, or of the files of a folder one after the other, hexadecimal.

    Raises:
        OSError: a file cannot be read.
    """
    digest = hashlib.sha256()
    for file in _files(path):
        with open(file, "rb") as opened:
            while block := opened.read(_BLOCK):
                digest.update(block)
    return digest.hexdigest()


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of the files of a folder."""
    return sum(file.stat().st_size for file in _files(path))


def natural(file: Path) -> list[tuple[int, str]]:
    """Return a key that sorts names as people do: dive2 before dive10."""
    parts = re.split(r"(\d+)", file.as_posix())
    return [(int(part) if part.isdecimal() else -1, part) for part in parts]


def _files(path: Path) -> list[Path]:
    return sorted(filter(Path.is_file, path.iterdir()), key=natural) if path.is_dir() else [path]


def expect_path(function: str, value: Any) -> Path:
    """Return the argument `value` of `function` as a path.

    Raises:
        MagycError: it is empty, or not a path.
    """
    if isinstance(value, str | os.PathLike) and os.fspath(value):
        return Path(value)
    raise MagycError(f"{function}: the path of a file is needed, got {value!r:.60}")
