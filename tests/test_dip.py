"""The dip of the place as a fact, where an accelerometer or an attitude says which way is up."""

from dataclasses import replace

import numpy as np
import pytest
from fact_slopes import check_slope
from scipy.spatial.transform import Rotation

from magyc_gtsam import Recording, calibrate, simulate
from magyc_gtsam.estimators.smoother.dip import DipFact, dip_fact, known_dip
from magyc_gtsam.estimators.smoother.options import DIP_SIGMA, FIELD_SIGMA, PlaceField
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.study.efficiency import error
from magyc_gtsam.study.known import skewed
from magyc_gtsam.study.known_facts import placed


@pytest.fixture(scope="module")
def earlier():
    return calibrate(simulate("wide", seed=999).recording, misalignment=0)


def test_its_slope_is_the_derivative_of_the_dip_of_the_chain():
    """On all parameters, skew included, the directions at their best for each."""
    run = placed("low", 200, 3)
    fit = fit_field_chain(run.recording, misalignment=np.radians(1.0))
    place = PlaceField(50e-6, FIELD_SIGMA, run.dip, DIP_SIGMA)
    fit = replace(fit, chain=replace(fit.chain, facts=(*fit.chain.facts, *dip_fact(run.recording, place))))

    check_slope(fit, DipFact)


@pytest.mark.parametrize("by", ["acceleration", "attitude"])
def test_the_field_dips_as_at_the_place_on_a_level_vehicle(by):
    """Without it, the vertical hard iron and the dip of the field can hardly be told apart."""
    off = {"alone": [], "dip": []}
    for seed in range(5):
        run = placed("level", 300, seed)
        kept = {"attitude": None} if by == "acceleration" else {"acceleration": None}
        recording = replace(run.recording, **kept)
        for way, options in (("alone", {}), ("dip", {"field": run.field})):
            calibration = calibrate(recording, misalignment=0, **options)
            field = Rotation.from_quat(run.recording.attitude).apply(calibration.apply(recording))
            dip = np.arcsin(field[:, 2] / np.linalg.norm(field, axis=1)).mean()  # the world's z axis points down
            off[way].append(np.degrees(dip - run.dip))
    assert (
        np.sqrt(np.mean(np.square(off["dip"]))) < 0.6
    )  # the accelerometer is off by 0.6° an axis, the place by 0.2
    assert np.sqrt(np.mean(np.square(off["dip"]))) < 0.7 * np.sqrt(np.mean(np.square(off["alone"])))


@pytest.mark.parametrize("motion", ["level", "ship"])
def test_with_matrix_and_strength_the_stated_sigmas_hold(earlier, motion):
    ratio = []
    for seed in range(6):
        run = placed(motion, 300, seed)
        recording = replace(run.recording, attitude=None)
        calibration = calibrate(recording, prior=earlier, hard_iron_walk=100e-6, field=run.field, misalignment=0)
        assert calibration.trusted, calibration.message
        assert calibration.diagnostics["dip"]["used"]
        away = error(calibration, run.truth)[6:9]
        ratio.append(away @ np.linalg.solve(calibration.covariance[6:9, 6:9], away) / 3)
    assert np.mean(ratio) < 2.6  # χ² of 18 over 18, 99.9 %


def test_a_skew_and_a_dip_go_together():
    simulation = skewed("wide", 1.0, 3)
    recording = replace(simulation.recording, attitude=None)
    dip = float(np.arctan2(simulation.field[2], np.hypot(*simulation.field[:2])))
    plain = calibrate(recording)
    told = calibrate(recording, field=(simulation.truth.field_strength, dip))
    assert told.diagnostics["dip"]["used"]
    np.testing.assert_allclose(told.terms[0].value, plain.terms[0].value, atol=2 * plain.terms[0].sigma.max())
    assert (told.terms[0].sigma <= plain.terms[0].sigma * 1.001).all()


def test_a_field_that_is_not_that_of_the_place_is_said_and_not_used():
    run = placed("wide", 200, 1)
    recording = replace(run.recording, attitude=None)
    strength, dip = run.field
    told = calibrate(recording, field=(strength, dip - np.radians(8)), misalignment=0)
    assert not told.diagnostics["dip"]["used"]
    assert "the field dips by" in told.message
    assert "which is not used" in told.message
    plain = calibrate(recording, field=(strength, None), misalignment=0)
    np.testing.assert_allclose(told.hard_iron, plain.hard_iron, atol=1e-9)


def test_surges_of_the_vehicle_average_out():
    run = placed("level", 300, 2)
    time = run.recording.time
    surge = 1.5 * np.sign(np.sin(2 * np.pi * time / 20)) * (np.abs(np.sin(2 * np.pi * time / 20)) > 0.9)
    world = np.column_stack([surge, np.zeros_like(surge), np.zeros_like(surge)])
    force = run.recording.acceleration + Rotation.from_quat(run.recording.attitude).inv().apply(world)
    recording = replace(run.recording, attitude=None, acceleration=force)
    calibration = calibrate(recording, field=run.field, misalignment=0)
    said = calibration.diagnostics["dip"]
    assert said["used"]
    assert abs(said["measured_deg"] - np.degrees(run.dip)) < 4 * said["sigma_deg"] < 3


def test_without_a_vertical_nothing_changes():
    run = placed("low", 200, 4)
    recording = replace(run.recording, attitude=None, acceleration=None)
    one, other = (calibrate(recording, field=field) for field in (run.field, (run.field[0], None)))
    np.testing.assert_array_equal(one.covariance, other.covariance)
    assert "dip" not in one.diagnostics


def test_a_vertical_that_turns_against_the_gyroscope_says_nothing_of_the_dip() -> None:
    """Its mean over a minute is far shorter than gravity everywhere, as where the gyroscope's bias was not found."""
    recording = simulate("wide", duration=180, seed=1).recording
    random = np.random.default_rng(0)
    force = random.normal(size=(len(recording.time) // 20 + 1, 3))
    force *= 9.81 / np.linalg.norm(force, axis=1)[:, None]
    acceleration = np.repeat(force, 20, axis=0)[: len(recording.time)]
    turned = Recording(recording.time, recording.magnetic_field, recording.angular_rate, acceleration=acceleration)
    assert known_dip(turned, fit_field_chain(turned)) == ()
