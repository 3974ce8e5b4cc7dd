"""Exports: each text is parsed as its target parses it, and corrected with the target's own formula."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from magyc_gtsam import calibrate
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.export import TARGETS, export
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io.px4_calibration import mounting
from magyc_gtsam.recording import Array
from magyc_gtsam.recording.autopilot import Autopilot, Place
from magyc_gtsam.recording.axes import axes_text, parse_axes
from magyc_gtsam.study.known import skewed

PRECISION = 1e-8  # printed decimals, in gauss for a field of one gauss


def parameters(text: str, separator: str, name: int, value: int) -> dict[str, float]:
    """Name → value of a parameter file whose comments begin with #."""
    rows = [line.split(separator) for line in text.splitlines() if line and not line.startswith("#")]
    return {row[name]: float(row[value]) for row in rows}


def symmetric(diagonal: list[float], off_diagonal: list[float]) -> Array:
    (xx, yy, zz), (xy, xz, yz) = diagonal, off_diagonal
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def px4(
    text: str, m: Array, w: Array, current: Array | None = None, warm: Array | None = None
) -> tuple[Array, Array]:
    """Magnetometer::Correct, with UpdatePower and TemperatureCompensation before it, and Gyroscope::Correct."""
    rows = parameters(text, "\t", 2, 3)
    offset = np.array([rows[f"CAL_MAG0_{axis}OFF"] for axis in "XYZ"])
    scale = symmetric(
        [rows[f"CAL_MAG0_{axis}SCALE"] for axis in "XYZ"], [rows[f"CAL_MAG0_{axis}ODIAG"] for axis in "XYZ"]
    )
    raw = m * 1e4
    if warm is not None and rows.get("TC_M_ENABLE"):
        beyond = warm - rows["TC_M0_TREF"]
        raw = raw - sum(
            np.array([rows[f"TC_M0_X{n}_{k}"] for k in range(3)]) * beyond[:, None] ** n for n in range(4)
        )
    if current is not None and rows.get("CAL_MAG_COMP_TYP") == 2:
        raw = raw + current[:, None] * 0.001 * np.array([rows[f"CAL_MAG0_{axis}COMP"] for axis in "XYZ"])
    rotation = turned(rows, "CAL_MAG0_") if rows.get("CAL_MAG0_ROT") == 100 else np.eye(3)
    bias = np.array([rows.get(f"CAL_GYRO0_{axis}OFF", np.nan) for axis in "XYZ"])
    if warm is not None and rows.get("TC_G_ENABLE"):
        beyond = warm - rows["TC_G0_TREF"]
        w = w - sum(np.array([rows[f"TC_G0_X{n}_{k}"] for k in range(3)]) * beyond[:, None] ** n for n in range(4))
    return (raw - offset) @ scale.T @ rotation.T * 1e-4, w - bias


def ardupilot(
    text: str,
    m: Array,
    w: Array,
    current: Array | None = None,
    outputs: Array | None = None,
    voltage: float = 14.8,
) -> tuple[Array, Array]:
    """AP_Compass_Backend::rotate_field and correct_field, Compass_PerMotor::compensate; milligauss, rad/s."""
    rows = parameters(text, ",", 0, 1)
    rotation = turned(rows, "CUST_ROT1_") if rows.get("COMPASS_ORIENT") == 101 else np.eye(3)
    field = m @ rotation.T * 1e7 + np.array([rows[f"COMPASS_OFS_{axis}"] for axis in "XYZ"])
    field = field * rows["COMPASS_SCALE"]
    scale = symmetric(
        [rows[f"COMPASS_DIA_{axis}"] for axis in "XYZ"], [rows[f"COMPASS_ODI_{axis}"] for axis in "XYZ"]
    )
    field = field @ scale.T
    if current is not None and rows.get("COMPASS_MOTCT") == 2:
        field = field + current[:, None] * np.array([rows[f"COMPASS_MOT_{axis}"] for axis in "XYZ"])
    if outputs is not None and rows.get("COMPASS_PMOT_EN"):
        motors = np.array([[rows[f"COMPASS_PMOT{k}_{axis}"] for axis in "XYZ"] for k in range(1, 5)])
        field = field + (outputs * voltage) ** rows["COMPASS_PMOT_EXP"] @ motors
    bias = np.array([rows.get(f"INS_GYROFFS_{axis}", np.nan) for axis in "XYZ"])
    return field * 1e-7, w - bias


