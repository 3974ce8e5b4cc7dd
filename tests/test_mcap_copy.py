"""`apply` on MCAP: only the vectors of the two sensors change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.io import write_mcap
from magyc_gtsam.io.ros2 import definition

CALIBRATION = mg.Calibration(
    np.diag([1.1, 0.9, 1.0]), np.array([1e-5, 2e-6, -3e-6]), np.array([1e-3, -2e-3, 5e-4])
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording among foreign topics, metadata and an attachment."""
    folder = tmp_path_factory.mktemp("log")
    plain, path = folder / "plain.mcap", folder / "log.mcap"
    write_mcap(plain, mg.simulate("wide", 30, seed=1).recording, epoch=10**18)
    with open(plain, "rb") as source, open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start("ros2", "another tool")
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        foreign = writer.register_channel("/chatter", "cdr", text, {"offered_qos_profiles": "- depth: 1"})
        unlike = writer.register_channel("/blob", "unknown-encoding", 0)
        ids: dict[str, int] = {}
        for k, (schema, channel, message) in enumerate(make_reader(source).iter_messages()):
            if schema is None:
                continue
            if channel.topic not in ids:
                own = writer.register_schema(
                    schema.name, schema.encoding, definition(schema.name.replace("/msg", "")).encode()
                )
                ids[channel.topic] = writer.register_channel(channel.topic, "cdr", own)
            at = message.log_time
            writer.add_message(ids[channel.topic], at + 7, message.data, at + 3, 1000 + k)
            if k % 10 == 0:
                writer.add_message(foreign, at, bytes(range(k % 200)), at + 1, k)
                writer.add_message(unlike, at, b"\x00\xff" * (k % 50), at + 2, k)
        writer.add_metadata("who", {"vehicle": "AUV"})
        writer.add_attachment(1, 2, "notes.txt", "text/plain", b"by hand")
        writer.finish()
    return path


def contents(path: Path) -> tuple[list[tuple[object, ...]], list[object], list[object]]:
    with open(path, "rb") as file:
        reader = make_reader(file)
        messages = [
            (
                channel.topic,
                channel.message_encoding,
                dict(channel.metadata),
                None if schema is None else (schema.name, schema.encoding, schema.data),
                message.log_time,
                message.publish_time,
                message.sequence,
                message.data,
            )
            for schema, channel, message in reader.iter_messages(log_time_order=False)
        ]
        metadata = [(each.name, each.metadata) for each in reader.iter_metadata()]
        attachments = [(each.name, each.media_type, each.data) for each in reader.iter_attachments()]
    return messages, metadata, attachments


def test_every_other_message_is_the_same(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    CALIBRATION.save(tmp_path / "cal.yaml")
    out = tmp_path / "out.mcap"
    assert cli.main(["apply", str(tmp_path / "cal.yaml"), str(log), "-o", str(out)]) == 0
    assert "messages of other topics copied unchanged" in capsys.readouterr().out
    (before, *rest), (after, metadata, attachments) = contents(log), contents(out)
    assert rest == [metadata[:-1], attachments]
    assert metadata[-1] == ("magyc-gtsam", {"calibrated /imu/mag": "yes"})
    assert [m[:-1] for m in before] == [m[:-1] for m in after]  # topics, schemas, times, sequence numbers
    sensors = ("/imu/mag", "/imu/data_raw")
    assert [m for m in before if m[0] not in sensors] == [m for m in after if m[0] not in sensors]
    changed = [(a[-1], b[-1]) for a, b in zip(before, after, strict=True) if a[0] in sensors]
    assert len(changed) == 600
    for a, b in changed:
        assert isinstance(a, bytes)
        assert isinstance(b, bytes)
        assert len(a) == len(b)
        differing = np.flatnonzero(np.frombuffer(a, np.uint8) != np.frombuffer(b, np.uint8))
        assert np.ptp(differing) < 24
    raw, calibrated = mg.read(log), mg.read(out)
    np.testing.assert_array_equal(calibrated.magnetometer.value, CALIBRATION.apply(raw.magnetometer.value))
    np.testing.assert_array_equal(calibrated.gyroscope.value, CALIBRATION.apply_gyroscope(raw.gyroscope.value))
    np.testing.assert_array_equal(calibrated.time, raw.time)


def test_an_interval_keeps_the_other_topics_whole(log: Path, tmp_path: Path) -> None:
    CALIBRATION.save(tmp_path / "cal.yaml")
    out = tmp_path / "out.mcap"
    asked = [
        "--start",
        "10",
        "--end",
        "20",
        "--stamps",
        "log",
        "--magnetic-field",
        "/imu/mag",
        "-q",
        "-o",
        str(out),
    ]
    assert cli.main(["apply", str(tmp_path / "cal.yaml"), str(log), *asked]) == 0
    before, after = contents(log)[0], contents(out)[0]
    assert [m for m in after if m[0] == "/chatter"] == [m for m in before if m[0] == "/chatter"]
    assert sum(m[0] == "/imu/mag" for m in after) == len(mg.read(log, start=10, end=20).magnetometer.time)


def test_a_damaged_log_is_refused(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    CALIBRATION.save(tmp_path / "cal.yaml")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:-3000])
    assert cli.main(["apply", str(tmp_path / "cal.yaml"), str(cut), "-q", "-o", str(tmp_path / "out.mcap")]) == 2
    assert "is damaged" in capsys.readouterr().err
    assert not (tmp_path / "out.mcap").exists()


