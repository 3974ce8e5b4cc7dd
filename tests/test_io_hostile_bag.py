"""ROS 1 bags that unpack to more than they should: refused before it fills the memory."""

import bz2
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from magyc_gtsam import MagycError
from magyc_gtsam.io import read, ros_bag

pytest.importorskip("rosbags")
_N = 400


def bag(path: Path, compression: str) -> Path:
    """A bag of one magnetometer with one chunk."""
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
    monkeypatch.setattr(ros_bag, "UNPACKED", (0, 1000))
    with pytest.raises(MagycError, match="unpacks to more than 0 times"):
        read(path)
