"""MCAP files and bags from anybody: no internal error, nothing granted without bound, damage that costs itself only."""

from __future__ import annotations

import bz2
import random
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import info, mcap_compression, read, write_mcap
from magyc_gtsam.io.mcap_records import records
from magyc_gtsam.io.mcap_topics import Topics
from magyc_gtsam.io.request import Request
from magyc_gtsam.io.ros2 import definition
from magyc_gtsam.recording import Recording

EPOCH = 1_620_000_000_000_000_000


def recording(n: int = 120) -> Recording:
    source = np.random.default_rng(5)
    return Recording(
        np.arange(n) / 50,
        source.normal(0, 3e-5, (n, 3)),
        source.normal(0, 1, (n, 3)),
        acceleration=source.normal(0, 5, (n, 3)),
        channels={"battery/current": source.normal(size=n)},
        name="a dive",
    )


@pytest.fixture
def log(tmp_path: Path) -> Path:
    write_mcap(tmp_path / "log.mcap", recording(), epoch=EPOCH, compression=None)
    return tmp_path / "log.mcap"


def test_flipped_bytes_are_refused_or_cost_themselves(log: Path, tmp_path: Path) -> None:
    """Names, types and lengths outside of any checksum among them."""
    whole = log.read_bytes()
    source = random.Random(7)
    bad = tmp_path / "bad.mcap"
    refused = 0
    for _ in range(250):
        data = bytearray(whole)
        for _ in range(source.randint(1, 12)):
            data[source.randrange(8, len(data))] = source.randrange(256)
        bad.write_bytes(data)
        try:
            read(bad)
        except MagycError:
            refused += 1
    assert 0 < refused < 250


def chunk(records: bytes, size: int, compression: str, packed: bytes | None = None) -> bytes:
    data = records if packed is None else packed
    name = compression.encode()
    content = struct.pack("<QQQII", 0, 1, size, 0 if packed else zlib.crc32(records), len(name)) + name
    content += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(content)) + content


@pytest.mark.parametrize("size", [10 << 30, 1 << 20])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_chunk_that_asks_for_too_much(log: Path, tmp_path: Path, compression: str, size: int) -> None:
    """Whether its head says so or lies about it."""
    import lz4.frame

    content = bytes(120 << 20)
    packed = zstandard.compress(content) if compression == "zstd" else lz4.frame.compress(content)
    del content
    data = log.read_bytes()
    first = data.index(b"\x06", 8)
    with open(log, "rb") as file:
        first = make_reader(file).get_summary().chunk_indexes[0].chunk_start_offset  # type: ignore[union-attr]
    bomb = tmp_path / "bomb.mcap"
    bomb.write_bytes(data[:first] + chunk(b"", size, compression, packed) + data[first:])
    tracemalloc.start()
    back = read(bomb)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6
    assert any("a chunk is damaged and was left out" in note for note in back.notes)
    np.testing.assert_array_equal(back.magnetic_field, recording().magnetic_field)


def test_file_that_unpacks_without_end(tmp_path: Path) -> None:
    one = struct.pack("<BQ", 5, 22 + 100) + bytes(22 + 100)
    records = one * 400_000
    packed = chunk(records, len(records), "zstd", zstandard.compress(records))
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + packed * 8)
    with pytest.raises(MagycError, match="unpacks to more than 100 times its"):
        read(path)


TYPES = ["bool", "byte", "char", *(f"{s}int{b}" for s in ("", "u") for b in (8, 16, 32, 64)), "float32", "float64"]


def value_of(kind: str, draw: Any) -> Any:
    if kind == "string":
        return draw(st.text(st.characters(codec="ascii", exclude_characters="\0"), max_size=9))
    if kind == "bool":
        return draw(st.booleans())
    if kind.startswith("float"):
        return draw(st.floats(width=int(kind[5:]), allow_nan=False))  # type: ignore[arg-type]
    bits = 8 if kind in ("byte", "char") else int(kind.lstrip("uint"))
    signed = not kind.startswith("u") and kind != "byte"
    low = -(2 ** (bits - 1)) if signed else 0
    return draw(st.integers(low, low + 2**bits - 1))


