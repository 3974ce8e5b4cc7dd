"""Atomic writing of files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(file: Path) -> Iterator[Path]:
    """Yield a temporary file that replaces `file` when the block ends, and is removed if the block raises.

    The folder is created if it does not exist. The temporary file that a killed process leaves behind is overwritten by
    the next run.
    """
    part = file.with_name(file.name + ".part")
    file.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield part
        os.replace(part, file)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(file: Path, text: str) -> None:
    """Write or replace a text file (UTF-8) in one step."""
    with whole_file(file) as part:
        part.write_text(text, encoding="utf-8", errors="backslashreplace")
