"""MagFactor3's model: closed form, GTSAM graph and truth."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.factors import custom_factor
from magyc_gtsam.factors.pose import scaled_magnetometer_factor
from magyc_gtsam.factors.variables import vector
from magyc_gtsam.study.table_one import MAGNETIC_HEADING, PUBLISHED, table_one

SCALE = 1.2
IDEAL = {"soft_iron": SCALE * np.eye(3)}
S, H = gtsam.symbol("s", 0), gtsam.symbol("h", 0)


@pytest.fixture(scope="module")
def dive():
    return mg.simulate("dive", 300, seed=1, **IDEAL)


def graph_solution(simulation, blocks=5):
    """Scale and hard iron of GTSAM's graph, samples stacked in a few factors, by Levenberg–Marquardt in gauss."""
    recording, field = simulation.recording, simulation.field * 1e4
    body = Rotation.from_quat(recording.attitude).inv().apply(field)
    graph = gtsam.NonlinearFactorGraph()
    for rows in np.array_split(np.arange(len(body)), blocks):
        u, m = body[rows], recording.magnetic_field[rows] * 1e4

        def error(scale, hard_iron, want_jacobians, u=u, m=m):
            residual = (scale * u + hard_iron - m).ravel()
            return residual, [u.reshape(-1, 1), np.tile(np.eye(3), (len(u), 1))] if want_jacobians else []

        graph.add(custom_factor("magfactor3", 1e-2, [S, H], [vector(1), vector(3)], 3 * len(rows), error))
    initial = gtsam.Values()
    initial.insert(S, np.ones(1))
    initial.insert(H, np.zeros(3))
    result = gtsam.LevenbergMarquardtOptimizer(graph, initial).optimize()
    return float(result.atVector(S)[0]), result.atVector(H) * 1e-4


