"""Orientations of ArduPilot's compasses and board: set within a log, inside the autopilot, custom ones in use."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_export import symmetric, turned
from test_io_ardupilot import dataflash

import magyc_gtsam as mg
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.io import read
from magyc_gtsam.io.px4_calibration import mounting
from magyc_gtsam.recording import Array

SIMULATION = mg.simulate("wide", 80, seed=3, rate=10)
RECORDING = SIMULATION.recording
COMPASS, BOARD = mounting(6), mounting(24)  # of the sensors, on the vehicle
SENSED = RECORDING.magnetic_field @ COMPASS  # in the compass's own axes
GYRO_OFFSET = np.array([0.02, -0.03, 0.01])
HALF = len(RECORDING.time) // 2
OFFSET = np.array([120.0, -80.0, 40.0])
MOUNTING = Term("misalignment", [0.03, -0.02, 0.05], np.eye(3) * 1e-9)


def logged(
    path: Path, parameters: dict[str, float], later: dict[str, float] | None = None, on: Array = BOARD
) -> Path:
    """A log of ArduPilot, which turns the readings by the parameters of each half of it."""
    names = [f"COMPASS_{part}_{axis}" for part in ("DIA", "ODI") for axis in "XYZ"]
    now = dict.fromkeys(names, 0.0) | {"COMPASS_SCALE": 0.0, "COMPASS_EXTERNAL": 1}
    now |= {f"COMPASS_OFS_{axis}": value for axis, value in zip("XYZ", OFFSET, strict=True)}
    now |= {f"INS_GYROFFS_{axis}": value for axis, value in zip("XYZ", GYRO_OFFSET, strict=True)}
    now |= {"AHRS_ORIENTATION": 24, "COMPASS_ORIENT": 6} | parameters
    messages: list[tuple[str, tuple]] = [("PARM", (0, name, float(value))) for name, value in now.items()]
    columns = (RECORDING.time, SENSED / 1e-7, RECORDING.angular_rate @ on - GYRO_OFFSET, RECORDING.acceleration)
    for row, (t, m, w, a) in enumerate(zip(*columns, strict=True)):
        at = 1_000_000 + round(t * 1e6)
        if row == HALF and later:
            messages += [("PARM", (at, name, float(value))) for name, value in later.items()]
            now |= later
        board = mounting(int(now["AHRS_ORIENTATION"]))
        compass = mounting(int(now["COMPASS_ORIENT"])) if now["COMPASS_EXTERNAL"] else board
        whole = (compass @ m + OFFSET).astype(int)
        messages.append(("MAG", (at, 0, *whole, *OFFSET.astype(int), 0, 0, 0, 1, at)))
        messages.append(("IMU", (at, 0, *(board @ w), *(board @ on.T @ a))))
    return dataflash(path, messages)


def values(text: str) -> dict[str, float]:
    return {name: float(value) for name, value in re.findall(r"^(\w+),(.*)$", text, re.MULTILINE)}


def by_ardupilot(rows: dict[str, float], turn: Array) -> Array:
    """AP_Compass_Backend::rotate_field and correct_field on what the compass sensed, in T."""
    offset, diagonal, beside = ([rows[f"COMPASS_{n}_{axis}"] for axis in "XYZ"] for n in ("OFS", "DIA", "ODI"))
    return np.asarray((SENSED / 1e-7 @ turn.T + offset) @ symmetric(diagonal, beside) * 1e-7)


@pytest.mark.parametrize("before", [{"COMPASS_ORIENT": 0}, {"AHRS_ORIENTATION": 0}])
def test_an_orientation_that_is_set_within_the_log(tmp_path: Path, before: dict[str, float]) -> None:
    """The readings of the two halves were in different axes, and the calibration of both was refused or wrong."""
    name = next(iter(before))
    at_end = {"COMPASS_ORIENT": 6, "AHRS_ORIENTATION": 24}[name]
    recording = read(logged(tmp_path / "a.BIN", before, {name: at_end}))
    np.testing.assert_allclose(recording.magnetic_field, RECORDING.magnetic_field, atol=1e-7)
    np.testing.assert_allclose(recording.angular_rate, RECORDING.angular_rate, atol=1e-6)
    np.testing.assert_allclose(recording.acceleration, RECORDING.acceleration, atol=1e-5)
    if name == "COMPASS_ORIENT":
        assert any(f"COMPASS_ORIENT was 0 for {HALF} samples" in note for note in recording.notes)
    calibration = mg.calibrate(recording)
    assert calibration.trusted
    field = by_ardupilot(values(calibration.export("ardupilot")), COMPASS)
    np.testing.assert_allclose(
        np.linalg.norm(field, axis=1),
        np.linalg.norm(calibration.apply(RECORDING.magnetic_field), axis=1),
        atol=1e-10,
    )


def test_a_compass_inside_the_autopilot_turns_with_its_board(tmp_path: Path) -> None:
    """The offset was turned by an orientation that is not applied to it: off by its length times the angle."""
    inside = {"COMPASS_EXTERNAL": 0, "AHRS_ORIENTATION": 6, "COMPASS_ORIENT": 3}
    recording = read(
        logged(tmp_path / "a.BIN", inside | {"AHRS_ORIENTATION": 0}, {"AHRS_ORIENTATION": 6}, COMPASS)
    )
    np.testing.assert_allclose(recording.magnetic_field, RECORDING.magnetic_field, atol=1e-7)
    calibration = replace(mg.calibrate(recording), terms=(MOUNTING,))
    text = calibration.export("ardupilot")
    rows = values(text)
    assert not [name for name in rows if "ORIENT" in name or "CUST" in name]
    assert "# LIMIT: a fixed rotation of 3.53 deg is left out, since the compass is inside the autopilot" in text
    expected = replace(calibration, terms=()).apply(RECORDING.magnetic_field)
    np.testing.assert_allclose(by_ardupilot(rows, COMPASS), expected, atol=1e-10)


@pytest.mark.parametrize(
    ("parameters", "custom"),
    [
        ({}, 1),
        ({"COMPASS_ORIENT2": 101}, 2),
        ({"COMPASS_ORIENT2": 102}, 1),
        ({"COMPASS_ORIENT2": 101, "COMPASS_ORIENT3": 102}, 0),
    ],
)
def test_a_custom_rotation_that_another_sensor_has_is_not_taken(
    tmp_path: Path, parameters: dict[str, float], custom: int
) -> None:
    """CUST_ROT1 was written for the first compass: another compass, or the board, was turned with it."""
    recording = read(logged(tmp_path / "a.BIN", parameters))
    calibration = replace(mg.calibrate(recording), terms=(MOUNTING,))
    text = calibration.export("ardupilot")
    rows = values(text)
    assert {name for name in rows if name.startswith("CUST_ROT")} - {"CUST_ROT_ENABLE"} == (
        {f"CUST_ROT{custom}_{angle}" for angle in ("ROLL", "PITCH", "YAW")} if custom else set()
    )
    if custom:
        assert rows["COMPASS_ORIENT"] == 100 + custom
        field = by_ardupilot(rows, turned(rows, f"CUST_ROT{custom}_"))
        np.testing.assert_allclose(field, calibration.apply(RECORDING.magnetic_field), atol=1e-10)
    else:
        assert "is left out, since both custom rotations of ArduPilot are in use" in text


def test_the_board_keeps_its_custom_rotation(tmp_path: Path) -> None:
    recording = read(logged(tmp_path / "a.BIN", {}))
    assert recording.autopilot is not None
    own = {"AHRS_ORIENTATION": 101.0, "CUST_ROT1_ROLL": 90.0, "CUST_ROT1_YAW": 45.0}
    path = logged(tmp_path / "a.BIN", {})
    messages = [("PARM", (0, name, value)) for name, value in own.items()]
    data = dataflash(tmp_path / "b.BIN", messages).read_bytes()
    head = dataflash(tmp_path / "c.BIN", []).read_bytes()
    whole = path.read_bytes().replace(b"AHRS_ORIENTATION", b"AHRS_ORIENTATIOM")
    (tmp_path / "d.BIN").write_bytes(whole[: len(head)] + data[len(head) :] + whole[len(head) :])
    back = read(tmp_path / "d.BIN")
    assert back.autopilot is not None
    assert back.autopilot.magnetometer.custom == 2
    expected = turned({"_ROLL": 90.0, "_PITCH": 0.0, "_YAW": 45.0}, "_")
    np.testing.assert_allclose(back.autopilot.gyroscope.axes, expected, atol=1e-12)


def test_a_compass_whose_parameters_are_not_known_is_refused(tmp_path: Path) -> None:
    """Those of the first driver were taken."""
    path = logged(tmp_path / "a.BIN", {"COMPASS_PRIO1_ID": 9, "COMPASS_DEV_ID": 5, "COMPASS_DEV_ID2": 7})
    with pytest.raises(mg.MagycError, match="COMPASS_PRIO1_ID 9 is no COMPASS_DEV_ID of the log"):
        read(path)
