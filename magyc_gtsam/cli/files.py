"""Files that are there whole or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path


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
    with _temporary(path if path.exists() else path.parent) as directory:
        part = directory / "folder"
        part.mkdir()
        yield part
        if not path.exists():
            os.rename(part, path)
        else:
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
    with tempfile.NamedTemporaryFile(prefix=".magyc-gtsam-", dir=file.parent):
        pass


@contextmanager
def _temporary(place: Path) -> Iterator[Path]:
    """A directory in `place`, which is made where it is missing, and unmade if the block fails."""
    missing = [p for p in (place, *place.parents) if not p.exists()]
    _refuse_files((place, *place.parents))
    place.mkdir(parents=True, exist_ok=True)
    directory = Path(tempfile.mkdtemp(prefix=".magyc-gtsam-", dir=place))
    try:
        yield directory
    except BaseException:
        shutil.rmtree(directory, ignore_errors=True)
        for folder in missing:
            if not any(folder.iterdir()):
                folder.rmdir()
        raise
    shutil.rmtree(directory, ignore_errors=True)


def _refuse_files(folders: Iterable[Path]) -> None:
    for folder in folders:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "is a file, a folder is expected", str(folder))
