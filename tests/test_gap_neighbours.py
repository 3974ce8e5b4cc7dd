"""What is nearly a name of the catalogue is not given it, and what is one keeps it; the levels of the noise effects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.evidence.neighbours import neighbours, product_of
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.samples.fine import NOISE_LIMIT
from magyc_gtsam.gap.samples.noise_effects import coloured_noise, tone
from magyc_gtsam.gap.samples.noise_isolability import noise_isolability
from magyc_gtsam.gap.samples.wrong_samples import spikes
from magyc_gtsam.simulation.environment import CHANNELS


@pytest.fixture(scope="module")
def twin() -> Twin:
    recording = mg.simulate("wide", 200, seed=3, channels=CHANNELS).recording
    return base_model(recording, None, short_term_noise(recording)).twin


def test_neighbours_are_products(twin: Twin) -> None:
    setting = {"time": 100.0}
    reading, gain = (f.columns(twin).window for f in neighbours("hard-iron-step", setting))
    assert twin.windows.span is not None
    on = np.clip((twin.time - 100.0) / twin.windows.span + 0.5, 0, 1)  # the share of a window that is later
    seen = twin.windows.need("field")
    unit = np.sqrt((seen**2).mean())
    for axis in range(3):
        np.testing.assert_allclose(gain[axis, axis], on * seen[axis] / unit)
    shifted = seen + twin.windows.need("hard_iron")[:, None]
    np.testing.assert_allclose(reading[1, 1], on * shifted[1] / np.sqrt((shifted**2).mean()))

    setting = {"lag": 0.0}
    warm = twin.columns("temperature-hard-iron", setting).window
    _, field = (f.columns(twin).window for f in neighbours("temperature-hard-iron", setting))
    assert field.shape == (3 * len(warm), 3, twin.n)
    np.testing.assert_allclose(field[5, 1], warm[1, 1] * seen[2] / unit)

    turned = twin.columns("timing", {}).window
    speed = np.linalg.norm(twin.windows.need("rate"), axis=0)
    fast, faster = (f.columns(twin).window for f in neighbours("timing", {}))
    np.testing.assert_allclose(fast, turned * speed / np.sqrt((speed**2).mean()))
    np.testing.assert_allclose(faster, turned * speed**2 / np.sqrt((speed**4).mean()))
    assert neighbours("tone", {"frequency": 1.0}) == []
    assert product_of("timing×speed") == "timing"
    assert product_of("rate×field") is product_of("timing") is None


def test_a_scale_that_drifts_is_no_bias_that_drifts() -> None:
    """Its error is the product of a drift and the rate of turn."""
    recording = mg.simulate("moderate", 120, seed=2).recording
    assert recording.angular_rate is not None
    scale = 1 + np.linspace(-0.05, 0.05, len(recording.time))
    drifting = replace(recording, angular_rate=recording.angular_rate * scale[:, None])
    gap = mg.find_gap(drifting, candidates=["gyro-bias-drift", "gyro-bias-step"])
    assert gap.names == ()
    assert gap.verdict == "unknown"


def test_noise_is_found_from_its_level_on() -> None:
    """At the level of the table nine of ten are found, at half of it hardly any."""
    recording = mg.simulate("wide", seed=4).recording
    rows = {row.name: row for row in noise_isolability(recording, 1e-6)}
    n, rate, runs = 6000, 10.0, 10
    time = np.arange(n) / rate
    random = np.random.default_rng(1)
    found = {(name, share): 0 for name in ("tone", "coloured-noise", "spikes") for share in (0.5, 1.0)}
    for _ in range(runs):
        white = random.standard_normal((3, n))
        way = random.standard_normal(3)
        line = (way / np.linalg.norm(way))[:, None] * np.cos(2 * np.pi * 3.217 * time)
        pole = np.exp(-1 / rate)
        colour = lfilter([np.sqrt(1 - pole**2)], [1, -pole], random.standard_normal((3, n)), axis=1)
        wrong = random.standard_normal((3, n)) * (random.uniform(size=n) < 0.01)
        for share in (0.5, 1.0):
            size = {
                name: share * rows[name].smallest for name in ("tone", "coloured-noise", "spikes")
            }  # σ is 1 µT
            found["tone", share] += tone(white + size["tone"] * line, time, 1.0, NOISE_LIMIT).significant
            coloured = white + size["coloured-noise"] * colour
            found["coloured-noise", share] += coloured_noise(coloured, rate, 1.0, NOISE_LIMIT).significant
            found["spikes", share] += spikes(white + size["spikes"] * wrong, 1.0, NOISE_LIMIT).significant
    for (name, share), count in found.items():
        assert count >= 0.7 * runs if share == 1.0 else count <= 0.3 * runs, (name, share, count)
