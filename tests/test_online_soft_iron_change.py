"""A change of the soft iron with a step in hard iron: estimated if it is probable, and covered if it is possible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_online import feed

import magyc_gtsam.online.refit as refits
from magyc_gtsam import MagycError, OnlineCalibrator, simulate
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain, fitted
from magyc_gtsam.estimators.smoother.skew import skew_prior_fact, widened
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC
from magyc_gtsam.online.soft_iron_change import _beside, _columns, soft_iron_change

AT = 400.0  # s
STEP = np.array([1.8, -2.0, 1.4]) * 1e-6
# Steel need not be symmetric: this one turns the field by 1.2°.
STEEL = np.array([[-0.02, 0.015, -0.01], [-0.015, 0.02, 0.02], [0.01, -0.02, -0.01]])


def changed(motion, seed, steel, duration=700):
    """Return a recording with a step in hard iron and another soft iron from `AT` on, and the hard iron from then."""
    simulation = simulate(motion, duration=duration, seed=seed)
    recording, truth = simulation.recording, simulation.truth
    field, later = recording.magnetic_field.copy(), recording.time >= AT
    expected = truth.hard_iron + STEP
    field[later] = (field[later] - truth.hard_iron) @ (np.eye(3) + steel).T + expected
    return replace(recording, magnetic_field=field), expected


def looks(motion, seed, steel):
    """Return (n, 3) the error of the hard iron in sigmas at each look that is in use, the run, and its last change."""
    recording, expected = changed(motion, seed, steel)
    online, off = OnlineCalibrator(), []
    for first in range(0, len(recording.time), 100):
        rows = slice(first, first + 100)
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
        if recording.time[rows][-1] > AT + 60 and online.converged and online.calibration.trusted:
            off.append((online.calibration.hard_iron - expected) / online.calibration.sigma["hard_iron"])
    return np.array(off), online, online._engine._online.belief.iron_change


@pytest.mark.parametrize(("motion", "seed"), [("moderate", 1300), ("tiny", 1305)])
def test_the_hard_iron_does_not_absorb_a_change_of_the_soft_iron(motion, seed):
    off, online, _ = looks(motion, seed, STEEL)
    assert len(online.changes) == 1
    assert len(off) > 10
    assert np.abs(off).max() < 3


@pytest.mark.parametrize(("motion", "seed"), [("moderate", 1300), ("tiny", 1305)])
def test_a_step_of_the_hard_iron_alone_keeps_the_soft_iron_before_it(motion, seed):
    off, online, change = looks(motion, seed, np.zeros((3, 3)))
    assert np.abs(off).max() < 3
    assert change.share < 0.1
    added = np.diag(change.covariance)[6:9]
    assert (added < 0.04 * online.calibration.sigma["hard_iron"] ** 2).all()


def engine_after(steel, duration=AT + 60):
    recording, _ = changed("moderate", 1300, steel, duration)
    online = feed(OnlineCalibrator(), recording)
    assert online.changes
    return online, online._engine._online


def test_the_closed_form_is_the_fit_with_a_widened_past():
    """Its mean and covariance are those of the fit that the widened marginal gives, within their linearisation."""
    _, engine = engine_after(0.3 * STEEL)
    belief, size = engine.belief, 0.02
    recording = engine.recording(belief.done)
    fit, _ = refits.fit_samples(engine, recording, False)
    columns = _columns(fit)
    information, gradient, moves = _beside(fit, fit.chain, columns)
    spread = np.linalg.inv(information + np.eye(9) / size**2)
    held = widened(fit, AUTOMATIC)
    other = replace(fit.chain, past=fit.chain.past.changed(size * columns))
    prior = (skew_prior_fact(AUTOMATIC.widest),)

    def of(chain):
        assert isinstance(chain, ContinuedChain)
        return fitted(replace(chain, facts=prior), held.state.parameters, held.free, reject=False)

    before, after = of(fit.chain), of(other)
    moved = after.state.parameters - before.state.parameters
    expected, covariance = -moves @ spread @ gradient, moves @ spread @ moves.T
    sigma = np.sqrt(np.diag(after.covariance))
    assert np.abs(moved[:9] / sigma[:9]).max() > 0.3
    assert np.abs((moved - expected) / sigma).max() < 0.1
    grown = np.diag(after.covariance) - np.diag(before.covariance)
    np.testing.assert_allclose(np.diag(covariance)[:9], grown[:9], rtol=0.1, atol=0.02 * sigma[:9].min() ** 2)


def test_a_past_without_a_soft_iron_is_not_tested():
    _, engine = engine_after(STEEL)
    fit, _ = refits.fit_samples(engine, engine.recording(engine.belief.done), False)
    assert soft_iron_change(fit, 1.0) is not None
    assert (
        soft_iron_change(replace(fit, chain=replace(fit.chain, past=fit.chain.past.forget(slice(0, 6)))), 1.0)
        is None
    )


def test_the_state_holds_the_possible_change(tmp_path):
    online, engine = engine_after(0.3 * STEEL)
    assert engine.belief.iron_change is not None
    online.save(tmp_path / "online.npz")
    again = OnlineCalibrator.load(tmp_path / "online.npz")
    assert (again.calibration.covariance == online.calibration.covariance).all()


def test_a_refit_after_a_step_that_fails_is_tried_again(monkeypatch):
    """The estimate was dropped and the past kept, so that the next refit ended with an internal error."""
    recording, _ = changed("moderate", 1300, STEEL, AT + 100)
    online, failed, fit_samples = OnlineCalibrator(), [], refits.fit_samples

    def failing(engine, *given):
        if engine.belief.past is not None and not failed:
            failed.append(engine.belief.done)
            raise MagycError("a window's direction has no finite curvature")
        return fit_samples(engine, *given)

    monkeypatch.setattr(refits, "fit_samples", failing)
    feed(online, recording)
    assert failed
    assert online.calibration is not None
