"""Files that are there whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file to write to; it takes the place of `path` if the block ends well, and is removed otherwise."""
    with _beside(path) as directory:
        part = directory / path.name
        yield part
        os.replace(part, path)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Likewise a folder; where `path` exists, the new files take their places in it one by one."""
    if path.exists() and not path.is_dir():
        raise NotADirectoryError(20, "is a file, a folder is expected", str(path))
    with _beside(path) as directory:
        part = directory / path.name
        part.mkdir()
        yield part
        if not path.exists():
            os.rename(part, path)
        else:
            for file in part.iterdir():
                os.replace(file, path / file.name)


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A temporary directory on the file system of `path`, whose missing parents are made."""
    missing = [p for p in (path.parent, *path.parent.parents) if not p.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    directory = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        yield directory
    except BaseException:
        shutil.rmtree(directory, ignore_errors=True)
        for parent in missing:
            if not any(parent.iterdir()):
                parent.rmdir()
        raise
    shutil.rmtree(directory, ignore_errors=True)
