"""Steps in hard iron: found, timed, re-estimated; and what is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_online import feed

from magyc_gtsam import OnlineCalibrator, calibrate, read, simulate
from magyc_gtsam.estimators.smoother.fit import begin, descend
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.online.change_point import find_step, in_sensor, step_profile
from magyc_gtsam.online.restart import find_earlier_change
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record

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
    feed(online, recording, step=2.0, after=lambda t: when or (online.changes and when.append(t)))
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
    by_noise = [np.diag(each.noise_covariance)[6:9] for each in (online.calibration, alone)]
    assert (by_noise[0] < by_noise[1]).all()


def test_steel_changes_the_soft_iron_with_the_hard_iron():
    """The hard iron after it is not bent to the soft iron before it, which a step of hard iron alone keeps."""
    simulation = simulate("wide", duration=300, seed=7001)
    recording, truth = simulation.recording, simulation.truth
    steel = np.eye(3) + np.array([[0.02, 0.01, -0.02], [0.01, -0.03, 0.01], [-0.02, 0.01, 0.02]])
    field = recording.magnetic_field.copy()
    later = recording.time >= 200
    expected = truth.hard_iron + np.array([1.0, 2.0, -1.0]) * MICROTESLA
    field[later] = (field[later] - truth.hard_iron) @ steel.T + expected
    online = feed(OnlineCalibrator(), replace(recording, magnetic_field=field))
    assert len(online.changes) == 1
    assert online.calibration.trusted
    off = online.calibration.hard_iron - expected
    assert (np.abs(off) < 3 * online.calibration.sigma["hard_iron"]).all()
    assert np.linalg.norm(off) < 0.3 * MICROTESLA
    iron, true = online.calibration.soft_iron, steel @ truth.soft_iron
    squares = [
        each @ each.T / np.cbrt(np.linalg.det(each)) ** 2 for each in (iron, true)
    ]  # as far as it is symmetric
    assert np.abs(squares[0] - squares[1]).max() < 0.01


def test_a_step_that_is_recognised_late_is_timed_all_the_same():
    """For half a minute it may also be the field of another place; meanwhile the tail does not let go of it."""
    random = np.random.default_rng(3092)
    at, step = random.uniform(200, 250), random.standard_normal(3)
    step *= 2e-6 / np.linalg.norm(step)
    when = []
    online = OnlineCalibrator()
    recording = with_step(simulate("low", duration=290, seed=3092), at, step)
    feed(online, recording, step=1.0, after=lambda t: when or (online.changes and when.append(t)))
    assert when[0] > at + 20
    change = online.changes[0]
    assert abs(change.time - at) < 3 * change.time_sigma < 6
    assert (np.abs(change.step - step) < 4 * change.step_sigma).all()


def test_a_place_with_another_field_is_no_step():
    """The field changes for good, but stands still in the world."""
    simulation = simulate("wide", duration=220, seed=2)
    recording, truth = simulation.recording, simulation.truth
    offset = Rotation.from_quat(recording.attitude).inv().apply([2e-6, -1e-6, 2e-6])
    placed = np.where(recording.time[:, None] > 130, offset @ truth.soft_iron.T, 0.0)
    online = feed(OnlineCalibrator(), replace(recording, magnetic_field=recording.magnetic_field + placed))
    assert online.changes == ()


def test_a_disturbance_that_passes_is_no_step():
    simulation = simulate("wide", duration=220, seed=3)
    recording = simulation.recording
    passing = ((recording.time > 130) & (recording.time < 133))[:, None] * np.array([20e-6, -10e-6, 5e-6])
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
    fit = fit_field_chain(recording, delay=0.0, robust=False)
    chain = ContinuedChain(fit.chain.windows, fit.chain.noise)
    fit = descend(replace(fit, chain=chain, reduced=chain.eliminate(fit.state, fit.weights)), 1e-12)
    weights = chain.unweighted()
    reduced = chain.eliminate(fit.state, weights)
    profile = step_profile(chain, fit.state, weights, reduced, in_sensor(len(chain.windows)))
    ratio, step, _ = profile.at_windows()
    n = int(np.argmax(ratio))
    part, inside, _ = profile.inside(np.full(3, n - 1), np.array([0.0, 0.4, 1.0]))
    assert part[0] == pytest.approx(ratio[n], rel=1e-9)
    assert part[2] == pytest.approx(ratio[n - 1], rel=1e-9)
    for window, share, value, gain in ((n - 1, 0.0, step[n], ratio[n]), (n - 1, 0.4, inside[1], part[1])):
        moved = chain.windows.field.copy()
        moved[:, window] -= share * value
        moved[:, window + 1 :] -= value[:, None]
        two = ContinuedChain(replace(chain.windows, field=moved), fit.chain.noise)
        without = descend(begin(two, fit.state.parameters, fit.free), 1e-12)
        assert 2 * (fit.reduced.cost - without.reduced.cost) == pytest.approx(gain, rel=0.02)


@pytest.mark.parametrize("at", [59.97, 60.4, 60.93])
def test_a_step_is_timed_within_its_window(at):
    """Wherever in its window it happens, and the window leaves no trace in the fits of both sides."""
    simulation = simulate("wide", duration=120, seed=6)
    step = np.array([5e-6, -3e-6, 4e-6])
    fit = fit_field_chain(with_step(simulation, at, step), delay=0.0)
    chain = ContinuedChain(fit.chain.windows, fit_field_chain(simulation.recording).chain.noise)
    found, *_ = find_step(replace(fit, chain=chain))
    assert found.time == pytest.approx(at, abs=0.3)
    assert abs(found.time - at) < 4 * found.time_sigma
    assert found.time_sigma < 0.12
    assert (np.abs(found.value - step) < 4 * found.sigma).all()


def test_a_log_that_fits_from_a_step_on():
    """The end's calibration is known; since when it holds, and what was before."""
    simulation = simulate("wide", duration=200, seed=7)
    step = np.array([10e-6, -20e-6, 15e-6])
    recording = with_step(simulation, 60, step)
    fit = fit_field_chain(recording.between(100, None))
    whole = fit_field_chain(recording, start=fit.state.parameters)
    chain = ContinuedChain(whole.chain.windows, fit.chain.noise)
    found = find_earlier_change(chain, fit.state.parameters)
    assert found.time == pytest.approx(60, abs=2)
    assert found.in_sensor
    assert (np.abs(found.step - step) < 5 * found.sigma).all()
    offset = Rotation.from_quat(simulation.recording.attitude).inv().apply([10e-6, -5e-6, 10e-6])
    placed = np.where(simulation.recording.time[:, None] < 60, offset, 0.0)
    whole = fit_field_chain(
        replace(simulation.recording, magnetic_field=simulation.recording.magnetic_field + placed)
    )
    chain = ContinuedChain(whole.chain.windows, fit.chain.noise)
    clean = fit_field_chain(simulation.recording)
    assert not find_earlier_change(chain, clean.state.parameters).in_sensor
    assert (
        find_earlier_change(ContinuedChain(clean.chain.windows, clean.chain.noise), clean.state.parameters) is None
    )


