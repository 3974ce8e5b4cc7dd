"""Write a recording in every format that is read, and files of the package's own; `fuzz.py` damages them."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.io import write_mcap

START = 1_620_000_000_000_000_000  # ns


def recording(n: int = 40) -> mg.Recording:
    source = np.random.default_rng(0)
    field, rate = source.normal(0, 3e-5, (n, 3)), source.normal(0, 1, (n, 3))
    return mg.Recording(np.arange(n) / 20, field, rate, acceleration=rate, channels={"current": rate[:, 0]})


def mcap(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    write_mcap(folder / "a.mcap", made, epoch=10**18)
    return (folder / "a.mcap").read_bytes(), ".mcap"


def mcap_plain(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    write_mcap(folder / "a.mcap", made, epoch=10**18, compression=None)
    return (folder / "a.mcap").read_bytes(), ".mcap"


def dataflash(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    formats = {
        "FMT": (128, "BBnNZ", "<BB4s16s64s", "Type,Length,Name,Format,Columns"),
        "PARM": (64, "QNf", "<Q16sf", "TimeUS,Name,Value"),
        "MAG": (65, "QBhhhhhhhhhB", "<QBhhhhhhhhhB", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health"),
        "IMU": (66, "QBffffff", "<QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    }

    def add(name: str, *values: object) -> bytes:
        number, _, layout, _ = formats[name]
        given = (v.encode() if isinstance(v, str) else v for v in values)
        return bytes([0xA3, 0x95, number]) + struct.pack(layout, *given)

    data = b"".join(add("FMT", n, 3 + struct.calcsize(s), k, c, names) for k, (n, c, s, names) in formats.items())
    offsets = {"COMPASS_OFS_X": 10.0, "COMPASS_OFS_Y": 0.0, "COMPASS_OFS_Z": 0.0}
    data += b"".join(add("PARM", 0, name, value) for name, value in offsets.items())
    field = (made.magnetic_field * 1e7).round().astype(int).tolist()
    for at, m, w in zip(_micro(made), field, made.angular_rate, strict=True):
        data += add("MAG", at, 0, *m, 10, 0, 0, 0, 0, 0, 1)
        data += add("IMU", at, 0, *w, 0.0, 0.0, -9.8)
    return data, ".bin"


def ulog(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    """Only what PX4's own format needs: definitions, one subscription a message, data."""

    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    combined = b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] magnetometer_ga;"
    data += message("F", combined)
    for name, value in (("CAL_MAG0_ID", 5), ("CAL_MAG0_XOFF", 1)):
        key = f"int32_t {name}".encode()
        data += message("P", bytes([len(key)]) + key + struct.pack("<i", value))
    data += message("A", struct.pack("<BH", 0, 3) + b"sensor_combined")
    for at, w, m in zip(_micro(made), made.angular_rate, made.magnetic_field * 1e4, strict=True):
        row = struct.pack("<Q6f", at + 50_000, *w, *m)
        data += message("D", struct.pack("<H", 3) + row)
    return data, ".ulg"


