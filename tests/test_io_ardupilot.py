"""ArduPilot logs: the compass correction is undone, so that applying it again gives what was logged."""

from __future__ import annotations

import re
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import info, read
from magyc_gtsam.io.ardupilot_compass import undo
from magyc_gtsam.io.px4_calibration import mounting

RAW = np.random.default_rng(3).normal(0, 400, (40, 3))  # milligauss
OFFSET = np.array([-40.328, 251.292, 363.938])
MOTOR = np.random.default_rng(4).normal(0, 30, (40, 3))
MATRIX = np.array([[1.1, 0.02, -0.03], [0.02, 0.95, 0.01], [-0.03, 0.01, 1.2]])
PARAMETERS = {
    "COMPASS_OFS_X": OFFSET[0], "COMPASS_OFS_Y": OFFSET[1], "COMPASS_OFS_Z": OFFSET[2],
    "COMPASS_DIA_X": 1.1, "COMPASS_DIA_Y": 0.95, "COMPASS_DIA_Z": 1.2,
    "COMPASS_ODI_X": 0.02, "COMPASS_ODI_Y": -0.03, "COMPASS_ODI_Z": 0.01,
    "COMPASS_SCALE": 1.25, "COMPASS_PMOT_EN": 0.0,
}  # fmt: skip
ONE_SET = np.zeros(40, dtype=np.int64)
WHOLE = np.tile(np.trunc(OFFSET), (40, 1))


def middle(whole: np.ndarray) -> np.ndarray:
    """Of what is logged as a whole number, truncated."""
    return np.asarray(whole + 0.5 * np.sign(whole))


def correct(raw: np.ndarray, scale: float = 1.25) -> np.ndarray:
    """AP_Compass_Backend::correct_field, one sample after the other."""
    return np.array([MATRIX @ ((m + OFFSET) * scale) + k for m, k in zip(raw, MOTOR, strict=True)])


def test_undone_is_raw() -> None:
    raw, _, notes = undo(correct(RAW), WHOLE, MOTOR, ONE_SET, [PARAMETERS], 0)
    np.testing.assert_allclose(raw, RAW, atol=1e-9)
    assert any("COMPASS_SCALE 1.2500" in n and "motor correction" in n for n in notes)


def test_scale_that_ardupilot_ignores() -> None:
    raw, _, _ = undo(correct(RAW, 1.0), WHOLE, MOTOR, ONE_SET, [PARAMETERS | {"COMPASS_SCALE": 1.7}], 0)
    np.testing.assert_allclose(raw, RAW, atol=1e-9)


def test_priority_is_not_the_drivers_number() -> None:
    renamed = {
        k.replace("OFS_", "OFS3_").replace("DIA_", "DIA3_").replace("ODI_", "ODI3_"): v
        for k, v in PARAMETERS.items()
    }
    renamed = renamed | {
        "COMPASS_SCALE3": 1.25,
        "COMPASS_PRIO1_ID": 9,
        "COMPASS_DEV_ID": 5,
        "COMPASS_DEV_ID3": 9,
    }
    raw, _, _ = undo(correct(RAW), WHOLE, MOTOR, ONE_SET, [renamed], 0)
    np.testing.assert_allclose(raw, RAW, atol=1e-9)


def test_offsets_learned_in_flight_and_parameters_that_change() -> None:
    learned = OFFSET + np.array([70.6, 0, 0])
    logged = correct(RAW)
    logged[20:] += MATRIX @ (1.25 * (learned - OFFSET))
    cut = np.vstack([WHOLE[:20], np.tile(np.trunc(learned), (20, 1))])
    raw, _, notes = undo(logged, cut, MOTOR, ONE_SET, [PARAMETERS], 0)
    np.testing.assert_allclose(raw, RAW, atol=1.0)
    assert any("20 offsets differ from the parameters" in n for n in notes)
    cut[30:] = np.trunc(OFFSET)  # back at the same whole number, with another fraction
    assert any("20 offsets differ" in n for n in undo(logged, cut, MOTOR, ONE_SET, [PARAMETERS], 0)[2])
    cut[30:] = cut[20]
    later = PARAMETERS | {f"COMPASS_OFS_{a}": learned[k] for k, a in enumerate("XYZ")}
    raw, _, _ = undo(logged, cut, MOTOR, np.repeat([0, 1], 20), [PARAMETERS, later], 0)
    np.testing.assert_allclose(raw, RAW, atol=1e-9)


