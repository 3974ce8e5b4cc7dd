"""A ROS 2 bag that was split into several files is one log, in MCAP and SQLite, for `read` and for every command."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.io import info, same_format
from magyc_gtsam.io.many import find_logs

DIVE = Path(__file__).parents[1] / "datasets" / "calibration_dive.mcap"


def split(folder: Path, edges: Sequence[float]) -> list[Path]:
    """Write the dive as rosbag2 splits it: metadata.yaml, and files that each number their channels anew."""
    folder.mkdir(parents=True)
    with open(DIVE, "rb") as file:
        rows = [(schema, channel, message) for schema, channel, message in make_reader(file).iter_messages()]
    first, bounds, files = rows[0][2].log_time, [0.0, *edges, np.inf], []
    for k, (start, end) in enumerate(pairwise(bounds)):
        files.append(folder / f"{folder.name}_{k}.mcap")
        own = [row for row in rows if start <= (row[2].log_time - first) / 1e9 < end]
        topics = {channel.topic: (schema, channel) for schema, channel, _ in own}
        with open(files[-1], "wb") as file:
            writer = Writer(file)
            writer.start()
            numbers = {}
            for name in sorted(topics, reverse=bool(k % 2)):
                schema, channel = topics[name]
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                numbers[name] = writer.register_channel(name, channel.message_encoding, known)
            for _, channel, message in own:
                writer.add_message(numbers[channel.topic], message.log_time, message.data, message.publish_time)
            writer.finish()
    listed = {"relative_file_paths": [file.name for file in files], "storage_identifier": "mcap", "version": 9}
    (folder / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": listed}), encoding="utf-8"
    )
    return files


def test_a_split_bag_is_read_as_one_log(tmp_path: Path) -> None:
    split(tmp_path / "dive", [100.0, 350.0])
    whole, parts = mg.read(DIVE), mg.read(tmp_path / "dive")
    for name in ("time", "magnetic_field", "angular_rate", "acceleration"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    assert parts.notes == whole.notes
    assert parts.name == "dive"
    described = info(tmp_path / "dive")
    assert described.duration == pytest.approx(whole.duration)
    assert described.problem is None
    assert {each.name: each.count for each in described.sources}["/imu/mag"] == 6000
    assert same_format(tmp_path / "dive", DIVE)
    assert mg.read(tmp_path / "dive", start=90.0, end=120.0).duration == pytest.approx(30.0, abs=0.2)


def test_the_order_is_that_of_the_metadata_or_of_the_numbers(tmp_path: Path) -> None:
    files = split(tmp_path / "dive", [float(50 * k) for k in range(1, 12)])  # dive_10 after dive_9
    whole = mg.read(DIVE)
    assert len(files) == 12
    (tmp_path / "dive" / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: [", encoding="utf-8"
    )
    cut_off = mg.read(tmp_path / "dive")
    np.testing.assert_array_equal(cut_off.magnetic_field, whole.magnetic_field)
    assert cut_off.notes[0].startswith(
        "metadata.yaml does not list the files, which are taken in the order of their"
    )


def test_files_that_are_missing_left_out_or_damaged_are_noted(tmp_path: Path) -> None:
    folder = tmp_path / "dive"
    files = split(folder, [100.0, 200.0, 300.0])
    files[1].unlink()
    files[3].write_bytes(b"")
    shutil.copy(files[2], folder / "dive_9.mcap")
    recording = mg.read(folder)
    assert recording.duration == pytest.approx(300.0, abs=0.2)
    notes = "; ".join(recording.notes)
    assert "files that metadata.yaml lists are missing: dive_1.mcap" in notes
    assert "files that metadata.yaml does not list are left out: dive_9.mcap" in notes
    assert "dive_3.mcap: left out, it is empty" in notes
    for file in (files[0], files[2], files[3]):
        file.unlink()
    with pytest.raises(mg.MagycError, match=r"none of the files of this bag is there \(dive_0\.mcap, "):
        mg.read(folder)


def test_no_file_outside_the_bag_is_read(tmp_path: Path) -> None:
    split(tmp_path / "dive", [])
    shutil.move(tmp_path / "dive" / "dive_0.mcap", tmp_path / "dive_0.mcap")
    listed = {"relative_file_paths": ["../dive_0.mcap", str(tmp_path / "dive_0.mcap")]}
    (tmp_path / "dive" / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": listed}), encoding="utf-8"
    )
    with pytest.raises(mg.MagycError, match="none of the files of this bag is there"):
        mg.read(tmp_path / "dive")


def test_a_bag_is_one_log_of_a_folder(tmp_path: Path) -> None:
    files = split(tmp_path / "season" / "dive", [300.0])
    shutil.copy(DIVE, tmp_path / "season" / "other.mcap")
    logs = (tmp_path / "season" / "dive", tmp_path / "season" / "other.mcap")
    assert find_logs(tmp_path / "season") == logs
    assert find_logs(logs[0]) == logs[:1]
    assert find_logs(str(tmp_path / "season" / "*")) == logs
    assert find_logs(str(tmp_path / "**" / "*")) == logs
    assert find_logs(files) == tuple(files)  # what is named is meant


def test_the_commands_take_a_bag_as_one_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, results = tmp_path / "dive", tmp_path / "results"
    split(bag, [150.0, 400.0])
    assert main(["calibrate", str(bag), "-o", str(results), "-q"]) == 0
    found, whole = mg.Calibration.load(results / "calibration.yaml"), mg.calibrate(mg.read(DIVE))
    np.testing.assert_array_equal(found.hard_iron, whole.hard_iron)
    configured = [
        "calibrate",
        "--config",
        str(results / "configuration.yaml"),
        "-o",
        str(tmp_path / "again"),
        "-q",
    ]
    assert main(configured) == 0
    for output in ("out.csv", "out.mcap"):
        applied = ["apply", str(results / "calibration.yaml"), str(bag), "-o", str(tmp_path / output)]
        assert main([*applied, "-q"]) == 0
    assert len(mg.read(tmp_path / "out.mcap").time) == len(whole.recording.time)
    assert main(["history", str(bag), "-o", str(tmp_path / "history"), "-q"]) == 0
    assert len(mg.History.load(tmp_path / "history" / "history.yaml")) == 1
    capsys.readouterr()
    (bag / "dive_1.mcap").write_bytes((bag / "dive_0.mcap").read_bytes())
    assert main(configured) == 2
    assert "dive has changed since" in capsys.readouterr().err


def test_a_bag_that_the_library_wrote(tmp_path: Path) -> None:
    """The metadata of rosbag2 itself, with its lists of topics and of qualities of service."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    known = types.types
    vector, time = known["geometry_msgs/msg/Vector3"], known["builtin_interfaces/msg/Time"]
    kind, field = "sensor_msgs/msg/MagneticField", np.random.default_rng(1).normal(0, 3e-5, (40, 3))
    with rosbag2.Writer(tmp_path / "bag", version=9) as bag:
        connection = bag.add_connection("/mag", kind, typestore=types)
        for k, row in enumerate(field.tolist()):
            head = known["std_msgs/msg/Header"](time(k // 10, k % 10 * 10**8), "imu")
            data = types.serialize_cdr(known[kind](head, vector(*row), np.zeros(9)), kind)
            bag.write(connection, k * 10**8, data)
    assert find_logs(tmp_path) == (tmp_path / "bag",)
    np.testing.assert_array_equal(mg.read(tmp_path / "bag").magnetic_field, field)
