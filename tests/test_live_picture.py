"""The next move, and what a run shows of itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.live.next_move import next_move
from magyc_gtsam.live.picture import Picture
from magyc_gtsam.live.source import NewSamples, none
from magyc_gtsam.observability import cell_of, cells
from magyc_gtsam.recording import Samples
from magyc_gtsam.simulation import simulate


def flown(now: np.ndarray, axis: str, degrees: float) -> np.ndarray:
    """Directions of the field in sensor axes while a vehicle tilts about an axis of its own, and turns once about z."""
    tilts = Rotation.from_euler(axis, np.linspace(0, degrees, 91)[:, None], degrees=True)
    tilted = tilts.inv().apply(now)
    turns = Rotation.from_euler("z", np.arange(0, 360)[:, None], degrees=True)
    return np.vstack([tilted, turns.inv().apply(tilted[-1])])


@pytest.mark.parametrize("seed", range(6))
def test_the_next_move_shows_what_it_promises(seed: int) -> None:
    """Made as it is said, by another library's rotations, it visits as many new cells; no other move is better."""
    random = np.random.default_rng(seed)
    now = random.normal(size=3)
    now /= np.linalg.norm(now)
    level = flown(now, "x", 0.0)
    seen = cells(level)
    move = next_move(now, seen)
    assert move is not None
    assert move.axis in ("x", "y")
    gained = cells(flown(now, move.axis, move.degrees)) & ~seen
    assert abs(int(gained.sum()) - move.gain) <= 1  # steps of 5° may miss the corner of a cell
    assert move.sentence.endswith("then turn once about z")


def test_all_is_seen_and_there_is_no_move() -> None:
    everywhere = np.random.default_rng(0).normal(size=(5000, 3))
    everywhere /= np.linalg.norm(everywhere, axis=1, keepdims=True)
    seen = cells(everywhere)
    assert seen.all()
    assert next_move(everywhere[0], seen) is None
    assert np.bincount(cell_of(everywhere), minlength=60).std() < 15, "cells of equal area"
    first = next_move(np.array([0.6, 0.0, 0.8]), np.zeros(60, dtype=bool))
    assert first is not None
    assert first.sentence == "turn once about z" or first.gain > 10


def test_a_picture_before_and_after_there_is_a_calibration() -> None:
    """The directions are those of the calibrated field; iron that comes near is called a disturbance, noise is not."""
    simulation = simulate("wide", duration=300, rate=10, seed=3)
    recording = simulation.recording
    online = mg.OnlineCalibrator()
    picture = Picture(online)
    assert picture.to_dict(None)["points"] == []
    time, field = recording.magnetometer

    def pass_on(first: int, stop: int, extra: float = 0.0) -> None:
        value = field[first:stop] + extra
        picture.take(NewSamples(Samples(time[first:stop], value), none()))
        online.update(time[first:stop], value, recording.angular_rate[first:stop])

    for first in range(0, 2400, 100):
        pass_on(first, first + 100)
        if first == 300:
            early = picture.to_dict(online.calibration)
    assert early["residual"] is None or not early["residual"]["disturbed"]
    calibration = online.calibration
    assert calibration is not None
    shown = picture.to_dict(calibration)
    assert not shown["rough"]
    assert 200 <= len(shown["points"]) <= 400
    np.testing.assert_allclose(np.linalg.norm(shown["points"], axis=1), 1, atol=0.12)
    truth = simulation.truth.apply(field[2399:2400])[0]
    np.testing.assert_allclose(shown["now"], truth / np.linalg.norm(truth), atol=0.06)
    assert sum(shown["cells"]) / 60 == pytest.approx(online.progress.coverage, abs=0.05)
    assert not shown["residual"]["disturbed"]
    for first in range(2400, 2500, 10):
        picture.take(NewSamples(Samples(time[first : first + 10], field[first : first + 10] + 8e-6), none()))
    assert picture.to_dict(calibration)["residual"]["disturbed"]
    again = Picture(online)
    assert abs(sum(again.to_dict(calibration)["cells"]) - sum(shown["cells"])) <= 2, (
        "a resumed run shows what it has"
    )


def test_a_picture_takes_no_more_memory_as_the_run_goes_on() -> None:
    picture = Picture(mg.OnlineCalibrator())
    random = np.random.default_rng(0)
    for second in range(1500):
        time = second + np.arange(100) / 100
        picture.take(NewSamples(Samples(time, random.normal(size=(100, 3)) * 5e-5), none()))
    assert len(picture._seen) <= 4000
    assert sum(len(samples.time) for samples in picture._recent) <= 700
