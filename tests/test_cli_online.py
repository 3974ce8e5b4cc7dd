"""`magyc-gtsam online`: files that grow, kills, pipes; nothing is lost and every ending has its exit code."""

from __future__ import annotations

import errno
import json
import logging
import os
import pty
import re
import select
import signal
import struct
import subprocess
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from commands import COMMAND, PATIENCE, run
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter

import magyc_gtsam as mg
from magyc_gtsam import MagycError, cli
from magyc_gtsam.cli import online_text
from magyc_gtsam.cli.online_feed import Feed
from magyc_gtsam.cli.online_session import judged_online
from magyc_gtsam.io import write_mcap
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import definition, encode
from magyc_gtsam.live.address import open_source
from magyc_gtsam.live.health import StreamMonitor
from magyc_gtsam.live.source import NewSamples
from magyc_gtsam.recording import Samples
from magyc_gtsam.simulation import simulate

EPOCH = 1_620_000_000_000_000_000
IFG = ("--method", "magyc-ifg", "--option", "estimate=current")  # quick, and bit for bit


@pytest.fixture(scope="module")
def simulation() -> mg.Simulation:
    return simulate("wide", duration=120, rate=20, seed=1)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, simulation: mg.Simulation) -> Path:
    """The whole recording in small chunks, as a recorder writes them; stamps count from 1970."""
    path = tmp_path_factory.mktemp("online") / "whole.mcap"
    recording = simulation.recording
    stamp = np.round(recording.time * 1e9).astype(np.int64) + EPOCH
    with open(path, "wb") as file:
        writer = McapWriter(file, chunk_size=8000)
        writer.start("ros2")
        streams = []
        for topic, kind, width, at, value in (
            ("/imu/mag", "MagneticField", 12, 0, recording.magnetic_field),
            ("/imu/data_raw", "Imu", 37, 13, recording.angular_rate),
        ):
            text = definition(f"sensor_msgs/{kind}").encode()
            identifier = writer.register_schema(f"sensor_msgs/msg/{kind}", "ros2msg", text)
            numbers = np.zeros((len(stamp), width))
            numbers[:, at : at + 3] = value
            streams.append((writer.register_channel(topic, "cdr", identifier), encode(stamp, numbers)))
        for row, when in enumerate(stamp.tolist()):
            for channel, messages in streams:
                writer.add_message(channel, when, messages[row], when)
        writer.finish()
    return path


@pytest.fixture(scope="module")
def expected(simulation: mg.Simulation) -> mg.Calibration:
    """What Python gives on the same samples in one block."""
    at = simulation.recording
    online = mg.OnlineCalibrator("magyc-ifg", estimate="current")
    online.update((np.round(at.time * 1e9).astype(np.int64) + EPOCH) / 1e9, at.magnetic_field, at.angular_rate)
    assert online.calibration is not None
    return online.calibration


@pytest.fixture
def inside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., tuple[int, str]]]:
    """The command in this process, which is quicker: exit code and standard error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str]:
        code = cli.main(["online", *map(str, arguments)])
        return code, capsys.readouterr().err

    with warnings.catch_warnings():
        yield call
    logging.disable(logging.NOTSET)  # `main` silences the libraries of its process; here the process goes on


def start(*arguments: object, cwd: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [COMMAND, "online", *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
    )


def same(path: Path, expected: mg.Calibration) -> None:
    found = mg.Calibration.load(path)
    for name in ("soft_iron", "hard_iron", "gyro_bias"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.field_strength == expected.field_strength


class Recorder:
    """Another process's part: the bytes of a log appear in a file bit by bit."""

    def __init__(self, whole: Path, path: Path) -> None:
        self._data, self._path, self._place = whole.read_bytes(), path, 0
        path.touch()

    def write(self, share: float) -> None:
        """Up to this share of the log, mostly in the middle of a record."""
        stop = round(share * len(self._data))
        with open(self._path, "ab") as file:
            file.write(self._data[self._place : stop])
        self._place = stop


def wait_for(condition: object) -> None:
    until = time.monotonic() + PATIENCE
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < until, "it did not happen in time"
        time.sleep(0.02)


def reported(process: subprocess.Popen[str], duration: float) -> None:
    """Read its lines of JSON until it has got so far."""
    assert process.stdout is not None
    for line in process.stdout:
        if json.loads(line)["duration"] >= duration:
            return
    raise AssertionError(process.stderr.read() if process.stderr else "")