def test_old_firmware() -> None:
    old = {k: v for k, v in PARAMETERS.items() if not k.endswith(("_SCALE", "_EN"))}
    with pytest.raises(MagycError, match="an order that depends on the firmware's version"):
        undo(correct(RAW), WHOLE, MOTOR, ONE_SET, [old], 0)
    logged = np.array([MATRIX @ (m + OFFSET) for m in RAW])
    raw, _, _ = undo(logged, WHOLE, np.zeros((40, 3)), ONE_SET, [old], 0)
    np.testing.assert_allclose(raw, RAW, atol=1e-9)
    with pytest.raises(MagycError, match=r"no COMPASS_\* parameters"):
        undo(logged, WHOLE, MOTOR, ONE_SET, [{}], 0)


@pytest.mark.parametrize("lost", ["COMPASS_OFS_Y", "COMPASS_DIA_X", "COMPASS_ODI_Z"])
def test_a_correction_that_is_not_all_in_the_log_is_not_guessed(lost: str) -> None:
    """Of a damaged log: without DIA the matrix would be 1."""
    with pytest.raises(MagycError, match=f"the log lacks {lost}, so the correction"):
        undo(correct(RAW), WHOLE, MOTOR, ONE_SET, [{k: v for k, v in PARAMETERS.items() if k != lost}], 0)


def test_offsets_learned_in_flight_are_truncated() -> None:
    """Of which the parameter knows nothing; logged without their fraction, they are larger by half a step."""
    learned = np.array([-80.6, 200.4, 0.0])
    parameters = PARAMETERS | {f"COMPASS_OFS_{a}": 0.0 for a in "XYZ"} | {"COMPASS_SCALE": 1.0}
    logged = (RAW + learned) @ MATRIX.T
    whole = np.tile(np.trunc(learned), (40, 1))
    raw, sigma, notes = undo(logged, whole, np.zeros((40, 3)), ONE_SET, [parameters], 0)
    np.testing.assert_allclose(sigma, [0.5 / np.sqrt(3)] * 3)
    whole[20:, 0] += 3  # two numbers, each of half of the samples
    _, sigma, _ = undo(logged, whole, np.zeros((40, 3)), ONE_SET, [parameters], 0)
    np.testing.assert_allclose(sigma, np.array([np.sqrt(0.5), 1, 1]) * 0.5 / np.sqrt(3))
    np.testing.assert_allclose(raw - RAW, np.tile(learned - [-80.5, 200.5, 0.0], (40, 1)), atol=1e-9)
    assert any("learned in flight" in note for note in notes)


