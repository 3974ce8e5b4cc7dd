"""The calibration of a gap carries the model error that `calibrate` would find beside its terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.estimators.model_error import model_error
from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.columns import Columns
from magyc_gtsam.gap.model.descent import prior_of
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import Refit, refit, widened, with_term
from magyc_gtsam.gap.outcome.corrected import as_calibration
from magyc_gtsam.gap.outcome.judged import fit_of, judged
from magyc_gtsam.level_turn import MisalignmentError
from magyc_gtsam.report.gap_page import render_gap
from magyc_gtsam.report.gap_verdict import as_judged, judged_gap
from magyc_gtsam.report.verdict import said
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record


def fitted(recording: mg.Recording, *names: str) -> Refit:
    """The twelve parameters and terms at their minimum."""
    short_term = short_term_noise(recording)
    base = base_model(recording, None, short_term)
    model = base.model
    sizes = {"timing": 1, "misalignment": 3, "gyro-scale": 6}
    for name in names:
        model = with_term(model, Active(name, {}, np.zeros(sizes[name])))
    return refit(base.twin.problem, model, short_term)


@pytest.fixture(scope="module")
def extended() -> Refit:
    """Terms on either sensor, and a delay."""
    return fitted(mg.simulate("wide", 200, seed=21).recording, "misalignment", "gyro-scale", "timing")


def test_terms_are_parameters_beside_which_columns_are_judged(extended: Refit) -> None:
    """Against the joint refit, whose columns go through a forward filter and are not eliminated."""
    twin, covariance = extended.twin, extended.covariance
    beside = fit_of(twin).beside
    base, innovation = twin.base_columns, twin.residual().ravel()
    some = 1e-6 * np.random.default_rng(4).normal(size=(2, 3, twin.n)).cumsum(axis=2)
    columns, new = twin.whiten(Columns(some, None)), beside.of(UnmodelledColumns(some, None))
    explained = base @ columns.T
    pull = base @ innovation + prior_of(twin)[0] * prior_of(twin)[1]
    sigma = np.sqrt(np.diag(covariance)[:13])
    moved = (covariance @ explained)[:13] / sigma[:, None]
    off = np.abs(beside.move(new) / sigma[:, None] - moved).max(axis=0)
    assert (off < 0.005 * np.abs(moved).max(axis=0)).all()
    normal = columns @ columns.T - explained.T @ covariance @ explained
    np.testing.assert_allclose(new.normal, normal, rtol=0.01, atol=0.001 * np.trace(normal))
    score = explained.T @ covariance @ pull - columns @ innovation
    np.testing.assert_allclose(new.score, score, atol=0.02 * np.sqrt(normal.trace()))
    assert (beside.of(UnmodelledColumns(*twin.columns("misalignment", {})[:2])).left_by_terms < 0.05).all()
    assert (new.left_by_terms > 0.5).all()


def test_a_value_far_from_its_prior_is_a_residual(extended: Refit) -> None:
    """The noise may rise after a fit, and the prior then weighs more than it did: the sum of squares stays positive."""
    fit = fit_of(extended.twin)
    assert fit.terms is not None
    tight = replace(fit, terms=fit.terms._replace(precision=1e6 * fit.terms.precision + 1e10))
    held = float(tight.terms.precision @ tight.terms.value**2)  # type: ignore[union-attr]
    assert 0 < tight.beside.square < fit.beside.square + held


def test_a_named_effect_is_no_model_error() -> None:
    """Scale and axes of the gyroscope, far beyond what it could be off by and not show."""
    recording = mg.simulate("wide", 200, seed=22, effects=[("gyro-scale", 3.0)]).recording
    without, within = fitted(recording), fitted(recording, "gyro-scale")
    assert {c.name for c in model_error(fit_of(without.twin)).components} & {"gyroscope:linear", "skew"}
    assert model_error(fit_of(within.twin)).components == ()


@pytest.mark.parametrize("seed", [23, 24])
def test_what_nobody_modelled_is_in_the_sigma(seed: int) -> None:
    """The gyroscope's axes turned by a degree, on a motion that hardly tilts: no name, the hard iron 1 to 2 µT off."""
    simulated = mg.simulate("moderate", 300, seed=seed)
    turn = Rotation.from_rotvec(np.radians(Rotation.random(random_state=seed).apply([1.0, 0.0, 0.0])))
    recording = replace(simulated.recording, angular_rate=turn.apply(simulated.recording.angular_rate.copy()))
    calibration = mg.find_gap(recording).calibration
    error = np.abs(calibration.hard_iron - simulated.truth.hard_iron)
    assert not calibration.trusted or (error < 3 * calibration.sigma["hard_iron"]).all()
    assert calibration.noise_covariance is not None
    noise = np.sqrt(np.diag(calibration.noise_covariance)[6:9])
    assert (calibration.sigma["hard_iron"] >= noise).all()


def test_a_current_that_follows_the_pitch_is_no_misalignment() -> None:
    """Of what moves with the sensor and is in no column of the candidates nothing is named."""
    fault = FAULTS["current-with-pitch"]
    log = record("wide", 8803, fault, fault.weak, "current-with-pitch")
    candidates = ["misalignment", "gyro-scale", "timing", "cubic", "hard-iron-drift"]
    gap = mg.find_gap(log.recording("current"), candidates=candidates)
    assert (gap.verdict, gap.names) == ("unknown", ())
    assert not gap.calibration.trusted


