"""Bags, telemetry and phone archives: each written by its format's own library, and read back to the same values."""

from __future__ import annotations

import contextlib
import sqlite3
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import info, read

N = 60
RANDOM = np.random.default_rng(8)
FIELD = RANDOM.normal(0, 3e-5, (N, 3))
RATE = RANDOM.normal(0, 1, (N, 3))
START = 1_620_000_000_000_000_000
STAMPS = START + np.arange(N, dtype=np.int64) * 20_000_000


def ros_messages(types: Any, ros1: bool) -> list[tuple[str, str, list[bytes]]]:
    """(topic, type, messages) by the library's own types and serializer."""
    known = types.types
    time, header = known["builtin_interfaces/msg/Time"], known["std_msgs/msg/Header"]
    vector, quaternion = known["geometry_msgs/msg/Vector3"], known["geometry_msgs/msg/Quaternion"]
    zero, nine = vector(0.0, 0.0, 0.0), np.zeros(9)
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
    field, inertial = [], []
    for k, stamp in enumerate(STAMPS.tolist()):
        at = time(stamp // 10**9, stamp % 10**9)
        head = header(k, at, "imu") if ros1 else header(at, "imu")
        mag = known["sensor_msgs/msg/MagneticField"](head, vector(*FIELD[k].tolist()), nine)
        imu = known["sensor_msgs/msg/Imu"](
            head, quaternion(0.0, 0.0, 0.0, 1.0), nine, vector(*RATE[k].tolist()), nine, zero, nine
        )
        field.append(bytes(serialize(mag, "sensor_msgs/msg/MagneticField")))
        inertial.append(bytes(serialize(imu, "sensor_msgs/msg/Imu")))
    return [("/mag", "sensor_msgs/msg/MagneticField", field), ("/imu", "sensor_msgs/msg/Imu", inertial)]


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    folder = tmp_path_factory.mktemp("bags")
    ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    with rosbag1.Writer(folder / "a.bag") as one:
        for topic, kind, messages in ros_messages(ros1, True):
            connection = one.add_connection(topic, kind, typestore=ros1)
            for at, data in zip(STAMPS.tolist(), messages, strict=True):
                one.write(connection, at, data)
    with rosbag2.Writer(folder / "b", version=9) as two:
        for topic, kind, messages in ros_messages(ros2, False):
            connection = two.add_connection(topic, kind, typestore=ros2)
            for at, data in zip(STAMPS.tolist(), messages, strict=True):
                two.write(connection, at, data)
    return {"bag": folder / "a.bag", "db3": next((folder / "b").glob("*.db3"))}


@pytest.mark.parametrize("kind", ["bag", "db3"])
def test_bags(bags: dict[str, Path], kind: str) -> None:
    back = read(bags[kind])
    np.testing.assert_array_equal(back.magnetic_field, FIELD)
    np.testing.assert_array_equal(back.angular_rate, RATE)
    np.testing.assert_array_equal(np.round(back.time * 1e9), STAMPS - START)
    described = info(bags[kind])
    assert described.readable
    assert {s.name: s.count for s in described.sources} == {"/mag": N, "/imu": N}
    assert ("ROS 1" if kind == "bag" else "ROS 2") in described.format


@pytest.mark.parametrize("kind", ["bag", "db3"])
def test_damaged_bags(bags: dict[str, Path], kind: str, tmp_path: Path) -> None:
    whole = bags[kind].read_bytes()
    source = np.random.default_rng(1)
    bad = tmp_path / f"bad.{kind}"
    for _ in range(60):
        data = bytearray(whole)
        for place in source.integers(16, len(data), 30):
            data[place] = source.integers(256)
        bad.write_bytes(data[: source.integers(len(data) // 2, len(data))])
        try:
            found = f"{len(read(bad).time)} rows"
        except MagycError as error:
            found = str(error)
        assert found


def test_a_record_of_an_impossible_length(bags: dict[str, Path], tmp_path: Path) -> None:
    """The messages before it are kept."""
    data = bytearray(bags["db3"].read_bytes())
    with contextlib.closing(sqlite3.connect(bags["db3"])) as base:
        (message,) = base.execute("SELECT data FROM messages WHERE id = ?", (N,)).fetchone()
        (stamp,) = base.execute("SELECT timestamp FROM messages WHERE id = ?", (N,)).fetchone()
    place = data.index(stamp.to_bytes(8, "big") + message)
    record = data.rindex(b"\x06\x00\x09\x06", 0, place) - 3  # its length and key come before the kinds of columns
    data[record : record + 12] = bytes.fromhex("ffffffff696d7500b62999bc")
    bad = tmp_path / "bad.db3"
    bad.write_bytes(data)
    with contextlib.closing(sqlite3.connect(bad)) as base, pytest.raises(MemoryError):
        base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id").fetchall()
    back = read(bad)
    assert any("impossible length" in note for note in back.notes)
    assert len(back.time) >= N - 2  # sqlite3 steps one row ahead, and may lose the last one before the damage
    np.testing.assert_array_equal(back.magnetic_field, FIELD[: len(back.time)])


def test_bags_that_rosbag2_compressed(bags: dict[str, Path], tmp_path: Path) -> None:
    """Message by message they are read; as a whole file the error names what unpacks it."""
    zstandard = pytest.importorskip("zstandard")
    bag = tmp_path / "b.db3"
    bag.write_bytes(bags["db3"].read_bytes())
    (tmp_path / "b.db3.zstd").write_bytes(zstandard.compress(bag.read_bytes()))
    with pytest.raises(MagycError, match=r"whole file; unpack it first \(zstd -d b\.db3\.zstd -o b\.db3\)"):
        read(tmp_path / "b.db3.zstd")
    with contextlib.closing(sqlite3.connect(bag)) as base, base:
        for number, data in base.execute("SELECT id, data FROM messages").fetchall():
            base.execute("UPDATE messages SET data = ? WHERE id = ?", (zstandard.compress(data), number))
    np.testing.assert_array_equal(read(bag).magnetic_field, FIELD)
    with contextlib.closing(sqlite3.connect(bag)) as base, base:
        base.execute("UPDATE messages SET data = substr(data, 1, 40) WHERE id = ?", (2 * N,))
    damaged = read(bag)
    assert any(f"1 of {2 * N} messages damaged" in note for note in damaged.notes)
    np.testing.assert_array_equal(damaged.magnetic_field, FIELD[: len(damaged.time)])
    with contextlib.closing(sqlite3.connect(bag)) as base, base:
        bomb = zstandard.compress(bytes(1 << 24))
        base.execute("UPDATE messages SET data = ? WHERE id <= 10", (bomb,))
    with pytest.raises(MagycError, match="unpacks to more than 100 times"):
        read(bag)


def test_a_database_that_is_no_bag(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "a.db3") as base:
        base.execute("CREATE TABLE other (id INTEGER)")
    with pytest.raises(MagycError, match="not a ROS 2 bag"):
        read(tmp_path / "a.db3")


def test_telemetry(tmp_path: Path) -> None:
    mavutil = pytest.importorskip("pymavlink.mavutil")
    dialect = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    field, rate = np.round(FIELD * 1e7).astype(int), np.round(RATE * 1e3).astype(int)
    path = tmp_path / "flight.tlog"
    with open(path, "wb") as file:
        link = dialect.MAVLink(file, srcSystem=1)
        ground = dialect.MAVLink(file, srcSystem=255)
        for k in range(N):
            message = dialect.MAVLink_scaled_imu2_message(1000 + 20 * k, 0, 0, -1000, *rate[k], *field[k])
            file.write((START // 1000 + 20_000 * k).to_bytes(8, "big"))
            file.write(message.pack(link))
            beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
            file.write((START // 1000 + 20_000 * k).to_bytes(8, "big"))
            file.write(beat.pack(ground))
    assert mavutil.mavlink_connection(str(path)).recv_match(type="SCALED_IMU2").xmag == field[0, 0]
    back = read(path)
    np.testing.assert_allclose(back.magnetic_field, field * 1e-7, rtol=1e-12)
    np.testing.assert_allclose(back.angular_rate, rate * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(back.time, np.arange(N) * 0.02, atol=1e-9)
    assert any("the autopilot's calibration" in n for n in back.notes)
    assert back.autopilot is not None
    known = mg.Calibration(np.eye(3), np.zeros(3), configuration={"autopilot": back.autopilot.to_dict()})
    for target in ("px4", "ardupilot"):  # whose parameters the readings include
        with pytest.raises(MagycError, match=f"nothing for {target}: telemetry: .*which these parameters would"):
            known.export(target)
    assert "bias" in known.export("ros")
    assert info(path).sources[0].count == N
    with pytest.raises(MagycError, match="no message 'RAW_IMU'"):
        read(path, magnetic_field="RAW_IMU")
    (tmp_path / "none.tlog").write_bytes(path.read_bytes()[:5])
    with pytest.raises(MagycError, match="holds none of HIGHRES_IMU"):
        read(tmp_path / "none.tlog")


def test_one_sender_of_telemetry_is_read(tmp_path: Path) -> None:
    """Two chips by `id`, a second component, and rows in which the magnetometer or the gyroscope is not new."""
    pytest.importorskip("pymavlink")
    dialect = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    field, rate = FIELD.astype(np.float32), RATE.astype(np.float32)

    def written(name: str, stamp: int, senders: tuple[tuple[int, int], ...]) -> Path:
        with open(tmp_path / name, "wb") as file:
            for k in range(N):
                for late, (component, number) in enumerate(senders):
                    own = field[k] * np.float32(1e4) + late if k % 3 == 0 else np.full(3, 0.1)
                    message = dialect.MAVLink_highres_imu_message(
                        stamp * k,
                        0,
                        0,
                        9.8,
                        *rate[k].tolist(),
                        *own.tolist(),
                        0,
                        0,
                        0,
                        0,
                        0x1FF if k % 3 == 0 else 0x3F,
                        number,
                    )
                    file.write((START // 1000 + 20_000 * k).to_bytes(8, "big"))
                    file.write(message.pack(dialect.MAVLink(None, srcSystem=1, srcComponent=component)))
        return tmp_path / name

    one = read(written("one.tlog", 20_000, ((1, 0),)))
    np.testing.assert_allclose(one.magnetometer.value, field[::3], rtol=1e-6)
    assert len(one.gyroscope.value) >= N - 2  # within the time that both cover
    several = read(written("several.tlog", 20_000, ((1, 1), (191, 0), (1, 0))))
    np.testing.assert_allclose(several.magnetometer.value, field[::3] + 2e-4, rtol=1e-5)
    assert "system 1, component 1, id 0 is read; ignored: " in several.notes[1]
    assert several.notes[1].endswith("system 1, component 1, id 1; system 1, component 191, id 0")
    without = written("zero.tlog", 0, ((1, 0),))
    with pytest.raises(MagycError, match=r"received them \(stamps='log'\)"):
        read(without)
    np.testing.assert_array_equal(read(without, stamps="log").magnetometer.value, one.magnetometer.value)


def table(header: str, columns: list[np.ndarray]) -> str:
    return header + "\n" + "\n".join(",".join(map(repr, row)) for row in np.column_stack(columns).tolist())


def test_phone_archives(tmp_path: Path) -> None:
    """Sensor Logger's names and order of columns, and phyphox's."""
    late = STAMPS + 3_000_000
    with zipfile.ZipFile(tmp_path / "logger.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, stamps, value in (
            ("MagnetometerUncalibrated.csv", STAMPS, FIELD * 1e6),
            ("Magnetometer.csv", STAMPS, FIELD * 1e6 - 10),
            ("Gyroscope.csv", late, RATE),
        ):
            rows = [
                f"{s},{(s - START) / 1e9!r},{v[2]!r},{v[1]!r},{v[0]!r}"
                for s, v in zip(stamps.tolist(), value.tolist(), strict=True)
            ]
            archive.writestr(name, "time,seconds_elapsed,z,y,x\n" + "\n".join(rows))
        archive.writestr("Metadata.csv", "version\n1\n")
    back = read(tmp_path / "logger.zip")
    own = back.magnetometer.value
    np.testing.assert_allclose(own, FIELD[-len(own) :], rtol=1e-12)
    np.testing.assert_allclose(back.gyroscope.value, RATE[: len(back.gyroscope.value)], rtol=1e-12)
    assert any("Magnetometer.csv could be named instead" in n for n in back.notes)
    named = read(tmp_path / "logger.zip", magnetic_field="Magnetometer.csv")
    np.testing.assert_allclose(named.magnetometer.value, own - 1e-5, atol=1e-12)
    seconds = (STAMPS - START) / 1e9
    with zipfile.ZipFile(tmp_path / "phyphox.zip", "w") as archive:
        axes = '"Time (s)","{0} x ({1})","{0} y ({1})","{0} z ({1})"'
        mag = table(axes.format("Magnetic field", "µT"), [seconds, *(FIELD * 1e6).T])
        archive.writestr("Magnetometer.csv", mag)
        archive.writestr("Gyroscope.csv", table(axes.format("Gyroscope", "rad/s"), [seconds, *RATE.T]))
        archive.writestr("meta/time.csv", '"event","experiment time"\n"START",0\n')
    back = read(tmp_path / "phyphox.zip")
    np.testing.assert_allclose(back.magnetic_field, FIELD, rtol=1e-12)
    np.testing.assert_allclose(back.angular_rate, RATE, rtol=1e-12)
    assert info(tmp_path / "phyphox.zip").duration == pytest.approx(1.18)


def test_damaged_archives(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Magnetometer.csv", table("time,z,y,x", [STAMPS, *(FIELD * 1e6).T]))
    whole, source, refused = (tmp_path / "a.zip").read_bytes(), np.random.default_rng(1), 0
    for _ in range(60):
        data = bytearray(whole)
        del data[(place := source.integers(len(data))) : place + source.integers(1, 60)]
        (tmp_path / "bad.zip").write_bytes(data)
        try:
            read(tmp_path / "bad.zip")
        except MagycError:
            refused += 1
    assert refused > 40


def test_archives_within_limits(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Magnetometer.csv", "t,x,y,z\n" + "0" * (300 << 20), compresslevel=1)
    with pytest.raises(MagycError, match=r"Magnetometer\.csv unpacks to \d+ bytes, more than the limit of \d+"):
        read(tmp_path / "bomb.zip")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("letter.txt", "dear")
    with pytest.raises(MagycError, match="no table of a magnetometer in the archive; it has letter"):
        read(tmp_path / "other.zip")
    np.savez(tmp_path / "arrays.npz", m=np.zeros((3, 3)))
    with pytest.raises(MagycError, match="a file of numpy arrays, whose meaning it does not say"):
        read(tmp_path / "arrays.npz")
    (tmp_path / "cut.zip").write_bytes((tmp_path / "bomb.zip").read_bytes()[:1000])
    with pytest.raises(MagycError, match="the archive cannot be read"):
        read(tmp_path / "cut.zip")
