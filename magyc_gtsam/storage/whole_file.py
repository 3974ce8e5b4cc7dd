"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(file: Path) -> Iterator[Path]:
    """A file to write to, which takes the place of `file` if the block ends well and is removed otherwise.

    What a kill leaves of it is overwritten by the next run, which has the same file to write.
    """
    part = file.with_name(file.name + ".part")
    try:
        yield part
        os.replace(part, file)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(file: Path, text: str) -> None:
    """Write a file of text (UTF-8), or put it in the place of another, in one step."""
    with whole_file(file) as part:
        part.write_text(text, encoding="utf-8", errors="backslashreplace")
