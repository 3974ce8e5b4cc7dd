"""Files that are written under the name of a link, a pipe or a folder, and failures that name them."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

import magyc_gtsam as mg
from magyc_gtsam.cli.files import refuse_unwritable, replacing, replacing_folder
from magyc_gtsam.storage.files import whole_file, write_text

Written = Callable[[Path], AbstractContextManager[Path]]
BOTH = pytest.mark.parametrize("written", [replacing, whole_file])


@BOTH
def test_of_a_link_the_target_is_written(tmp_path: Path, written: Written) -> None:
    link, target = tmp_path / "link.params", tmp_path / "there" / "target.params"
    target.parent.mkdir()
    link.symlink_to(target)
    for text in ("new", "replaced"):
        refuse_unwritable(link)
        with written(link) as part:
            part.write_text(text)
        assert link.is_symlink()
        assert target.read_text() == text
        assert not target.is_symlink()
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises((OSError, mg.MagycError), match="loop.*"), written(loop) as part:
        part.write_text("nowhere")
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["link.params", "loop", "target.params", "there"]


@BOTH
def test_a_pipe_stays_and_takes_the_data(tmp_path: Path, written: Written) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    refuse_unwritable(pipe)
    descriptor = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)
    try:
        with written(pipe) as part:
            part.write_text("data")
        assert os.read(descriptor, 100) == b"data"
    finally:
        os.close(descriptor)
    assert pipe.is_fifo()
    assert [file.name for file in tmp_path.iterdir()] == ["pipe.csv"]


def test_a_failure_names_the_file_and_no_temporary_one(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError) as raised, replacing(tmp_path):
        pass
    assert raised.value.filename == str(tmp_path)
    for name in (None, "the temporary one"):
        with pytest.raises(OSError, match="No space left") as full, replacing(tmp_path / "a.csv") as part:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), None if name is None else str(part))
        assert full.value.filename == str(tmp_path / "a.csv")
    for folder in (tmp_path / "new", tmp_path):
        with pytest.raises(mg.MagycError) as refused, replacing_folder(folder) as part:
            write_text(part, "")
        assert str(refused.value).startswith(f"{folder}: cannot be written (it is a folder)")
        with pytest.raises(FileNotFoundError) as missing, replacing_folder(folder) as part:
            (part / "absent" / "a.csv").write_text("")
        assert missing.value.filename == str(folder / "absent" / "a.csv")
    with pytest.raises(FileNotFoundError) as other, replacing(tmp_path / "a.csv"):
        open(tmp_path / "log.csv").close()
    assert other.value.filename == str(tmp_path / "log.csv")
