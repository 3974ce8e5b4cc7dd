"""Steps in hard iron: found, timed, re-estimated; and what is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_online import feed

from magyc_gtsam import OnlineCalibrator, calibrate, read, simulate
from magyc_gtsam.estimators.chain_fit import begin, descend
from magyc_gtsam.estimators.chain_search import fit_field_chain
from magyc_gtsam.online.retrospect import find_beginning
from magyc_gtsam.online.steps import in_sensor, likelihood_ratio
from magyc_gtsam.online.summary import ContinuedChain

MICROTESLA = 1e-6


def with_step(simulation, at, step):
    recording = simulation.recording
    return replace(recording, magnetic_field=recording.magnetic_field + (recording.time >= at)[:, None] * step)


@pytest.mark.parametrize(
    ("motion", "at", "step"),
    [
        ("wide", 151.3, (1.2, -1.5, 0.6)),
        ("moderate", 200.0, (0.0, 0.0, 2.0)),
        ("tiny", 140.7, (-30.0, 4.0, 25.0)),
    ],
)
def test_a_step_is_found_timed_and_estimated(motion, at, step):
    step = np.array(step) * MICROTESLA
    simulation = simulate(motion, duration=400, seed=1)
    recording = with_step(simulation, at, step)
    when = []
    online = OnlineCalibrator()
    feed(online, recording, step=1.0, after=lambda t: when.append(t) if online.changes else None)
    assert len(online.changes) == 1
    change = online.changes[0]
    assert when[0] < at + 30
    assert abs(change.time - at) < 1.5 + 3 * change.time_sigma
    assert (np.abs(change.step - step) < 5 * change.step_sigma).all()
    truth = simulation.truth.hard_iron
    for calibration, expected in ((change.before, truth), (change.after, truth + step)):
        assert calibration.converged
        assert (np.abs(calibration.hard_iron - expected) < 5 * calibration.sigma["hard_iron"]).all()
    assert online.converged
    # What was known before the step of all else still helps.
    alone = calibrate(recording.between(at, None))
    assert (online.calibration.sigma["hard_iron"] < alone.sigma["hard_iron"]).all()


def test_a_place_with_another_field_is_no_step():
    """The field changes for good, but stands still in the world."""
    simulation = simulate("wide", duration=300, seed=2)
    recording, truth = simulation.recording, simulation.truth
    offset = Rotation.from_quat(recording.attitude).inv().apply([2e-6, -1e-6, 2e-6])
    placed = np.where(recording.time[:, None] > 150, offset @ truth.soft_iron.T, 0.0)
    online = feed(OnlineCalibrator(), replace(recording, magnetic_field=recording.magnetic_field + placed))
    assert online.changes == ()


def test_a_disturbance_that_passes_is_no_step():
    simulation = simulate("wide", duration=300, seed=3)
    recording = simulation.recording
    passing = ((recording.time > 150) & (recording.time < 153))[:, None] * np.array([20e-6, -10e-6, 5e-6])
    online = feed(OnlineCalibrator(), replace(recording, magnetic_field=recording.magnetic_field + passing))
    assert online.changes == ()
    error = np.abs(online.calibration.hard_iron - simulation.truth.hard_iron)
    assert (error < 5 * online.calibration.sigma["hard_iron"]).all()


def test_changes_are_not_looked_for_where_none_are_wanted():
    simulation = simulate("wide", duration=200, seed=1)
    online = feed(OnlineCalibrator(detect_changes=False), with_step(simulation, 120, [5e-6, 0, 0]))
    assert online.changes == ()


def test_the_likelihood_ratio_is_the_gain_of_a_fit_with_the_step():
    """λ of the true step against the cost that a chain of two hard irons saves; a small step, so that all is linear."""
    simulation = simulate("wide", duration=120, seed=5)
    recording = with_step(simulation, 60, np.array([0.6e-6, -0.3e-6, 0.2e-6]))
    fit, _ = fit_field_chain(recording, delay=0.0, robust=False)
    chain = ContinuedChain(fit.chain.windows, fit.chain.noise)
    fit = descend(replace(fit, chain=chain, reduced=chain.eliminate(fit.state, fit.weights)), 1e-12)
    ratio, step, _ = likelihood_ratio(
        chain, fit.state, chain.eliminate(fit.state, chain.unweighted()), in_sensor(len(chain.windows))
    )
    n = int(np.argmax(ratio))
    moved = chain.windows.field.copy()
    moved[:, n:] -= step[n][:, None]
    two = ContinuedChain(replace(chain.windows, field=moved), fit.chain.noise)
    without = descend(begin(two, fit.state.parameters, fit.free), 1e-12)
    assert 2 * (fit.reduced.cost - without.reduced.cost) == pytest.approx(ratio[n], rel=0.02)


def test_a_log_that_fits_from_a_step_on():
    """The end's calibration is known; since when it holds, and what was before."""
    simulation = simulate("wide", duration=200, seed=7)
    step = np.array([10e-6, -20e-6, 15e-6])
    recording = with_step(simulation, 60, step)
    fit, _ = fit_field_chain(recording.between(100, None))
    whole, _ = fit_field_chain(recording, start=fit.state.parameters)
    chain = ContinuedChain(whole.chain.windows, fit.chain.noise)
    found = find_beginning(chain, fit.state.parameters)
    assert found.time == pytest.approx(60, abs=2)
    assert (np.abs(found.step - step) < 5 * found.sigma).all()
    clean, _ = fit_field_chain(simulation.recording)
    assert find_beginning(ContinuedChain(clean.chain.windows, clean.chain.noise), clean.state.parameters) is None


@pytest.mark.real
def test_a_magnet_attached_by_hand_and_taken_off(shared_data):
    recording = read(shared_data / "broad_32_attached_magnet_1cm.mcap")
    online = feed(OnlineCalibrator(), recording, step=2.0)
    attached, removed = online.changes
    start = recording.time[0]
    assert attached.time - start == pytest.approx(41.5, abs=5)
    assert removed.time - start == pytest.approx(92, abs=4)
    assert (np.abs(attached.step / MICROTESLA - [-6, -1, 58]) < 3 * attached.step_sigma / MICROTESLA).all()
    np.testing.assert_allclose(removed.step / MICROTESLA, [6, 1, -58], atol=3)
    with_magnet, without = calibrate(recording.between(41.5, 92)), calibrate(recording.between(95, None))
    np.testing.assert_allclose(removed.before.hard_iron, with_magnet.hard_iron, atol=1e-6)
    np.testing.assert_allclose(online.calibration.hard_iron, without.hard_iron, atol=1e-6)