def test_rov(shared_data: Path) -> None:
    reader_of = pytest.importorskip("pymavlink.DFReader")
    path = shared_data / "ardusub_still.BIN"
    back = read(path)
    reader = reader_of.DFReader_binary(str(path), zero_time_base=True)
    messages: dict[str, list] = {"MAG": [], "IMU": [], "ATT": []}
    parameters = {}
    while (message := reader.recv_match(type=["MAG", "IMU", "ATT", "PARM"], strict=True)) is not None:
        if message.get_type() == "PARM":
            parameters.setdefault(message.Name, message.Value)
        elif getattr(message, "I", 0) == 0:
            messages[message.get_type()].append(message)
    offset = np.array([parameters[f"COMPASS_OFS_{a}"] for a in "XYZ"])
    first = max(messages["MAG"][0].TimeUS, messages["IMU"][0].TimeUS)
    logged = {m.TimeUS - first: [m.MagX, m.MagY, m.MagZ] for m in messages["MAG"]}
    again = back.magnetometer.value / 1e-7 + offset  # DIA is 1, ODI 0, SCALE and motors off
    whole = np.array([logged[round(t * 1e6)] for t in back.magnetometer.time])
    np.testing.assert_allclose(again, middle(whole), atol=1e-6)
    rates = {m.TimeUS - first: [m.GyrX, m.GyrY, m.GyrZ] for m in messages["IMU"]}
    assert parameters["AHRS_ORIENTATION"] == 16  # roll by 90 degrees
    x, y, z = (parameters[f"INS_GYROFFS_{a}"] for a in "XYZ")
    logged_rates = [rates[round(t * 1e6)] for t in back.gyroscope.time]
    np.testing.assert_allclose(back.gyroscope.value - [x, -z, y], logged_rates, atol=1e-12)
    np.testing.assert_array_equal([np.trunc(offset)] * 3, [[m.OfsX, m.OfsY, m.OfsZ] for m in messages["MAG"][:3]])
    assert back.magnetometer.time[0] == 0
    assert back.duration == pytest.approx(23.6, abs=0.1)
    attitude = messages["ATT"][50]
    row = int(np.argmin(np.abs(back.time - (attitude.TimeUS - first) / 1e6)))
    assert back.attitude_is == "estimate"
    angles = Rotation.from_quat(back.attitude[row]).as_euler("ZYX", degrees=True)  # type: ignore[index]
    np.testing.assert_allclose(
        angles % 360,
        np.array([attitude.Yaw, attitude.Pitch, attitude.Roll]) % 360,
        atol=0.05,
    )
    assert set(back.channels) >= {"BAT.Curr", "BAT.Volt", "IMU.T"}
    other = read(path, magnetic_field="MAG[1]")
    assert np.linalg.norm(other.magnetometer.value.mean(axis=0) - back.magnetometer.value.mean(axis=0)) > 1e-6
    with pytest.raises(MagycError, match=r"no message 'MAG\[2\]'; the log has MAG\[0\] \(237 samples\), MAG\[1\]"):
        read(path, magnetic_field="MAG[2]")
    described = info(path)
    assert described.readable
    assert described.duration == pytest.approx(23.7, abs=0.1)
    imu = next(s for s in described.sources if s.name == "IMU[0]")
    assert imu.rate == pytest.approx(25, abs=0.1)