def test_a_whole_file(tmp_path: Path) -> None:
    simulation = simulate("dive", duration=300, rate=10, seed=1)
    write_mcap(tmp_path / "whole.mcap", simulation.recording, epoch=EPOCH)
    finished = run("online", "whole.mcap", "--every", "60", cwd=tmp_path)
    assert finished.returncode == 0, finished.stderr
    calibration = mg.Calibration.load(tmp_path / "online-calibration.yaml")
    assert calibration.method == "smoother"
    for name in ("hard_iron", "gyro_bias"):
        error = np.abs(getattr(calibration, name) - getattr(simulation.truth, name))
        assert (error < 4.5 * calibration.sigma[name]).all()
    for text in (
        "whole.mcap: 299.9 s, smoother; the input is complete",
        "Hard iron (µT)",
        "±",
        "calibration: online",
    ):
        assert text in finished.stdout


def test_a_file_that_another_process_writes(log: Path, expected: mg.Calibration, tmp_path: Path) -> None:
    """It starts on an empty file, reports on the way, and ends by itself at the footer."""
    recorder = Recorder(log, tmp_path / "growing.mcap")
    process = start("growing.mcap", *IFG, "--json", "--every", "0.2", cwd=tmp_path)
    reported(process, 0.0)
    for share, duration in ((0.25, 20), (0.5, 50), (0.777, 80)):
        recorder.write(share)
        reported(process, duration)
        assert (tmp_path / "online-calibration.yaml").exists()
    recorder.write(1.0)
    output, errors = process.communicate(timeout=PATIENCE)
    assert errors == "" or process.returncode == 1
    last = json.loads(output.splitlines()[-1])
    assert last["stuck"] == []
    assert last["final"]
    assert last["end"] == "the input is complete"
    assert last["exit_code"] == process.returncode
    assert last["windows"] == 119
    same(tmp_path / "online-calibration.yaml", expected)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_stopped_while_the_file_grows_and_gone_on_with(
    log: Path, expected: mg.Calibration, tmp_path: Path, number: signal.Signals
) -> None:
    recorder = Recorder(log, tmp_path / "growing.mcap")
    arguments = ("growing.mcap", *IFG, "--state", "run.state", "--every", "0.2", "--json")
    process = start(*arguments, cwd=tmp_path)
    recorder.write(0.6123)
    reported(process, 65)
    process.send_signal(number)
    recorder.write(0.7)
    output, errors = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in errors
    assert not list(tmp_path.glob("*.part"))
    on_the_way = mg.Calibration.load(tmp_path / "online-calibration.yaml")
    assert on_the_way.diagnostics["windows"] >= 60
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
    else:
        assert process.returncode in (0, 1)
        assert json.loads(output.splitlines()[-1])["end"] == "interrupted"
    recorder.write(1.0)
    finished = run("online", "growing.mcap", "--state", "run.state", "--quiet", cwd=tmp_path)
    assert re.search(r"\d+ samples were in the saved state already", finished.stderr)
    same(tmp_path / "online-calibration.yaml", expected)


