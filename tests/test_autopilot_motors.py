"""Motors of autopilots: the field follows a throttle or a current, and the firmware's own formula removes it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_io_ardupilot import dataflash
from test_io_px4 import ulog, written

import magyc_gtsam as mg
from magyc_gtsam.factors.effects.signals import rows_by_kind
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.io import read
from magyc_gtsam.recording import Array

SIMULATION = mg.simulate("wide", 100, seed=3, rate=20)
RECORDING = SIMULATION.recording
TIME = RECORDING.time
THROTTLE = np.clip(0.5 + 0.5 * np.sin(TIME / 3) * np.sign(np.sin(TIME / 7)), 0, 1)
OF_MOTORS = np.array([6e-6, -4e-6, 9e-6])  # T at full throttle
RAW = RECORDING.magnetic_field + THROTTLE[:, None] * OF_MOTORS
WARM = 30 + 10 * np.sin(TIME / 20)
BATTERY = {"BAT": (70, "QBff", "TimeUS,I,Volt,Curr")}
COPTER = {"CTUN": (71, "Qff", "TimeUS,ThI,ThO")}
PLANE = {"CTUN": (71, "Qhh", "TimeUS,NavRoll,ThO")}
MOTORS_IN_FLIGHT = {"COMPASS_MOTCT": 2, "COMPASS_MOT2_X": 0.5}  # a second compass corrected by the current


def flown(
    path: Path, throttle: Array | None, current: Array | None = None, ctun: dict = COPTER, raw: Array = RAW
) -> mg.Recording:
    """The recording of an ArduPilot log, with `RAW` as its compass measured it."""
    names = [f"COMPASS_{part}_{axis}" for part in ("OFS", "DIA", "ODI") for axis in "XYZ"]
    parameters = dict.fromkeys(names, 0.0) | {"COMPASS_SCALE": 0.0, "COMPASS_PMOT_EN": 0.0} | MOTORS_IN_FLIGHT
    messages: list[tuple[str, tuple]] = [("PARM", (0, name, float(value))) for name, value in parameters.items()]
    milligauss = np.trunc(raw * 1e7).astype(int)
    for row, t in enumerate(TIME):
        at = 1_000_000 + round(t * 1e6)
        messages.append(("MAG", (at, 0, *milligauss[row], 0, 0, 0, 0, 0, 0, 1, at)))
        messages.append(("IMU", (at, 0, *RECORDING.angular_rate[row], *RECORDING.acceleration[row], WARM[row])))
        if throttle is not None:
            messages.append(("CTUN", (at, 0, throttle[row])))
        if current is not None:
            messages.append(("BAT", (at, 0, 14.8, current[row])))
    formats = {"IMU": (66, "QBfffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T")}
    formats |= (ctun if throttle is not None else {}) | (BATTERY if current is not None else {})
    return read(dataflash(path, messages, formats))


def named(recording: mg.Recording, effect: str = "motor-current") -> mg.Calibration:
    gap = mg.find_gap(recording, candidates=[effect])
    assert [found.name for found in gap.effects] == [effect]
    return gap.calibration


def by_ardupilot(text: str, raw: Array, power: Array) -> Array:
    """AP_Compass_Backend::correct_field, milligauss; `power` is what COMPASS_MOTCT selects."""
    rows = {name: float(value) for name, value in re.findall(r"^(\w+),(.*)$", text, re.MULTILINE)}
    offset, motor, (dx, dy, dz), (xy, xz, yz) = (
        np.array([rows[f"COMPASS_{name}_{axis}"] for axis in "XYZ"]) for name in ("OFS", "MOT", "DIA", "ODI")
    )
    field = (raw * 1e7 + offset) @ np.array([[dx, xy, xz], [xy, dy, yz], [xz, yz, dz]])
    return np.asarray(field + power[:, None] * motor)


def variation(field: Array) -> float:
    """The relative standard deviation of the field's strength."""
    strength = np.linalg.norm(field, axis=1)
    return float(strength.std() / strength.mean())


STILL = variation(
    (RECORDING.magnetic_field - SIMULATION.truth.hard_iron) @ np.linalg.inv(SIMULATION.truth.soft_iron).T
)


@pytest.mark.parametrize("current", [None, np.zeros(len(TIME))])
def test_the_field_of_the_motors_follows_the_throttle_where_no_current_is_measured(
    tmp_path: Path, current: Array | None
) -> None:
    """It was named a drift; batteries without a sensor are logged with a current of 0."""
    calibration = named(flown(tmp_path / "a.BIN", THROTTLE, current))
    assert calibration.terms[0].channels == ("CTUN.ThO",)
    text = calibration.export("ardupilot")
    assert "COMPASS_MOTCT,1" in text
    assert "milligauss at full throttle" in text
    assert variation(by_ardupilot(text, RAW, THROTTLE)) < 1.1 * STILL
    # The second compass was corrected by the current in flight, and would be by the throttle.
    assert "COMPASS_MOT2_X,0" in text


