"""PX4 logs: what PX4 had applied is undone, so that applying it again gives what was logged."""

from __future__ import annotations

import re
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.export import export
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.history import History
from magyc_gtsam.history.log_factor import factor_of
from magyc_gtsam.io import info, read
from magyc_gtsam.io.px4_calibration import Parameters, mounting, undo
from magyc_gtsam.io.px4_thermal import corrected
from magyc_gtsam.recording.autopilot import Autopilot

RAW = np.random.default_rng(2).normal(0, 0.4, (30, 3))  # gauss, the sensor's own frame
STAMP = np.arange(30) * 1000 + 5_000_000
MAG = {
    "CAL_MAG0_ID": 77, "CAL_MAG0_XOFF": 0.1, "CAL_MAG0_YOFF": -0.2, "CAL_MAG0_ZOFF": 0.05,
    "CAL_MAG0_XSCALE": 1.1, "CAL_MAG0_YSCALE": 0.9, "CAL_MAG0_ZSCALE": 1.05,
    "CAL_MAG0_XODIAG": 0.01, "CAL_MAG0_YODIAG": -0.02, "CAL_MAG0_ZODIAG": 0.03, "CAL_MAG0_ROT": 6,
}  # fmt: skip
OFFSET = np.array([0.1, -0.2, 0.05])
SCALE = np.array([[1.1, 0.01, -0.02], [0.01, 0.9, 0.03], [-0.02, 0.03, 1.05]])
YAW_270 = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def correct(raw: np.ndarray, rotation: np.ndarray = YAW_270) -> np.ndarray:
    """PX4's calibration::Magnetometer::Correct, one sample after the other."""
    return np.array([rotation @ (SCALE @ (m - OFFSET)) for m in raw])


def test_undone_is_raw_in_the_vehicles_frame() -> None:
    value, notes, _ = undo("MAG", correct(RAW), STAMP, Parameters(MAG), 77, corrected=True, rotated=True)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)
    assert any("CAL_MAG0_* was applied in flight and is undone" in n for n in notes)


def test_uncorrected_message_is_only_rotated() -> None:
    value, _, _ = undo("MAG", RAW, STAMP, Parameters(MAG), 77, corrected=False, rotated=False)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)


def test_corrected_by_the_driver_and_not_yet_rotated() -> None:
    logged = correct(RAW, np.eye(3))
    value, _, _ = undo("MAG", logged, STAMP, Parameters(MAG), 77, corrected=True, rotated=False)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)


def test_board_rotation_of_an_internal_sensor() -> None:
    parameters = MAG | {
        "CAL_MAG0_ROT": -1,
        "SENS_BOARD_ROT": 8,
        "SENS_BOARD_X_OFF": 2.0,
        "SENS_BOARD_Z_OFF": -3.0,
    }
    board = Rotation.from_euler("xyz", [2.0, 0.0, -3.0], degrees=True).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    value, _, _ = undo("MAG", correct(RAW, board), STAMP, Parameters(parameters), 77, corrected=True, rotated=True)
    np.testing.assert_allclose(value, RAW @ board.T, atol=1e-12)


def test_parameters_that_change_in_the_log() -> None:
    middle = int(STAMP[15])
    logged = correct(RAW)
    logged[15:] = np.array([YAW_270 @ (SCALE @ (m - OFFSET - [0.3, 0, 0])) for m in RAW[15:]])
    parameters = Parameters(MAG, ((middle, "CAL_MAG0_XOFF", 0.4),))
    value, notes, _ = undo("MAG", logged, STAMP, parameters, 77, corrected=True, rotated=True)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)
    assert any("changed within the log" in n for n in notes)


@pytest.mark.parametrize("changed", ["identifier", "rotation"])
def test_a_sensor_that_is_calibrated_or_turned_in_the_log(changed: str) -> None:
    """From then on its parameters are in force; a rotation that was wrong before is not that of the vehicle."""
    middle = int(STAMP[15])
    if changed == "identifier":
        initial, before = {"SENS_BOARD_ROT": 6}, RAW @ YAW_270.T
        changes = tuple((middle, name, value) for name, value in MAG.items())
    else:
        initial, before = MAG | {"CAL_MAG0_ROT": 0}, correct(RAW, np.eye(3))
        changes = ((middle, "CAL_MAG0_ROT", 6.0),)
    logged = np.concatenate([before[:15], correct(RAW)[15:]])
    value, notes, place = undo(
        "MAG", logged, STAMP, Parameters(initial, changes), 77, corrected=True, rotated=True
    )
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)
    assert (place.slot, place.device, place.problem) == (0, None, "")
    np.testing.assert_allclose(place.axes, YAW_270, atol=1e-12)
    assert any("changed within the log" in note for note in notes)


