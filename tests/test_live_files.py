"""Sources that are still coming: MCAP files cut at any byte, writers at work, lines of JSON."""

from __future__ import annotations

import json
import os
import struct
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import read, write_mcap
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import definition, encode
from magyc_gtsam.live.line_sources import JsonLines
from magyc_gtsam.live.mcap_follow import McapFollower
from magyc_gtsam.live.source import NewSamples
from magyc_gtsam.recording import Recording, Samples
from magyc_gtsam.simulation import simulate

EPOCH = 1_620_000_000_000_000_000
UNITS = Request(units={"magnetic_field": "uT", "angular_rate": "deg/s"})


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("wide", duration=60, rate=20, seed=1).recording


def write(path: Path, recording: Recording, **options: Any) -> Path:
    """As `write_mcap`, with the options of the library's writer."""
    with open(path, "wb") as file:
        writer = McapWriter(file, **options)
        writer.start("ros2")
        channels = {}
        for topic, kind in (("/imu/mag", "MagneticField"), ("/imu/data_raw", "Imu")):
            text = definition(f"sensor_msgs/{kind}").encode()
            identifier = writer.register_schema(f"sensor_msgs/msg/{kind}", "ros2msg", text)
            channels[topic] = writer.register_channel(topic, "cdr", identifier)
        stamp = np.round(recording.time * 1e9).astype(np.int64) + EPOCH
        for topic, width, at, value in (
            ("/imu/mag", 12, 0, recording.magnetic_field),
            ("/imu/data_raw", 37, 13, recording.angular_rate),
        ):
            numbers = np.zeros((len(stamp), width))
            numbers[:, at : at + 3] = value
            messages = encode(stamp, numbers)
            for i, message in enumerate(messages):
                writer.add_message(channels[topic], int(stamp[i]), message, int(stamp[i]))
        writer.finish()
    return path


def joined(batches: list[NewSamples]) -> NewSamples:
    parts = [[batch[i] for batch in batches] for i in range(2)]
    return NewSamples(
        *(Samples(np.concatenate([p.time for p in part]), np.vstack([p.value for p in part])) for part in parts)
    )


def drained(source: Any) -> NewSamples:
    """All that a source has until it ends or has nothing more."""
    batches = [source.read(0.0)]
    while batches[-1] and not source.ended:
        batches.append(source.read(0.0))
    return joined(batches)


def same(batch: NewSamples, recording: Recording) -> None:
    for samples, (at, value) in zip(batch, (recording.magnetometer, recording.gyroscope), strict=True):
        np.testing.assert_array_equal(samples.time, (np.round(at * 1e9).astype(np.int64) + EPOCH) / 1e9)
        np.testing.assert_array_equal(samples.value, value)


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.ZSTD, "chunk_size": 20_000},
        {"compression": CompressionType.LZ4, "chunk_size": 20_000},
        {"compression": CompressionType.NONE, "chunk_size": 20_000},
        {"use_chunking": False},
        {"index_types": IndexType.NONE, "use_statistics": False, "use_summary_offsets": False},
    ],
    ids=["zstd", "lz4", "none", "unchunked", "no index"],
)
def test_a_file_that_grows_by_any_number_of_bytes(tmp_path: Path, recording: Recording, options: Any) -> None:
    whole = write(tmp_path / "whole.mcap", recording, **options).read_bytes()
    growing = tmp_path / "growing.mcap"
    growing.write_bytes(b"")
    follower = McapFollower(growing, Request())
    random = np.random.default_rng(0)
    cuts = np.sort(random.integers(0, len(whole), 60))
    batches, place = [], 0
    for cut in (3, 8, 12, *cuts.tolist(), len(whole)):
        if cut > place:
            with open(growing, "ab") as file:
                file.write(whole[place:cut])
            place = cut
        batches.append(drained(follower))
    assert follower.ended
    assert follower.waiting_for == ""
    assert follower.notes == []
    same(joined(batches), recording)