def test_the_model_error_of_a_named_misalignment_is_in_its_sigma() -> None:
    recording = mg.simulate("wide", 300, seed=3, effects=("misalignment",)).recording
    gap = mg.find_gap(recording, candidates=["misalignment", "gyro-scale", "timing", "cubic", "hard-iron-drift"])
    calibration = gap.calibration
    named = next(term for term in calibration.terms if term.name == "misalignment")
    effect = next(each for each in gap.effects if each.name == "misalignment")
    np.testing.assert_allclose(effect.sigma, 1e3 * named.sigma)
    assert effect.sentence in gap.sentence
    assert f"± {effect.sigma.max():.1f}" in effect.sentence
    stored = MisalignmentError.of(calibration.diagnostics)
    assert stored is not None
    np.testing.assert_allclose(stored.covariance, named.covariance, rtol=1e-9)
    for row in gap.moved:
        part, axes = row.name.rsplit(" ", 1)
        if part == "hard iron":
            assert row.sigma == pytest.approx(1e6 * calibration.sigma["hard_iron"]["xyz".index(axes)])


def test_the_sigma_of_a_misalignment_that_calibrate_takes_out_has_the_model_error() -> None:
    """By the sensors alone it was 0.09 degrees where the axes were taken to be 1.5 degrees misaligned by a current."""
    fault = FAULTS["current-with-pitch"]
    log = record("wide", 8803, fault, fault.weak, "current-with-pitch")
    calibration = mg.calibrate(log.recording("current"))
    (term,) = calibration.terms
    stored = MisalignmentError.of(calibration.diagnostics)
    assert stored is not None
    np.testing.assert_allclose(term.covariance, stored.covariance)
    assert np.degrees(term.sigma).max() > 0.5
    assert "misaligned" in calibration.message
    assert "± 0.09°" not in calibration.message


@pytest.mark.parametrize("effects", [[], [("timing", 2.0)], [("gyro-scale", 2.0)]])
def test_what_is_clean_or_named_stays_trusted_and_as_sharp(effects: list) -> None:
    gap = mg.find_gap(mg.simulate("wide", 120, seed=26, effects=effects).recording)
    assert gap.doubt is None
    assert gap.calibration.trusted
    assert judged_gap(gap).trusted
    assert gap.calibration.noise_covariance is not None
    noise = np.sqrt(np.diag(gap.calibration.noise_covariance)[6:9])
    assert (gap.calibration.sigma["hard_iron"] < 1.3 * noise).all()
    late = [term.sigma[0] for term in gap.calibration.terms if term.name == "timing"]
    assert late == pytest.approx([gap.calibration.delay_sigma] if ("timing", 2.0) in effects else [], rel=1e-12)


def test_a_gap_without_effects_asks_for_the_motion_that_its_calibration_lacks() -> None:
    gap = mg.find_gap(mg.simulate("ship", 200, seed=27, effects=["timing"]).recording)
    assert gap.verdict == "none"
    assert gap.doubt is not None
    assert gap.next_manoeuvre is not None
    assert gap.next_manoeuvre.motion == gap.doubt.action == judged_gap(gap).action


def test_a_closed_gap_whose_calibration_is_uncertain_is_not_used() -> None:
    """The field of the place goes with the attitude: to any other place the iron of it cannot be taken."""
    simulated = mg.simulate("moderate", 200, seed=27)
    recording = simulated.recording
    attitude = Rotation.from_quat(recording.attitude.copy())
    world = 2e-6 * attitude.apply([1.0, 0.5, 0.2])[:, [1, 2, 0]]
    recording = replace(recording, magnetic_field=recording.magnetic_field + attitude.inv().apply(world))
    result = widened(fitted(recording))
    calibration, doubt = judged(as_calibration(result, None), result, recording, None)
    assert doubt is not None
    assert not calibration.trusted
    clean = mg.find_gap(simulated.recording)
    gap = replace(clean, calibration=calibration, doubt=doubt)
    verdict = judged_gap(gap)
    assert (verdict.trusted, verdict.cause, verdict.title) == (False, doubt.cause, "Do not use this calibration")
    assert as_judged(gap, verdict) is gap
    assert said(doubt.sentence) in render_gap(recording, gap)
    with pytest.raises(MagycError, match="must not be trusted"):
        calibration.export("px4")


@pytest.mark.parametrize(("scale", "trusted"), [(0.3, True), (3.0, False)])
def test_what_an_effect_moves_that_is_not_corrected_is_in_the_sigma(scale: float, trusted: bool) -> None:
    """The calibration without a scale of the gyroscope, beside that with it; a large one moves it too far."""
    recording = mg.simulate("moderate", 200, seed=28, effects=(("gyro-scale", scale),)).recording
    plain, beyond = (widened(fitted(recording, *names)) for names in ((), ("gyro-scale",)))
    calibration = as_calibration(plain, None)
    alone, _ = judged(calibration, plain, recording, None)
    beside, doubt = judged(calibration, plain, recording, None, beyond)
    moved = as_calibration(beyond, None).hard_iron - calibration.hard_iron
    variance = beside.covariance[6:9, 6:9] - alone.covariance[6:9, 6:9]
    assert moved @ np.linalg.pinv(beside.covariance[6:9, 6:9]) @ moved < 1
    assert np.linalg.eigvalsh(variance)[-1] > 0
    assert (doubt is None) == beside.trusted == trusted
