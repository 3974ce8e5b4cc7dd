"""An earlier calibration, online as in the batch: on motions too small to do without."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.recording import Recording


def fed(recording: Recording, **options: object) -> mg.OnlineCalibrator:
    """Every row, 20 s at a time."""
    online = mg.OnlineCalibrator(**options)
    for i in range(0, len(recording.time), 200):
        rows = slice(i, i + 200)
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
    return online


@pytest.fixture(scope="module")
def earlier() -> mg.Calibration:
    return mg.calibrate(mg.simulate("wide", 600, seed=11).recording)


@pytest.mark.parametrize(
    "options", [{}, {"hard_iron_walk": 0.3e-6}, {"horizon": 200.0}, {"hard_iron_drift": 0.1e-6}]
)
def test_it_ends_as_in_the_batch(earlier: mg.Calibration, options: dict[str, float]) -> None:
    simulation = mg.simulate("tiny", 240, seed=12)
    online = fed(simulation.recording, prior=earlier, **options).calibration
    walk = options.get("hard_iron_walk", 0.0)
    batch = mg.calibrate(simulation.recording, prior=earlier, hard_iron_walk=walk)
    alone = mg.calibrate(simulation.recording)
    off = (online.hard_iron - batch.hard_iron) / batch.sigma["hard_iron"]
    exact = set(options) <= {"hard_iron_walk"}
    assert np.abs(off).max() < (0.1 if exact else 1.0)
    np.testing.assert_allclose(online.sigma["hard_iron"], batch.sigma["hard_iron"], rtol=0.05 if exact else 0.6)
    assert online.sigma["hard_iron"][2] < 0.7 * alone.sigma["hard_iron"][2]
    error = (online.hard_iron - simulation.truth.hard_iron) / online.sigma["hard_iron"]
    assert np.abs(error).max() < 4


def test_it_is_kept_with_the_state(earlier: mg.Calibration, tmp_path: Path) -> None:
    recording = mg.simulate("low", 120, seed=3).recording
    online = fed(recording, prior=earlier)
    online.save(tmp_path / "state.npz")
    again = mg.OnlineCalibrator.load(tmp_path / "state.npz")
    assert again.calibration.to_dict() == online.calibration.to_dict()
    assert again.options == online.options
    assert mg.Calibration.from_dict(again.options["prior"]).to_dict() == earlier.to_dict()


@functools.cache
def in_tesla() -> tuple[float, mg.Calibration]:
    """The field's strength, and a calibration by it."""
    simulation = mg.simulate("wide", seed=998)
    strength = simulation.truth.field_strength
    return strength, mg.calibrate(simulation.recording, field_strength=strength)


@pytest.mark.parametrize(("moved", "factor"), [(0.0, 1.0), (3e-6, 1.0), (0.0, 1.1)])
def test_what_contradicts_it_is_said_as_in_the_batch(moved: float, factor: float) -> None:
    """On a ship a strength that is wrong by 10 % moves the hard iron by 6 µT, a wrong hard iron stays as it is."""
    strength, scaled = in_tesla()
    recording = mg.simulate("ship", seed=9, hard_iron=scaled.hard_iron + np.array([0, moved, 0])).recording
    options = {"prior": scaled, "field": (factor * strength, None), "misalignment": 0.0}
    options |= {} if moved else {"hard_iron_walk": 50e-6}
    online, batch = fed(recording, **options).calibration, mg.calibrate(recording, **options)
    assert online.trusted == batch.trusted == (not moved and factor == 1.0), online.message
    said = ["the data contradict the earlier"] * bool(moved) + ["µT at the place"] * (factor != 1.0)
    assert all(words in each.message for words in said for each in (online, batch))


def test_after_a_step_it_holds_no_more(earlier: mg.Calibration) -> None:
    simulation = mg.simulate("wide", 320, seed=4)
    recording, step = simulation.recording, np.array([8e-6, -6e-6, 5e-6])
    field = recording.magnetic_field + np.outer(recording.time > 180, step)
    online = fed(Recording(recording.time, field, recording.angular_rate), prior=earlier)
    (change,) = online.changes
    np.testing.assert_allclose(change.step, step, atol=1e-6)
    error = (online.calibration.hard_iron - simulation.truth.hard_iron - step) / online.calibration.sigma[
        "hard_iron"
    ]
    assert np.abs(error).max() < 4


def test_what_is_no_prior_is_refused() -> None:
    with pytest.raises(mg.MagycError, match="hard_iron_walk: must be a finite number of at least 0, got -1"):
        mg.OnlineCalibrator(hard_iron_walk=-1)
    with pytest.raises(mg.MagycError, match="prior: an earlier Calibration is needed, got float"):
        mg.OnlineCalibrator(prior=1.0)
    with pytest.raises(mg.MagycError, match="hard_iron_walk=: .* give that calibration too .prior=."):
        mg.OnlineCalibrator(hard_iron_walk=1e-6)