def test_while_another_thread_writes(tmp_path: Path, recording: Recording) -> None:
    """`read(wait)` comes back as soon as there is something."""
    whole = write(tmp_path / "whole.mcap", recording, chunk_size=30_000).read_bytes()
    path = tmp_path / "growing.mcap"
    path.touch()

    def grow() -> None:
        with open(path, "ab", buffering=0) as file:
            for place in range(0, len(whole), 9001):
                file.write(whole[place : place + 9001])
                time.sleep(0.005)

    thread = threading.Thread(target=grow)
    thread.start()
    follower, batches = McapFollower(path, Request()), []
    while not follower.ended:
        batches.append(follower.read(300.0))
        assert batches[-1] or follower.ended
    thread.join()
    same(joined(batches), recording)


def test_it_reads_what_the_reader_of_whole_files_reads(tmp_path: Path, recording: Recording) -> None:
    write_mcap(tmp_path / "a.mcap", recording, epoch=EPOCH)
    whole = read(tmp_path / "a.mcap")
    same(drained(McapFollower(tmp_path / "a.mcap", Request())), whole)
    batch = drained(McapFollower(tmp_path / "a.mcap", Request(stamps="log", units={"magnetic_field": "mT"})))
    np.testing.assert_allclose(batch.magnetometer.value, 1e-3 * whole.magnetometer.value)


def test_space_set_aside_and_lengths_filled_in_later_are_waited_for(tmp_path: Path, recording: Recording) -> None:
    whole = write(tmp_path / "whole.mcap", recording, chunk_size=20_000).read_bytes()
    place, opcodes = 8, []
    while whole[place] != 6:  # the first chunk
        opcodes.append(whole[place])
        place += 9 + struct.unpack_from("<Q", whole, place + 1)[0]
    path = tmp_path / "open.mcap"
    for unfinished in (
        whole[:place] + bytes(50_000),
        whole[: place + 1] + b"\xff" * 8 + whole[place + 9 : place + 9000],
    ):
        path.write_bytes(unfinished)
        follower = McapFollower(path, Request())
        assert not drained(follower)
        assert not follower.ended
        with open(path, "r+b") as file:
            file.write(whole)
        same(drained(follower), recording)


