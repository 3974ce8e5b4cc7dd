"""MCAP: what is written comes back, damaged files give what they have, and what is ambiguous is refused."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import info, info_and_recording, read, write_mcap
from magyc_gtsam.io.ros2 import definition, encode
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation import simulate

EPOCH = 1_620_000_000_123_456_789
IMU, MAG = "sensor_msgs/Imu", "sensor_msgs/MagneticField"


def small(n: int = 200, **changes: Any) -> Recording:
    """Magnetometer at every third row, gyroscope at all others and some of these, odd bits everywhere."""
    random = np.random.default_rng(1)
    time = np.cumsum(random.integers(1_000_000, 9_000_000, n)) / 1e9
    time -= time[0]
    row = np.arange(n)
    mag_time, gyro_time = time[row % 3 == 0], time[(row % 3 != 0) | (row % 6 == 0)]
    quaternion = random.normal(size=(n, 4))
    arguments: dict[str, Any] = {
        "magnetic_field": (mag_time, random.normal(0, 3e-5, (len(mag_time), 3))),
        "angular_rate": (gyro_time, random.normal(0, 1, (len(gyro_time), 3))),
        "acceleration": (gyro_time, random.normal(0, 5, (len(gyro_time), 3))),
        "attitude": (time, quaternion / np.linalg.norm(quaternion, axis=1)[:, None]),
        "channels": {
            "battery/current": (time, random.normal(size=n)),
            "motors": (time, random.normal(size=(n, 4))),
        },
        "name": "a dive",
    }
    return Recording.from_streams(**(arguments | changes))


def stamps(recording: Recording) -> np.ndarray:
    return np.round(recording.time * 1e9).astype(np.int64)


def assert_same(a: Recording, b: Recording) -> None:
    """Equal samples bit by bit, equal stamps to the nanosecond from the first row."""
    for first, second in ((a.magnetometer, b.magnetometer), (a.gyroscope, b.gyroscope)):
        np.testing.assert_array_equal(first.value, second.value)
    np.testing.assert_array_equal(stamps(a) - stamps(a)[0], stamps(b))
    np.testing.assert_array_equal(a.magnetic_field_fresh, b.magnetic_field_fresh)
    np.testing.assert_array_equal(a.magnetic_field_stamped, b.magnetic_field_stamped)
    np.testing.assert_array_equal(a.angular_rate_fresh, b.angular_rate_fresh)


def alter(source: Path, target: Path, change: Callable[[str, int, bytes, int], Any], **options: Any) -> Path:
    """Copy a log message by message; `change` returns messages (topic, log_time, data) in place of each."""
    with open(source, "rb") as file, open(target, "wb") as out:
        writer = McapWriter(out, **options)
        writer.start("ros2")
        channels: dict[str, int] = {}
        counts: dict[str, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            index = counts.setdefault(channel.topic, 0)
            counts[channel.topic] += 1
            assert schema is not None
            for topic, log_time, data in change(channel.topic, index, message.data, message.log_time):
                if topic not in channels:
                    identifier = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[topic] = writer.register_channel(topic, "cdr", identifier)
                writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    return target


def restamp(data: bytes, stamp: int) -> bytes:
    return data[:4] + struct.pack("<iI", *divmod(stamp, 10**9)) + data[12:]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.mcap"
    write_mcap(path, small(), epoch=EPOCH)
    return path


def test_repeated_readings_are_written(tmp_path: Path) -> None:
    """Coarse steps repeat themselves, and a held sensor too: without these rows a reader cannot tell."""
    whole = small()
    coarse = 5e-5 * np.sign(whole.magnetic_field) * [1.0, 0.0, 0.0]
    recording = replace(
        whole,
        magnetic_field=coarse,
        magnetic_field_fresh=None,
        magnetic_field_stamped=whole.magnetic_field_stamped,
    )
    assert (recording.magnetic_field_stamped & ~recording.magnetic_field_fresh).sum() > 20
    write_mcap(tmp_path / "a.mcap", recording)
    assert_same(recording, read(tmp_path / "a.mcap"))


@pytest.mark.parametrize("compression", ["zstd", "lz4", None])
def test_round_trip_is_exact(tmp_path: Path, compression: Any) -> None:
    recording = small()
    write_mcap(tmp_path / "a.mcap", recording, epoch=EPOCH, compression=compression)
    back = read(tmp_path / "a.mcap")
    assert_same(recording, back)
    assert back.name == "a dive"
    assert back.acceleration is not None
    assert back.attitude is not None
    gyro = back.angular_rate_fresh
    np.testing.assert_array_equal(recording.acceleration[gyro], back.acceleration[gyro])  # type: ignore[index]
    alike = np.abs(np.sum(recording.attitude * back.attitude, axis=1))  # type: ignore[operator]
    np.testing.assert_allclose(alike, 1, rtol=0, atol=1e-15)  # q and -q are one attitude
    assert dict(back.channels).keys() == {"battery/current", "motors"}
    for name, values in recording.channels.items():
        np.testing.assert_array_equal(values, back.channels[name])
    write_mcap(tmp_path / "b.mcap", back, epoch=EPOCH)
    again = read(tmp_path / "b.mcap")
    assert_same(back, again)
    np.testing.assert_array_equal(back.time, again.time)


def test_epoch_is_noted_to_the_nanosecond(log: Path) -> None:
    first = EPOCH + stamps(small())[0]
    assert f"({first // 10**9}.{first % 10**9:09d} s)" in " ".join(read(log).notes)
    assert "time 0 is 2021-05-03T00:00:00." in " ".join(read(log).notes)


def test_interval_mean_is_restored(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", small(angular_rate_is="interval-mean", attitude_is="estimate"))
    back = read(tmp_path / "a.mcap")
    assert (back.angular_rate_is, back.attitude_is) == ("interval-mean", "estimate")
    between = np.flatnonzero(~back.angular_rate_fresh[:-1])
    following = [np.flatnonzero(back.angular_rate_fresh[k:])[0] + k for k in between]
    np.testing.assert_array_equal(back.angular_rate[between], back.angular_rate[following])  # type: ignore[index]


def test_the_library_decodes_what_is_written(log: Path) -> None:
    recording = small()
    with open(log, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages: dict[str, list[Any]] = {}
        for _, channel, _, decoded in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(decoded)
    assert set(messages) == {
        "/imu/mag",
        "/imu/data_raw",
        "/reference/attitude",
        "/battery/current",
        "/motors",
    }
    field = messages["/imu/mag"][7]
    np.testing.assert_array_equal(
        recording.magnetometer.value[7],
        [field.magnetic_field.x, field.magnetic_field.y, field.magnetic_field.z],
    )
    stamp = field.header.stamp.sec * 10**9 + field.header.stamp.nanosec
    assert stamp == EPOCH + np.round(recording.magnetometer.time[7] * 1e9)
    imu = messages["/imu/data_raw"][5]
    assert imu.orientation_covariance[0] == -1
    assert imu.angular_velocity_covariance[0] == 0
    assert imu.angular_velocity.y == recording.gyroscope.value[5, 1]
    assert list(messages["/motors"][3].data) == list(recording.channels["motors"][3])


def test_only_a_magnetometer(tmp_path: Path) -> None:
    recording = small(angular_rate=None, acceleration=None)
    write_mcap(tmp_path / "a.mcap", recording)
    back = read(tmp_path / "a.mcap")
    assert back.angular_rate is None
    assert any("no gyroscope" in n for n in back.notes)
    np.testing.assert_array_equal(recording.magnetometer.value, back.magnetometer.value)


def test_stamps_that_a_header_cannot_hold(tmp_path: Path) -> None:
    with pytest.raises(MagycError, match="choose another epoch"):
        write_mcap(tmp_path / "a.mcap", small(), epoch=-(10**9))


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
@pytest.mark.parametrize("share", [0.35, 0.7, 0.95])
def test_cut_in_the_middle(log: Path, tmp_path: Path, compression: CompressionType, share: float) -> None:
    whole = alter(
        log,
        tmp_path / "whole.mcap",
        lambda t, i, d, at: [(t, at, d)],
        chunk_size=4096,
        compression=compression,
    )
    cut = tmp_path / "cut.mcap"
    with open(whole, "rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes  # type: ignore[union-attr]
    data = whole.read_bytes()
    end = chunks[-1].chunk_start_offset + chunks[-1].chunk_length
    cut.write_bytes(data[: int(end * share)])
    complete = [c for c in chunks if c.chunk_start_offset + c.chunk_length <= int(end * share)]
    back = read(cut)
    full = read(whole)
    assert any("cut off" in n and "messages could be read" in n for n in back.notes)
    assert 0 < len(complete) < len(chunks)
    last = max(c.message_end_time for c in complete) - EPOCH - stamps(small())[0]
    assert abs(back.time[-1] * 1e9 - last) < 30e6
    n = len(back.magnetometer.value)
    np.testing.assert_array_equal(back.magnetometer.value, full.magnetometer.value[:n])


def test_damaged_chunk_is_left_out(log: Path, tmp_path: Path) -> None:
    whole = alter(log, tmp_path / "whole.mcap", lambda t, i, d, at: [(t, at, d)], chunk_size=4096)
    with open(whole, "rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes  # type: ignore[union-attr]
    data = bytearray(whole.read_bytes())
    middle = chunks[len(chunks) // 2]
    for k in range(200, 220):
        data[middle.chunk_start_offset + k] ^= 0xFF
    (tmp_path / "damaged.mcap").write_bytes(data)
    back = read(tmp_path / "damaged.mcap")
    assert any("damaged" in n for n in back.notes)
    assert 0 < len(read(whole).magnetometer.value) - len(back.magnetometer.value) < 40


def test_without_index_or_chunks(log: Path, tmp_path: Path) -> None:
    plain = alter(
        log,
        tmp_path / "plain.mcap",
        lambda t, i, d, at: [(t, at, d)],
        index_types=IndexType.NONE,
        use_chunking=False,
        use_statistics=False,
        repeat_channels=False,
        repeat_schemas=False,
    )
    assert_same(read(log), read(plain))


def test_not_an_mcap_file(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x00\x01 nothing of the kind")
    with pytest.raises(MagycError, match="the content is not that of a"):
        read(tmp_path / "a.mcap")
    (tmp_path / "b.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(MagycError, match=r"not an MCAP file|no message"):
        read(tmp_path / "b.mcap")
    (tmp_path / "c.mcap").write_bytes(b"")
    with pytest.raises(MagycError, match="is empty"):
        read(tmp_path / "c.mcap")
    with pytest.raises(MagycError, match="cannot be read"):
        read(tmp_path / "d.mcap")


def test_two_magnetometers_are_listed(log: Path, tmp_path: Path) -> None:
    def twice(topic: str, index: int, data: bytes, at: int) -> list[Any]:
        return [(topic, at, data)] + ([("/imu2/mag", at, data)] if topic == "/imu/mag" and index < 40 else [])

    two = alter(log, tmp_path / "two.mcap", twice)
    with pytest.raises(
        MagycError, match=r"2 topics could be meant: /imu/mag \(67 messages\), /imu2/mag \(40 messages\)"
    ):
        read(two)
    assert len(read(two, magnetic_field="/imu2/mag").magnetometer.value) == 40
    assert len(read(two, magnetic_field="imu/mag").magnetometer.value) == 67
    with pytest.raises(MagycError, match=r"no topic '/mag'; the file has /imu/mag"):
        read(two, magnetic_field="/mag")
    with pytest.raises(MagycError, match="must be of type sensor_msgs/MagneticField .* got sensor_msgs/msg/Imu"):
        read(two, magnetic_field="/imu/data_raw")
    described = info(two)
    assert not described.readable
    assert "2 topics could be meant" in str(described.problem)
    mag = next(s for s in described.sources if s.name == "/imu/mag")
    assert (mag.count, mag.serves_as) == (67, ("magnetic_field",))
    assert mag.rate == pytest.approx(66 / np.ptp(small().magnetometer.time))


def test_units_are_named_and_converted_only_when_asked(tmp_path: Path) -> None:
    source = small()
    write_mcap(tmp_path / "si.mcap", source)

    def in_gauss(topic: str, index: int, data: bytes, at: int) -> list[Any]:
        if topic != "/imu/mag":
            return [(topic, at, data)]
        value = np.frombuffer(data[20:44], dtype="<f8") * 1e4
        return [(topic, at, data[:20] + value.tobytes() + data[44:])]

    gauss = alter(tmp_path / "si.mcap", tmp_path / "gauss.mcap", in_gauss)
    with pytest.raises(MagycError, match="likely unit: gauss"):
        read(gauss)
    back = read(gauss, magnetic_unit="gauss")
    np.testing.assert_allclose(back.magnetometer.value, source.magnetometer.value, rtol=1e-15)
    assert any("read in gauss" in n for n in back.notes)
    degrees = read(tmp_path / "si.mcap", angular_unit="deg/s", acceleration_unit="g")
    np.testing.assert_allclose(degrees.gyroscope.value, np.radians(source.gyroscope.value), rtol=1e-15)
    with pytest.raises(MagycError, match="'parsec' is unknown; there are T, mT, uT"):
        read(gauss, magnetic_unit="parsec")
    with pytest.raises(MagycError, match="option 'rate' does not apply"):
        read(gauss, rate=10)


@pytest.mark.parametrize("share", [1, 10])
def test_absent_axis(log: Path, tmp_path: Path, share: int) -> None:
    nan = struct.pack("<d", np.nan)
    holed = alter(
        log,
        tmp_path / "nan.mcap",
        lambda t, i, d, at: [(t, at, d[:36] + nan + d[44:] if t == "/imu/mag" and i % share == 0 else d)],
    )
    if share == 1:
        with pytest.raises(MagycError, match="axis z is absent"):
            read(holed)
    else:
        back = read(holed)
        assert len(back.magnetometer.value) == 60
        assert any("7 of 67 samples are not finite" in n for n in back.notes)


def test_no_estimate(log: Path, tmp_path: Path) -> None:
    def without_gyroscope(topic: str, index: int, data: bytes, at: int) -> list[Any]:
        place = 20 + 8 * 16
        return [
            (
                topic,
                at,
                data[:place] + struct.pack("<d", -1) + data[place + 8 :] if "data_raw" in topic else data,
            )
        ]

    back = read(alter(log, tmp_path / "a.mcap", without_gyroscope))
    assert back.angular_rate is None
    assert back.acceleration is not None
    assert any("declares that it has no angular_rate" in n for n in back.notes)
    with pytest.raises(MagycError, match="declares that it has no attitude"):
        read(log, attitude="/imu/data_raw")


def test_repeated_messages(log: Path, tmp_path: Path) -> None:
    again = alter(log, tmp_path / "a.mcap", lambda t, i, d, at: [(t, at, d)] * (2 if "mag" in t and i < 5 else 1))
    back = read(again)
    assert_same(read(log), back)
    assert any("/imu/mag: 5 samples were recorded twice" in n for n in back.notes)

    def conflict(topic: str, index: int, data: bytes, at: int) -> list[Any]:
        return (
            [(topic, at, data), (topic, at, data[:20] + bytes(8) + data[28:])]
            if "mag" in topic
            else [(topic, at, data)]
        )

    with pytest.raises(MagycError, match=r"/imu/mag: 67 stamps occur twice with different values"):
        read(alter(log, tmp_path / "b.mcap", conflict))


def test_interleaved_messages_are_sorted(log: Path, tmp_path: Path) -> None:
    held: list[Any] = []

    def swap(topic: str, index: int, data: bytes, at: int) -> list[Any]:
        if topic != "/imu/mag":
            return [(topic, at, data)]
        if index % 10 == 3:
            held.append((topic, at, data))
            return []
        return [(topic, at, data), *([held.pop()] if held else [])]

    back = read(alter(log, tmp_path / "a.mcap", swap))
    assert_same(read(log), back)
    assert any("7 samples out of order" in n for n in back.notes)


@pytest.mark.parametrize(
    ("set_by", "says"), [(-3600, r"goes back by 3599\.\d+ s"), (40 * 86400, "jumps ahead by 40 days")]
)
def test_a_clock_that_is_set(log: Path, tmp_path: Path, set_by: int, says: str) -> None:
    whole = read(log)
    half = int(stamps(whole)[100]) + EPOCH + stamps(small())[0]

    def reset(topic: str, index: int, data: bytes, at: int) -> list[Any]:
        if topic not in ("/imu/mag", "/imu/data_raw", "/reference/attitude"):
            return []
        return [(topic, at, restamp(data, at + (set_by * 10**9 if at > half else 0)))]

    back = alter(log, tmp_path / "a.mcap", reset)
    with pytest.raises(MagycError, match=rf"/imu/mag: its clock {says} after sample 34") as caught:
        read(back)
    cut = float(str(caught.value).split("end=")[1].split(" ")[0])
    first, second = read(back, end=cut), read(back, start=cut)
    # Each side starts and ends where the slower sensor does, so a few rows at the seam belong to neither.
    assert 195 <= len(first.time) + len(second.time) <= 200
    np.testing.assert_array_equal(
        first.magnetometer.value, whole.magnetometer.value[: len(first.magnetometer.value)]
    )
    np.testing.assert_array_equal(
        second.magnetometer.value, whole.magnetometer.value[-len(second.magnetometer.value) :]
    )
    assert_same(whole, read(back, stamps="log"))


def test_what_an_imu_does_not_hold_is_not_listed(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", replace(small(), attitude=None))
    described, recording = info_and_recording(tmp_path / "a.mcap")
    assert recording is not None
    (imu,) = [source for source in described.sources if "angular_rate" in source.serves_as]
    assert imu.serves_as == ("angular_rate", "acceleration")


def test_an_attitude_that_is_not_used_is_not_listed(tmp_path: Path) -> None:
    recording = simulate("wide", 20).recording
    assert recording.attitude is not None
    write_mcap(tmp_path / "a.mcap", recording)
    listed = {source.name: source.serves_as for source in info(tmp_path / "a.mcap").sources}
    assert listed["/reference/attitude"] == ("attitude",)
    assert listed["/imu/data_raw"] == ("angular_rate", "acceleration")


def test_a_topic_that_begins_before_the_sensors(log: Path, tmp_path: Path) -> None:
    """`info` counts from the recording's first row as `start` and `end` do; on another clock, from the first stamp."""

    def early(topic: str, index: int, data: bytes, at: int) -> list[tuple[str, int, bytes]]:
        return [("/motors", at - 60 * 10**9, data)] * (topic == "/motors") + [(topic, at, data)]

    def of_boot(topic: str, index: int, data: bytes, at: int) -> list[tuple[str, int, bytes]]:
        return [(topic, at, restamp(data, at - EPOCH) if "imu" in topic else data)]

    path = alter(log, tmp_path / "a.mcap", early)
    for file, begin in ((path, 0.0), (alter(path, tmp_path / "b.mcap", of_boot), 60.0)):
        spans = {source.name: source.span for source in info(file).sources}
        assert spans["/imu/mag"] == pytest.approx((begin, begin + np.ptp(small().time)), abs=0.05)
        assert spans["/motors"] == pytest.approx((begin - 60, begin + np.ptp(small().time)), abs=0.05)


