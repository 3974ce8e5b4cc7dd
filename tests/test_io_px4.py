"""PX4 logs: what PX4 had applied is undone, so that applying it again gives what was logged."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import info, read
from magyc_gtsam.io.px4_calibration import Parameters, mounting, undo

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
    value, notes = undo("MAG", correct(RAW), STAMP, Parameters(MAG), 77, corrected=True, rotated=True)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)
    assert any("CAL_MAG0_* was applied in flight and is undone" in n for n in notes)


def test_uncorrected_message_is_only_rotated() -> None:
    value, _ = undo("MAG", RAW, STAMP, Parameters(MAG), 77, corrected=False, rotated=False)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)


def test_corrected_by_the_driver_and_not_yet_rotated() -> None:
    logged = correct(RAW, np.eye(3))
    value, _ = undo("MAG", logged, STAMP, Parameters(MAG), 77, corrected=True, rotated=False)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)


def test_board_rotation_of_an_internal_sensor() -> None:
    parameters = MAG | {
        "CAL_MAG0_ROT": -1,
        "SENS_BOARD_ROT": 8,
        "SENS_BOARD_X_OFF": 2.0,
        "SENS_BOARD_Z_OFF": -3.0,
    }
    board = Rotation.from_euler("xyz", [2.0, 0.0, -3.0], degrees=True).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    value, _ = undo("MAG", correct(RAW, board), STAMP, Parameters(parameters), 77, corrected=True, rotated=True)
    np.testing.assert_allclose(value, RAW @ board.T, atol=1e-12)


def test_parameters_that_change_in_the_log() -> None:
    middle = int(STAMP[15])
    logged = correct(RAW)
    logged[15:] = np.array([YAW_270 @ (SCALE @ (m - OFFSET - [0.3, 0, 0])) for m in RAW[15:]])
    parameters = Parameters(MAG, ((middle, "CAL_MAG0_XOFF", 0.4),))
    value, notes = undo("MAG", logged, STAMP, parameters, 77, corrected=True, rotated=True)
    np.testing.assert_allclose(value, RAW @ YAW_270.T, atol=1e-12)
    assert any("changed within the log" in n for n in notes)


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
