"""Complete logs online: the folder of a bag, tables, and files that a power cut left without an end."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_io_ros2_bag import DIVE, split
from test_live_files import drained

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import read, write_mcap
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.address import open_source
from magyc_gtsam.live.logged import CompleteLog
from magyc_gtsam.live.mcap_follow import McapFollower
from magyc_gtsam.live.source import MEANS


def test_the_folder_of_a_bag_has_the_samples_and_stamps_of_the_whole_file(tmp_path: Path) -> None:
    split(tmp_path / "dive", [100.0, 350.0])
    source = open_source(str(tmp_path / "dive"), Request())
    assert isinstance(source, CompleteLog)
    found, expected = drained(source), drained(McapFollower(DIVE, Request()))
    assert source.ended
    assert source.notes == []
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.time, other.time)
        np.testing.assert_array_equal(one.value, other.value)
    assert source.read().magnetometer.time.size == 0


def test_samples_that_the_magnetometer_repeated_are_passed_on(tmp_path: Path) -> None:
    recording = read(DIVE, channels=())
    held = recording.magnetic_field[np.arange(len(recording.time)) // 3 * 3]
    columns = np.column_stack([recording.time, held, recording.angular_rate])
    np.savetxt(tmp_path / "held.csv", columns, delimiter=",", header="time,mx,my,mz,gx,gy,gz", comments="")
    source = CompleteLog(tmp_path / "held.csv", Request())
    assert len(drained(source).magnetometer.time) == len(recording.time)


def test_the_command_reads_a_bag_and_a_table_without_a_header(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    split(tmp_path / "dive", [300.0])
    recording = read(DIVE, channels=())
    columns = np.column_stack([recording.time, recording.magnetic_field, recording.angular_rate])
    np.savetxt("bare.csv", columns, delimiter=",", fmt="%.17g")
    names = ("--read", "columns=time,mx,my,mz,gx,gy,gz")
    assert main(["online", "dive", "-o", "bag.yaml", "-q"]) == 0
    assert main(["online", "bare.csv", *names, "-o", "table.yaml", "-q"]) == 0
    assert capsys.readouterr().err == ""
    bag, other = mg.Calibration.load("bag.yaml"), mg.Calibration.load("table.yaml")
    np.testing.assert_allclose(other.hard_iron, bag.hard_iron, atol=1e-9)
    assert main(["online", str(DIVE), "--read", "rate=10", "-q"]) == 2
    assert "option 'rate' does not apply to a MCAP file" in capsys.readouterr().err
    assert main(["online", "-", "--read", "rate=10", "-q"]) == 2
    assert "--read: has no effect on -" in capsys.readouterr().err


def test_the_files_of_a_bag_without_metadata_are_told(tmp_path: Path) -> None:
    folder = tmp_path / "dive"
    files = split(folder, [float(50 * k) for k in range(1, 12)])  # dive_10 after dive_9
    (folder / "metadata.yaml").unlink()
    words = (
        r"its 12 files dive_0\.mcap to dive_11\.mcap are named like those of a ROS 2 bag without metadata\.yaml"
    )
    for reader in (lambda: open_source(str(folder), Request()), lambda: read(folder)):
        with pytest.raises(MagycError, match=words):
            reader()
    (note,) = open_source(str(files[3]), Request()).notes
    assert note.startswith(
        "dive_3.mcap is followed alone; with dive_11.mcap it is named like the files of a ROS 2"
    )
    assert open_source(str(files[-1]), Request()).notes == []  # the one that is being written
    shutil.copy(files[0], tmp_path / "alone_0.mcap")
    assert open_source(str(tmp_path / "alone_0.mcap"), Request()).notes == []


def test_the_log_of_an_autopilot_is_for_calibrate(shared_data: Path) -> None:
    with pytest.raises(MagycError, match=r"the log of an autopilot.*use magyc-gtsam calibrate"):
        open_source(str(shared_data / "ardusub_still.BIN"), Request())


@pytest.mark.parametrize("damage", ["cut off", "zeros", "an impossible length"])
def test_a_file_without_an_end_gives_what_was_before_with_a_warning(
    damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = DIVE.read_bytes()
    head = whole[: round(0.8 * len(whole))]
    tail = {"cut off": b"", "zeros": bytes(50_000), "an impossible length": b""}[damage]
    if damage == "an impossible length":
        follower = McapFollower(DIVE, Request())
        follower.read()
        end = follower._place  # where a record ends
        head, tail = whole[:end], b"\x05" + b"\xff" * 8 + bytes(100)
    Path("cut.mcap").write_bytes(head + tail)
    assert main(["calibrate", "cut.mcap", "-o", "batch", "-q"]) == 0
    capsys.readouterr()
    assert main(["online", "cut.mcap", "--idle", "0.1", "-q"]) == 0
    *others, line = capsys.readouterr().err.splitlines()
    assert ["a chunk at byte" in other for other in others] == [True] * (damage == "zeros")
    assert line.startswith("magyc-gtsam: cut.mcap: the file is ")
    assert ("damaged at byte" if damage == "an impossible length" else "cut off after") in line
    assert line.endswith("; what was read before is used")
    online, batch = mg.Calibration.load("online-calibration.yaml"), mg.Calibration.load("batch/calibration.yaml")
    assert (np.abs(online.hard_iron - batch.hard_iron) < 0.5 * batch.sigma["hard_iron"]).all()


def test_a_file_cut_off_before_its_first_message_has_the_exit_code_of_calibrate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cut.mcap").write_bytes(DIVE.read_bytes()[:20_000])
    assert main(["calibrate", "cut.mcap", "-o", "batch", "-q"]) == 2
    assert main(["online", "cut.mcap", "--idle", "0.1", "-q"]) == 2
    errors = capsys.readouterr().err
    assert "cut.mcap: the file is cut off after 20000 bytes (no footer)\n" in errors
    assert "no topic of magnetic_field" in errors


@pytest.mark.parametrize("source", ["applied.mcap", "applied.csv"])
def test_a_log_that_apply_wrote_gives_no_parameters(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", str(DIVE), "-o", "batch", "-q"]) == 0
    assert main(["apply", "batch/calibration.yaml", str(DIVE), "-o", source, "-q"]) == 0
    capsys.readouterr()
    assert main(["online", source, "-q"]) == 0
    assert "the field is calibrated already: `magyc-gtsam apply` wrote it" in capsys.readouterr().err
    calibration = mg.Calibration.load("online-calibration.yaml")
    assert calibration.trusted
    with pytest.raises(MagycError, match="holds only the rest"):
        calibration.export("px4")


def test_a_log_of_mean_rates_says_how_it_is_read(tmp_path: Path) -> None:
    """Its mark is at the end, after the samples; they were taken for instants without a word."""
    recording = replace(read(DIVE, channels=()).between(0.0, 20.0), angular_rate_is="interval-mean")
    write_mcap(tmp_path / "means.mcap", recording)
    follower = McapFollower(tmp_path / "means.mcap", Request())
    drained(follower)
    assert MEANS in follower.notes
    assert MEANS in CompleteLog(tmp_path / "means.mcap", Request()).notes
    assert MEANS not in CompleteLog(DIVE, Request()).notes