def turned(rows: dict[str, float], prefix: str) -> Array:
    """Dcm of roll, pitch, yaw in degrees, R_z(yaw) R_y(pitch) R_x(roll)."""
    roll, pitch, yaw = (np.radians(rows[prefix + name]) for name in ("ROLL", "PITCH", "YAW"))
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def registers(text: str) -> dict[int, tuple[Array, Array]]:
    """Register number → (C, B) of every command whose checksum is right."""
    result = {}
    for line in text.splitlines():
        if not line.startswith("$"):
            continue
        body, checksum = line[1:].split("*")
        assert int(checksum, 16) == np.bitwise_xor.reduce(np.frombuffer(body.encode(), dtype=np.uint8))
        command, number, *values = body.split(",")
        assert command == "VNWRG"
        assert len(values) == 12
        numbers = np.array([float(value) for value in values])
        result[int(number)] = numbers[:9].reshape(3, 3), numbers[9:]
    return result


def vectornav(text: str, m: Array, w: Array) -> tuple[Array, Array]:
    """C (M − B) of registers 23 and 84; gauss, rad/s."""
    held = registers(text)
    matrix, offset = held[23]
    gyro_matrix, bias = held.get(84, (np.full((3, 3), np.nan), np.zeros(3)))
    return (m * 1e4 - offset) @ matrix.T * 1e-4, (w - bias) @ gyro_matrix.T


def ros(text: str, m: Array, w: Array) -> tuple[Array, Array]:
    """The bias remover of magnetometer_pipeline; tesla, rad/s."""
    rows = yaml.safe_load(text)["/**"]["ros__parameters"]
    offset = np.array([rows[f"initial_mag_bias_{axis}"] for axis in "xyz"])
    matrix = np.array(rows["initial_mag_scaling_matrix"]).reshape(3, 3)
    return (m - offset) @ matrix.T, w - np.array(rows.get("gyroscope_bias", [np.nan] * 3))


CORRECTED_BY = {"px4": px4, "ardupilot": ardupilot, "vectornav": vectornav, "ros": ros}

SOFT_IRON = np.array([[1.10, 0.10, 0.04], [0.10, 0.88, 0.02], [0.04, 0.02, 1.22]])
HARD_IRON = np.array([2e-6, 12e-6, 9e-6])
GYRO_BIAS = np.array([4e-3, -5e-3, 2e-3])
FIELD = np.random.default_rng(0).normal(0, 50e-6, (40, 3))
RATE = np.random.default_rng(1).normal(0, 0.5, (40, 3))


@st.composite
def soft_irons(draw: st.DrawFn) -> Array:
    """Positive definite, eigenvalues 0.3 to 3, in any direction."""
    square = draw(arrays(np.float64, (3, 3), elements=st.floats(-1, 1, width=32)))
    rotation, _ = np.linalg.qr(square)
    eigenvalues = draw(arrays(np.float64, 3, elements=st.floats(0.3, 3)))
    result: Array = rotation @ np.diag(eigenvalues) @ rotation.T
    return (result + result.T) / 2


def test_every_target_has_a_check() -> None:
    assert set(CORRECTED_BY) == set(TARGETS)


@pytest.mark.parametrize("target", TARGETS)
@settings(max_examples=50, deadline=None)
@given(
    soft_iron=soft_irons(),
    hard_iron=arrays(np.float64, 3, elements=st.floats(-100e-6, 100e-6)),
    gyro_bias=arrays(np.float64, 3, elements=st.floats(-0.2, 0.2)),
)
def test_target_formula_gives_the_calibration(
    target: str, soft_iron: Array, hard_iron: Array, gyro_bias: Array
) -> None:
    calibration = Calibration(soft_iron, hard_iron, gyro_bias)
    field, rate = CORRECTED_BY[target](calibration.export(target), FIELD, RATE)
    # The offset is printed to 1e-8 gauss and then multiplied by the inverse, of norm below 3.4.
    np.testing.assert_allclose(field, calibration.apply(FIELD), rtol=0, atol=20 * PRECISION * 1e-4)
    np.testing.assert_allclose(rate, calibration.apply_gyroscope(RATE), rtol=0, atol=PRECISION)