def test_a_state_that_holds_all_of_the_file(
    log: Path, expected: mg.Calibration, tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    assert inside(log, *IFG, "--state", "run.state", "--quiet")[0] == 0
    code, errors = inside(log, "--state", "run.state", "--quiet")
    assert code == 0
    assert "all 4800 samples were in the saved state already" in errors
    same(tmp_path / "online-calibration.yaml", expected)


def test_units_that_disagree_are_wrong_input(log: Path, inside: Callable[..., tuple[int, str]]) -> None:
    """As a field beyond every limit is, and as `calibrate` has it; not a calibration that lacks motion."""
    code, errors = inside(log, "--angular-unit", "deg/s", "--quiet")
    assert "read it in its unit (--angular-unit 'rad/s')" in errors
    assert code == 2


def test_stamps_before_the_saved_state_are_told_in_every_report(simulation: mg.Simulation, tmp_path: Path) -> None:
    """A sensor that was switched off counts from 0 again."""
    lines, at = json_lines(simulation.recording), simulate("wide", duration=20, rate=20, seed=2).recording
    arguments = ("online", "-", "--magnetic-unit", "gauss", "--state", "s")
    assert run(*arguments, *IFG, "--quiet", cwd=tmp_path, stdin="\n".join(lines)).returncode == 0
    finished = run(*arguments, "--json", cwd=tmp_path, stdin="\n".join(json_lines(at)[:300]))
    last = json.loads(finished.stdout.splitlines()[-1])
    assert finished.returncode == last["exit_code"] == 1
    assert not last["converged"]
    assert last["left_out"] == 600
    assert last["sentence"] == (
        "none of the 600 samples is used: their stamps lie before the end of the saved state (119.950 s); "
        "if this is another log or clock, begin a new --state"
    )
    assert last["sentence"] in finished.stderr

    feed = Feed(mg.OnlineCalibrator.load(tmp_path / "s"))
    source = open_source("-", Request())
    assert "600 left out" not in online_text.line(feed, source, StreamMonitor().health)
    assert at.angular_rate is not None
    for shift in (0.0, 119.0, 0.0):  # the second has one second that is new
        stamps = at.time[:400] + shift
        feed.take(NewSamples(Samples(stamps, at.magnetic_field[:400]), Samples(stamps, at.angular_rate[:400])))
        report = online_text.line(feed, source, StreamMonitor().health)
        assert ("lie before the end of the saved state" in report) == (shift == 0.0)
    assert "the last 800 samples are not used" in report
    assert "800 left out" in report


def test_a_clock_that_goes_back_ends_the_run_with_the_result_before(
    simulation: mg.Simulation, tmp_path: Path
) -> None:
    lines = json_lines(simulation.recording)
    finished = run(
        "online", "-", *IFG, "--magnetic-unit", "gauss", cwd=tmp_path, stdin="\n".join([*lines, *lines[:1000]])
    )
    assert finished.returncode == 0, finished.stderr
    assert "standard input: 120.0 s, magyc-ifg; a clock went back" in finished.stdout
    assert "Hard iron (µT)" in finished.stdout
    assert finished.stderr == (
        "magyc-gtsam: magnetic_field: time goes back from 119.950 to 0.250 s and stays there; if a clock was set, keep "
        "the calibration so far and start a new run without the saved state (give it another -o)\n"
    )
    found = mg.Calibration.load(tmp_path / "online-calibration.yaml")
    direct = mg.OnlineCalibrator("magyc-ifg", estimate="current")
    at = simulation.recording
    direct.update(at.time, at.magnetic_field, at.angular_rate)
    np.testing.assert_allclose(found.hard_iron, direct.calibration.hard_iron, atol=1e-12)


def test_a_state_that_cannot_be_written_costs_nothing_else(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: object, path: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(mg.OnlineCalibrator, "save", full)
    finished = run("online", log, *IFG, "--state", "run.state", cwd=tmp_path)
    assert finished.returncode == 2
    assert "Hard iron (µT)" in finished.stdout
    assert "calibration: online-calibration.yaml" in finished.stdout
    assert "state: " not in finished.stdout
    assert "not written: run.state: No space left on device; check the path" in finished.stderr.splitlines()[-1]
    assert mg.Calibration.load(tmp_path / "online-calibration.yaml").trusted


def test_interrupted_before_there_is_a_calibration(log: Path, tmp_path: Path) -> None:
    recorder = Recorder(log, tmp_path / "growing.mcap")
    process = start("growing.mcap", "--json", "--every", "0.2", cwd=tmp_path)
    recorder.write(0.01)
    reported(process, 0.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert errors == "magyc-gtsam: interrupted before there was a calibration\n"
    assert [file.name for file in tmp_path.iterdir()] == ["growing.mcap"]


def test_a_recorder_that_died(log: Path, tmp_path: Path) -> None:
    """No footer ever comes; after --idle the run ends with what there is."""
    (tmp_path / "cut.mcap").write_bytes(log.read_bytes()[:-30_000])
    finished = run("online", "cut.mcap", *IFG, "--idle", "0.5", "--json", "--every", "1e9", cwd=tmp_path)
    (line,) = finished.stdout.splitlines()
    assert json.loads(line)["end"] == "no new data"
    assert json.loads(line)["windows"] > 80


def json_lines(recording: mg.Recording, stop: int | None = None) -> list[str]:
    assert recording.angular_rate is not None
    rows = zip(recording.time, recording.magnetic_field * 1e4, recording.angular_rate, strict=True)
    return [json.dumps({"time": t, "magnetic_field": m.tolist(), "angular_rate": w.tolist()}) for t, m, w in rows][
        :stop
    ]


def test_lines_of_json_in_gauss_with_a_bad_one(simulation: mg.Simulation, tmp_path: Path) -> None:
    recording = simulation.recording
    lines = json_lines(recording)
    lines.insert(100, '{"time": 5.0, "magnetic_field": [1, 2]}')
    lines.insert(1000, "Segmentation fault (core dumped)")
    finished = run("online", "-", *IFG, "--magnetic-unit", "gauss", cwd=tmp_path, stdin="\n".join(lines))
    assert "standard input, line 101: " in finished.stderr
    assert "standard input, line 1001: not JSON" in finished.stderr
    found = mg.Calibration.load(tmp_path / "online-calibration.yaml")
    direct = mg.OnlineCalibrator("magyc-ifg", estimate="current")
    direct.update(recording.time, recording.magnetic_field, recording.angular_rate)
    np.testing.assert_allclose(found.hard_iron, direct.calibration.hard_iron, atol=1e-12)
    assert found.diagnostics["windows"] == direct.progress.windows


def test_a_pipe_that_is_interrupted_keeps_what_came(simulation: mg.Simulation, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [COMMAND, "online", "-", *IFG, "--magnetic-unit", "gauss", "--json", "--every", "0.2", "--state", "s"],
        cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdin is not None
    process.stdin.write("\n".join(json_lines(simulation.recording, 1500)) + '\n{"time": 75.0, "magn')
    process.stdin.flush()
    reported(process, 74.9)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE)
    assert process.returncode in (0, 1)
    rest = "\n".join(json_lines(simulation.recording)[1500:])
    run("online", "-", "--magnetic-unit", "gauss", "--state", "s", "--quiet", cwd=tmp_path, stdin=rest)
    found = mg.Calibration.load(tmp_path / "online-calibration.yaml")
    direct = mg.OnlineCalibrator("magyc-ifg", estimate="current")
    at = simulation.recording
    direct.update(at.time, at.magnetic_field, at.angular_rate)
    np.testing.assert_allclose(found.hard_iron, direct.calibration.hard_iron, atol=1e-12)


def test_plain_lines_and_the_view_of_a_terminal(log: Path, tmp_path: Path) -> None:
    recorder = Recorder(log, tmp_path / "growing.mcap")
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [COMMAND, "online", "growing.mcap", "--every", "0.3"],
        cwd=tmp_path, stdout=theirs, stderr=theirs, env=os.environ | {"TERM": "xterm-256color", "COLUMNS": "110"},
    )  # fmt: skip
    os.close(theirs)
    text = ""

    def shows(*wanted: str) -> bool:
        nonlocal text
        while select.select([ours], [], [], 0.1)[0]:
            try:
                text += os.read(ours, 65536).decode()
            except OSError:  # the other side is closed
                break
        return all(each in text for each in wanted)

    wait_for(lambda: shows("no topic of magnetic_field", "Ctrl-C ends"))
    recorder.write(0.7)
    wait_for(lambda: shows("Hard iron (µT)", "±", "directions seen", "growing.mcap · smoother", "written"))
    recorder.write(1.0)
    wait_for(lambda: shows("the input is complete", "calibration: online-calibration.yaml") or process.poll())
    assert process.wait(PATIENCE) in (0, 1)
    os.close(ours)
    assert "\x1b[?25h" in text  # the cursor is back


def test_plain_lines_of_a_pipe(log: Path, tmp_path: Path) -> None:
    recorder = Recorder(log, tmp_path / "growing.mcap")
    recorder.write(0.7)
    process = start("growing.mcap", *IFG, "--every", "0.1", cwd=tmp_path)
    assert process.stdout is not None
    line = next(line for line in process.stdout if "coverage" in line)
    assert re.fullmatch(r" *\d+\.\d s \| hard iron .* µT \| coverage \d+% \| \w.*\n", line)
    recorder.write(1.0)
    rest, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode in (0, 1)
    assert "growing.mcap: 120.0 s, magyc-ifg; the input is complete" in rest


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("absent.mcap",), "absent.mcap: cannot be read"),
        (("{log}", "--output", "a.txt"), "must end in .yaml or .json"),
        (("{log}", "--method", "ellipsoid"), "'ellipsoid' is not one of smoother, magyc-ifg"),
        (("{log}", "--option", "turbo=1"), "has no option 'turbo'"),
        (("{log}", "--magnetic-field", "/compass", "--idle", "0"), "no topic of magnetic_field (/compass) yet"),
        (("{log}", "--gyroscope-axes", "x,x,z"), "must name x, y and z once each"),
        (("{log}", "--magnetic-unit", "gauss", "--magnetic-unit", "furlong"), "'furlong' is unknown"),
        (("{log}", "--state", "."), ""),
        (
            ("{log}", "--field-strength", "0"),
            "--field-strength: must be that of the Earth, 20 to 70 µT (8 to 175 µT is accepted), got 0 µT",
        ),
        (
            ("{log}", "--option", "field_strength=strong"),
            "field_strength: must be a number of tesla, got 'strong'",
        ),
        (("{log}", "--option", "horizon=long"), "horizon: must be a finite number of at least 120, got 'long'"),
        (
            ("{log}", "--output", "one.yaml", "--state", "./one.yaml"),
            "one.yaml is the --output too; give two files",
        ),
        (("{log}", "--magnetic-unit", "counts"), "needs the field in tesla; give the tesla per count"),
        (("{log}", "--method", ""), "'' is not one of smoother, magyc-ifg"),
        (("{log}", "--output", "{log}/there.yaml"), "expected a folder, this is a file"),
        (("{log}", "--state", "{log}/there.state"), "expected a folder, this is a file"),
        ((".",), "expected a file, got a directory; name a log in it"),
    ],
)
def test_what_is_wrong_is_one_line_and_code_2(
    arguments: tuple[str, ...], message: str, log: Path, tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    code, errors = inside(*(argument.format(log=log) for argument in arguments))
    assert code == 2
    assert message in errors
    assert errors.count("\n") == 1
    assert "internal error" not in errors
    assert not list(tmp_path.iterdir())


def test_an_output_that_is_a_folder_is_refused_before_the_run(
    log: Path, tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    (tmp_path / "taken.yaml").mkdir()
    code, errors = inside(log, "--output", "taken.yaml", "--state", "kept.state")
    assert code == 2
    assert "taken.yaml: expected a file, this is a folder" in errors
    assert [file.name for file in tmp_path.iterdir()] == ["taken.yaml"]


def test_numbers_of_options_need_no_point(
    log: Path, tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    inside(
        log,
        "--quiet",
        "--state",
        "kept.state",
        "--option",
        "noise=[1e-6,5E-3]",
        "--option",
        "hard_iron_drift=1e-9",
    )
    options = mg.OnlineCalibrator.load(tmp_path / "kept.state").options
    assert options == {"noise": [1e-6, 5e-3], "hard_iron_drift": 1e-9}


def test_a_wrong_unit_and_a_state_of_another_method(
    log: Path, simulation: mg.Simulation, tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    finished = run("online", "-", cwd=tmp_path, stdin="\n".join(json_lines(simulation.recording, 50)))
    assert finished.returncode == 2
    assert "read a log in its unit (--magnetic-unit)" in finished.stderr
    mg.OnlineCalibrator("magyc-ifg", window=0.5).save(tmp_path / "ifg.state")
    code, errors = inside(log, "--state", "ifg.state", "--method", "smoother")
    assert code == 2
    assert "continues a run with --method magyc-ifg --option window=0.5" in errors


def test_a_log_without_gyroscope(
    simulation: mg.Simulation, tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    at = simulation.recording
    write_mcap(tmp_path / "field.mcap", mg.Recording(at.time, at.magnetic_field))
    code, errors = inside("field.mcap")
    assert code == 2
    assert "no topic of angular_rate (sensor_msgs/Imu) yet; the file has /imu/mag" in errors


def test_axes_of_the_gyroscope(
    simulation: mg.Simulation, expected: mg.Calibration, tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    at = simulation.recording
    assert at.angular_rate is not None
    turned = at.angular_rate[:, [1, 0, 2]] * [-1, 1, 1]  # its y lies along x, its −x along y
    write_mcap(tmp_path / "turned.mcap", mg.Recording(at.time, at.magnetic_field, turned), epoch=EPOCH)
    inside("turned.mcap", *IFG, "--gyroscope-axes", "y, -x, z", "--state", "kept.state", "--quiet")
    same(tmp_path / "online-calibration.yaml", expected)
    written = mg.Calibration.load(tmp_path / "online-calibration.yaml")
    assert written.configuration["gyroscope_axes"] == "y,-x,z"
    code, errors = inside("turned.mcap", "--state", "kept.state", "--gyroscope-axes", "x,y,z")
    assert code == 2
    assert "continues a run with --method magyc-ifg --option" in errors


def test_an_estimate_that_still_changes_is_not_written_as_trusted() -> None:
    recording = simulate("wide", 60, seed=3).recording
    online = mg.OnlineCalibrator()
    online.update(recording.time, recording.magnetic_field, recording.angular_rate)
    calibration = judged_online(online)
    assert not online.converged
    assert calibration is not None
    assert calibration.message.startswith("the estimate still changes")
    with pytest.raises(MagycError, match="must not be trusted"):
        calibration.export("px4")


def test_stamps_that_were_never_filled_in_are_told(tmp_path: Path, simulation: mg.Simulation) -> None:
    recording = simulation.recording
    with open(tmp_path / "unstamped.mcap", "wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        for kind, width, at, value in (
            ("MagneticField", 12, 0, recording.magnetic_field),
            ("Imu", 37, 13, recording.angular_rate),
        ):
            text = definition(f"sensor_msgs/{kind}").encode()
            identifier = writer.register_schema(f"sensor_msgs/msg/{kind}", "ros2msg", text)
            numbers = np.zeros((len(recording.time), width))
            numbers[:, at : at + 3] = value
            channel = writer.register_channel(f"/{kind}", "cdr", identifier)
            for k, message in enumerate(encode(np.zeros(len(numbers), np.int64), numbers)):
                writer.add_message(channel, EPOCH + k * 50_000_000, message, EPOCH)
        writer.finish()
    finished = run("online", "unstamped.mcap", "-o", "out.yaml", cwd=tmp_path)
    assert finished.returncode == 1
    assert "samples (stamps that repeat, go back or leap" in finished.stderr
    assert "if the stamps were never filled in, take --stamps log" in finished.stderr
    assert not (tmp_path / "out.yaml").exists()
    run("online", "unstamped.mcap", "-o", "out.yaml", "--stamps", "log", cwd=tmp_path)
    assert (tmp_path / "out.yaml").exists()  # though two minutes do not settle the estimate


def test_clocks_that_differ_are_named_with_the_remedy(
    tmp_path: Path, inside: Callable[..., tuple[int, str]]
) -> None:
    """`calibrate` named --stamps log, `online` nothing; `info` did not say that its times are the recorder's."""
    recording = mg.simulate("wide", 120, 10, seed=1).recording
    write_mcap(tmp_path / "one.mcap", recording)
    log = tmp_path / "two.mcap"
    with open(tmp_path / "one.mcap", "rb") as source, open(log, "wb") as file:
        writer, known = McapWriter(file), dict[str, int]()
        writer.start("ros2")
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.topic not in known:
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, own)
            data = bytearray(message.data)
            if channel.topic == "/imu/mag":
                struct.pack_into("<i", data, 4, struct.unpack_from("<i", data, 4)[0] + 1_700_000_000)
            writer.add_message(known[channel.topic], message.log_time, bytes(data), message.publish_time)
        writer.finish()
    code, errors = inside(log, "--idle", 1, "--quiet")
    assert code == 1
    assert (
        "if the clocks differ, shift one of them, or read a log by its recording times (--stamps 'log')" in errors
    )
    assert "clock" not in inside(log, "--idle", 1, "--quiet", "--stamps", "log")[1]
    shown = run("info", log, cwd=tmp_path).stdout
    assert "recorded, s" in shown
    assert "clocks do not overlap" in shown
    table = tmp_path / "table.csv"
    table.write_text("time_s,mag_x_uT,mag_y_uT,mag_z_uT\n0,20,1,40\n1,22,2,41\n2,21,1,40\n")
    assert "recorded" not in run("info", table, cwd=tmp_path).stdout