def test_throttle_of_before_2016_is_per_mille(tmp_path: Path) -> None:
    calibration = named(flown(tmp_path / "a.BIN", 1000 * THROTTLE))
    text = calibration.export("ardupilot")
    assert variation(by_ardupilot(text, RAW, THROTTLE)) < 1.1 * STILL


def test_the_current_is_the_channel_where_both_are_logged(tmp_path: Path) -> None:
    current = 25 * THROTTLE**1.5
    raw = RECORDING.magnetic_field + current[:, None] * OF_MOTORS / 25
    recording = flown(tmp_path / "a.BIN", THROTTLE, current, raw=raw)
    assert rows_by_kind(recording.channels)["current"] == ("BAT.Curr",)
    calibration = named(recording)
    text = calibration.export("ardupilot")
    assert "COMPASS_MOTCT,2" in text
    assert "COMPASS_MOT2_X" not in text
    assert variation(by_ardupilot(text, raw, current)) < 1.1 * STILL
    # What follows the current does not follow the throttle of a log without it.
    without = replace(recording, channels={"CTUN.ThO": THROTTLE})
    with pytest.raises(mg.MagycError, match="follows BAT.Curr, and the data have CTUN.ThO instead"):
        calibration.apply(without)
    with pytest.raises(mg.MagycError, match="follows BAT.Curr, and the data have CTUN.ThO instead"):
        mg.find_gap(without, calibration=calibration)
    kept = mg.Calibration.from_dict(calibration.to_dict())
    np.testing.assert_array_equal(kept.apply(recording), calibration.apply(recording))


def test_the_throttle_of_a_plane_is_not_what_its_compass_is_told(tmp_path: Path) -> None:
    percent = np.rint(100 * THROTTLE).astype(int)
    calibration = named(flown(tmp_path / "a.BIN", percent, ctun=PLANE))
    text = calibration.export("ardupilot")
    assert (
        "# LIMIT: not included: motor-current (CTUN.ThO is not what the autopilot corrects a compass by)" in text
    )
    assert "COMPASS_MOTCT" not in text


def test_the_thermometer_of_the_gyroscope_stands_for_others(tmp_path: Path) -> None:
    raw = RECORDING.magnetic_field + (WARM - 30)[:, None] * np.array([3e-7, -2e-7, 4e-7])
    calibration = named(flown(tmp_path / "a.BIN", None, raw=raw), "temperature-hard-iron")
    assert calibration.terms[0].channels == ("IMU.T",)
    both = replace(RECORDING, magnetic_field=raw, channels={"IMU.T": WARM, "BARO.Temp": WARM - 12})
    alone = replace(both, channels={"IMU.T": WARM})
    assert rows_by_kind(both.channels)["temperature"] == ("BARO.Temp",)
    np.testing.assert_array_equal(calibration.apply(both), calibration.apply(alone))  # each by its own thermometer
    with pytest.raises(mg.MagycError, match="follows IMU.T, and the data have BARO.Temp instead"):
        calibration.apply(replace(both, channels={"BARO.Temp": WARM}))


THRUST = {"timestamp": "Q", "xyz": "3f"}
CONTROLS = {"timestamp": "Q", "control": "4f"}
STATUS = {"timestamp": "Q", "current_a": "f"}


@pytest.mark.parametrize(
    ("message", "instance", "fields", "rows", "power", "kind"),
    [
        ("vehicle_thrust_setpoint", 0, THRUST, [(0, 0, -p) for p in THROTTLE], THROTTLE, 1),
        ("actuator_controls_0", 0, CONTROLS, [(0, 0, 0, p) for p in THROTTLE], THROTTLE, 1),
        ("battery_status", 0, STATUS, [(25 * p,) for p in THROTTLE], 0.025 * THROTTLE, 2),
        ("battery_status", 1, STATUS, [(25 * p,) for p in THROTTLE], 0.025 * THROTTLE, 3),
    ],
)
def test_px4_is_told_by_what_to_multiply(
    tmp_path: Path, message: str, instance: int, fields: dict, rows: list, power: Array, kind: int
) -> None:
    """Magnetometer::Correct with UpdatePower: throttle, or current in kA of one of two batteries."""
    pytest.importorskip("pyulog")
    at = [round((t + 10) * 1e6) for t in TIME]
    messages = [
        ("sensor_mag", 0, [(t, 7, *m) for t, m in zip(at, (RAW * 1e4).tolist(), strict=True)]),
        ("sensor_gyro", 0, [(t, 8, *w) for t, w in zip(at, RECORDING.angular_rate.tolist(), strict=True)]),
        (message, instance, [(t, *row) for t, row in zip(at, rows, strict=True)]),
    ]
    parameters = {
        "CAL_MAG0_ID": 7,
        "CAL_MAG1_ID": 9,
        "CAL_GYRO0_ID": 8,
        "CAL_MAG_COMP_TYP": 2,
        "CAL_MAG1_XCOMP": 0.5,
    }
    recording = read(ulog(tmp_path / "a.ulg", parameters, messages, {message: fields}))
    text = named(recording).export("px4")
    values = written(text)
    assert values["CAL_MAG_COMP_TYP"] == kind
    assert ("CAL_MAG1_XCOMP" in values) == (kind != 2)
    comp, offset, scale, (xy, xz, yz) = (
        np.array([values[f"CAL_MAG0_{axis}{name}"] for axis in "XYZ"])
        for name in ("COMP", "OFF", "SCALE", "ODIAG")
    )
    matrix = np.diag(scale) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    assert variation((RAW * 1e4 + power[:, None] * comp - offset) @ matrix) < 1.1 * STILL


