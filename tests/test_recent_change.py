"""Readings just after a change of the instrument, before it is found, and a change at the end of a log."""

from __future__ import annotations

import numpy as np
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from magyc_gtsam import OnlineCalibrator, Recording, calibrate, simulate
from magyc_gtsam.estimators.model_error.recent_change import RECENT, recent_change
from magyc_gtsam.simulation import HARD_IRON
from magyc_gtsam.study.faults.signals import record

CHANGED = 240.0  # s


def readings(seed):
    """Return of each (time since the change, largest error of the soft iron and error of the misalignment in sigmas,
    whether a change is named).
    """
    simulation = simulate("wide", duration=260, seed=seed)
    recording, truth = simulation.recording, simulation.truth
    steel = np.eye(3) + np.random.default_rng(seed).normal(0, 0.03, (3, 3))
    field, later = recording.magnetic_field.copy(), recording.time >= CHANGED
    field[later] = (field[later] - truth.hard_iron) @ steel.T + truth.hard_iron
    online, result = OnlineCalibrator(), []
    for first in range(0, len(recording.time), 20):
        rows = slice(first, first + 20)
        online.update(recording.time[rows], field[rows], recording.angular_rate[rows])
        now = recording.time[rows][-1] - CHANGED
        if now < -12 or not online.converged:
            continue
        calibration = online.calibration
        expected = steel @ truth.soft_iron if now > 0 else truth.soft_iron
        squares = [each @ each.T / np.cbrt(np.linalg.det(each)) ** 2 for each in (calibration.soft_iron, expected)]
        off = np.abs(squares[0] - squares[1]).max() / (2 * calibration.sigma["soft_iron"].max())
        turned = Rotation.from_matrix(polar(expected, "left")[0]).as_rotvec()
        found = next((-term.value for term in calibration.terms if term.name == "misalignment"), np.zeros(3))
        spread = np.trace(calibration.diagnostics["skew"]["covariance"])
        misaligned = np.linalg.norm(turned - found) / np.sqrt(spread)
        named = [each["name"] for each in calibration.diagnostics["model_error"]["components"]]
        result.append((now, off, misaligned, "recent change" in named))
    return result


def test_the_sigmas_cover_most_of_a_change_of_the_soft_iron_that_is_not_yet_found():
    """Of 116 looks at 24 changes 13 are beyond three sigmas, the worst at 15: a look may still believe the iron before.

    Without the widening all are at 7 to 15, without the turn in it the misalignment is off by 14 to 50.
    """
    every = [reading for seed in range(9200, 9202) for reading in readings(seed)]
    before = [named for now, _, _, named in every if now < 0]
    after = np.array([both for now, *both, _ in every if now > 5])
    assert len(before) > 6
    assert not any(before)
    assert len(after) > 4
    assert np.median(after, axis=0).max() < 1.5
    assert (after > 3).any(axis=1).mean() < 0.3


def test_a_change_does_not_hide_behind_the_correlation_that_it_causes_in_a_short_tail():
    """With the correlation of the tail its probability was 0.008, and with that of the last refit it is 0.9."""
    log = record("moderate", 940, duration=260.0)
    steel = np.eye(3) + 0.03 * np.array([[0.3, -0.9, 0.2], [0.8, -0.4, 0.6], [-0.7, 0.9, 0.5]])
    later = log.field_time > 250.0
    field = np.where(later[:, None], (log.field - HARD_IRON) @ steel.T + HARD_IRON, log.field)
    online = OnlineCalibrator(horizon=120.0)
    for first in range(0, len(field), 50):
        rows = slice(first, first + 50)
        online.update(log.field_time[rows], field[rows], log.rate[rows])
    engine = online._engine._online
    fit = engine.fit_tail(int(engine.buffer.numbers[-1]) + 1)
    assert engine.belief.past is not None
    assert fit.colour > 2 * engine.last.colour
    assert recent_change(fit, engine.last.colour).share > 0.5
    named = {each["name"] for each in online.calibration.diagnostics["model_error"]["components"]}
    assert "recent change" in named


def test_at_the_end_of_a_log_a_turn_of_the_magnetometer_is_looked_for_as_online():
    """Turned about the vertical, one link only is rejected, and the calibration from before was kept."""
    simulated = simulate("wide", 300, 20, seed=0, magnetometer_noise=3e-7, gyroscope_noise=1e-3).recording
    for angle, found in ((np.radians(6.0), 1), (0.0, 0)):
        turn = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        late = (simulated.time > 255)[:, None]
        field = np.where(late, simulated.magnetic_field @ turn.T, simulated.magnetic_field)
        calibration = calibrate(Recording(simulated.time, field, simulated.angular_rate))
        names = [each["name"] for each in calibration.diagnostics["model_error"]["components"]]
        assert names.count(RECENT) == found
        assert calibration.trusted == (not found)
