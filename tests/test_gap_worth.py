"""The field of the place as variance components, and what is named and not corrected beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam import metrics
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.field_variation import field_variation, functions_of_attitude
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import refit, widened, with_term
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.outcome.worth import expected, pays, predicted


def twin_of(recording: mg.Recording) -> Twin:
    """The base model at the sensors' own noise."""
    short_term = short_term_noise(recording)
    base = base_model(recording, None, short_term)
    return refit(base.twin.problem, replace(base.model, noise=short_term), None).twin


def in_a_room(seed: int, level: float, **sensor: float) -> mg.Recording:
    """A field that wanders over some ten seconds along the way, in the world's axes."""
    simulation = mg.simulate("wide", 120, seed=seed, **sensor)
    recording = simulation.recording
    assert recording.attitude is not None
    steps = np.random.default_rng(seed).standard_normal((len(recording.time), 3))
    world, pole = np.zeros_like(steps), np.exp(-0.1 / 10.0)
    for k in range(1, len(steps)):
        world[k] = pole * world[k - 1] + np.sqrt(1 - pole**2) * steps[k]
    added = Rotation.from_quat(recording.attitude).inv().apply(level * world) @ simulation.truth.soft_iron.T
    return replace(recording, magnetic_field=recording.magnetic_field + added)


def test_a_field_that_stands_is_not_said_to_vary() -> None:
    for motion in ("wide", "moderate"):
        found = [field_variation(twin_of(mg.simulate(motion, 120, seed=s).recording)) for s in range(400, 404)]
        assert not any(one.evident for one in found)
        assert max(one.noise for one in found) < 1.1


def test_a_field_that_varies_is_sized() -> None:
    """The process of 1.5 µT is found to a factor of two, and what it leaves is white."""
    sizes = []
    for seed in range(500, 504):
        twin = twin_of(in_a_room(seed, 1.5e-6))
        found = field_variation(twin)
        assert found.evident
        sizes.append(found.along)
        base = np.linalg.qr(found.whiten(twin.base_columns).T)[0]
        v = found.whiten(twin.residual().reshape(1, -1))[0]
        v = v - base @ (base.T @ v)
        assert (v @ v) / (len(v) - 12) == pytest.approx(1.0, abs=0.15)
    assert 0.75e-6 < np.median(sizes) < 3e-6


def test_the_whitening_is_that_of_the_covariance() -> None:
    """M^½ M^½ is the inverse of ρ² (I + Z Λ Zᵀ), whatever rows it is applied to."""
    found = field_variation(twin_of(in_a_room(505, 1.5e-6)))
    components = found.components
    rows = np.random.default_rng(0).standard_normal((3, components.shape[1]))
    inner = found.whiten(rows) @ found.whiten(rows).T
    inside = rows @ components.T
    small = np.eye(len(components)) + components @ components.T
    direct = (rows @ rows.T - inside @ np.linalg.solve(small, inside.T)) / found.noise**2
    np.testing.assert_allclose(inner, direct, rtol=1e-9)


def test_functions_of_attitude_span_a_smooth_process() -> None:
    """Of unit variance wherever the sensor was turned to, and fewer for a motion that turns less."""
    wide, tiny = (
        functions_of_attitude(twin_of(mg.simulate(motion, 120, seed=2).recording).windows.need("to_sensor"))
        for motion in ("wide", "tiny")
    )
    assert (wide**2).sum(axis=0).mean() == pytest.approx(1.0, abs=0.1)
    assert len(tiny) < 0.5 * len(wide)


def test_what_is_there_pays_and_what_is_not_does_not() -> None:
    """A delay of 0.3 s in a room, and a bent reading that is none; of four seeds each."""
    right = {"timing": 0, "cubic": 0}
    for seed in range(510, 514):
        recording = in_a_room(seed, 1.5e-6, delay=0.3)
        short_term = short_term_noise(recording)
        base = base_model(recording, None, short_term)
        late = with_term(base.model, Active("timing", {}, np.zeros(1)))
        one = widened(refit(base.twin.problem, late, short_term))
        variation = field_variation(one.twin)
        right["timing"] += pays(one, widened(base), 0, variation)
        two = widened(refit(base.twin.problem, with_term(one.model, Active("cubic", {}, np.zeros(3))), short_term))
        right["cubic"] += not pays(two, one, 1, variation)
        assert min(predicted(one, 0, variation)) > min(predicted(two, 1, variation))
        assert expected(one, widened(base), 0) > 0
    assert right == {"timing": 4, "cubic": 4}


def test_a_lead_is_no_plate() -> None:
    twin = twin_of(mg.simulate("wide", 100, seed=1).recording)
    possible = TERMS["eddy-plane"].possible
    across = {"x": 0.0, "y": 0.0, "z": 1.0}
    assert possible(twin, np.array([0.0, 0.0, 5e-3]), across)
    assert not possible(twin, np.array([0.0, 0.0, -5e-3]), across)


@pytest.mark.real
def test_a_misalignment_of_half_a_walk_is_not_corrected(shared_data) -> None:  # type: ignore[no-untyped-def]
    """It would take the heading of the other half from 3.4° to 4.6°; the delay is corrected, and hurts neither half.

    Nor does the scale of the gyroscope of the second half, which optics bear out in part.
    """
    recording = mg.read(shared_data / "nexus5_augmented_reality.mcap")
    assert recording.attitude is not None
    half = 0.5 * recording.duration
    parts = recording.between(None, half), recording.between(half, None)
    for part, other in (parts, parts[::-1]):
        gap = mg.find_gap(part, candidates=["timing", "misalignment", "gyro-scale", "eddy-plane"])
        assert not any(e.applied for e in gap.effects if e.name == "misalignment")
        assert gap.before.heading is not None
        assert gap.after.heading is not None
        assert gap.after.heading < 1.02 * gap.before.heading
        assert other.attitude is not None
        known = np.isfinite(other.attitude).all(axis=1) & other.magnetic_field_fresh
        before, after = (
            metrics.heading_deviation(one.apply(other)[known], other.attitude[known])
            for one in (gap.base, gap.calibration)
        )
        assert after < 1.05 * before


def test_many_logs_in_rooms_tell_the_room_from_the_instrument() -> None:
    logs = [
        replace(in_a_room(seed, 1.5e-6, delay=0.3), attitude=None, name=f"room {seed}") for seed in range(510, 513)
    ]
    gap = mg.find_gap(logs, candidates=["timing", "misalignment", "hard-iron-drift", "local-anomaly"])
    assert [(effect.name, effect.of) for effect in gap.effects] == [
        ("field-variation", "place"),
        ("timing", "instrument"),
    ]
    assert gap.verdict == "closed"
    room, late = gap.effects
    assert all(0.7 < log.value[0] < 3 and log.present <= 1 for log in room.logs)  # µT
    assert abs(late.value[0] - 300) < 3 * late.sigma[0]
