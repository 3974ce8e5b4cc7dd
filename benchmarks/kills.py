"""Stops commands at random moments and looks at what they leave.

    python benchmarks/kills.py COUNT [COMMAND ...]      # calibrate online gap compare study; COUNT of each signal

SIGINT goes to the whole group of processes, as from a terminal, SIGTERM and SIGKILL to the command alone. One run in
ten is a process of its own, stopped from its first moment on, imports included; the others are forked from this one,
which has everything imported. Looked at after each: files are whole or absent, nothing else is left (after SIGKILL:
once the next run into the same place has ended), no process goes on, no traceback is printed. Prints one line for each
command and signal, and every violation; the exit code is 1 where there is one.
"""

from __future__ import annotations

import collections
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import yaml

import magyc_gtsam as mg
import magyc_gtsam.cli.app  # so that forked runs find it imported
from magyc_gtsam.cli import main as command_line
from magyc_gtsam.io import write_mcap

COMMANDS = {
    "calibrate": "calibrate LOG -o out -q",
    "online": "online LOG -o out.yaml --state state.npz --every 0.1 --idle 0 -q",
    "gap": "gap LOG -o out -q",
    "compare": "compare LOG -o out -q",
    "study": "study faults --runs 2 --motion wide --fault clean --by batch -o out",
}
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
CODES = {0, 1, 128 + signal.SIGINT, 128 + signal.SIGTERM}
PATIENCE = 60.0  # s for a command to end once it was asked to
ORPHANED = 10.0  # s for its worker processes
FRESH = 10  # one run in so many is a process of its own


def start(words: list[str], folder: Path, fresh: bool) -> int:
    """The process id of a command in `folder`; it leads a group of its own."""
    sys.stdout.flush()
    asked = {signal.SIGINT, signal.SIGTERM}
    said = os.open(folder.parent / "said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    signal.pthread_sigmask(signal.SIG_BLOCK, asked)  # until the command can be
    if (process := os.fork()) == 0:
        code = 70
        try:
            os.setpgid(0, 0)
            os.chdir(folder)
            os.dup2(said, 1)
            os.dup2(said, 2)
            os.environ["TMPDIR"] = str(folder.parent / "tmp")
            tempfile.tempdir = None
            signal.pthread_sigmask(signal.SIG_UNBLOCK, asked)
            if fresh:
                script = "import sys; from magyc_gtsam.cli import main; sys.exit(main())"
                os.execv(sys.executable, [sys.executable, "-c", script, *words])
            code = command_line(words)
        except KeyboardInterrupt:  # before its first line
            code = 128 + signal.SIGINT
        finally:
            os._exit(code)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, asked)
    os.close(said)
    with contextlib.suppress(OSError):
        os.setpgid(process, process)
    return process


def ended(process: int, within: float) -> int | None:
    """Its exit code, negative for a signal; None where it goes on."""
    until = time.monotonic() + within
    while time.monotonic() < until:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)
    return None