def test_closed_form_is_the_minimum_of_the_graph(dive):
    scale, hard_iron = graph_solution(dive)
    calibration = mg.calibrate(dive.recording, "magfactor3", field=dive.field)
    np.testing.assert_allclose(calibration.soft_iron, scale * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(calibration.hard_iron, hard_iron, atol=1e-13)


def test_an_attitude_that_the_magnetometer_took_part_in_is_not_believed(dive):
    told = replace(dive.recording, attitude_is="estimate")
    calibration = mg.calibrate(told, "magfactor3")
    np.testing.assert_array_equal(calibration.hard_iron, mg.calibrate(dive.recording, "magfactor3").hard_iron)
    assert not calibration.trusted
    assert "took part in" in calibration.message
    assert mg.calibrate(dive.recording, "magfactor3").trusted


def test_known_field(dive):
    calibration = mg.calibrate(dive.recording, "magfactor3", field=dive.field.tolist())
    assert calibration.converged, calibration.message
    assert calibration.soft_iron[0, 0] == pytest.approx(SCALE, rel=3e-3)
    np.testing.assert_allclose(calibration.hard_iron, dive.truth.hard_iron, atol=0.1e-6)
    assert calibration.field_strength == pytest.approx(np.linalg.norm(dive.field))


def test_unknown_field_in_whatever_axes_the_attitude_has(dive):
    """The scale then is that of the strength, and the heading of the world's axes does not matter."""
    turned = Rotation.from_euler("Z", 1.0) * Rotation.from_quat(dive.recording.attitude)
    calibrations = [
        mg.calibrate(replace(dive.recording, attitude=attitude), "magfactor3")
        for attitude in (dive.recording.attitude, turned.as_quat())
    ]
    for calibration in calibrations:
        np.testing.assert_allclose(calibration.hard_iron, dive.truth.hard_iron, atol=0.15e-6)
        np.testing.assert_array_equal(calibration.soft_iron, np.eye(3))
        assert calibration.field_strength == pytest.approx(SCALE * np.linalg.norm(dive.field), rel=1e-3)
    np.testing.assert_allclose(calibrations[0].hard_iron, calibrations[1].hard_iron, atol=1e-12)
    strength = float(np.linalg.norm(dive.field))
    scaled = mg.calibrate(dive.recording, "magfactor3", field_strength=strength)
    np.testing.assert_allclose(scaled.soft_iron, SCALE * np.eye(3), rtol=1e-3, atol=1e-15)


def test_unknown_field_is_the_minimum_of_a_graph_of_its_factors(dive):
    """`scaled_magnetometer_factor`, one for every sample, with scale, direction and hard iron as variables."""
    recording = dive.recording.rows(slice(None, None, 40))
    s, d, h = (gtsam.symbol(letter, 0) for letter in "sdh")
    graph = gtsam.NonlinearFactorGraph()
    for field, attitude in zip(recording.magnetic_field, recording.attitude, strict=True):
        rotation = gtsam.Rot3(Rotation.from_quat(np.array(attitude)).as_matrix())
        graph.add(scaled_magnetometer_factor(d, s, h, field, rotation, 1e-6))
    initial = gtsam.Values()
    initial.insert(s, 50.0)
    initial.insert(d, gtsam.Unit3([1.0, 0.0, 1.0]))
    initial.insert(h, np.zeros(3))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    result = gtsam.LevenbergMarquardtOptimizer(graph, initial, parameters).optimize()
    calibration = mg.calibrate(recording, "magfactor3")
    np.testing.assert_allclose(result.atVector(h) * 1e-6, calibration.hard_iron, atol=1e-10)
    assert result.atDouble(s) * 1e-6 == pytest.approx(calibration.field_strength, rel=1e-5)


def test_gtsams_own_factor_has_no_error_at_the_estimate(dive):
    """MagFactor1, which GTSAM wraps: scale, direction and bias known, one attitude."""
    quiet = mg.simulate("dive", 300, seed=1, magnetometer_noise=0, **IDEAL)
    calibration = mg.calibrate(quiet.recording, "magfactor3", field=quiet.field)
    strength = float(np.linalg.norm(quiet.field))
    row = 1234
    factor = gtsam.MagFactor1(
        0,
        quiet.recording.magnetic_field[row],
        float(calibration.soft_iron[0, 0]) * strength,
        gtsam.Unit3(quiet.field / strength),
        calibration.hard_iron,
        gtsam.noiseModel.Isotropic.Sigma(3, 1e-6),
    )
    values = gtsam.Values()
    values.insert(0, gtsam.Rot3(Rotation.from_quat(quiet.recording.attitude[row]).as_matrix()))
    assert factor.error(values) < 1e-12


def test_delay_is_taken_out():
    simulation = mg.simulate("wide", 300, 50, seed=1, delay=0.1, **IDEAL)
    late, right = (mg.calibrate(simulation.recording, "magfactor3", delay=d) for d in (0.0, 0.1))
    assert right.diagnostics["residual"] < 0.9 * late.diagnostics["residual"]


def test_a_turn_about_one_axis_does_not_tell_field_from_hard_iron():
    time = np.arange(600) / 10
    attitude = Rotation.from_euler("Z", np.linspace(0, 12, 600)[:, None])
    field = attitude.inv().apply([20e-6, 0, 40e-6]) + [1e-6, 2e-6, 3e-6]
    recording = mg.Recording(time, field, attitude=attitude.as_quat())
    with pytest.raises(mg.MagycError, match="about one axis at most"):
        mg.calibrate(recording, "magfactor3")
    # With the field known that motion is enough.
    calibration = mg.calibrate(recording, "magfactor3", field=(20e-6, 0.0, 40e-6))
    np.testing.assert_allclose(calibration.hard_iron, [1e-6, 2e-6, 3e-6], atol=1e-12)


def test_refusals(dive):
    with pytest.raises(mg.MagycError, match="no attitude"):
        mg.calibrate(replace(dive.recording, attitude=None), "magfactor3")
    with pytest.raises(mg.MagycError, match=r"must be \(3,\) T with a length between"):
        mg.calibrate(dive.recording, "magfactor3", field=(1.0, 2.0, 3.0))
    with pytest.raises(mg.MagycError, match="not in the attitude's world axes"):
        mg.calibrate(dive.recording, "magfactor3", field=-dive.field)


def test_table_one_of_the_magyc_paper():
    """The printed headings come out with the heading of the raw field; the true heading halves them."""
    rows = {(r.method, r.motion): r for r in table_one(3, methods=(MAGNETIC_HEADING, "magfactor3"))}
    for motion, (heading, _) in PUBLISHED[MAGNETIC_HEADING].items():
        assert rows[MAGNETIC_HEADING, motion].heading[0] == pytest.approx(heading, rel=0.2)
        assert 7 < rows["magfactor3", motion].heading[0] < (12 if motion == "tiny" else 9)
        assert rows["magfactor3", motion].failed == 0


@pytest.mark.real
def test_a_magnet_against_the_optical_attitude(shared_data):
    recording = mg.read(shared_data / "broad_32_attached_magnet_1cm.mcap").between(41.5, 92)
    calibration = mg.calibrate(recording, "magfactor3")
    assert calibration.converged, calibration.message
    np.testing.assert_allclose(calibration.hard_iron * 1e6, [-6, -1, 58], atol=1.0)