@pytest.mark.parametrize("target", TARGETS)
def test_without_gyroscope_bias_nothing_is_said_about_it(target: str) -> None:
    text = export(target, SOFT_IRON, HARD_IRON)
    field, rate = CORRECTED_BY[target](text, FIELD, RATE)
    np.testing.assert_allclose(field, Calibration(SOFT_IRON, HARD_IRON).apply(FIELD), atol=1e-11)
    assert np.isnan(rate).all()
    assert "GYRO" not in text.replace("GYRO0.", "")


@pytest.mark.parametrize("target", TARGETS)
def test_begins_with_comments_that_say_the_units(target: str) -> None:
    lines = export(target, SOFT_IRON, HARD_IRON, GYRO_BIAS).splitlines()
    comments = [line for line in lines if line.startswith("#")]
    assert lines[0] in comments
    assert any("tesla" in line or "gauss" in line for line in comments)
    assert any("rad/s" in line for line in comments)
    assert not any("$" in line for line in comments)


def test_vectornav_checksum_is_the_manual_s() -> None:
    # The manual's default values of register 23, as a read: $VNRRG,23,1,0,0,0,1,0,0,0,1,0,0,0*73
    from magyc_gtsam.export.vectornav import _checksum

    assert _checksum("VNRRG,23,1,0,0,0,1,0,0,0,1,0,0,0") == 0x73


def test_unknown_target_lists_the_targets() -> None:
    with pytest.raises(MagycError, match="'betaflight'; there are px4, ardupilot, vectornav, ros"):
        export("betaflight", SOFT_IRON, HARD_IRON)


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_symmetric_targets_keep_the_field_strength_of_a_triangular_soft_iron(target: str) -> None:
    triangular = np.triu(SOFT_IRON)
    text = export(target, triangular, HARD_IRON)
    field, _ = CORRECTED_BY[target](text, FIELD, RATE)
    expected = Calibration(triangular, HARD_IRON).apply(FIELD)
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), np.linalg.norm(expected, axis=1), atol=1e-11)
    rotation = np.linalg.lstsq(field, expected, rcond=None)[0].T
    angle = np.degrees(np.arccos((np.trace(rotation) - 1) / 2))
    assert f"rotation of {angle:.2f} deg" in text


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_symmetric_targets_refuse_a_mirrored_axis(target: str) -> None:
    with pytest.raises(MagycError, match="mirrors an axis"):
        export(target, np.diag([1.0, 1.0, -1.0]) @ SOFT_IRON, HARD_IRON)


@pytest.mark.parametrize(
    ("target", "soft_iron", "hard_iron", "limit"),
    [
        ("ardupilot", SOFT_IRON, [0.0, 0.0, 181e-6], "offset of 1810 milligauss, beyond 1800"),
        ("ardupilot", np.diag([0.15, 1, 1]), HARD_IRON, "COMPASS_DIA is outside 0.2 to 5"),
        (
            "ardupilot",
            np.array([[1, -0.8, 0], [-0.8, 1, 0], [0, 0, 1]]),
            HARD_IRON,
            "COMPASS_ODI is beyond 1",
        ),
        ("px4", np.diag([0.3, 1, 1]), HARD_IRON, "SCALE is outside 0.1 to 3"),
    ],
)
def test_limits_of_the_target_are_said(target: str, soft_iron: Array, hard_iron: Array, limit: str) -> None:
    text = export(target, soft_iron, hard_iron)
    assert any(line.startswith("# LIMIT") and limit in line for line in text.splitlines())
    assert "LIMIT" not in export(target, SOFT_IRON, HARD_IRON)


