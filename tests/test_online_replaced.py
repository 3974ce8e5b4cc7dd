"""A magnetometer that is turned against the gyroscope or replaced while online: not trusted, then calibrated anew."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_online import feed

from magyc_gtsam import OnlineCalibrator, simulate

AT = 200.0


def looks(recording, online=None, after=AT):
    """Return (time, whether it may be used, the calibration) at looks every 15 s after a change."""
    online, seen = online or OnlineCalibrator(), []

    def look(time):
        if time > after and time - (seen[-1][0] if seen else 0.0) >= 15.0:
            calibration = online.calibration
            seen.append((time, online.converged and calibration.trusted, calibration))

    feed(online, recording, step=2.0, after=look)
    return seen


def changed(simulation, of_field, of_rate=0.0):
    recording = simulation.recording
    later = recording.time >= AT
    field = np.where(later[:, None], of_field(recording.magnetic_field), recording.magnetic_field)
    rate = recording.angular_rate + later[:, None] * of_rate
    return replace(recording, magnetic_field=field, angular_rate=rate)


@pytest.mark.parametrize(("motion", "degrees"), [("low", 8.0), ("wide", 15.0)])
def test_a_magnetometer_that_was_turned_is_named_and_not_trusted(motion, degrees):
    simulation = simulate(motion, duration=AT + 45, seed=3)
    truth = simulation.truth
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.8, 0.0, -0.6])).as_matrix()
    whole = truth.soft_iron @ turn @ np.linalg.inv(truth.soft_iron)
    before = looks(simulation.recording)
    seen = looks(changed(simulation, lambda field: (field - truth.hard_iron) @ whole.T + truth.hard_iron))
    assert all(use for _, use, _ in before)
    assert len(seen) >= 3
    for _, use, each in seen[1:]:
        assert not use
        told = re.search(r"the magnetometer may have turned by ([\d.]+)° against the gyroscope", each.message)
        assert told is not None
        assert abs(float(told[1]) - degrees) < 0.1 * degrees
        assert each.observability.heading_sigma > degrees


def test_a_replaced_instrument_is_calibrated_anew():
    simulation = simulate("wide", duration=AT + 230, seed=5)
    truth = simulation.truth
    soft_iron = truth.soft_iron @ np.array([[1.1, 0.05, 0.0], [0.05, 0.92, 0.04], [0.0, 0.04, 1.0]])
    soft_iron = 0.5 * (soft_iron + soft_iron.T)
    hard_iron = truth.hard_iron + np.array([8e-6, -12e-6, 9e-6])
    other = soft_iron @ np.linalg.inv(truth.soft_iron)
    recording = changed(
        simulation, lambda field: (field - truth.hard_iron) @ other.T + hard_iron, np.array([6e-3, -4e-3, 5e-3])
    )
    seen = looks(recording, after=AT)
    used = [(time, each) for time, use, each in seen if use and time > AT + 20]
    assert used
    for _, each in used:
        assert (np.abs(each.hard_iron - hard_iron) < 5 * each.sigma["hard_iron"]).all()