def test_a_raw_message_is_corrected_for_temperature_as_px4_does() -> None:
    """By the polynomial of the sensor with the identifier, clipped to its range."""
    warm = np.linspace(-10.0, 70.0, 30)
    parameters = {
        "TC_M_ENABLE": 1,
        "TC_M0_ID": 5,
        "TC_M1_ID": 77,
        "TC_M1_TREF": 20.0,
        "TC_M1_TMIN": 0,
        "TC_M1_TMAX": 50,
    }
    parameters |= {"TC_M0_X0_0": 9.0, "TC_M1_X0_0": 0.05, "TC_M1_X1_1": 2e-3, "TC_M1_X3_2": 1e-6}
    offset = [[0.05, 2e-3 * (t - 20), 1e-6 * (t - 20) ** 3] for t in np.clip(warm, 0, 50)]
    value, note = corrected("TC_M", RAW + offset, warm, parameters, 77)
    np.testing.assert_allclose(value, RAW, atol=1e-12)
    assert note == "TC_M1_*: the thermal correction of PX4 is subtracted, and stays"
    for other, device in ((parameters | {"TC_M_ENABLE": 0}, 77), (parameters, 8), (parameters, None)):
        assert corrected("TC_M", RAW, None, other, device) == (pytest.approx(RAW), "")
    with pytest.raises(MagycError, match="which the message does not have"):
        corrected("TC_M", RAW, None, parameters, 77)


def test_a_correction_for_the_motors_that_a_raw_message_lacks_is_cleared() -> None:
    """It would be added to the offset on the vehicle, which contains its mean."""
    powered = Parameters(MAG | {"CAL_MAG_COMP_TYP": 2, "CAL_MAG0_XCOMP": 0.1, "CAL_MAG0_ZCOMP": -0.2})
    place = undo("MAG", RAW, STAMP, powered, 77, corrected=False, rotated=False)[2]
    text = export("px4", np.eye(3), np.zeros(3), autopilot=Autopilot("px4", place))
    assert [line.split("\t")[2:4] for line in text.splitlines() if "COMP\t" in line] == [
        ["CAL_MAG0_XCOMP", "0.00000000"],
        ["CAL_MAG0_ZCOMP", "0.00000000"],
    ]
    assert Autopilot.from_dict(Autopilot("px4", place).to_dict()) == Autopilot("px4", place)
    current = Term("motor-current", np.array([1e-7, 0, 0]), np.eye(3) * 1e-18)
    text = export("px4", np.eye(3), np.zeros(3), terms=(current,), autopilot=Autopilot("px4", place))
    assert sum("CAL_MAG0_XCOMP\t" in line for line in text.splitlines()) == 1


@pytest.mark.parametrize(
    ("parameters", "why"),
    [
        ({"TC_M_ENABLE": 1, "TC_M2_ID": 77, "TC_M2_X1_0": 1e-3}, "TC_M2_* corrects the sensor already"),
        ({"TC_M0_ID": 5}, "TC_M0_* are those of another sensor (5)"),
    ],
)
def test_a_thermal_correction_that_is_there_is_not_replaced(parameters: dict[str, float], why: str) -> None:
    """What was found is the rest of it, or the parameters are another sensor's."""
    place = undo("MAG", RAW, STAMP, Parameters(MAG | parameters), 77, corrected=False, rotated=False)[2]
    warm = Term("temperature-hard-iron", np.array([1e-7, 0, 0]), np.eye(3) * 1e-18, {"reference_0": 20.0})
    text = export("px4", np.eye(3), np.zeros(3), terms=(warm,), autopilot=Autopilot("px4", place))
    assert f"# LIMIT: the magnetometer's dependence on temperature is not included: {why}" in text
    assert not [line for line in text.splitlines() if line.startswith("1\t1\tTC_")]
    free = undo("MAG", RAW, STAMP, Parameters(MAG | {"TC_M0_ID": 77}), 77, corrected=False, rotated=False)[2]
    text = export("px4", np.eye(3), np.zeros(3), terms=(warm,), autopilot=Autopilot("px4", free))
    assert "TC_M0_X1_1\t0.00100000" in text  # in the sensor's axes


