"""The configuration of a calibration repeats it, from the file as well, and says what describes the recording."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators import check_options
from magyc_gtsam.recording.axes import parse_axes
from magyc_gtsam.recording.turned import with_turned_gyroscope

SIMULATED = mg.simulate("wide", 100, 10, seed=3).recording
HEADING = replace(SIMULATED, channels={"heading": np.zeros(len(SIMULATED.time))})


def repeated(recording: mg.Recording, calibration: mg.Calibration) -> mg.Calibration:
    """The calibration of the recording by the configuration in the file of the first one; it is the same."""
    read = mg.Calibration.from_dict(json.loads(json.dumps(calibration.to_dict())))
    again = mg.calibrate(recording, read.method, **read.configuration)
    first, second = calibration.to_dict(), again.to_dict()
    for each in (first, second):
        each["diagnostics"] = {k: v for k, v in each["diagnostics"].items() if k != "seconds"}
    assert second == first
    return again


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"field_strength": 50e-6, "noise": (1e-6, 5e-3), "robust": False},
        {"misalignment": 0.02, "delay": 0.0, "window": 0.8, "turn": 0.3},
        {"misalignment": 0},
        {"gyroscope_scale": 0.01, "clock_drift": 1e-5},
        {"field": (50e-6, 1.05)},
        {"field": ((50e-6, 200e-9), (1.05, 0.01))},
        {"field": (None, 1.05)},
    ],
    ids=str,
)
def test_the_smoother_is_repeated(options: dict[str, Any]) -> None:
    repeated(SIMULATED, mg.calibrate(SIMULATED, **options))


def test_an_earlier_calibration_is_in_the_configuration() -> None:
    earlier = mg.calibrate(mg.simulate("wide", 100, 10, seed=4).recording, gyroscope_scale=0.01)
    known = mg.calibrate(SIMULATED, prior=earlier, hard_iron_walk=1e-6, soft_iron_walk=0.01)
    again = repeated(SIMULATED, known)
    twice = mg.calibrate(mg.simulate("wide", 100, 10, seed=5).recording, prior=again)
    repeated(mg.simulate("wide", 100, 10, seed=5).recording, twice)


@pytest.mark.parametrize(
    "method", sorted(set(mg.methods()) - {"smoother", "magyc-bfg", "magyc-ifg", "magfactor3"})
)
def test_other_methods_are_repeated(method: str) -> None:
    repeated(SIMULATED, mg.calibrate(SIMULATED, method, field_strength=50e-6))


@pytest.mark.parametrize("method", ["magyc-bfg", "magyc-ifg", "magfactor3"])
def test_graphs_are_repeated(method: str) -> None:
    pytest.importorskip("gtsam")
    repeated(SIMULATED, mg.calibrate(SIMULATED, method))


def test_what_describes_the_recording_is_no_option() -> None:
    rolled = replace(SIMULATED, attitude=None, angular_rate=SIMULATED.angular_rate[:, [2, 0, 1]])
    recording = with_turned_gyroscope(rolled, parse_axes("y,z,x"))
    calibration = mg.calibrate(recording)
    assert calibration.configuration["gyroscope_axes"] == "y,z,x"
    repeated(recording, calibration)
    with pytest.raises(mg.MagycError, match=r"gyroscope_axes: the recording has 'x,y,z'.* 'y,z,x'"):
        mg.calibrate(SIMULATED, **calibration.configuration)
    check_options(**calibration.configuration)
    counts = mg.Recording(SIMULATED.time, SIMULATED.magnetic_field * 1e7, magnetic_field_unit="counts")
    raw = mg.calibrate(counts, "ellipsoid")
    repeated(counts, raw)
    with pytest.raises(mg.MagycError, match="magnetic_field_unit: the recording has 'T'"):
        mg.calibrate(SIMULATED, "ellipsoid", **raw.configuration)


def test_the_number_of_the_compass_is_kept() -> None:
    second = mg.calibrate(SIMULATED, compass=2)
    assert second.configuration["compass"] == 2
    assert second.export("px4") == repeated(SIMULATED, second).export("px4")
    assert "CAL_MAG1_XOFF" in second.export("px4")
    for wrong in (0, "2", True):
        with pytest.raises(mg.MagycError, match="compass: must be a number from 1 on"):
            mg.calibrate(SIMULATED, compass=wrong)


ANGLE, RATE = np.radians(3.0), 40.0
TURNED = np.array([[np.cos(ANGLE), -np.sin(ANGLE), 0], [np.sin(ANGLE), np.cos(ANGLE), 0], [0, 0, 1.0]])


def inconsistency(field: np.ndarray, rate: np.ndarray) -> float:
    """The field's change that the rate does not explain, of that change: d/dt u = −ω × u holds in one frame alone."""
    change = np.diff(field, axis=0) * RATE
    middle, turn = 0.5 * (field[1:] + field[:-1]), 0.5 * (rate[1:] + rate[:-1])
    return float(np.linalg.norm(change + np.cross(turn, middle)) / np.linalg.norm(change))