MOTOR = Term("motor-current", [3e-8, -5e-8, 8e-8], np.eye(3) * 1e-18, {"reference_0": 12.0})
WARM = Term("temperature-hard-iron", [2e-8, 1e-8, -4e-8], np.eye(3) * 1e-18, {"reference_0": 24.0})
MOUNTING = Term("misalignment", [0.05, -0.2, 0.1], np.eye(3) * 1e-9)
CURRENT, TEMPERATURE = np.linspace(0, 40, len(FIELD)), np.linspace(5, 60, len(FIELD))
CHANNELS = {"current": CURRENT, "temperature": TEMPERATURE}


@pytest.mark.parametrize("terms", [(MOTOR,), (MOUNTING,), (MOTOR, MOUNTING), (WARM,), (WARM, MOTOR, MOUNTING)])
def test_terms_are_exported_where_the_target_has_them(terms: tuple[Term, ...]) -> None:
    """What is pasted corrects as `apply` does, the current's and temperature's references included."""
    calibration = Calibration(SOFT_IRON, HARD_IRON, GYRO_BIAS, terms=terms)
    expected = calibration.apply(FIELD, time=np.arange(40.0), channels=CHANNELS)
    by_px4, _ = px4(calibration.export("px4"), FIELD, RATE, CURRENT, TEMPERATURE)
    np.testing.assert_allclose(by_px4, expected, atol=2e-11)
    text = calibration.export("ardupilot")
    if WARM in terms:
        assert "LIMIT: not included: temperature-hard-iron" in text
        calibration = Calibration(SOFT_IRON, HARD_IRON, terms=tuple(t for t in terms if t is not WARM))
        expected = calibration.apply(FIELD, time=np.arange(40.0), channels=CHANNELS)
    by_ardupilot, _ = ardupilot(text, FIELD, RATE, CURRENT)
    np.testing.assert_allclose(by_ardupilot, expected, atol=2e-11)


@pytest.mark.parametrize("terms", [(), (WARM, MOTOR), (WARM, MOTOR, MOUNTING)])
def test_a_log_of_px4_gives_parameters_in_the_axes_of_each_sensor(terms: tuple[Term, ...]) -> None:
    """PX4 corrects before it turns; the values in the vehicle's axes were off by up to the whole hard iron."""
    own, gyroscope = mounting(6), mounting(38)
    autopilot = Autopilot("px4", Place(axes=own.tolist()), Place(axes=gyroscope.tolist()))
    known = Calibration(SOFT_IRON, HARD_IRON, GYRO_BIAS, terms=terms)
    calibration = replace(known, configuration={"autopilot": autopilot.to_dict()})
    text = calibration.export("px4")
    field, rate = px4(text, FIELD @ own, RATE @ gyroscope, CURRENT, TEMPERATURE)
    turned_by_px4 = np.eye(3) if MOUNTING in terms else own  # CAL_MAG0_ROT stays, or is in the file
    expected = calibration.apply(FIELD, time=np.arange(40.0), channels=CHANNELS)
    np.testing.assert_allclose(field @ turned_by_px4.T, expected, atol=3e-11)
    np.testing.assert_allclose(rate @ gyroscope.T, calibration.apply_gyroscope(RATE), atol=3e-8)
    assert calibration.export("ros") == known.export("ros")
    straight = Autopilot("px4", Place(axes=own.tolist())).to_dict()
    said = "# Gyroscope values are in its own axes, of which -y,x,z lie along the magnetometer's"
    assert said in replace(known, configuration={"autopilot": straight}).export("px4")
    assert "Gyroscope values are in its own axes" not in text  # which are oblique
    with pytest.raises(MagycError, match="the log is of PX4, and does not say which of ArduPilot's"):
        calibration.export("ardupilot")
    damaged = {"firmware": "px4", "magnetometer": {"axes": [[1, 0, 0]]}, "gyroscope": {}}
    for wrong in (damaged, {"firmware": "px4"}, "px4"):
        with pytest.raises(MagycError, match="autopilot: "):
            replace(calibration, configuration={"autopilot": wrong}).export("px4")