@settings(max_examples=60)
@given(st.data())
def test_any_message_as_the_library_decodes_it(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    """Random types, nested, with strings and arrays of changing lengths between the numbers."""
    draw = data.draw
    kinds = st.sampled_from([*TYPES, "string"])
    fields = [
        (f"f{k}", draw(kinds), draw(st.sampled_from(["", "[3]", "[]"]))) for k in range(draw(st.integers(1, 6)))
    ]
    inner = [(f"g{k}", draw(kinds)) for k in range(draw(st.integers(0, 3)))]
    lengths = {name: draw(st.integers(1, 4)) for name, _, _ in fields}
    text = "".join(f"{t}{a} {n}\n" for n, t, a in fields) + "p/Inner inner\np/Inner[] many\nuint8 last\n"
    text += "=" * 80 + "\nMSG: p/Inner\n" + "".join(f"{t} {n}\n" for n, t in inner)

    def inside() -> dict[str, Any]:
        return {n: value_of(t, draw) for n, t in inner}

    path = tmp_path_factory.mktemp("types") / "a.mcap"
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=300)
        schema = writer.register_msgdef("p/msg/Outer", text)
        for k in range(12):
            message = {
                n: [value_of(t, draw) for _ in range(3 if a == "[3]" else lengths[n])] if a else value_of(t, draw)
                for n, t, a in fields
            }
            for n, t, a in fields:
                if a and t in ("byte", "uint8"):
                    message[n] = bytes(message[n])
            message |= {"inner": inside(), "many": [inside() for _ in range(k % 3)], "last": k}
            writer.write_message("/x", schema, message, k)
        writer.finish()
    topics = Topics(lambda name, kind: True, Request(), [])
    for record in records(path, [], lambda _: None):
        topics.keep(record)  # type: ignore[arg-type]
    found = topics["/x"].channels()
    with open(path, "rb") as file:
        decoded = [m for *_, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()]
    expected = {f"x.{n}" for n, t, a in fields if t != "string" and not (a and t in ("byte", "uint8"))}
    expected |= {f"x.inner.{n}" for n, t in inner if t != "string"} | {"x.last"}
    # A topic with one number is a channel by its own name.
    assert {"x.last"} | (set(found) - {"x"} if expected == {"x.last"} else set(found)) == expected
    for name, stream in found.items():
        values = []
        for message in decoded:
            at: Any = message
            for part in name.split(".")[1:] or ["last"]:
                at = getattr(at, part)
            values.append(list(at) if hasattr(at, "__len__") else at)
        np.testing.assert_array_equal(stream.value, np.array(values, dtype=np.float64))