def test_a_damaged_chunk_is_left_out_and_named(tmp_path: Path, recording: Recording) -> None:
    path = write(tmp_path / "a.mcap", recording, chunk_size=20_000, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    data[60_000] ^= 0xFF
    path.write_bytes(data)
    follower = McapFollower(path, Request())
    batch = drained(follower)
    assert follower.ended
    (note,) = follower.notes
    assert "a chunk at byte" in note
    assert "crc" in note
    assert 1.6 * len(recording.time) < sum(len(s.time) for s in batch) < 2 * len(recording.time)


def test_topics_are_waited_for_named_and_not_guessed(tmp_path: Path, recording: Recording) -> None:
    path = write(tmp_path / "a.mcap", recording)
    named = McapFollower(path, Request(sensors={"magnetic_field": "imu/mag"}))
    assert len(drained(named).magnetometer.time) == len(recording.time)
    absent = McapFollower(path, Request(sensors={"magnetic_field": "/other"}))
    drained(absent)
    assert "no topic of magnetic_field (/other) yet; the file has /imu/mag" in absent.waiting_for
    wrong = McapFollower(path, Request(sensors={"magnetic_field": "/imu/data_raw"}))
    with pytest.raises(MagycError, match="must be of type sensor_msgs/MagneticField"):
        wrong.read()
    two = tmp_path / "two.mcap"
    with open(two, "wb") as file:
        writer = McapWriter(file, use_chunking=False)
        writer.start("ros2")
        identifier = writer.register_schema("sensor_msgs/msg/MagneticField", "ros2msg", b"")
        for topic in ("/a", "/b"):
            writer.register_channel(topic, "cdr", identifier)
        writer.finish()
    with pytest.raises(MagycError, match="2 topics could be meant: /a"):
        McapFollower(two, Request()).read()


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(MagycError, match="cannot be read"):
        McapFollower(tmp_path / "absent.mcap", Request())
    text = tmp_path / "text.mcap"
    text.write_text("Dear diary, nothing turned.")
    with pytest.raises(MagycError, match="not an MCAP file"):
        McapFollower(text, Request()).read()


def test_a_file_that_shrinks_was_replaced(tmp_path: Path, recording: Recording) -> None:
    path = write(tmp_path / "a.mcap", recording)
    follower = McapFollower(path, Request())
    follower.read()
    path.write_bytes(path.read_bytes()[:100])
    follower.ended = False
    with pytest.raises(MagycError, match="was replaced"):
        follower.read()


def lines_of(*texts: str, request: Request | None = None) -> tuple[JsonLines, NewSamples]:
    """A source that got these pieces one by one, and all that it gave."""
    reader, writer = os.pipe()
    source = JsonLines(reader, request or Request())
    batches = []
    for text in texts:
        os.write(writer, text.encode())
        batches.append(source.read(1.0))
    os.close(writer)
    while not source.ended:
        batches.append(source.read(1.0))
    os.close(reader)
    return source, joined(batches)


def test_json_lines_cut_anywhere_and_the_last_without_an_end(recording: Recording) -> None:
    text = "\n".join(
        json.dumps({"time": t, "magnetic_field": m.tolist(), "angular_rate": w.tolist(), "depth": 3})
        for t, m, w in zip(recording.time[:100], recording.magnetic_field, recording.angular_rate, strict=False)
    )
    cuts = [0, *np.sort(np.random.default_rng(0).integers(0, len(text), 30)).tolist(), len(text)]
    source, batch = lines_of(*(text[a:b] for a, b in pairwise(cuts) if a < b))
    assert source.waiting_for == ""
    assert source.notes == []
    np.testing.assert_array_equal(batch.magnetometer.time, recording.time[:100])
    np.testing.assert_array_equal(batch.magnetometer.value, recording.magnetic_field[:100])
    np.testing.assert_array_equal(batch.gyroscope.value, recording.angular_rate[:100])


def test_json_lines_of_one_sensor_each_in_units_of_their_own() -> None:
    source, batch = lines_of(
        '{"time": 1, "magnetic_field": [20, 0, 40], "angular_rate": null}\n',
        '{"time": 1.5, "angular_rate": [180, 0, 0]}\n\n',
        request=UNITS,
    )
    np.testing.assert_allclose(batch.magnetometer.value, [[20e-6, 0, 40e-6]])
    np.testing.assert_allclose(batch.gyroscope.value, [[np.pi, 0, 0]])
    assert source.waiting_for == ""
    source, _ = lines_of('{"time": 1, "magnetic_field": [20e-6, 0, 0]}\n')
    assert source.waiting_for == "no angular_rate in 1 line so far"


def drained_of(source: JsonLines) -> None:
    while not source.ended:
        source.read(1.0)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("{time: 1}", "not JSON"),
        ("[1, 2]", "expected an object"),
        ('{"magnetic_field": [1, 2, 3]}', '"time" must be a number of seconds, got null'),
        ('{"time": "noon", "magnetic_field": [1, 2, 3]}', '"time" must be a number of seconds, got "noon"'),
        ('{"time": true, "magnetic_field": [1, 2, 3]}', '"time" must be a number of seconds, got true'),
        ('{"time": 1, "magnetic_field": [1, 2]}', "must be three numbers"),
        ('{"time": 1, "angular_rate": [1, 2, "3"]}', "must be three numbers"),
        ('{"time": 1}', "neither"),
        ('{"time": ' + "9" * 400 + "}", '"time" must be a number of seconds, got Infinity'),
        ('{"time": ' + "9" * 5000 + "}", '"time" must be a number of seconds, got Infinity'),
        ("[" * 50_000, "not JSON"),
    ],
)
def test_a_bad_line_is_left_out_with_its_number_and_the_others_are_not(line: str, reason: str) -> None:
    good = '{"time": 1, "magnetic_field": [2e-5, 0, 0]}\n'
    source, batch = lines_of(good, line + "\n", good)
    assert len(batch.magnetometer.time) == 2
    (note,) = source.notes
    assert note.startswith("standard input, line 2: ")
    assert reason in note
    assert source.lost == 1


def test_a_stream_without_lines_is_refused() -> None:
    reader, writer = os.pipe()
    source = JsonLines(reader, Request())

    def flood() -> None:
        for _ in range(20):
            os.write(writer, b"x" * 60_000)
        os.close(writer)

    thread = threading.Thread(target=flood)
    thread.start()
    with pytest.raises(MagycError, match="line 1: longer than"):
        drained_of(source)
    while os.read(reader, 1 << 20):
        pass
    thread.join()
    os.close(reader)
