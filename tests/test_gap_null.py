"""What chance alone would give: draws that hang together as the innovations of the data do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.model.variants import Projector, variants
from magyc_gtsam.gap.scores.null import Draws, colour, memory
from magyc_gtsam.recording import Array


@pytest.fixture(scope="module")
def twin() -> Twin:
    recording = mg.simulate("moderate", duration=400, seed=5).recording
    return base_model(recording, None, short_term_noise(recording)).twin


def _white(twin: Twin, draws: int) -> Draws:
    return np.random.default_rng(0).standard_normal((3 * twin.n, draws)).astype(np.float32)


def _innovations(twin: Twin, project: Projector, windows: Array, seed: int) -> Array:
    """(k, 3, n) freed of the base model, of windows' noise (k, 3, n) and the gyroscope's own."""
    links = np.random.default_rng(seed).standard_normal((len(windows), 3, twin.n - 1))
    rows = twin.innovations(windows.copy(), links)
    return project(rows.reshape(len(rows), -1)).reshape(rows.shape)


def _of_a_swinging_mount(count: int, n: int) -> Array:
    """(count, 3, n) white noise and a damped resonance of 0.05 cycles a window."""
    random = np.random.default_rng(3)
    poles = [1.0, -2 * 0.7 * np.cos(2 * np.pi * 0.05), 0.7**2]
    swing = lfilter([1.0], poles, random.standard_normal((count, 3, n + 50)))[..., 50:]
    return random.standard_normal((count, 3, n)) + 1.5 * swing / swing.std()


def test_white_noise_of_the_reading_and_the_rate_gives_white_innovations(twin: Twin) -> None:
    project = Projector(twin.base_columns)
    white = np.random.default_rng(1).standard_normal((50, 3, twin.n))
    rows = _innovations(twin, project, white, 2)
    assert rows.std() == pytest.approx(1.0, abs=0.02)
    assert memory(rows[0]) == 0
    draws = _white(twin, 10)
    assert colour(rows[0], lambda w: _innovations(twin, project, w, 4), draws) is draws


def test_draws_explain_as_much_as_the_colour_would(twin: Twin) -> None:
    """Of one recording, on level turns, where the filter mixes the axes; of sixty, in the mean of each effect."""
    project = Projector(twin.base_columns)
    truth = _innovations(twin, project, _of_a_swinging_mount(60, twin.n), 5)
    drawn = colour(truth[0], lambda w: _innovations(twin, project, w, 6), _white(twin, 200))
    assert memory(truth[0]) > 1
    for axis in range(3):
        rows = drawn.reshape(3, twin.n, -1)[axis]
        for lag in (1, 2, 4):
            mine = float(np.vdot(rows[lag:], rows[:-lag]) / np.vdot(rows, rows))
            one = truth[0, axis]
            assert mine == pytest.approx(float(one[lag:] @ one[:-lag] / (one @ one)), abs=0.1)
    for name in ("hysteresis", "hard-iron-drift", "hard-iron-step"):
        chosen = variants(twin, project, name, TERMS[name].settings(twin)[:3])
        for each in chosen:
            expected = ((each.unit @ truth.reshape(len(truth), -1).T) ** 2).sum(axis=0).mean()
            assert ((each.unit @ drawn) ** 2).sum(axis=0).mean() == pytest.approx(expected, rel=0.4), name