def dataflash(path: Path, messages: list[tuple[str, tuple]], more: dict[str, tuple[int, str, str]] = {}) -> Path:  # noqa: B006
    """A log of the named messages, in dataflash's own format; `more` are types as (number, letters, columns)."""
    formats = {
        "FMT": (128, "BBnNZ", "<BB4s16s64s", "Type,Length,Name,Format,Columns"),
        "PARM": (64, "QNf", "<Q16sf", "TimeUS,Name,Value"),
        "MAG": (
            65,
            "QBhhhhhhhhhBI",
            "<QBhhhhhhhhhBI",
            "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S",
        ),
        "IMU": (66, "QBffffff", "<QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        **{name: (number, code, f"<{code}", columns) for name, (number, code, columns) in more.items()},
    }
    data = b""

    def add(name: str, values: tuple) -> bytes:
        number, _, layout, _ = formats[name]
        return bytes([0xA3, 0x95, number]) + struct.pack(
            layout, *(v.encode() if isinstance(v, str) else v for v in values)
        )

    for name, (number, code, layout, columns) in formats.items():
        data += add("FMT", (number, 3 + struct.calcsize(layout), name, code, columns))
    for name, values in messages:
        data += add(name, values)
    path.write_bytes(data)
    return path


def test_parameters_in_the_order_of_the_log(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    messages: list[tuple[str, tuple]] = [
        ("PARM", (0, "COMPASS_DIA_X", 1.0)),
        ("PARM", (0, "COMPASS_SCALE", 0.0)),
        *(("PARM", (0, f"COMPASS_ODI_{a}", 0.0)) for a in "XYZ"),
    ]
    raw = np.round(RAW)
    for k, m in enumerate(raw):
        at = 1_000_000 + k * 100_000
        if k == 10:  # written while samples already were: in force from the start
            messages += [("PARM", (at, f"COMPASS_DIA_{a}", 1.0)) for a in "YZ"]
            messages += [("PARM", (at, f"COMPASS_OFS_{a}", 100.0)) for a in "XYZ"]
        if k == 25:  # changed
            messages += [("PARM", (at, f"COMPASS_OFS_{a}", 150.0)) for a in "XYZ"]
        offset = 100 if k < 25 else 150
        logged = (int(x) + offset for x in m)
        healthy = int(k != 30)
        messages.append(("MAG", (at, 0, *logged, offset, offset, offset, 0, 0, 0, healthy, at)))
        messages.append(("IMU", (at, 0, 0.1 * k, 0.0, 0.0, 0.0, 0.0, -9.8)))
    back = read(dataflash(tmp_path / "a.BIN", messages))
    offsets = np.where(np.arange(40) < 25, 100, 150)[:, None]
    expected = middle(raw + offsets) - offsets
    np.testing.assert_allclose(back.magnetometer.value, np.delete(expected, 30, axis=0) * 1e-7, atol=1e-15)
    assert any("1 of 40 samples are unhealthy" in n for n in back.notes)
    np.testing.assert_allclose(back.gyroscope.value[:, 0], np.float32(0.1 * np.arange(40)), rtol=1e-6)
    without = [m for m in messages if not (m[0] == "PARM" and str(m[1][1]).startswith("COMPASS"))]
    with pytest.raises(MagycError, match=r"no COMPASS_\* parameters"):
        read(dataflash(tmp_path / "b.BIN", without))
    with pytest.raises(MagycError, match="no MAG messages"):
        read(dataflash(tmp_path / "c.BIN", [m for m in messages if m[0] != "MAG"]))


def test_without_pymavlink(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    assert len(read(dataflash(tmp_path / "a.BIN", flight())).time) == 40


def flight() -> list[tuple[str, tuple]]:
    names = (f"COMPASS_{part}_{axis}" for part in ("OFS", "DIA", "ODI") for axis in "XYZ")
    messages: list[tuple[str, tuple]] = [("PARM", (0, name, 0.0)) for name in names]
    for k, m in enumerate(np.round(RAW).astype(int).tolist()):
        at = 1_000_000 + k * 100_000
        messages.append(("MAG", (at, 0, *m, 0, 0, 0, 0, 0, 0, 1, at)))
        messages.append(("IMU", (at, 0, 0.1 * k, 0.0, 0.0, 0.0, 0.0, -9.8)))
    return messages


def test_inertial_messages_without_rates(tmp_path: Path) -> None:
    messages = [(name, values if name != "IMU" else (*values[:2], *values[5:])) for name, values in flight()]
    layout = {"IMU": (66, "QBfff", "TimeUS,I,AccX,AccY,AccZ")}
    back = read(dataflash(tmp_path / "a.BIN", messages, layout))
    assert back.angular_rate is None
    assert "no angular_rate: IMU[0] has no GyrX, GyrY, GyrZ" in back.notes
    assert back.acceleration is not None


def test_the_thermometer_is_that_of_the_gyroscope(tmp_path: Path) -> None:
    layout = {"IMU": (66, "QBfffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T")}
    messages = [m for m in flight() if m[0] != "IMU"]
    for name, values in flight():
        if name == "IMU":
            messages += [("IMU", (values[0], k, *values[2:], 20.0 + 10 * k)) for k in range(2)]
    path = dataflash(tmp_path / "a.BIN", messages, layout)
    for k in range(2):
        back = read(path, angular_rate=f"IMU[{k}]")
        np.testing.assert_array_equal(back.channels["IMU.T"], 20.0 + 10 * k)
    np.testing.assert_array_equal(read(path, channels=["IMU[1].T"]).channels["IMU[1].T"], 30.0)


# Of each compass of the log, by priority: iron beside the vehicle's in milligauss, and offset in flight.
BESIDE, IN_FLIGHT = ((0, 0, 0), (100, -200, 50)), ((-30, 50, 20), (100, 0, -70))
DRIVERS = ("2", "")  # of its parameters
GYROSCOPE_IN_FLIGHT = {"INS_GYROFFS": (0.01, -0.02, 0.005), "INS_GYR2OFFS": (-0.3, 0.0, 0.04)}
BOARD = mounting(6)  # AHRS_ORIENTATION


def vehicle(path: Path, simulation: mg.Simulation) -> Path:
    """A log of two compasses, the second of which has the first driver, and two gyroscopes on a turned board."""
    parameters: dict[str, float] = {"COMPASS_PMOT_EN": 0, "COMPASS_DEV_ID": 5, "COMPASS_DEV_ID2": 9}
    parameters |= {"COMPASS_PRIO1_ID": 9, "COMPASS_PRIO2_ID": 5}
    for driver, offset in zip(DRIVERS, IN_FLIGHT, strict=True):
        parameters |= {f"COMPASS_OFS{driver}_{a}": o for a, o in zip("XYZ", offset, strict=True)}
        parameters |= {f"COMPASS_{part}{driver}_{a}": 0.0 for part in ("DIA", "ODI") for a in "XYZ"}
        parameters |= {f"COMPASS_MOT{driver}_{a}": float(len(driver)) for a in "XYZ"} | {"COMPASS_MOTCT": 2}
    offsets = list(GYROSCOPE_IN_FLIGHT.values())
    for name, offset in GYROSCOPE_IN_FLIGHT.items():
        parameters |= {f"{name}_{a}": o for a, o in zip("XYZ", offset, strict=True)}
    parameters |= {"AHRS_ORIENTATION": 6, "COMPASS_ORIENT": 4, "COMPASS_ORIENT2": 101, "CUST_ROT1_YAW": 90}
    messages: list[tuple[str, tuple]] = [("PARM", (0, name, float(value))) for name, value in parameters.items()]
    recording = simulation.recording
    for t, m, w in zip(recording.time, recording.magnetic_field * 1e7, recording.angular_rate, strict=True):
        at = 1_000_000 + round(t * 1e6)
        for k, (beside, offset) in enumerate(zip(BESIDE, IN_FLIGHT, strict=True)):
            logged = np.trunc(m + beside + offset).astype(int)
            messages.append(("MAG", (at, k, *logged, *offset, 0, 0, 0, 1, at)))
        messages += [("IMU", (at, k, *(w - BOARD @ offsets[k]), 0.0, 0.0, -9.8)) for k in range(2)]
    return dataflash(path, messages)


@pytest.mark.parametrize("compass", range(2))
def test_exported_parameters_correct_the_compass_of_their_driver(tmp_path: Path, compass: int) -> None:
    """The first compass's parameters were written for every compass."""
    pytest.importorskip("pymavlink")
    simulation = mg.simulate("wide", 60, rate=20, seed=3)
    path, driver = vehicle(tmp_path / "a.BIN", simulation), DRIVERS[compass]
    back = read(path, magnetic_field=f"MAG[{compass}]", angular_rate=f"IMU[{compass}]")
    assert back.autopilot is not None
    np.testing.assert_allclose(back.autopilot.magnetometer.mounting, mounting((2, 4)[compass]), atol=1e-12)
    text = mg.calibrate(back).export("ardupilot")
    rows = {name: float(value) for name, value in re.findall(r"^(\w+),(.*)$", text, re.MULTILINE)}
    assert {n for n in rows if "_OFS" in n} == {f"COMPASS_OFS{driver}_{a}" for a in "XYZ"}
    raw = simulation.recording.magnetic_field * 1e7 + BESIDE[compass]
    vectors = [[rows[f"COMPASS_{name}{driver}_{a}"] for a in "XYZ"] for name in ("OFS", "DIA", "ODI")]
    offset, (dx, dy, dz), (xy, xz, yz) = vectors
    field = (raw + offset) @ np.array([[dx, xy, xz], [xy, dy, yz], [xz, yz, dz]])
    assert np.linalg.norm(field, axis=1).std() < 0.3 * np.linalg.norm(raw, axis=1).std()
    own = "INS_GYR2OFFS" if compass else "INS_GYROFFS"
    assert {n for n in rows if "GYR" in n} == {f"{own}_{a}" for a in "XYZ"}
    # What corrects for the motors on the vehicle, and was undone, would be added once more.
    motors = {f"COMPASS_MOT2_{a}": 0.0 for a in "XYZ"} if driver == "2" else {}
    assert {n: value for n, value in rows.items() if "MOT" in n} == motors
    # The offset in flight would be replaced: what was exported was the rest, in the vehicle's axes.
    bias = [rows[f"{own}_{a}"] for a in "XYZ"]
    np.testing.assert_allclose(bias, simulation.truth.gyro_bias @ BOARD, atol=1e-3)


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({}, "does not hold INS_GYROFFS"),
        (
            {"INS_GYROFFS_X": 0.1, "INS_GYROFFS_Y": 0.1, "INS_GYROFFS_Z": 0.1, "AHRS_ORIENTATION": 100.0},
            "AHRS_ORIENTATION 100 is not a rotation",
        ),
    ],
)
def test_an_offset_that_cannot_be_undone_is_not_replaced(
    tmp_path: Path, parameters: dict[str, float], why: str
) -> None:
    messages = [("PARM", (0, name, value)) for name, value in parameters.items()]
    back = read(dataflash(tmp_path / "a.BIN", [*messages, *flight()]))
    assert any(why in note for note in back.notes)
    np.testing.assert_allclose(back.gyroscope.value[:, 0], np.float32(0.1 * np.arange(40)), rtol=1e-6)
    assert back.autopilot is not None
    bias = mg.Calibration(np.eye(3), np.zeros(3), np.full(3, 0.1))
    text = replace(bias, configuration={"autopilot": back.autopilot.to_dict()}).export("ardupilot")
    assert "COMPASS_OFS_X," in text
    assert "INS_GYROFFS_X," not in text
    assert "# LIMIT: the gyroscope's values are not included: INS_GYROFFS_* was subtracted" in text


OLD_NAMES = (
    "TimeMS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOfsX,MOfsY,MOfsZ",
    "TimeUS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOfsX,MOfsY,MOfsZ",
)


@pytest.mark.parametrize(("columns", "code", "unit"), [(OLD_NAMES[0], "I", 1e-3), (OLD_NAMES[1], "Q", 1e-6)])
def test_logs_from_before_2015(tmp_path: Path, columns: str, code: str, unit: float) -> None:
    """Milliseconds, motor offsets under another name, parameters without a time, messages of one compass."""
    raw, offset, motor = np.round(RAW).astype(int), np.array([19, 49, 11]), np.array([3, -4, 5])
    described = [
        ("FMT", 128, "BBnNZ", "<BB4s16s64s", "Type,Length,Name,Format,Columns"),
        ("PARM", 129, "Nf", "<16sf", "Name,Value"),
        ("MAG", 130, f"{code}hhhhhhhhh", f"<{code}hhhhhhhhh", columns),
        ("IMU", 131, f"{code}ffffff", f"<{code}ffffff", f"{columns[:6]},GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    ]
    layouts = {name: (number, layout) for name, number, _, layout, _ in described}

    def add(name: str, *values: object) -> bytes:
        number, layout = layouts[name]
        given = (v.encode() if isinstance(v, str) else v for v in values)
        return bytes([0xA3, 0x95, number]) + struct.pack(layout, *given)

    data = b"".join(add("FMT", n, 3 + struct.calcsize(s), name, c, names) for name, n, c, s, names in described)
    data += b"".join(add("PARM", f"COMPASS_OFS_{a}", float(o)) for a, o in zip("XYZ", offset, strict=True))
    for k, m in enumerate(raw):
        at = round((1 + k / 10) / unit)
        data += add("MAG", at, *(m + offset + motor).tolist(), *offset.tolist(), *motor.tolist())
        data += add("IMU", at, 0.1 * k, 0.0, 0.0, 0.0, 0.0, -9.8)
    (tmp_path / "old.bin").write_bytes(data)
    back = read(tmp_path / "old.bin")
    expected = middle(raw + offset + motor) - middle(motor) - offset
    np.testing.assert_allclose(back.magnetometer.value, expected * 1e-7, atol=1e-15)
    np.testing.assert_allclose(back.time, np.arange(40) / 10, atol=1e-9)
    assert info(tmp_path / "old.bin").duration == pytest.approx(3.9)


def test_damage_costs_itself(tmp_path: Path) -> None:
    """A type that is not described, a format of unknown letters, bytes in between, a clock without sense."""
    whole = dataflash(tmp_path / "a.BIN", flight()).read_bytes()
    message = bytes([0xA3, 0x95, 65])
    at = whole.index(message, 1000)
    unknown = bytes([0xA3, 0x95, 99]) + bytes(20)
    strange = bytes([0xA3, 0x95, 128]) + struct.pack("<BB4s16s64s", 70, 20, b"ODD", b"\\?!", b"A,B,C")
    spoilt = bytearray(whole)
    second = whole.index(message, at + 1)
    spoilt[second + 3 : second + 11] = b"\xff" * 8  # TimeUS
    (tmp_path / "b.BIN").write_bytes(
        bytes(spoilt[:at]) + unknown + strange + b"\xa3\x95\xa3\x95" + bytes(spoilt[at:])
    )
    good, bad = read(tmp_path / "a.BIN"), read(tmp_path / "b.BIN")
    assert len(good.magnetometer.value) - len(bad.magnetometer.value) == 1
    kept = np.isin(np.round(good.time * 1e6), np.round(bad.magnetometer.time * 1e6))
    np.testing.assert_array_equal(good.magnetic_field[kept], bad.magnetometer.value)
    assert any("27 bytes belong to no message" in n for n in bad.notes)
    assert any("1 message with impossible times left out" in n for n in bad.notes)


def test_random_damage_is_refused_or_costs_itself(tmp_path: Path) -> None:
    whole = dataflash(tmp_path / "a.BIN", flight()).read_bytes()
    source = np.random.default_rng(9)
    refused = 0
    for _ in range(200):
        data = bytearray(whole)
        for place in source.integers(0, len(data), source.integers(1, 20)):
            data[place] = source.integers(256)
        (tmp_path / "b.BIN").write_bytes(data)
        try:
            read(tmp_path / "b.BIN")
        except MagycError:
            refused += 1
    assert 0 < refused < 200


@pytest.mark.parametrize(
    ("kind", "code"), [("PARM", "QNn"), ("PARM", "Qnf"), ("MAG", "ZBhhhhhhhhhBI"), ("IMU", "Qnffffff")]
)
def test_formats_that_make_text_of_numbers(tmp_path: Path, kind: str, code: str) -> None:
    """A description that damage changed, or somebody."""
    whole = dataflash(tmp_path / "a.BIN", flight()).read_bytes()
    number = {"PARM": 64, "MAG": 65, "IMU": 66}[kind]
    at = whole.index(bytes([0xA3, 0x95, 0x80, number]))
    columns = whole[at + 25 : at + 89]
    length = 3 + struct.calcsize(
        "<" + "".join({"Q": "Q", "N": "16s", "n": "4s", "Z": "64s"}.get(c, c) for c in code)
    )
    changed = (
        bytes([0xA3, 0x95, 0x80]) + struct.pack("<BB4s16s", number, length, kind.encode(), code.encode()) + columns
    )
    (tmp_path / "b.BIN").write_bytes(whole[:at] + changed + whole[at + 89 :])
    try:
        found = f"{len(read(tmp_path / 'b.BIN').time)} rows"
    except MagycError as error:
        found = str(error)
    assert found


def test_a_log_cut_off_anywhere_is_read_or_refused(tmp_path: Path) -> None:
    """From its first two bytes on: before a description is whole, and before a message of a sensor is."""
    whole = dataflash(tmp_path / "whole.bin", flight()).read_bytes()
    lengths = [*range(2, 120), *range(120, 2000, 37), len(whole)]
    outcomes = set()
    for length in lengths:
        path = tmp_path / "cut.bin"
        path.write_bytes(whole[:length])
        try:
            outcomes.add(len(read(path).time) > 2)
        except MagycError:
            outcomes.add(False)
    assert outcomes == {True, False}