def test_a_step_of_the_size_of_the_field_is_found():
    """It is far from linear, and must not be rejected as a disturbance for what the first estimate leaves of it."""
    step = np.array([7.7, -42.3, -25.6]) * MICROTESLA
    simulation = simulate("low", duration=400, seed=100)
    online = feed(OnlineCalibrator(), with_step(simulation, 363.6, step))
    (change,) = online.changes
    assert abs(change.time - 363.6) < 0.1 + 4 * change.time_sigma
    assert (np.abs(change.step - step) < 5 * change.step_sigma).all()


def test_no_fit_of_all_windows_comes_between_a_step_and_its_decision():
    """A refit falls due between the two; over two hard irons it would take the convergence, and the step with it."""
    simulation = simulate("wide", duration=280, seed=101)
    rng = np.random.default_rng([101, 50, 50])
    step = rng.standard_normal(3)
    step *= 50e-6 / np.linalg.norm(step)
    online = feed(OnlineCalibrator(), with_step(simulation, 202.5, step))
    (change,) = online.changes
    assert abs(change.time - 202.5) < 0.1 + 4 * change.time_sigma
    assert (np.abs(change.step - step) < 5 * change.step_sigma).all()


def test_nothing_is_trusted_while_a_large_step_is_possible():
    """All samples together would give a mean of the hard irons before and after it."""
    told = []

    def look(time):
        if time > 150 and "may have changed" in online.progress.sentence:
            told.append(online.converged or online.progress.converged or online.calibration.converged)

    step = np.random.default_rng(6005).standard_normal(3)
    step *= 30e-6 / np.linalg.norm(step)
    online = OnlineCalibrator()
    feed(online, with_step(simulate("moderate", duration=175, seed=6005), 150.0, step), step=2.0, after=look)
    assert len(online.changes) == 1
    assert told
    assert not any(told)


def test_a_fit_that_follows_one_that_did_not_fit_is_not_converged():
    """Readings that wrap leave several minima; in one log a trusted fit, 5 µT off, follows one that does not fit."""
    fault = FAULTS["wrapping-full-scale"]
    log = record("wide", 35008, fault, fault.strong, "wrapping-full-scale")
    assert not feed(OnlineCalibrator(), log.recording("wraps")).converged


@pytest.fixture(scope="module")
def magnet(shared_data):
    """A recording, and its calibrations with a magnet and without."""
    recording = read(shared_data / "broad_32_attached_magnet_1cm.mcap")
    return recording, calibrate(recording.between(41.5, 92)), calibrate(recording.between(95, None))


@pytest.mark.real
def test_a_magnet_attached_by_hand_and_taken_off(magnet):
    """Before anything has converged, and again when it has."""
    recording, with_magnet, without = magnet
    start = recording.time[0]
    online = feed(OnlineCalibrator(), recording)
    attached, removed = online.changes
    # With the optical attitude, the magnet's field is seen to rise at 38.1 s, after 37.7 and up to 40.3 s, and to
    # fall at 95.0 s, from 94.1 s to 95.5 s.
    assert attached.time - start == pytest.approx(38.1, abs=0.6)
    assert removed.time - start == pytest.approx(95.0, abs=0.6)
    assert (np.abs(attached.step / MICROTESLA - [-6, -1, 58]) < 3 * attached.step_sigma / MICROTESLA).all()
    np.testing.assert_allclose(removed.step / MICROTESLA, [6, 1, -58], atol=3)
    np.testing.assert_allclose(removed.before.hard_iron, with_magnet.hard_iron, atol=1e-6)
    np.testing.assert_allclose(online.calibration.hard_iron, without.hard_iron, atol=1e-6)