def rewritten(source: Path, target: Path, change: Callable[[str, bytes], bytes]) -> Path:
    """A copy of a log with the data that `change` returns for a topic and the data of its message."""
    with open(source, "rb") as read, open(target, "wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        ids: dict[str, int] = {}
        for schema, channel, message in make_reader(read).iter_messages():
            if channel.topic not in ids:
                own = 0 if schema is None else writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, own)
            data = change(channel.topic, message.data)
            writer.add_message(ids[channel.topic], message.log_time, data, message.publish_time)
        writer.finish()
    return target


def test_a_delay_where_the_header_is_empty(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is taken from the stamps in use, those of the recorder; every message was lost without a word."""

    def without_stamp(topic: str, data: bytes) -> bytes:
        return data[:4] + bytes(8) + data[12:] if topic == "/imu/mag" else data

    blank = rewritten(log, tmp_path / "blank.mcap", without_stamp)
    late = replace(CALIBRATION, terms=(Term("timing", [0.25], [[1e-6]]),))
    late.save(tmp_path / "cal.yaml")
    out = tmp_path / "out.mcap"
    apply = ["apply", str(tmp_path / "cal.yaml"), "-o", str(out)]
    assert cli.main([*apply, str(blank), "--stamps", "log"]) == 0
    assert "300 samples of the calibrated field" in capsys.readouterr().out
    stamps = [{m[4]: m[7][4:12] for m in contents(file)[0] if m[0] == "/imu/mag"} for file in (blank, out)]
    assert {at - 250_000_000: header for at, header in stamps[0].items()} == stamps[1]


def test_a_log_without_a_message_that_can_be_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A header has no stamp before 0, where a delay may put the whole of a short log."""
    write_mcap(tmp_path / "short.mcap", mg.simulate("wide", 5, seed=1).recording)
    replace(CALIBRATION, terms=(Term("timing", [8.0], [[1e-6]]),)).save(tmp_path / "cal.yaml")
    apply = ["apply", str(tmp_path / "cal.yaml"), str(tmp_path / "short.mcap"), "-o", str(tmp_path / "out.mcap")]
    assert cli.main(apply) == 2
    assert "less than the delay of 8.000 s" in capsys.readouterr().err
    assert not (tmp_path / "out.mcap").exists()


def test_messages_that_repeat_the_vector_of_the_one_before(tmp_path: Path) -> None:
    """Of a held gyroscope, and of a magnetometer in coarse steps: they were left out, and the acceleration in them."""
    places = {"/imu/mag": slice(-96, -72), "/imu/data_raw": slice(-192, -168)}
    seen: dict[str, list[bytes]] = {topic: [] for topic in places}

    def held(topic: str, data: bytes) -> bytes:
        place, earlier = places[topic], seen[topic]
        earlier.append(earlier[-1] if len(earlier) % 2 else data[place])
        return data[: place.start] + earlier[-1] + data[place.stop :]

    write_mcap(tmp_path / "plain.mcap", replace(mg.simulate("wide", 30, seed=1).recording, attitude=None))
    log = rewritten(tmp_path / "plain.mcap", tmp_path / "log.mcap", held)
    CALIBRATION.save(tmp_path / "cal.yaml")
    for name in ("out.mcap", "out.csv"):
        cli.main(["apply", str(tmp_path / "cal.yaml"), str(log), "-q", "-o", str(tmp_path / name)])
    before, after = ([m for m in contents(path)[0] if m[0] in places] for path in (log, tmp_path / "out.mcap"))
    assert [m[:-1] for m in before] == [m[:-1] for m in after]
    for topic, apply in (("/imu/mag", CALIBRATION.apply), ("/imu/data_raw", CALIBRATION.apply_gyroscope)):
        raw, calibrated = (
            np.array([np.frombuffer(m[7][places[topic]]) for m in each if m[0] == topic])  # type: ignore[index]
            for each in (before, after)
        )
        np.testing.assert_array_equal(apply(raw), calibrated)
    table = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)
    columns = {name: np.isfinite(table[name]).mean() for name in table.dtype.names}
    assert {name: share for name, share in columns.items() if share < 1 and "angular_rate" not in name} == {}