def test_a_compass_inside_the_autopilot_is_given_no_rotation() -> None:
    """PX4 turns it with its board, whatever CAL_MAGn_ROT is."""
    inside = Parameters(MAG | {"CAL_MAG0_ROT": -1, "SENS_BOARD_ROT": 6})
    place = undo("MAG", RAW, STAMP, inside, 77, corrected=False, rotated=False)[2]
    skew = Term("misalignment", np.array([0.0, 0.0, 0.1]), np.eye(3) * 1e-9)
    text = export("px4", np.eye(3), np.zeros(3), terms=(skew,), autopilot=Autopilot("px4", place))
    assert "LIMIT: a fixed rotation of 5.73 deg is left out, since the compass is inside the autopilot" in text
    assert "CAL_MAG0_ROT\t" not in text


def test_which_calibration_must_be_known() -> None:
    two = Parameters(MAG | {"CAL_MAG1_ID": 78})

    def undone(parameters: Parameters, device: int | None) -> Any:
        return undo("MAG", correct(RAW), STAMP, parameters, device, corrected=True, rotated=True)

    with pytest.raises(MagycError, match=r"which of CAL_MAGn_\* \(n = 0, 1\) was applied"):
        undone(two, None)
    with pytest.raises(MagycError, match=r"no CAL_MAGn_ID is set"):
        undone(Parameters({}), None)
    prime = undone(Parameters(dict(two.initial) | {"CAL_MAG_PRIME": 77}), None)
    np.testing.assert_allclose(prime[0], RAW @ YAW_270.T, atol=1e-12)
    np.testing.assert_allclose(undone(two, 77)[0], RAW @ YAW_270.T, atol=1e-12)
    foreign = undone(two, 99)
    np.testing.assert_allclose(foreign[0], correct(RAW), atol=1e-12)
    assert any("no calibration had been applied" in n for n in foreign[1])
    powered = Parameters(MAG | {"CAL_MAG_COMP_TYP": 1, "CAL_MAG0_XCOMP": 0.1})
    with pytest.raises(MagycError, match=r"motors' power.*magnetic_field='sensor_mag'"):
        undone(powered, 77)
    with pytest.raises(MagycError, match="is singular"):
        undone(Parameters(MAG | {"CAL_MAG0_ZSCALE": 0.0, "CAL_MAG0_ZODIAG": 0.0, "CAL_MAG0_YODIAG": 0.0}), 77)


def test_mountings_are_rotations() -> None:
    matrices = [mounting(k) for k in range(41)]
    for matrix in matrices:
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(matrix) == pytest.approx(1)
    np.testing.assert_allclose(mounting(16) @ [0, 1, 0], [0, 0, 1], atol=1e-12)  # roll 90
    np.testing.assert_allclose(mounting(24) @ [1, 0, 0], [0, 0, -1], atol=1e-12)  # pitch 90
    np.testing.assert_allclose(mounting(38)[0], [0.14303897, 0.36877649, -0.91844638], atol=1e-7)
    with pytest.raises(MagycError, match="sensor orientation: must be 0 to"):
        mounting(99)


def test_mountings_agree_with_mavlink() -> None:
    dialect = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    for number, entry in dialect.enums["MAV_SENSOR_ORIENTATION"].items():
        if number > 40 or number == 38:  # 38 is given in whole degrees there
            continue
        words = dict(part.split(": ") for part in entry.description.split(", "))
        angles = [float(words.get(k, 0)) for k in ("Yaw", "Pitch", "Roll")]
        np.testing.assert_allclose(
            mounting(number), Rotation.from_euler("ZYX", angles, degrees=True).as_matrix(), atol=1e-12
        )