def csv(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    rows = [
        ",".join(f"{x:.9g}" for x in (t, *m, *w))
        for t, m, w in zip(made.time, made.magnetic_field, made.angular_rate, strict=True)
    ]
    return ("t,mx,my,mz,gx,gy,gz\n" + "\n".join(rows) + "\n").encode(), ".csv"


def lines(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    """Lines of JSON, as another program pipes them in."""
    rows = [
        json.dumps({"time": t, "magnetic_field": m, "angular_rate": w})
        for t, m, w in zip(
            made.time.tolist(), made.magnetic_field.tolist(), made.angular_rate.tolist(), strict=True
        )
    ]
    return ("\n".join(rows) + "\n").encode(), ".jsonl"


def calibration(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    deviations = np.diag(np.arange(1.0, 13.0) * 1e-14)
    cal = mg.Calibration(np.eye(3) + 0.01, [1e-5, 2e-5, 3e-5], [1e-3, 0, 0], deviations, method="smoother")
    cal.save(folder / "a.yaml")
    return (folder / "a.yaml").read_bytes(), ".yaml"


def state(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    online = mg.OnlineCalibrator()
    online.update(made.time, made.magnetic_field, made.angular_rate)
    online.save(folder / "a.npz")
    return (folder / "a.npz").read_bytes(), ".npz"


def ros_bag(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    """A bag of ROS 1, by the library that reads it."""
    from rosbags import rosbag1
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC)
    (folder / "a.bag").unlink(missing_ok=True)
    with rosbag1.Writer(folder / "a.bag") as bag:
        for topic, kind, messages in _ros_messages(types, made, ros1=True):
            connection = bag.add_connection(topic, kind, typestore=types)
            for stamp, data in messages:
                bag.write(connection, stamp, data)
    return (folder / "a.bag").read_bytes(), ".bag"


def ros_database(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    """A bag of ROS 2 in SQLite, likewise."""
    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    with rosbag2.Writer(folder / "b", version=9) as bag:
        for topic, kind, messages in _ros_messages(types, made, ros1=False):
            connection = bag.add_connection(topic, kind, typestore=types)
            for stamp, data in messages:
                bag.write(connection, stamp, data)
    return next((folder / "b").glob("*.db3")).read_bytes(), ".db3"


def _ros_messages(types: Any, made: mg.Recording, ros1: bool) -> list[tuple[str, str, list[tuple[int, bytes]]]]:
    known = types.types
    time, header = known["builtin_interfaces/msg/Time"], known["std_msgs/msg/Header"]
    vector, quaternion = known["geometry_msgs/msg/Vector3"], known["geometry_msgs/msg/Quaternion"]
    level, zero, nine = quaternion(0.0, 0.0, 0.0, 1.0), vector(0.0, 0.0, 0.0), np.zeros(9)
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
    field, inertial = "sensor_msgs/msg/MagneticField", "sensor_msgs/msg/Imu"
    topics: dict[str, list[tuple[int, bytes]]] = {field: [], inertial: []}
    samples = zip(_micro(made), made.magnetic_field.tolist(), made.angular_rate.tolist(), strict=True)
    for k, (micro, m, w) in enumerate(samples):
        stamp = START + 1000 * micro
        at = time(stamp // 10**9, stamp % 10**9)
        head = header(k, at, "imu") if ros1 else header(at, "imu")
        for kind, message in (
            (field, known[field](head, vector(*m), nine)),
            (inertial, known[inertial](head, level, nine, vector(*w), nine, zero, nine)),
        ):
            topics[kind].append((stamp, bytes(serialize(message, kind))))
    return [("/mag", field, topics[field]), ("/imu", inertial, topics[inertial])]


def telemetry(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    """Messages of MAVLink behind stamps, as a ground station writes them."""
    from pymavlink.dialects.v20 import ardupilotmega

    data = io.BytesIO()
    link = ardupilotmega.MAVLink(data, srcSystem=1)
    rows = np.c_[made.angular_rate * 1e3, made.magnetic_field * 1e7].round().astype(int).tolist()
    for at, row in zip(_micro(made), rows, strict=True):
        message = ardupilotmega.MAVLink_scaled_imu2_message(1000 + at // 1000, 0, 0, -1000, *row)
        data.write((START // 1000 + at).to_bytes(8, "big") + message.pack(link))
    return data.getvalue(), ".tlog"


def phone(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    """An archive as Sensor Logger makes it."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in (("Magnetometer", made.magnetic_field * 1e6), ("Gyroscope", made.angular_rate)):
            rows = [
                f"{START + 1000 * at},{at / 1e6!r},{z!r},{y!r},{x!r}"
                for at, (x, y, z) in zip(_micro(made), values.tolist(), strict=True)
            ]
            archive.writestr(f"{name}.csv", "time,seconds_elapsed,z,y,x\n" + "\n".join(rows))
    return data.getvalue(), ".zip"


def blackbox(folder: Path, made: mg.Recording) -> tuple[bytes, str]:
    """A log of I frames alone, of which nothing is predicted."""
    names = ["loopIteration", "time", *(f"{k}[{i}]" for k in ("gyroADC", "accSmooth", "magADC") for i in range(3))]
    lines = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "I interval:1",
        "P interval:1/1",
        "Firmware type:Cleanflight",
        "Firmware revision:INAV 7.1.0 (abc) MATEKF405",
        "gyro_scale:0x3d800000",
        "acc_1G:4096",
        "Field I name:" + ",".join(names),
        "Field I signed:0,0" + ",1" * 9,
        "Field I predictor:0,0" + ",0" * 9,
        "Field I encoding:1,1" + ",0" * 9,
        "Field P predictor:1,1" + ",1" * 9,
        "Field P encoding:0,0" + ",0" * 9,
    ]
    rate, field = np.degrees(made.angular_rate) / 0.0625, made.magnetic_field / 4e-8
    rows = np.c_[rate, np.tile([0.0, 0.0, 4096.0], (len(rate), 1)), field].round().astype(int)
    frames = b"".join(
        b"I" + b"".join(map(_variable_byte, [k, at, *((v << 1) ^ (v >> 31) for v in row)]))
        for k, (at, row) in enumerate(zip(_micro(made), rows.tolist(), strict=True))
    )
    return "".join(f"H {line}\n" for line in lines).encode() + frames + b"E\xffEnd of log\0", ".bbl"


def _variable_byte(value: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    result = bytearray()
    while value > 127:
        result.append((value & 127) | 128)
        value >>= 7
    return bytes([*result, value])


def _micro(made: mg.Recording) -> list[int]:
    """µs since the first sample."""
    return [round(at) for at in ((made.time - made.time[0]) * 1e6).tolist()]