def test_header_never_filled_in(log: Path, tmp_path: Path) -> None:
    blank = alter(log, tmp_path / "a.mcap", lambda t, i, d, at: [(t, at, restamp(d, 0) if "imu" in t else d)])
    with pytest.raises(MagycError, match=r"was the header never filled in.*stamps='log'"):
        read(blank)
    assert_same(read(log), read(blank, stamps="log", attitude="/reference/attitude"))


def test_start_and_end(log: Path) -> None:
    whole = read(log)
    part = read(log, start=0.2, end=0.6)
    inside = (whole.time >= 0.2) & (whole.time <= 0.6)
    np.testing.assert_array_equal(part.time, whole.time[inside])
    np.testing.assert_array_equal(part.magnetic_field, whole.magnetic_field[inside])


def test_progress_ends_at_one(log: Path) -> None:
    told: list[float] = []
    read(log, progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


BATTERY = """std_msgs/Header header
float32 voltage
float32 current
string location
uint8[] blob
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""


def test_channels_of_any_message(tmp_path: Path) -> None:
    recording = small(channels=None, attitude=None)
    n = len(recording.time)
    at = stamps(recording) + EPOCH
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file)
        mag, imu = (writer.register_msgdef(t.replace("/", "/msg/"), definition(t)) for t in (MAG, IMU))
        battery = writer.register_msgdef("my_msgs/msg/Battery", BATTERY)
        depth = writer.register_msgdef("std_msgs/msg/Float64", "float64 data\n")
        text = writer.register_msgdef("std_msgs/msg/String", "string data\n")
        image = writer.register_msgdef("my_msgs/msg/Image", "uint8[] data\n")
        zero = {"x": 0.0, "y": 0.0, "z": 0.0}
        for k in range(n):
            header = {
                "stamp": {"sec": int(at[k] // 10**9), "nanosec": int(at[k] % 10**9)},
                "frame_id": "x" * (k % 5),
            }
            m, w = recording.magnetic_field[k], recording.angular_rate[k]  # type: ignore[index]
            late = int(at[k]) + 5_000_000
            vector = dict(zip("xyz", map(float, m), strict=True))
            field = {"header": header, "magnetic_field": vector, "magnetic_field_covariance": [0.0] * 9}
            writer.write_message("/mag", mag, field, late)
            inertial = {
                "header": header,
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8},
                "angular_velocity": dict(zip("xyz", map(float, w), strict=True)),
                "linear_acceleration": zero,
                **{
                    f"{c}_covariance": [0.0] * 9
                    for c in ("orientation", "angular_velocity", "linear_acceleration")
                },
            }
            writer.write_message("/imu", imu, inertial, late)
            cell = {"header": header, "voltage": 12.5, "current": float(k), "location": "bow", "blob": []}
            writer.write_message("/battery", battery, cell, late)
            writer.write_message("/depth", depth, {"data": k / 8}, int(at[k]))
            writer.write_message("/remark", text, {"data": "good"}, late)
            if k < 3:
                writer.write_message("/camera", image, {"data": [0] * 5000}, late)
        writer.finish()
    back = read(tmp_path / "a.mcap")
    assert set(back.channels) == {"battery.voltage", "battery.current", "depth"}
    np.testing.assert_array_equal(back.channels["battery.current"], np.arange(n))
    np.testing.assert_array_equal(back.channels["depth"], np.arange(n) / 8)
    assert any("/remark (std_msgs/msg/String): holds no number" in note for note in back.notes)
    assert any("/camera" in note and "at most 2048 bytes" in note for note in back.notes)
    np.testing.assert_array_equal(back.magnetic_field, recording.magnetic_field)
    np.testing.assert_array_equal(back.angular_rate, recording.angular_rate)
    assert back.attitude is None  # an Imu's orientation is its own filter's, and used only when named
    named = read(tmp_path / "a.mcap", attitude="/imu", channels=["battery.current"])
    np.testing.assert_allclose(named.attitude, np.tile([0, 0, 0.6, 0.8], (n, 1)))  # type: ignore[arg-type]
    assert set(named.channels) == {"battery.current"}
    with pytest.raises(MagycError, match="channels: the file has no salinity"):
        read(tmp_path / "a.mcap", channels=["salinity"])


def test_ros1_and_big_endian(tmp_path: Path) -> None:
    recording = small(channels=None, attitude=None, acceleration=None)
    sensors = {
        MAG: (recording.magnetometer, np.pad(recording.magnetometer.value, ((0, 0), (0, 9)))),
        IMU: (recording.gyroscope, np.pad(recording.gyroscope.value, ((0, 0), (13, 21)))),
    }

    def ros1(stamp: int, value: np.ndarray) -> bytes:
        return struct.pack("<IIII", 7, *divmod(stamp, 10**9), 3) + b"imu" + value.astype("<f8").tobytes()

    def big_endian(stamp: int, value: np.ndarray) -> bytes:
        head = b"\0\0\0\0" + struct.pack(">iII", *divmod(stamp, 10**9), 9) + b"sensor_1\0"
        return head + b"\0" * (-(len(head) - 4) % 8) + value.astype(">f8").tobytes()

    for name, encoding, pack in (("ros1", "ros1", ros1), ("big", "cdr", big_endian)):
        with open(tmp_path / f"{name}.mcap", "wb") as file:
            writer = McapWriter(file)
            writer.start()
            for kind, (samples, numbers) in sensors.items():
                schema = writer.register_schema(kind, "ros1msg", b"")
                channel = writer.register_channel(f"/{kind.split('/')[1]}", encoding, schema)
                for time, row in zip(samples.time, numbers, strict=True):
                    stamp = EPOCH + round(time * 1e9)
                    writer.add_message(channel, stamp, pack(stamp, row), stamp)
            writer.finish()
        back = read(tmp_path / f"{name}.mcap")
        np.testing.assert_array_equal(back.magnetometer.value, recording.magnetometer.value)
        np.testing.assert_array_equal(back.gyroscope.value, recording.gyroscope.value)
        assert np.ptp(back.time) == pytest.approx(np.ptp(recording.time), abs=1e-9)


def test_two_encodings_on_one_topic(log: Path, tmp_path: Path) -> None:
    """Messages of ROS 1 were decoded as those of ROS 2."""
    mixed = tmp_path / "a.mcap"
    with open(log, "rb") as source, open(mixed, "wb") as file:
        writer = McapWriter(file)
        writer.start()
        topics: dict[str, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None
            if channel.topic not in topics:
                own = writer.register_schema(schema.name, schema.encoding, schema.data)
                topics[channel.topic] = writer.register_channel(channel.topic, "cdr", own)
            writer.add_message(topics[channel.topic], message.log_time, message.data, message.publish_time)
        ros1 = writer.register_channel(
            "/imu/mag", "ros1", writer.register_schema(MAG.replace("/", "/msg/"), "ros1msg", b"")
        )
        for k in range(3):
            at = EPOCH + 10**9 + k
            data = struct.pack("<IIII", 7, *divmod(at, 10**9), 3) + b"imu" + bytes(96)
            writer.add_message(ros1, at, data, at)
        writer.finish()
    back = read(mixed)
    assert_same(read(log), back)
    assert any("/imu/mag has messages of two types or encodings; those of" in note for note in back.notes)


def test_message_shorter_than_its_type(log: Path, tmp_path: Path) -> None:
    short = alter(
        log, tmp_path / "a.mcap", lambda t, i, d, at: [(t, at, d[:50] if t == "/imu/mag" and i == 4 else d)]
    )
    with pytest.raises(MagycError, match="/imu/mag: message 5 of 50 bytes is too short"):
        read(short)


def test_encode_width() -> None:
    message = encode(np.array([EPOCH]), np.zeros((1, 12)))[0]
    assert len(message) == 4 + 8 + 4 + 4 + 96


@pytest.mark.parametrize(
    ("name", "magnetometer", "gyroscope", "seconds"),
    [
        ("broad_01_slow_rotation", 40352, 56940, 199.3),
        ("broad_06_fast_rotation", 40022, 56380, 197.3),
        ("broad_32_attached_magnet_1cm", 33720, 47639, 166.7),
        ("nexus5_augmented_reality", 5995, 24009, 120.9),
        ("nexus5_calibration_d1", 1389, 5563, 28.0),
        ("breakout_boards_hand_rotation", 7958, 10527, 106.3),
    ],
)
def test_real_logs(shared_data: Path, name: str, magnetometer: int, gyroscope: int, seconds: float) -> None:
    back = read(shared_data / f"{name}.mcap")
    assert len(back.magnetometer.time) == pytest.approx(magnetometer, rel=0.002)
    assert len(back.gyroscope.time) == pytest.approx(gyroscope, rel=0.002)
    assert back.duration == pytest.approx(seconds, abs=0.1)
    assert back.time[0] == 0
    if name.startswith("broad"):
        assert len(back.time) == gyroscope  # both sensors have the same stamps
        assert np.isfinite(back.attitude).all(axis=1).mean() > 0.9  # type: ignore[type-var]


def test_real_log_against_the_librarys_decoder(shared_data: Path) -> None:
    path = shared_data / "nexus5_calibration_d1.mcap"
    found: dict[str, dict[int, list[float]]] = {"/imu/mag": {}, "/imu/data_raw": {}}
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
            vector = message.magnetic_field if channel.topic == "/imu/mag" else message.angular_velocity
            found[channel.topic][stamp] = [vector.x, vector.y, vector.z]
    first = max(min(f) for f in found.values())
    last = min(max(f) for f in found.values())
    union = sorted({s for f in found.values() for s in f if first <= s <= last})
    back = read(path)
    np.testing.assert_array_equal(stamps(back), np.array(union) - first)
    gyroscope = [found["/imu/data_raw"][s] for s in union if s in found["/imu/data_raw"]]
    np.testing.assert_array_equal(back.gyroscope.value, gyroscope)
    rows = np.searchsorted(stamps(back), np.array([s for s in union if s in found["/imu/mag"]]) - first)
    np.testing.assert_array_equal(back.magnetic_field[rows], [found["/imu/mag"][union[r]] for r in rows])