@pytest.mark.parametrize("axes", ["x,y,z", "y,z,x", "-y,x,z"])
@pytest.mark.parametrize("misaligned", [False, True])
def test_field_and_rate_are_in_one_frame(axes: str, misaligned: bool) -> None:
    """With other axes of the gyroscope, with chips that are not aligned, and with both."""
    noise = {"magnetometer_noise": 2e-9, "gyroscope_noise": 2e-4}
    quiet = mg.simulate("wide", 100, RATE, seed=7, gyro_bias=np.zeros(3), **noise).recording
    matrix, rotation, bias = (
        parse_axes(axes),
        TURNED if misaligned else np.eye(3),
        np.array([0.004, -0.005, 0.002]),
    )
    true = quiet.angular_rate @ rotation
    delivered = replace(quiet, attitude=None, angular_rate=(true + bias) @ matrix)
    recording = with_turned_gyroscope(delivered, matrix)
    calibration = mg.calibrate(recording, delay=0.0, misalignment=0.05)
    field, rate = calibration.apply(recording), calibration.apply_gyroscope(recording)
    assert inconsistency(field, rate) < 0.02
    assert (
        inconsistency(field, calibration.apply_gyroscope(recording.angular_rate)) < 0.02
    )  # arrays are in these axes
    if axes != "x,y,z":
        assert inconsistency(field, calibration.apply_gyroscope(delivered.angular_rate)) > 0.5
    assert np.abs(rate - true).max() < 2e-3  # in the frame of the gyroscope, not in the magnetometer's
    assert (inconsistency(replace(calibration, terms=()).apply(recording), rate) > 0.03) == misaligned


def test_a_recording_in_other_axes_is_refused() -> None:
    rolled = replace(SIMULATED, attitude=None, angular_rate=SIMULATED.angular_rate[:, [2, 0, 1]])
    recording = with_turned_gyroscope(rolled, parse_axes("y,z,x"))
    calibration = mg.calibrate(recording)
    with pytest.raises(mg.MagycError, match=r"axes y,z,x, and the log is read with x,y,z: read it in these axes"):
        calibration.apply_gyroscope(rolled)
    with pytest.raises(mg.MagycError, match="leave out gyroscope_axes="):
        mg.calibrate(SIMULATED).apply_gyroscope(recording)
    with pytest.raises(mg.MagycError, match="has no angular_rate"):
        calibration.apply_gyroscope(mg.Recording(SIMULATED.time, SIMULATED.magnetic_field))
    calibration.apply(rolled)  # of the field nothing is in the gyroscope's axes
    skewed = replace(mg.calibrate(recording, misalignment=0.02))
    assert skewed.terms
    with pytest.raises(mg.MagycError, match="the log is read with x,y,z"):
        skewed.apply(rolled)
