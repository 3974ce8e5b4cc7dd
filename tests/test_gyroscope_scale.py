"""The scales of the gyroscope's axes, estimated with one log and shared by the logs of one instrument."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.history import History
from magyc_gtsam.history.coordinates import shape_of
from magyc_gtsam.history.log_factor import HARD_IRON, SCALE, compress

PRIOR = 0.01
SOFT_IRON = np.array([[1.03, 0.02, -0.01], [0.02, 0.98, 0.015], [-0.01, 0.015, 1.0]])
SOFT_IRON /= np.cbrt(np.linalg.det(SOFT_IRON))
HARD_IRON_T = np.array([12e-6, -8e-6, 20e-6])
BIAS = np.array([4e-3, -2e-3, 3e-3])
OWN_SCALE = np.array([0.012, -0.009, 0.007])


def scaled(motion: str, seed: int, scale: np.ndarray, seconds: float = 300.0) -> mg.Recording:
    """Return a recording of an instrument whose gyroscope reads ω ∘ (1 + scale) + bias."""
    dive = mg.simulate(
        motion, seconds, 10, seed=seed, soft_iron=SOFT_IRON, hard_iron=HARD_IRON_T, gyro_bias=BIAS
    ).recording
    time, rate = dive.gyroscope
    return dive.with_samples(dive.magnetometer, (time, BIAS + (rate - BIAS) * (1 + scale)))


def test_the_covariance_with_the_calibration_is_honest() -> None:
    squares, with_scale, without = [], [], []
    for seed, motion in enumerate(["wide", "moderate", "low", "tiny"] * 3):
        scale = np.random.default_rng(seed).normal(0, PRIOR, 3)
        dive = scaled(motion, 300 + seed, scale, 600.0)
        found = mg.calibrate(dive, gyroscope_scale=PRIOR)
        assert found.trusted
        (term,) = (term for term in found.terms if term.name == "gyro-scale")
        off = np.r_[
            vech(found.soft_iron) - vech(SOFT_IRON),
            found.hard_iron - HARD_IRON_T,
            found.gyro_bias - BIAS,
            term.value - scale,
        ][1:]  # of the six numbers of a soft iron with determinant 1 five are free
        covariance = np.zeros((15, 15))
        covariance[:12, :12], covariance[12:, 12:] = found.noise_covariance, term.covariance
        covariance[:12, 12:] = found.diagnostics["gyroscope_scale"]
        covariance[12:, :12] = covariance[:12, 12:].T
        squares.append(off @ np.linalg.solve(covariance[1:, 1:], off))
        if motion in ("wide", "low"):
            with_scale.append(found.hard_iron - HARD_IRON_T)
            without.append(mg.calibrate(dive).hard_iron - HARD_IRON_T)
    assert np.mean(squares) == pytest.approx(14, abs=3 * np.sqrt(28 / 12))
    assert np.linalg.norm(with_scale) < 0.6 * np.linalg.norm(without)


@pytest.mark.parametrize(("motion", "seconds", "scale"), [("level", 300.0, -0.03), ("survey", 100.0, 0.005)])
def test_no_size_is_stated_that_the_data_do_not_give(motion: str, seconds: float, scale: float) -> None:
    """Columns of nearly the same form cancel on level turns, and a straight leg has none: 30 % was stated for both."""
    found = mg.calibrate(scaled(motion, 1 if motion == "level" else 40, np.full(3, scale), seconds))
    assert not found.trusted
    said = [each["sentence"] for each in found.diagnostics["model_error"]["components"]]
    scales = [sentence for sentence in said if "scale" in sentence]
    assert scales
    assert all("off by an unknown amount" in sentence for sentence in scales)


def test_a_size_that_the_data_give_is_stated() -> None:
    found = mg.calibrate(scaled("level", 1, np.full(3, 0.015)))
    (said,) = [each["sentence"] for each in found.diagnostics["model_error"]["components"]]
    assert said.startswith("the gyroscope's scale is off by 1.")


def test_a_motion_of_small_turns_has_no_larger_scale() -> None:
    """A plain regression on the measured rate would: their noise is as large as 2 % of these turns."""
    found = [mg.calibrate(scaled("tiny", 330 + seed, np.zeros(3)), gyroscope_scale=PRIOR) for seed in range(6)]
    values = np.array([found.terms[-1].value for found in found])
    sigma = found[0].terms[-1].sigma
    assert np.all(np.abs(values.mean(axis=0)) < 3 * sigma / np.sqrt(6))


@pytest.fixture(scope="module")
def dives() -> list[mg.Recording]:
    return [scaled(motion, 340 + k, OWN_SCALE) for k, motion in enumerate(["wide", "low", "tiny", "wide"])]


def test_logs_of_one_instrument_share_the_scale(dives: list[mg.Recording], tmp_path: Path) -> None:
    history = mg.calibrate_many(dives, gyroscope_scale=PRIOR)
    assert history.groups == ((0, 1, 2, 3),)
    (term,) = (term for term in history.next.terms if term.name == "gyro-scale")
    alone = mg.calibrate(dives[2], gyroscope_scale=PRIOR)
    off = (term.value - OWN_SCALE) / term.sigma
    assert np.abs(off).max() < 3.5
    assert term.sigma.max() < 0.003 < PRIOR
    assert np.all(history.calibrations[2].sigma["hard_iron"] < 0.7 * alone.sigma["hard_iron"])
    shape = compress(history.next, "", None)
    assert shape.mean is not None
    assert np.abs(shape.mean[:5] - shape_of(SOFT_IRON)[0]).max() < 0.005
    assert np.abs(shape.mean[HARD_IRON] - HARD_IRON_T * 1e6).max() < 0.5

    rate = dives[0].gyroscope.value
    turned = (rate - history.next.gyro_bias) / (1 + term.value)
    assert history.next.apply_gyroscope(rate) == pytest.approx(turned, abs=1e-9)

    one_by_one = mg.calibrate_many(dives[:2], gyroscope_scale=PRIOR)
    one_by_one.save(tmp_path / "history.yaml")
    for dive in dives[2:]:
        one_by_one = History.load(tmp_path / "history.yaml").add(dive)
        one_by_one.save(tmp_path / "history.yaml")
    assert one_by_one.next.to_dict() == history.next.to_dict()
    assert one_by_one.model.gyroscope_scale == history.model.gyroscope_scale == 1e3 * PRIOR


def test_the_prior_counts_once(dives: list[mg.Recording]) -> None:
    """The factor of a log has the information of its data on the scale, whatever the prior it was fitted with."""
    level = [mg.calibrate(dives[2], gyroscope_scale=prior) for prior in (0.005, 0.01)]
    one, other = (compress(each, "", None) for each in level)
    assert one.covariance is not None
    assert other.covariance is not None
    sigma = np.sqrt(np.array([one.covariance[SCALE, SCALE].diagonal(), other.covariance[SCALE, SCALE].diagonal()]))
    assert sigma[0][2] == pytest.approx(sigma[1][2], rel=0.05)
    assert (
        sigma.min(axis=0)[:2].min() > 25
    )  # ‰: tiny turns tell nothing of the two others, and the prior is taken out
    assert level[0].terms[-1].sigma.max() < 0.7 * level[1].terms[-1].sigma.max()


def test_logs_with_and_without_a_scale_are_not_joined(dives: list[mg.Recording]) -> None:
    with_scale = mg.calibrate_many(dives[:1], gyroscope_scale=PRIOR)
    without = mg.calibrate_many(dives[1:2])
    with pytest.raises(mg.MagycError, match="calibrate all of them with the same gyroscope_scale"):
        History([*with_scale.factors, *without.factors])


def test_a_scale_beyond_its_prior_is_not_believed() -> None:
    """Rates in a unit that is wrong by half, say."""
    found = mg.calibrate(scaled("moderate", 2, np.full(3, 0.5)), gyroscope_scale=PRIOR)
    assert not found.trusted
    assert "check its unit, or expect more (gyroscope_scale)" in found.message
    # All that is known of it: the step away from the limit is not the value.
    assert found.message.startswith("the gyroscope's scale would be off by more than 4 % along ")
    assert not [term for term in found.terms if term.name == "gyro-scale"]


def test_a_prior_that_is_another_unit() -> None:
    dive = scaled("wide", 1, np.zeros(3))
    with pytest.raises(mg.MagycError, match=r"gyroscope_scale must be at least 0 and below 0\.1, got 1"):
        mg.calibrate(dive, gyroscope_scale=1)