SENSOR = {"timestamp": "Q", "device_id": "I", "x": "f", "y": "f", "z": "f"}
TYPES = {"Q": "uint64_t", "I": "uint32_t", "f": "float", "3f": "float[3]", "4f": "float[4]"}


def ulog(
    path: Path,
    parameters: dict[str, float],
    messages: list[tuple[str, int, list[tuple[Any, ...]]]],
    more: dict[str, dict[str, str]] = {},  # noqa: B006
) -> Path:
    """A log of (message, instance, rows of `SENSOR`, or of the fields that `more` has), in PX4's own format."""

    def packed(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    data = b"ULog\x01\x12\x35\x01" + bytes(8) + packed("B", bytes(40))
    for name in dict.fromkeys(name for name, _, _ in messages):
        fields = "".join(f"{TYPES[code]} {field};" for field, code in more.get(name, SENSOR).items())
        data += packed("F", f"{name}:{fields}".encode())
    for name, value in parameters.items():
        key = f"{'int32_t' if isinstance(value, int) else 'float'} {name}".encode()
        data += packed("P", bytes([len(key)]) + key + struct.pack("<i" if isinstance(value, int) else "<f", value))
    rows = []
    for number, (name, instance, values) in enumerate(messages):
        data += packed("A", struct.pack("<BH", instance, number) + name.encode())
        rows += [
            (row[0], packed("D", struct.pack("<H" + "".join(more.get(name, SENSOR).values()), number, *row)))
            for row in values
        ]
    path.write_bytes(data + b"".join(row for _, row in sorted(rows)))
    return path


DEVICES, TURNS, GYROSCOPE = (111, 222, 333), (8, 6, 0), 5
SIMULATION = mg.simulate("wide", 60, rate=20, seed=3)
SENSED = [
    (SIMULATION.recording.magnetic_field * 1e4 + [0.1 * k, -0.2 * k, 0.05 * k]) @ mounting(turn)
    for k, turn in enumerate(TURNS)
]  # gauss, in the axes of each of three compasses
TURNED = SIMULATION.recording.angular_rate @ mounting(2)  # type: ignore[operator]  # in the gyroscope's
# Compass 222 has the parameters 0, compass 111 the parameters 2, and compass 333 none.
SLOTS = (2, 0, 1)
SET = {
    "CAL_MAG0_ID": 222, "CAL_MAG0_ROT": 6, "CAL_MAG0_XOFF": 0.02, "CAL_MAG2_ID": 111, "CAL_MAG2_ROT": 8,
    "CAL_GYRO0_ID": 4, "CAL_GYRO1_ID": GYROSCOPE, "CAL_GYRO1_ROT": 2, "CAL_GYRO1_XOFF": 0.5,
}  # fmt: skip


def three_compasses(path: Path) -> Path:
    """A log of raw messages of three compasses, which are mounted in different ways, and a gyroscope."""
    at = [round((t + 10) * 1e6) for t in SIMULATION.recording.time]
    messages = [
        (name, k, [(t, device, *row) for t, row in zip(at, values.tolist(), strict=True)])
        for name, k, device, values in (
            *(("sensor_mag", k, DEVICES[k], values) for k, values in enumerate(SENSED)),
            ("sensor_gyro", 0, GYROSCOPE, TURNED),
        )
    ]
    return ulog(path, SET, messages)


def written(text: str) -> dict[str, float]:
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    return {row[2]: float(row[3]) for row in rows}


def by_px4(rows: dict[str, float], slot: int, raw: np.ndarray) -> np.ndarray:
    """S (raw − offset) of PX4's Magnetometer::Correct with the parameters of a slot."""
    offset, scale, beside = (
        np.array([rows[f"CAL_MAG{slot}_{axis}{name}"] for axis in "XYZ"]) for name in ("OFF", "SCALE", "ODIAG")
    )
    xy, xz, yz = beside
    matrix = np.diag(scale) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    return np.asarray((raw - offset) @ matrix)


@pytest.mark.parametrize("compass", range(3))
def test_exported_parameters_correct_the_sensor_of_their_slot(tmp_path: Path, compass: int) -> None:
    """The vehicle's axes were written for the sensor's, and the first compass's parameters for every compass."""
    pytest.importorskip("pyulog")
    path = three_compasses(tmp_path / "a.ulg")
    recording = read(path, magnetic_field=f"sensor_mag[{compass}]")
    calibration = mg.calibrate(recording)
    rows = written(calibration.export("px4"))
    assert {name[7] for name in rows if name.startswith("CAL_MAG")} == {str(SLOTS[compass])}
    assert rows.get("CAL_MAG1_ID") == (333 if compass == 2 else None)  # of the compass that has none yet
    raw = SENSED[compass]
    spread = np.linalg.norm(by_px4(rows, SLOTS[compass], raw), axis=1).std()
    assert spread < 0.3 * np.linalg.norm(raw, axis=1).std()
    assert {name[8] for name in rows if name.startswith("CAL_GYRO")} == {"1"}
    bias = [rows[f"CAL_GYRO1_{axis}OFF"] for axis in "XYZ"]
    np.testing.assert_allclose(bias, SIMULATION.truth.gyro_bias @ mounting(2), atol=1e-3)
    if compass == 0:  # what else keeps a calibration
        gap = mg.find_gap(recording, candidates=["timing"])
        History([factor_of(recording, None, {})]).save(tmp_path / "history.yaml")
        history = History.load(tmp_path / "history.yaml")
        for other in (gap.calibration, gap.base, *history.calibrations, history.next):
            assert other.export("px4").count("CAL_MAG2_XOFF") == 1


def test_every_command_writes_the_parameters_of_the_slot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)  # no processes
    pytest.importorskip("pyulog")
    path, out = three_compasses(tmp_path / "a.ulg"), tmp_path / "out"
    assert main(["calibrate", str(path), "--all", "-q", "-o", str(out)]) == 0
    for folder, slot in zip(("a-sensor-mag", "a-sensor-mag-1", "a-sensor-mag-2"), SLOTS, strict=True):
        text = (out / folder / "px4.params").read_text(encoding="utf-8")
        assert {f"CAL_MAG{slot}_"} == set(re.findall(r"CAL_MAG\d_", "\n".join(written(text))))
        assert main(["export", str(out / folder / "calibration.yaml"), "px4", "-o", str(tmp_path / "again")]) == 0
        assert (tmp_path / "again").read_text(encoding="utf-8") == text
        assert (
            (out / folder / "ardupilot.param").read_text(encoding="utf-8").startswith("# nothing for ardupilot: ")
        )