@pytest.mark.parametrize(
    ("name", "per_unit", "kind"),
    [("throttle", 1.0, 1), ("throttle_percent", 100.0, 1), ("current_A", 1.0, 2), ("current_mA", 1000.0, 2)],
)
def test_the_name_of_a_channel_of_another_log_tells_its_unit(name: str, per_unit: float, kind: int) -> None:
    term = Term("motor-current", OF_MOTORS / per_unit, np.eye(3) * 1e-16, {}, (name,))
    calibration = mg.Calibration(np.eye(3), np.zeros(3), terms=(term,))
    text = calibration.export("ardupilot")
    assert f"COMPASS_MOTCT,{kind}" in text
    assert f"It was found with the channel {name}." in text
    field = by_ardupilot(text, RAW, THROTTLE)
    np.testing.assert_allclose(field, RECORDING.magnetic_field * 1e7, atol=1e-3)


@pytest.mark.parametrize("compass", range(2))
def test_px4_corrects_by_the_own_thermometer_of_a_compass(tmp_path: Path, compass: int) -> None:
    """Of the second compass the first's was read, and written as its own."""
    pytest.importorskip("pyulog")
    raw = (RECORDING.magnetic_field + (WARM - 30)[:, None] * np.array([3e-7, -2e-7, 4e-7])) * 1e4
    at = [round((t + 10) * 1e6) for t in TIME]
    own, others = WARM, 50 - 0.5 * WARM
    messages = [
        ("sensor_mag", k, [(t, 7 + k, *m, warm) for t, m, warm in zip(at, raw, there, strict=True)])
        for k, there in enumerate((own, others)[:: -1 if compass else 1])
    ]
    messages.append(("sensor_gyro", 0, [(t, 9, *w) for t, w in zip(at, RECORDING.angular_rate, strict=True)]))
    fields = {"timestamp": "Q", "device_id": "I", "x": "f", "y": "f", "z": "f", "temperature": "f"}
    parameters = {"CAL_MAG0_ID": 7, "CAL_MAG1_ID": 8, "CAL_GYRO0_ID": 9}
    path = ulog(tmp_path / "a.ulg", parameters, messages, {"sensor_mag": fields})
    recording = read(path, magnetic_field=f"sensor_mag[{compass}]")
    np.testing.assert_allclose(recording.channels["sensor_mag.temperature"], own, atol=1e-5)
    calibration = named(recording, "temperature-hard-iron")
    values = written(calibration.export("px4"))
    beyond = own - values[f"TC_M{compass}_TREF"]
    slopes = np.array([values[f"TC_M{compass}_X1_{k}"] for k in range(3)])
    offset, scale, (xy, xz, yz) = (
        np.array([values[f"CAL_MAG{compass}_{axis}{name}"] for axis in "XYZ"])
        for name in ("OFF", "SCALE", "ODIAG")
    )
    matrix = np.diag(scale) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    assert variation((raw - beyond[:, None] * slopes - offset) @ matrix) < 1.1 * STILL
    term = replace(calibration.terms[0], channels=("vehicle_air_data.baro_temp_celcius",))
    text = replace(calibration, terms=(term,)).export("px4")
    assert (
        "not included: temperature-hard-iron (vehicle_air_data.baro_temp_celcius is not the magnetometer's" in text
    )


def test_many_logs_have_one_quantity() -> None:
    """A value in µT/A was shared with logs in which a throttle stood for the current."""
    logs = []
    for seed in (3, 4, 5):
        recording = mg.simulate("wide", 120, seed=seed, rate=10).recording
        throttle = np.clip(0.5 + 0.5 * np.sin(recording.time / (2 + seed)), 0, 1)
        field = recording.magnetic_field + throttle[:, None] * OF_MOTORS
        channel = {"throttle": throttle} if seed == 4 else {"current": 25 * throttle}
        logs.append(replace(recording, magnetic_field=field, channels=channel, name=f"log {seed}"))
    gap = mg.find_gap(logs, candidates=["motor-current"])
    followed = {log: term.channels for log, found in gap.calibrations.items() for term in found.terms}
    assert set(followed.values()) == {("current",)}
    with_current = mg.find_gap([logs[0], logs[2]], candidates=["motor-current"])
    assert [effect.name for effect in with_current.effects] == ["motor-current"]