def group_ends(process: int) -> bool:
    """Whether all processes of its group are gone in time."""
    until = time.monotonic() + ORPHANED
    while time.monotonic() < until:
        try:
            os.killpg(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    os.killpg(process, signal.SIGKILL)
    return False


def unfinished(path: Path) -> str | None:
    """What is wrong with a file."""
    if path.name.startswith("."):
        return "left behind"
    try:
        if path.name in ("calibration.yaml", "out.yaml"):
            mg.Calibration.load(path)
        elif path.suffix == ".yaml":
            assert yaml.safe_load(path.read_text("utf-8"))
        elif path.suffix == ".json":
            json.loads(path.read_text("utf-8"))
        elif path.suffix == ".npz":
            mg.OnlineCalibrator.load(path)
        elif path.suffix == ".html":
            assert path.read_text("utf-8").rstrip().endswith("</html>")
        elif path.suffix == ".parquet":
            assert path.read_bytes()[-4:] == b"PAR1"
        elif path.suffix in (".csv", ".param", ".params", ".txt"):
            assert path.read_text("utf-8").endswith("\n")
        else:
            return "left behind"
    except Exception as error:  # noqa: BLE001 - what is looked for
        return f"half written ({type(error).__name__})"
    return None


def violations(place: Path, whole: set[str], leftovers: bool) -> list[str]:
    """What is wrong with what a run left in `place`; `leftovers` are looked for, or left to the next run."""
    files = [p for p in (place / "run").rglob("*") if not p.is_dir()]
    hidden = [p for p in (place / "run").rglob(".*") if p.is_dir()]
    seen = [p for p in files if not any(part.startswith(".") for part in p.relative_to(place).parts)]
    found = [f"{p.name}: {wrong}" for p in seen if p.suffix != ".part" and (wrong := unfinished(p))]
    names = {p.name for p in seen if p.parent.name == "out"}
    if "report.html" in whole and names and names != whole:
        found.append(f"out holds {sorted(names)}")
    if leftovers:
        left = [*hidden, *(p for p in seen if p.suffix == ".part"), *(place / "tmp").iterdir()]
        found += [f"{p.name}: left behind" for p in left]
    return found


def series(name: str, number: signal.Signals, count: int, log: Path, whole: set[str], length: float) -> list[str]:
    """So many stops; returns what was violated."""
    source, found = random.Random(f"{name} {number}"), []
    codes: collections.Counter[int] = collections.Counter()
    words = [str(log) if w == "LOG" else w for w in COMMANDS[name].split()]
    kill = number == signal.SIGKILL
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for k in range(count + kill):
            if not kill or not k:
                for part in ("run", "tmp"):
                    shutil.rmtree(place / part, ignore_errors=True)
                    (place / part).mkdir()
            fresh = k % FRESH == 0
            process = start(words, place / "run", fresh)
            if k < count:  # of killed ones the last is the next run, which cleans up
                code = ended(process, source.uniform(0, 1.1 * length + (1.5 if fresh else 0)))
                if code is None:
                    (os.killpg if number == signal.SIGINT else os.kill)(process, number)
                    code = ended(process, PATIENCE)
            else:
                code = ended(process, 10 * PATIENCE)  # nothing asks it to end
            if code is None:
                found.append("it goes on")
                os.killpg(process, signal.SIGKILL)
                ended(process, PATIENCE)
            if not group_ends(process):
                found.append("a worker process goes on")
            codes[code if code is not None else 999] += 1
            said = (place / "said").read_text("utf-8", errors="replace")
            # Before the command's first line, as where Python is still importing what its own start needs: from
            # there on a request is a `Stopped`, whose name a traceback would show.
            stopped_early = code == -number or (fresh and said.endswith("\nKeyboardInterrupt\n"))
            if not kill and not stopped_early and (code not in CODES or "Traceback" in said):
                found.append(f"exit code {code}: {said[-300:]}")
            found += violations(place, whole, leftovers=not kill or k == count)
    print(f"{name} {number.name}: {count} stopped, exit codes {dict(codes)}, {len(found)} violations", flush=True)
    for violation in sorted(set(found)):
        print(f"  {found.count(violation)} × {violation}", flush=True)
    return found


def undisturbed(name: str, log: Path) -> tuple[set[str], float]:
    """The files of a whole run, and how long it takes, s."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for part in ("run", "tmp"):
            (place / part).mkdir()
        began = time.monotonic()
        process = start([str(log) if w == "LOG" else w for w in COMMANDS[name].split()], place / "run", False)
        assert ended(process, 10 * PATIENCE) in (0, 1), (place / "said").read_text()
        return {p.name for p in (place / "run" / "out").rglob("*")}, time.monotonic() - began


def main(count: int, names: list[str]) -> int:
    """The exit code."""
    failed = 0
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has its background jobs ignore it
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.mcap"
        write_mcap(log, mg.simulate("wide", duration=60, rate=10, seed=0).recording)
        mg.calibrate(mg.read(log))  # imports what it needs
        for name in names:
            undisturbed(name, log)
            whole, length = undisturbed(name, log)
            for number in SIGNALS:
                failed += len(series(name, number, count, log, whole, length))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2:] or list(COMMANDS)))