def test_a_rotation_comes_after_the_orientation_that_ardupilot_had() -> None:
    """COMPASS_ORIENT is replaced: a compass that was mounted backwards pointed backwards."""
    autopilot = Autopilot("ardupilot", Place(mounting=mounting(4).tolist()))
    calibration = Calibration(SOFT_IRON, HARD_IRON, terms=(MOUNTING,))
    text = replace(calibration, configuration={"autopilot": autopilot.to_dict()}).export("ardupilot")
    field, _ = ardupilot(text, FIELD @ mounting(4), RATE)
    np.testing.assert_allclose(field, calibration.apply(FIELD), atol=3e-11)


def test_a_gyroscope_that_warms_up_is_exported_where_the_target_has_it() -> None:
    """What is pasted corrects as `apply` does; ArduPilot's table is relative to its own calibration's temperature."""
    warming = Term("temperature-gyro", [2e-5, -4e-5, 3e-5], np.eye(3) * 1e-14, {"reference_0": 24.0})
    calibration = Calibration(SOFT_IRON, HARD_IRON, GYRO_BIAS, terms=(warming,))
    expected = calibration.apply_gyroscope(RATE, time=np.arange(40.0), channels=CHANNELS)
    _, by_px4 = px4(calibration.export("px4"), FIELD, RATE, None, TEMPERATURE)
    np.testing.assert_allclose(by_px4, expected, atol=1e-6)
    for target in ("ardupilot", "vectornav", "ros"):
        assert "LIMIT: not included: temperature-gyro" in calibration.export(target)
    # Read as z, x, y, and found to be y, -x, z of these: the values are those of the sensor itself.
    order = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    exchanged = Term("axis-order", order.ravel(), np.zeros((9, 9)))
    for more, own in (((), parse_axes("z,x,y")), ((exchanged,), order @ parse_axes("z,x,y"))):
        turned = replace(calibration, terms=(warming, *more), configuration={"gyroscope_axes": "z,x,y"})
        text = turned.export("px4")
        _, by_px4 = px4(text, FIELD, RATE @ own, None, TEMPERATURE)
        np.testing.assert_allclose(by_px4 @ own.T, expected, atol=1e-6)
        for target in TARGETS:
            said = turned.export(target)
            assert f"# Gyroscope values are in its own axes, of which {axes_text(own)} lie along" in said
    assert "own axes, of which" not in calibration.export("px4")
    lagging = Term("temperature-gyro", warming.value, warming.covariance, {"reference_0": 24.0, "lag": 60.0})
    assert "LIMIT: not included: temperature-gyro" in Calibration(
        SOFT_IRON, HARD_IRON, GYRO_BIAS, terms=(lagging,)
    ).export("px4")


@pytest.mark.parametrize("moving", [(0, 1, 2, 3), (1, 3)])
def test_ardupilot_compensates_motor_by_motor(moving: tuple[int, ...]) -> None:
    """Of the four outputs those that moved, about references of their own."""
    outputs = np.abs(np.random.default_rng(1).normal(0.5, 0.2, (len(FIELD), 4)))
    value = np.random.default_rng(2).normal(0, 1e-6, 3 * len(moving))
    setting = {f"reference_{i}": 0.3 + 0.1 * i for i in moving}
    term = Term("motor-current", value, np.eye(len(value)) * 1e-18, setting)
    calibration = Calibration(SOFT_IRON, HARD_IRON, terms=(MOUNTING, term))
    channels = {f"motor_{k + 1}": outputs[:, k] for k in range(4)}
    expected = calibration.apply(FIELD, time=np.arange(40.0), channels=channels)
    by_voltage = calibration.export("ardupilot", per_motor=True, battery_voltage=14.8)
    field, _ = ardupilot(by_voltage, FIELD, RATE, outputs=outputs)
    np.testing.assert_allclose(field, expected, atol=2e-11)
    assert "not included: motor-current" in calibration.export("ardupilot")
    assert "not included: motor-current" in calibration.export("px4", per_motor=True)
    five = Term("motor-current", np.ones(15) * 1e-8, np.eye(15))
    with pytest.raises(MagycError, match="compensates for 4 motors"):
        Calibration(SOFT_IRON, HARD_IRON, terms=(five,)).export("ardupilot", per_motor=True, battery_voltage=12)
    with pytest.raises(
        MagycError, match="multiplies a motor's output by the voltage of the battery, which is needed"
    ):
        calibration.export("ardupilot", per_motor=True)
    with pytest.raises(MagycError, match="has no effect of the motors"):
        replace(calibration, terms=(MOUNTING,)).export("ardupilot", per_motor=True, battery_voltage=12)