def test_a_place_that_the_log_does_not_tell() -> None:
    def place(parameters: dict[str, float], device: int | None, *, rotated: bool = False) -> Any:
        return undo("MAG", RAW, STAMP, Parameters(parameters), device, corrected=rotated, rotated=rotated)[2]

    full = {f"CAL_MAG{k}_ID": k + 1 for k in range(4)}
    assert "all are in use by others" in place(full, 9).problem
    assert "does not say which CAL_MAGn_*" in place(full, None).problem
    board = {"SENS_BOARD_ROT": 2}
    assert "turns with the board" in place(board, 9, rotated=True).problem
    assert not place(board, 9).problem
    assert (place({}, 9, rotated=True).slot, place({}, 9).device) == (0, 9)


def test_flight(shared_data: Path) -> None:
    pyulog = pytest.importorskip("pyulog")
    path = shared_data / "px4_flight.ulg"
    back = read(path)
    log = pyulog.ULog(str(path), ["sensor_combined", "vehicle_attitude"])
    parameters = log.initial_parameters
    combined = log.get_dataset("sensor_combined").data
    x, y, z = (parameters[f"SENS_BOARD_{a}_OFF"] for a in "XYZ")
    board = Rotation.from_euler("xyz", [x, y, z], degrees=True).as_matrix()

    # PX4's formula with the log's parameters, applied to what was read, is what was logged.
    scale = [parameters[f"CAL_MAG0_{a}SCALE"] for a in "XYZ"]
    offset = [parameters[f"CAL_MAG0_{a}OFF"] for a in "XYZ"]
    applied = ((back.magnetometer.value / 1e-4 @ board - offset) * scale) @ board.T
    own = combined["timestamp"].astype(np.int64) + combined["magnetometer_timestamp_relative"]
    at = {int(t): k for k, t in enumerate(own)}
    first = int(combined["timestamp"][0])
    rows = [at[first + round(t * 1e6)] for t in back.magnetometer.time]
    logged = np.column_stack([combined[f"magnetometer_ga[{k}]"] for k in range(3)])[rows]
    np.testing.assert_allclose(applied, logged, atol=1e-9)

    offset = [parameters[f"CAL_GYRO0_{a}OFF"] for a in "XYZ"]
    applied = (back.gyroscope.value @ board - offset) @ board.T
    logged = np.column_stack([combined[f"gyro_rad[{k}]"] for k in range(3)])
    np.testing.assert_allclose(applied, logged[: len(applied)], atol=1e-9)
    assert back.angular_rate_is == "interval-mean"

    # The attitude is sensor→world with z down: gravity is up, against z.
    assert back.attitude is not None
    assert back.attitude_is == "estimate"
    assert back.acceleration is not None
    known = np.isfinite(back.attitude).all(axis=1)
    up = Rotation.from_quat(back.attitude[known]).apply(back.acceleration[known]).mean(axis=0)
    np.testing.assert_allclose(up, [0, 0, -9.7], atol=0.3)
    assert "actuator_controls_0.control[3]" in back.channels
    with pytest.raises(
        MagycError, match=r"no message 'sensor_mag'; the log has sensor_combined \(17070 samples\)"
    ):
        read(path, magnetic_field="sensor_mag")
    assert set(read(path, channels=["cpuload.load"]).channels) == {"cpuload.load"}
    with pytest.raises(MagycError, match=r"the log has no 'cpuload\.heat'"):
        read(path, channels=["cpuload.heat"])
    described = info(path)
    assert described.readable
    assert described.duration == pytest.approx(68.9, abs=0.1)