VENDOR = """std_msgs/Header header
string device
vendor_msgs/Inertial imu
float32[3] magnetometer
================================================================================
MSG: vendor_msgs/Inertial
float64 temperature
geometry_msgs/Vector3 rate
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""


def test_sensors_inside_a_vendors_message(tmp_path: Path) -> None:
    source = recording()
    path = tmp_path / "vendor.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("vendor_msgs/msg/Common", VENDOR)
        for k, (m, w) in enumerate(zip(source.magnetic_field, source.angular_rate, strict=True)):  # type: ignore[arg-type]
            at = EPOCH + round(source.time[k] * 1e9)
            message = {
                "header": {"stamp": {"sec": at // 10**9, "nanosec": at % 10**9}, "frame_id": "x"},
                "device": "vn-100" + "x" * (k % 3),
                "imu": {"temperature": 20.0, "rate": dict(zip("xyz", w.tolist(), strict=True))},
                "magnetometer": (m * 1e4).tolist(),  # gauss, as VectorNav has it
            }
            writer.write_message("/vendor/common", schema, message, at)
        writer.finish()
    with pytest.raises(
        MagycError, match=r"a vector inside a message: .*/vendor/common\.imu\.rate.*\.magnetometer"
    ):
        read(path)
    with pytest.raises(MagycError, match="likely unit: gauss"):
        read(path, magnetic_field="/vendor/common.magnetometer")
    back = read(
        path,
        magnetic_field="/vendor/common.magnetometer",
        angular_rate="vendor/common.imu.rate",
        magnetic_unit="gauss",
    )
    np.testing.assert_array_equal(back.angular_rate, source.angular_rate)
    np.testing.assert_allclose(back.magnetic_field, source.magnetic_field, rtol=1e-6)
    with pytest.raises(MagycError, match=r"has no field 'imu' of 3 numbers; it has /vendor/common\.imu\.rate"):
        read(path, magnetic_field="/vendor/common.imu")


def test_types_that_nest_without_end_or_count_without_bound(tmp_path: Path) -> None:
    source = recording()
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        names = ("sensor_msgs/MagneticField", "sensor_msgs/Imu")
        write_mcap(tmp_path / "good.mcap", source, epoch=EPOCH)
        with open(tmp_path / "good.mcap", "rb") as good:
            own: dict[str, int] = {}
            for _, channel, message in make_reader(good).iter_messages():
                if channel.topic == "/battery/current":
                    continue
                if channel.topic not in own:
                    kind = names[0] if channel.topic == "/imu/mag" else names[1]
                    schema = writer.register_schema(
                        kind.replace("/", "/msg/"), "ros2msg", definition(kind).encode()
                    )
                    own[channel.topic] = writer.register_channel(channel.topic, "cdr", schema)
                writer.add_message(own[channel.topic], message.log_time, message.data, message.log_time)
        for name, text, payload in (
            ("p/A", "p/A a\n", bytes(40)),
            ("p/B", "p/Empty[] many\n" + "=" * 80 + "\nMSG: p/Empty\n", b"\0\1\0\0" + b"\xff" * 4),
            ("p/C", "wstring text\nfloat64 x\n", bytes(40)),
            ("p/D", "this is no definition\n", bytes(40)),
        ):
            schema = writer.register_schema(name.replace("/", "/msg/"), "ros2msg", text.encode())
            channel_id = writer.register_channel(f"/{name}", "cdr", schema)
            writer.add_message(channel_id, EPOCH, payload, EPOCH)
        writer.finish()
    back = read(path)
    np.testing.assert_array_equal(back.magnetic_field, source.magnetic_field)
    for name in "ABCD":
        assert any(f"/p/{name}" in note for note in back.notes), name
    assert not back.channels


def test_information_of_what_cannot_be_decoded(log: Path) -> None:
    described = info(log)
    assert {s.name: s.count for s in described.sources} == {
        "/imu/mag": 120,
        "/imu/data_raw": 120,
        "/battery/current": 120,
    }


def _text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _topic(number: int, name: str, kind: str, definition: str, encoding: str = "cdr") -> bytes:
    schema = struct.pack("<H", number) + _text(kind) + _text("ros2msg") + _text(definition)
    channel = struct.pack("<HH", number, number) + _text(name) + _text(encoding) + struct.pack("<I", 0)
    return _record(3, schema) + _record(4, channel)


def _messages(number: int, contents: list[bytes]) -> bytes:
    return b"".join(
        _record(5, struct.pack("<HIQQ", number, 0, EPOCH + k * 5_000_000, 0) + content)
        for k, content in enumerate(contents)
    )


def _with(log: Path, records: bytes) -> Path:
    data = log.read_bytes()
    path = log.with_name("more.mcap")
    path.write_bytes(data[:8] + records + data[8:])
    return path


def _packed(records: bytes) -> bytes:
    return chunk(b"", len(records), "zstd", zstandard.compress(records))


TRUTHS = _topic(50, "/truths", "a/msg/B", "\n".join(f"bool f{k}" for k in range(2000)))


@pytest.mark.parametrize("kept", ["numbers of one byte, which become eight", "messages without a channel so far"])
def test_what_is_kept_is_bounded_by_the_size_of_the_file(
    log: Path, monkeypatch: pytest.MonkeyPatch, kept: str
) -> None:
    """However small it is packed."""
    if kept.startswith("numbers"):
        path = _with(log, TRUTHS + _packed(_messages(50, [b"\0\1\0\0" + bytes(2000)] * 1000)))
    else:
        path = _with(log, _packed(_messages(60, [bytes(2000)] * 1000)))
    read(path)
    monkeypatch.setattr("magyc_gtsam.io.ros_log._KEPT", (1, 1 << 20))
    with pytest.raises(MagycError, match="holds more numbers than"):
        read(path)


def test_records_that_no_chunk_holds(log: Path) -> None:
    """Nine zero bytes are a record; a hundred million of them pack to some kB."""
    back = read(_with(log, _packed(bytes(9) * 200_000)))
    assert any("records that are not messages" in note for note in back.notes)


def test_messages_of_many_channels_are_split_in_one_pass(log: Path) -> None:
    heads = np.zeros(100_000, dtype=[("op", "u1"), ("length", "<u8"), ("channel", "<u2"), ("rest", "S20")])
    heads["op"], heads["length"], heads["channel"] = 5, 22, 1000 + np.arange(len(heads)) % 20_000
    back = read(_with(log, _packed(heads.tobytes())))
    assert any("100000 messages of channels without a record" in note for note in back.notes)
    assert max(map(len, back.notes)) < 600


def test_messages_of_very_many_layouts_are_no_channel(log: Path) -> None:
    def message(first: int, second: int) -> bytes:
        content = struct.pack("<I", first) + bytes(first)
        content += bytes(-len(content) % 4) + struct.pack("<I", second) + bytes(second)
        return b"\0\1\0\0" + content + bytes(-len(content) % 8) + struct.pack("<d", 1.0)

    topic = _topic(50, "/texts", "a/msg/S", "string a\nstring b\nfloat64 x")
    few = read(_with(log, topic + _messages(50, [message(k % 20, k % 7) for k in range(400)])))
    assert few.channels["texts"][20] == 1.0
    many = read(_with(log, topic + _messages(50, [message(k % 40, k // 40) for k in range(1600)])))
    assert "texts" not in many.channels
    assert any("more than 1000 different lengths" in note for note in many.notes)


@pytest.mark.parametrize("array", ["", "[2000000000]"])
def test_types_without_fields_within_each_other(log: Path, array: str) -> None:
    """They take no bytes, so that none are missing at any number of them."""
    kinds = ["a/T1 x"]
    for k in range(1, 8):
        kinds += [f"===\nMSG: a/T{k}", *(f"a/T{k + 1}{array} x{j}" for j in range(60))]
    definition = "\n".join([*kinds, "===\nMSG: a/T8", ""])
    topic = _topic(50, "/nested", "a/msg/S", definition, "ros1").replace(b"ros2msg", b"ros1msg")
    back = read(_with(log, topic + _messages(50, [bytes(2000)])))
    assert "nested" not in back.channels


def test_damage_is_told_in_few_words(log: Path) -> None:
    """However much there is of it, and whatever the file calls things."""
    topics = [_topic(k, f"/t{k}" * 100, "a/msg/S", "what is this") for k in range(100, 400)]
    messages = [_messages(k, [bytes(8)]) for k in range(100, 400)]
    back = read(_with(log, b"".join([*topics, *messages, *[_record(6, b"x" * 50)] * 3000])))
    assert any("3000 chunks are damaged" in note for note in back.notes)
    assert any(note.endswith("more notes") for note in back.notes)
    assert sum(map(len, back.notes)) < 30_000
    with pytest.raises(MagycError, match="no topic 'absent'") as caught:
        read(log.with_name("more.mcap"), magnetic_field="absent")
    assert len(str(caught.value)) < 3000


def test_a_message_shorter_than_its_head_costs_itself(log: Path) -> None:
    back = read(_with(log, _record(5, b"short")))
    assert any("a message is damaged and was left out" in note for note in back.notes)
    np.testing.assert_array_equal(back.magnetic_field, recording().magnetic_field)


_N = 400


def bag(path: Path, compression: str) -> Path:
    """A bag of one magnetometer with one chunk."""
    pytest.importorskip("rosbags")
    from rosbags import rosbag1
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds = store.types
    Vector, Header = kinds["geometry_msgs/msg/Vector3"], kinds["std_msgs/msg/Header"]
    random = np.random.default_rng(0)
    writer = rosbag1.Writer(path)
    if compression != "none":
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression.upper()])
    with writer as file:
        connection = file.add_connection("/mag", "sensor_msgs/msg/MagneticField", typestore=store)
        for k in range(_N):
            at = 10**18 + 10**7 * k
            header = Header(k, kinds["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9), "imu")
            field = Vector(*(random.normal(0.0, 3e-5, 3) + 1e-5))
            message = kinds["sensor_msgs/msg/MagneticField"](header, field, np.zeros(9))
            file.write(connection, at, store.serialize_ros1(message, "sensor_msgs/msg/MagneticField"))
    return path


def chunk_of(path: Path) -> tuple[int, int, int]:
    """Where its chunk begins, and where its data lie and how long they are."""
    from rosbags.rosbag1 import Reader

    with Reader(path) as file:
        ((place, chunk),) = file.chunks.items()
        return place, chunk.datapos, chunk.datasize


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_whole_bags_are_read(tmp_path: Path, compression: str) -> None:
    back = read(bag(tmp_path / "a.bag", compression))
    assert len(back.time) == _N
    assert not any("damaged" in note for note in back.notes)


def test_a_chunk_that_holds_more_than_it_announces(tmp_path: Path) -> None:
    """Sixty-four megabytes of zeros in the place of its messages: known before they are unpacked."""
    path = bag(tmp_path / "a.bag", "bz2")
    _, start, length = chunk_of(path)
    data, bomb = bytearray(path.read_bytes()), bz2.compress(bytes(1 << 26))
    assert len(bomb) < length
    data[start : start + length] = bomb + bytes(length - len(bomb))
    path.write_bytes(data)
    tracemalloc.start()
    with pytest.raises(MagycError, match="more than the"):
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 25


@pytest.mark.parametrize("compression", ["bz2", "lz4"])
def test_a_chunk_that_announces_more_than_is_granted(tmp_path: Path, compression: str) -> None:
    path = bag(tmp_path / "a.bag", compression)
    place, start, _ = chunk_of(path)
    data = bytearray(path.read_bytes())
    at = data.index(b"size=", place, start) + len(b"size=")
    data[at : at + 4] = b"\xff\xff\xff\xff"
    path.write_bytes(data)
    with pytest.raises(MagycError, match="declares 4294967295 bytes"):
        read(path)


def test_all_chunks_together_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bag(tmp_path / "a.bag", "lz4")
    monkeypatch.setattr(mcap_compression, "UNPACKED", (0, 1000))
    with pytest.raises(MagycError, match="unpacks to more than 0 times"):
        read(path)
