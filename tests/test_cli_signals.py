"""Commands that are asked to end, or killed: nothing half written, nothing left behind, no traceback."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import COMMAND

import magyc_gtsam as mg
from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.foreign_text import printable, shortened
from magyc_gtsam.io import write_mcap

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and locks of POSIX")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("signals") / "log.mcap"
    write_mcap(path, mg.simulate("wide", duration=60, rate=10, seed=0).recording)
    return path


def stopped(log: Path, folder: Path, number: int, after: float) -> tuple[int, str]:
    """Exit code and standard error of `calibrate`, sent a signal after so many seconds."""
    command = [sys.executable, "-c", "import sys; from magyc_gtsam.cli import main; sys.exit(main())"]
    process = subprocess.Popen(
        [*command, "calibrate", str(log), "--output", str(folder / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    errors = process.communicate(timeout=120)[1]
    return process.returncode, errors


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("after", [0.4, 1.2])
def test_asked_to_end(log: Path, tmp_path: Path, number: int, code: int, after: float) -> None:
    """From the first half second on, in which everything is imported."""
    returned, errors = stopped(log, tmp_path, number, after)
    if returned == -number:  # before the first line of ours: the interpreter itself was still starting
        pytest.skip("the machine is too busy to start Python within the time")
    if returned in (0, 1):
        assert (tmp_path / "out" / "calibration.yaml").exists()
        return
    assert returned == code
    assert "Traceback" not in errors
    assert "no file is left half written" in errors
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path: Path) -> None:
    script = (
        "import sys, time; from pathlib import Path; from magyc_gtsam.cli.files import replacing_folder\n"
        "with replacing_folder(Path(sys.argv[1])) as part:\n"
        "    (part / 'half').write_text('x'); print('ready', flush=True); time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script, str(tmp_path / "out")], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    with replacing_folder(tmp_path / "other") as part:
        (part / "whole").write_text("y")
    assert len(list(tmp_path.glob(".magyc-gtsam-*"))) == 1  # of the run at work, which is not touched
    process.kill()
    process.communicate()
    with replacing_folder(tmp_path / "other") as part:
        (part / "whole").write_text("z")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["other"]
    assert (tmp_path / "other" / "whole").read_text() == "z"


def test_two_runs_into_one_folder_leave_the_files_of_one(tmp_path: Path) -> None:
    """Both find no folder when they begin; the later one to end takes the places of all files."""
    target = tmp_path / "out"
    with replacing_folder(target) as first:
        with replacing_folder(target) as second:
            for part, text in ((first, "first"), (second, "second")):
                for name in ("a", "b", "c"):
                    (part / name).write_text(text)
        assert (target / "a").read_text() == "second"
    assert {(target / name).read_text() for name in "abc"} == {"first"}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_second_run_replaces_the_files_in_subfolders(tmp_path: Path) -> None:
    for text in ("first", "second"):
        with replacing_folder(tmp_path / "out") as part:
            (part / "calibrations").mkdir()
            (part / "calibrations" / "a.yaml").write_text(text)
    assert (tmp_path / "out" / "calibrations" / "a.yaml").read_text() == "second"
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["calibrations"]


def test_a_folder_that_takes_no_files_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "random-name"))

    monkeypatch.setattr("tempfile.mkdtemp", full)
    with pytest.raises(OSError, match="No space left on device") as raised, replacing_folder(tmp_path / "out"):
        pass
    assert raised.value.filename == str(tmp_path)


def test_names_from_files_do_not_reach_the_terminal_as_commands(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from magyc_gtsam.cli import main

    name = "mag\x1b]0;owned\x07\u202e_x"
    path = tmp_path / "a.csv"
    path.write_text(f"t,{name},b\n" + "\n".join(f"{k},1,2" for k in range(20)))
    assert main(["info", str(path)]) in (0, 1, 2)
    assert main(["calibrate", str(path)]) == 2
    shown = "".join(capfd.readouterr())
    assert "\x1b]" not in shown
    assert "\x07" not in shown
    assert "\u202e" not in shown
    assert "\\x1b]0;owned" in shown
    assert printable("µT − 3\u00a0°") == "µT − 3\u00a0°"
    assert len(shortened("x" * 10_000)) == 201


@pytest.mark.skipif(os.name != "posix", reason="names are bytes there")
def test_a_file_name_that_is_no_text(log: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Bytes that are no UTF-8, and what a terminal obeys: in the pages and files as escapes."""
    from magyc_gtsam.cli import main

    named = Path(os.fsdecode(os.fsencode(tmp_path) + b"/dive\xff\x1b[31m\n<b>.mcap"))
    named.write_bytes(log.read_bytes())
    few = {"calibrate": [], "compare": ["--methods", "smoother,ellipsoid"], "gap": ["--candidates", "timing"]}
    for command, options in few.items():
        assert main([command, str(named), *options, "-o", str(tmp_path / command)]) in (0, 1)
        assert "\x1b" not in "".join(capfd.readouterr())
        page = (tmp_path / command / "report.html").read_text("utf-8")
        assert "\x1b" not in page
        assert "<b>.mcap" not in page
    assert main(
        [
            "calibrate",
            "--config",
            str(tmp_path / "calibrate/configuration.yaml"),
            "-q",
            "-o",
            str(tmp_path / "again"),
        ]
    ) in (0, 1, 2)
    assert "internal error" not in "".join(capfd.readouterr())


def test_a_directory_of_a_run_killed_before_it_had_its_lock_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".magyc-gtsam-killed" / "folder").mkdir(parents=True)
    with replacing_folder(tmp_path / "out") as part:
        (part / "whole").write_text("y")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_worker_processes_end_with_a_parent_that_is_killed(start: str) -> None:
    script = (
        "import os, sys, time; from concurrent.futures import ProcessPoolExecutor\n"
        "from multiprocessing import get_context; from magyc_gtsam.engine import as_worker\n"
        "if __name__ == '__main__':\n"
        "    pool = ProcessPoolExecutor(1, get_context(sys.argv[1]), as_worker)\n"
        "    print(pool.submit(os.getpid).result(), flush=True); time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script, start], stdout=subprocess.PIPE)
    assert process.stdout is not None
    worker = int(process.stdout.readline())
    process.kill()
    process.communicate()
    until = time.monotonic() + 30
    while time.monotonic() < until:
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.kill(worker, signal.SIGKILL)
    pytest.fail("the worker goes on")


def test_a_part_of_a_table_is_removed_where_its_writing_fails(tmp_path: Path) -> None:
    from magyc_gtsam.storage.files import whole_file

    def write() -> None:
        with whole_file(tmp_path / "table") as part:
            part.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write()
    assert list(tmp_path.iterdir()) == []


def test_a_request_to_end_that_comes_while_something_is_destroyed_is_not_lost(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Python drops the exceptions of destructors; the command went on to its end."""
    from magyc_gtsam.cli import app, main

    class Destroyed:
        def __del__(self) -> None:
            os.kill(os.getpid(), signal.SIGTERM)
            sum(range(1000))

    def run(arguments: object) -> int:
        del arguments
        Destroyed()
        until = time.monotonic() + 20
        while time.monotonic() < until:
            time.sleep(0.01)
        return 0

    monkeypatch.setattr(app, "run", run)
    assert main(["info"]) == 143
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_full_output_keeps_the_exit_code_and_is_named(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        asked = [COMMAND, "info", "absent.mcap"]
        assert subprocess.run(asked, cwd=tmp_path, stderr=full, check=False).returncode == 2
        told = subprocess.run(
            [COMMAND, "export", "--help"],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert told.returncode == 2
    assert "No space left" in told.stderr