def test_cut_log(shared_data: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    data = (shared_data / "px4_flight.ulg").read_bytes()
    (tmp_path / "cut.ulg").write_bytes(data[: len(data) // 2 + 7])
    back, whole = read(tmp_path / "cut.ulg"), read(shared_data / "px4_flight.ulg")
    assert 0.3 * whole.duration < back.duration < 0.7 * whole.duration
    n = len(back.gyroscope.value) - 1
    np.testing.assert_array_equal(back.gyroscope.value[:n], whole.gyroscope.value[:n])


def test_without_pyulog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    (tmp_path / "a.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    with pytest.raises(MagycError, match=r"pip install 'magyc-gtsam\[px4\]'"):
        read(tmp_path / "a.ulg")


def test_damage_is_refused_or_costs_itself(
    shared_data: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyulog")
    whole = (shared_data / "px4_flight.ulg").read_bytes()[:150_000]
    source = np.random.default_rng(4)
    refused = 0
    for _ in range(40):
        data = bytearray(whole)
        for place in source.integers(8, len(data), source.integers(1, 60)):
            data[place] = source.integers(256)
        (tmp_path / "bad.ulg").write_bytes(data)
        try:
            read(tmp_path / "bad.ulg")
        except MagycError:
            refused += 1
    assert refused < 40
    assert capfd.readouterr().out == ""  # the library prints to where results go


def test_combined_message_without_the_magnetometers_own_stamps(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Logs of other versions have the field without `magnetometer_timestamp_relative`."""
    from magyc_gtsam.io import px4_messages, ulog

    def without(path: Path, names: list[str] | None) -> Any:
        messages, parameters, notes = px4_messages.load(path, names)
        for message in messages:
            message.data.pop("magnetometer_timestamp_relative", None)  # type: ignore[attr-defined]
        return messages, parameters, notes

    pytest.importorskip("pyulog")
    monkeypatch.setattr(ulog, "load", without)
    back = read(shared_data / "px4_flight.ulg")
    assert len(back.magnetometer.time) > 1000


def test_a_last_message_longer_than_the_file(tmp_path: Path) -> None:
    """pyulog by itself goes back to messages that it has read, again and again."""
    pytest.importorskip("pyulog")
    header, message = b"ULog\x01\x12\x35\x01" + bytes(8), b"\x01\x00X\x00"
    path = tmp_path / "a.ulg"
    path.write_bytes(header + 40 * message + b"\x64\x00\x00" + bytes(100 - 41))
    with pytest.raises(MagycError, match="no magnetometer"):
        read(path)