def test_currents_of_motors_are_not_their_outputs() -> None:
    """Those of the speed controllers were written as if at full output."""
    names = tuple(f"ESC[{k}].Curr" for k in range(4))
    term = Term("motor-current", np.full(12, 1e-7), np.eye(12) * 1e-18, {}, names)
    with pytest.raises(
        MagycError, match=r"by the outputs of the motors, 0 to 1, not by their currents \(ESC\[0\]"
    ):
        Calibration(SOFT_IRON, HARD_IRON, terms=(term,)).export("ardupilot", per_motor=True, battery_voltage=12)
    percent = tuple(f"motor_{k}_percent" for k in range(4))
    full = replace(term, channels=tuple(f"motor_{k}" for k in range(4)))
    of_percent = replace(term, channels=percent, value=term.value / 100, covariance=term.covariance)
    first, second = (
        Calibration(SOFT_IRON, HARD_IRON, terms=(one,)).export("ardupilot", per_motor=True, battery_voltage=12)
        for one in (full, of_percent)
    )
    assert first == second


def test_the_one_current_that_moved_has_its_own_reference() -> None:
    second = Term("motor-current", MOTOR.value, MOTOR.covariance, {"reference_1": 7.0})
    calibration = Calibration(SOFT_IRON, HARD_IRON, terms=(second,))
    both = {"current_a": 0 * CURRENT, "current_b": CURRENT}
    field, _ = ardupilot(calibration.export("ardupilot"), FIELD, RATE, CURRENT)
    np.testing.assert_allclose(field, calibration.apply(FIELD, time=np.arange(40.0), channels=both), atol=2e-11)


@pytest.mark.parametrize("target", ["px4", "ardupilot"])
def test_another_compass_has_parameters_of_its_own(target: str) -> None:
    """The same numbers, under the second compass' names, with nothing of the first's."""
    first = Calibration(SOFT_IRON, HARD_IRON, GYRO_BIAS, terms=(MOTOR, MOUNTING))
    second = replace(first, configuration={"compass": 2})
    text = second.export(target)
    if target == "px4":
        back = re.sub(r"(CAL_MAG|TC_M)1_", r"\g<1>0_", text)
    else:
        assert "COMPASS_ORIENT2,102" in text
        back = re.sub(r"(COMPASS_(?:OFS|DIA|ODI|MOT))2_", r"\1_", text)
        back = re.sub(r"(COMPASS_(?:SCALE|ORIENT))2", r"\1", back).replace("CUST_ROT2_", "CUST_ROT1_")
        back = back.replace("COMPASS_ORIENT,102", "COMPASS_ORIENT,101")
    names = [line for line in text.splitlines() if not line.startswith("#")]
    assert not [line for line in names if "MAG0" in line or "COMPASS_OFS_" in line or "CUST_ROT1" in line]
    ours, theirs = (CORRECTED_BY[target](each, FIELD, RATE, CURRENT) for each in (first.export(target), back))
    np.testing.assert_array_equal(ours[0], theirs[0])
    with pytest.raises(MagycError, match="compass: must be 1 to"):
        replace(first, configuration={"compass": 9}).export(target)
    assert replace(first, configuration={"compass": 2}).export("ros") == first.export("ros")


