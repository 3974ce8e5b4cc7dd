"""An earlier calibration as prior, and the field at the place."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam import Calibration, MagycError, Recording, calibrate, calibrate_many, simulate
from magyc_gtsam.factors.chain.rotations import exponential_matrices
from magyc_gtsam.report.verdict import judged
from magyc_gtsam.simulation.sensor import HARD_IRON, SOFT_IRON
from magyc_gtsam.study.efficiency import error

ANYTHING = 100e-6  # T, a hard iron that may have changed by as much as one has


@pytest.fixture(scope="module")
def earlier():
    return calibrate(simulate("wide", seed=999).recording, misalignment=0)


@pytest.fixture(scope="module")
def strength():
    return simulate("wide", duration=10).truth.field_strength


def hard_iron_error(motion, seeds, duration=600, **options):
    """Root mean square error of an axis in T; mean of its squared ratio to the stated sigma."""
    square, ratio = [], []
    for seed in seeds:
        simulation = simulate(motion, duration, seed=seed)
        calibration = calibrate(simulation.recording, misalignment=0, **options)
        away = error(calibration, simulation.truth)[6:9]
        square.append(np.mean(away**2))
        ratio.append(away @ np.linalg.solve(calibration.covariance[6:9, 6:9], away) / 3)
        assert calibration.trusted, calibration.message
    return np.sqrt(np.mean(square)), np.mean(ratio)


@pytest.mark.parametrize(("motion", "duration"), [("tiny", 60), ("level", 600), ("ship", 600)])
def test_the_matrix_and_the_strength_make_little_motion_enough(earlier, strength, motion, duration):
    seeds = range(6)
    alone, _ = hard_iron_error(motion, seeds, duration)
    matrix, its = hard_iron_error(motion, seeds, duration, prior=earlier, hard_iron_walk=ANYTHING)
    both, theirs = hard_iron_error(
        motion, seeds, duration, prior=earlier, hard_iron_walk=ANYTHING, field=(strength, None)
    )
    assert matrix < 0.65 * alone
    assert both < 0.25 * alone
    assert max(its, theirs) < 2.6  # χ² of 18 over 18, 99.9 %


def tumbled(seed, hard_iron):
    """20 s of turning about all axes by hand, at 100 Hz."""
    random = np.random.default_rng(seed)
    time = np.arange(0, 20, 0.01)
    frequency, phase, size = (random.uniform(*span, (3, 4)) for span in ((0.1, 0.5), (0, 6.3), (0.3, 1.2)))
    swing = np.sin(2 * np.pi * frequency[:, :, None] * time + phase[:, :, None])
    rate = np.einsum("ij,ijn->ni", size, swing)
    turn = [Rotation.identity()]
    for step in 0.005 * (rate[1:] + rate[:-1]):
        turn.append(turn[-1] * Rotation.from_rotvec(step))
    field = Rotation.concatenate(turn).inv().apply([20e-6, 0, 43e-6]) @ SOFT_IRON.T + hard_iron
    field += 0.5e-6 * random.normal(size=field.shape)
    return Recording(time, field, rate + 5e-3 * random.normal(size=rate.shape))


@pytest.mark.parametrize("axis", range(3))
def test_a_hard_iron_that_moved_far_is_found_as_soon_as_without_a_prior(earlier, axis):
    """From the hard iron of before it took up to 20 iterations, and ran away on a piece of a real log."""
    moved = HARD_IRON - 80e-6 * np.eye(3)[axis]
    recording = tumbled(2, moved)
    told = calibrate(recording, prior=earlier, hard_iron_walk=ANYTHING, misalignment=0)
    alone = calibrate(recording, misalignment=0)
    assert np.abs(told.hard_iron - moved).max() < 0.5e-6
    assert told.diagnostics["iterations"] <= alone.diagnostics["iterations"] + 2


def test_a_prior_that_did_not_walk_is_hardly_moved_by_little_data(earlier):
    simulation = simulate("tiny", duration=60, seed=5)
    calibration = calibrate(simulation.recording, prior=earlier, misalignment=0)
    assert (np.abs(calibration.hard_iron - earlier.hard_iron) < 0.5 * earlier.sigma["hard_iron"]).all()
    by_noise = np.sqrt(np.diag(calibration.noise_covariance)[6:9])
    assert (by_noise < 1.01 * earlier.sigma["hard_iron"]).all()
    assert (
        calibration.sigma["hard_iron"] < 1.2 * earlier.sigma["hard_iron"]
    ).all()  # it may drift within the minute


def test_the_walk_widens_the_prior(earlier):
    recording = simulate("tiny", duration=60, seed=5).recording
    sigmas = [
        calibrate(recording, prior=earlier, hard_iron_walk=walk, misalignment=0).sigma["hard_iron"].max()
        for walk in (0.0, 0.2e-6, 5e-6)
    ]
    assert sigmas == sorted(sigmas)
    assert sigmas[2] > 2 * sigmas[0]


def test_a_hard_iron_that_moved_contradicts_the_prior_and_says_so(earlier):
    moved = simulate("wide", seed=7, hard_iron=HARD_IRON + np.array([0, 8e-6, 0])).recording
    calibration = calibrate(moved, prior=earlier, misalignment=0)
    assert not calibration.trusted
    assert re.search(
        r"the data contradict the earlier calibration: hard iron y by \+(7\.9|8)", calibration.message
    )
    assert "(hard_iron_walk)" in calibration.message
    allowed = calibrate(moved, prior=earlier, hard_iron_walk=10e-6, misalignment=0)
    assert allowed.trusted, allowed.message


@pytest.mark.parametrize("percent", [0.5, 1.0])
def test_a_matrix_that_is_off_is_noticed_on_wide_motion(earlier, percent):
    stretched = SOFT_IRON + percent / 100 * np.diag([1.0, 0.0, -1.0])
    recording = simulate("wide", seed=8, soft_iron=stretched).recording
    calibration = calibrate(recording, prior=earlier, misalignment=0)
    assert not calibration.trusted
    assert "the data contradict the earlier calibration: soft iron" in calibration.message
    assert calibrate(recording, prior=earlier, soft_iron_walk=0.01, misalignment=0).trusted


@pytest.mark.parametrize("walk", [0.0, 50e-6])
def test_a_strength_that_the_prior_and_the_motion_contradict_is_said(strength, walk):
    """By 10 %, which moved the vertical hard iron of a ship by 6 µT without a word."""
    scaled = calibrate(simulate("wide", seed=998).recording, field_strength=strength)
    recording = simulate("ship", seed=9).recording
    for factor in (0.9, 1.0, 1.1):
        told = calibrate(recording, prior=scaled, hard_iron_walk=walk, field=(factor * strength, None))
        assert told.trusted == (factor == 1.0), told.message
        there = f"{1e6 * factor * strength:.1f} µT at the place"
        assert (there in told.message) == ("(field=, hard_iron_walk=)" in told.message) == (factor != 1.0)


def test_the_strength_sets_the_scale_with_its_sigma(strength):
    recording = simulate("wide", seed=3).recording
    calibration = calibrate(recording, field=((40e-6, 400e-9), None))
    assert calibration.field_strength == 40e-6
    assert np.cbrt(np.linalg.det(calibration.soft_iron)) == pytest.approx(strength / 40e-6, rel=2e-3)
    plain = calibrate(recording)
    np.testing.assert_allclose(calibration.hard_iron, plain.hard_iron, atol=1e-9)
    # One percent of each element.
    assert calibration.sigma["soft_iron"][2, 2] == pytest.approx(0.01 * calibration.soft_iron[2, 2], rel=0.1)


def test_a_prior_with_a_skew_hands_it_on():
    angle = np.radians([0.5, -0.4, 0.6])
    turn = exponential_matrices(angle[:, None])[:, :, 0]
    cal0 = calibrate(simulate("wide", seed=11, soft_iron=SOFT_IRON @ turn).recording)
    assert cal0.terms
    recording = simulate("level", seed=12, soft_iron=SOFT_IRON @ turn).recording
    calibration = calibrate(recording, prior=cal0, hard_iron_walk=5e-6)
    np.testing.assert_allclose(-calibration.terms[0].value, angle, atol=np.radians(0.2))
    assert calibration.trusted, calibration.message


def test_the_configuration_is_enough_to_run_again(earlier, tmp_path):
    recording = simulate("tiny", duration=60, seed=5).recording
    first = calibrate(recording, prior=earlier, hard_iron_walk=5e-6, field=(50e-6, 1.05))
    first.save(tmp_path / "cal.yaml")
    again = calibrate(recording, **Calibration.load(tmp_path / "cal.yaml").configuration)
    np.testing.assert_array_equal(again.covariance, first.covariance)


def test_what_makes_no_sense_is_refused(earlier):
    recording = simulate("wide", duration=60).recording
    without = replace(earlier, covariance=None)
    for options, said in (
        ({"prior": without}, "has no covariance"),
        ({"prior": 3}, "an earlier Calibration is needed, got int"),
        ({"hard_iron_walk": 1e-6}, "give it .prior=."),
        ({"prior": earlier, "hard_iron_walk": -1}, "hard_iron_walk must be at least 0 and below 1 T, got -1"),
        ({"field": 50e-6}, "is neither .strength T, dip rad. nor"),
        ({"field": (50e-6, 3.0)}, "the dip must be above"),
        ({"field": (50e-6, 1.0), "field_strength": 50e-6}, "give one of them"),
    ):
        with pytest.raises(MagycError, match=said):
            calibrate(recording, **options)


def test_where_the_motion_is_too_little_the_cheapest_fact_is_named(earlier, strength):
    recording = simulate("level", duration=60, seed=1).recording
    alone = calibrate(recording)
    assert not alone.trusted
    assert "this motion is enough with " in alone.message
    told = calibrate(recording, prior=earlier, hard_iron_walk=ANYTHING, field=(strength, None))
    assert told.trusted, told.message
    stated = float(alone.message.split("place and date (prior=, field=: hard iron ±")[1].split()[0])
    by_noise = np.sqrt(told.noise_covariance.diagonal()[6:9])
    assert by_noise.max() * 1e6 == pytest.approx(stated, rel=0.1)
    assert told.sigma["hard_iron"].max() * 1e6 < 2 * stated


def test_the_first_line_of_the_verdict_names_it_beside_the_manoeuvre():
    recording = simulate("level", duration=60, seed=1).recording
    verdict = judged(calibrate(recording), recording)
    assert verdict.action.startswith("pitch or roll by 20° or more")
    assert verdict.action.endswith("; or give prior=, field=")
    assert len(f"{verdict.cause} {verdict.action}".split()) <= 30


def test_with_an_earlier_calibration_of_known_scale_the_place_is_what_is_left(strength):
    wide = simulate("wide", seed=999).recording
    recording = simulate("level", duration=60, seed=3).recording
    place = (strength, None)
    for scaled, remedy in ((True, "place and date (field=: hard iron ±"), (False, "")):
        prior = calibrate(wide, misalignment=0, **({"field": place} if scaled else {}))
        walked = {"prior": prior, "hard_iron_walk": ANYTHING, "misalignment": 0}
        told = calibrate(recording, **walked, soft_iron_walk=0.02)
        assert not told.trusted
        assert ("this motion is enough with " in told.message) == scaled
        assert remedy in told.message


def test_the_same_recording_is_not_counted_twice(tmp_path):
    first, second = (simulate("wide", 60, seed=seed).recording for seed in (5, 6))
    earlier = calibrate(first)
    earlier.save(tmp_path / "earlier.yaml")
    renamed = replace(first, name="copy")
    with pytest.raises(
        MagycError, match="fitted to samples of this recording, which would count twice; leave the prior"
    ):
        calibrate(renamed, prior=Calibration.load(tmp_path / "earlier.yaml"))
    with pytest.raises(MagycError, match="would count twice"):
        calibrate(first, prior=earlier.to_dict())  # as the command line gives it
    with pytest.raises(MagycError, match="would count twice"):
        calibrate(first.between(20, 50), prior=earlier)  # a part of it
    both = calibrate(second, prior=earlier)
    assert both.fitted_to == (earlier.fitted_to[0], calibrate(second).fitted_to[0])
    with pytest.raises(MagycError, match="would count twice"):
        calibrate(first, prior=both)
    with pytest.raises(MagycError, match="would count twice"):
        calibrate(first, prior=calibrate_many([first, second]).next)