@pytest.mark.parametrize("target", TARGETS)
def test_a_skew_that_was_found_is_in_every_target(target: str) -> None:
    """From a log to what is pasted, corrected by the target's own formula."""
    simulation = skewed("wide", 1.0, 2)
    recording = simulation.recording.between(0, 200)
    calibration = calibrate(recording)
    assert [term.name for term in calibration.terms] == ["misalignment"]
    text = calibration.export(target)
    field, _ = CORRECTED_BY[target](text, recording.magnetic_field, recording.angular_rate)
    np.testing.assert_allclose(field, calibration.apply(recording), atol=2e-11)
    turned_by = np.degrees(np.linalg.norm(calibration.terms[0].value))
    if target in ("px4", "ardupilot"):
        assert f"{turned_by:.2f} deg" in text
        assert "# LIMIT: a compass inside the autopilot" in text
    else:
        assert "LIMIT" not in text


@pytest.mark.parametrize("target", ["vectornav", "ros"])
def test_a_mounting_is_in_any_matrix_and_a_current_in_none(target: str) -> None:
    calibration = Calibration(SOFT_IRON, HARD_IRON, terms=(MOUNTING,))
    field, _ = CORRECTED_BY[target](calibration.export(target), FIELD, RATE)
    np.testing.assert_allclose(field, calibration.apply(FIELD), atol=2e-11)
    assert "not included: motor-current" in Calibration(SOFT_IRON, HARD_IRON, terms=(MOTOR,)).export(target)


def _parameters(text: str) -> list[str]:
    return [line for line in text.splitlines() if not line.startswith("#")]


def test_what_no_target_computes_is_said() -> None:
    """A lag behind the thermometer or the current, and several currents; the rest is as without them."""
    lagging = Term("temperature-hard-iron", WARM.value, WARM.covariance, {"lag": 60.0})
    late = Term("motor-current", MOTOR.value, MOTOR.covariance, {"reference_0": 12.0, "lag": 1.0})
    several = Term("motor-current", np.ones(6) * 1e-8, np.eye(6))
    assert "not included: motor-current" in Calibration(SOFT_IRON, HARD_IRON, terms=(late,)).export("ardupilot")
    plain = _parameters(Calibration(SOFT_IRON, HARD_IRON).export("px4"))
    assert _parameters(Calibration(SOFT_IRON, HARD_IRON, terms=(late,)).export("px4")) == plain
    for term in (lagging, late, several):
        text = Calibration(SOFT_IRON, HARD_IRON, terms=(term,)).export("px4")
        assert f"LIMIT: not included: {term.name}" in text


@pytest.mark.parametrize("target", TARGETS)
def test_after_a_jump_the_iron_at_the_end_of_the_log_is_exported(target: str) -> None:
    """With what was pasted before, every reading after the jump was off by it."""
    at_end = FIELD[len(FIELD) // 2 :], np.arange(40.0)[len(FIELD) // 2 :]
    jumps = (
        Term("hard-iron-step", [4e-6, -1e-6, 2e-6], np.eye(3) * 1e-16, {"time": 1.0}),
        Term("hard-iron-step", [1e-6, 1e-6, 0.0], np.eye(3) * 1e-16, {"time": 2.0}),
        Term("soft-iron-step", [0.01, 0.02, 0.0, -0.02, 0.01, 0.0], np.eye(6) * 1e-8, {"time": 3.0}),
    )
    passed = Term("hard-iron-step", [4e-6, 0.0, 0.0], np.eye(3) * 1e-16, {"time": 1.0, "until": 2.0})
    calibration = Calibration(SOFT_IRON, HARD_IRON, GYRO_BIAS, terms=(*jumps, passed, passed))
    text = calibration.export(target)
    assert text.startswith("# LIMIT: not included: hard-iron-step. Only ")
    said = "# LIMIT: the values are those after hard-iron-step, soft-iron-step, at the end of the log. "
    assert text.splitlines()[1].startswith(said)
    field, _ = CORRECTED_BY[target](text, at_end[0], RATE[: len(at_end[0])])
    expected = calibration.apply(at_end[0], time=at_end[1])
    if target in ("px4", "ardupilot"):  # which take symmetric matrices: the strength is the same
        field, expected = np.linalg.norm(field, axis=1), np.linalg.norm(expected, axis=1)
    np.testing.assert_allclose(field, expected, rtol=0, atol=2e-11)
