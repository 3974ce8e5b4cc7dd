"""Lines of the spectrum: steady ones are tones; lines that never end, and those of a channel, are none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.gap.samples.fine import Fine, single_scores

ALONG = np.array([0.6, -0.5, 0.62])
CANDIDATES = ["tone", "timing", "coloured-noise"]


@pytest.fixture(scope="module")
def base() -> mg.Recording:
    return mg.simulate("wide", duration=200, seed=31).recording


def with_lines(base: mg.Recording, lines: Sequence[tuple[float, float]]) -> mg.Recording:
    """Return the recording with steady lines (Hz, T)."""
    signal = sum(size * np.cos(2 * np.pi * frequency * base.time) for frequency, size in lines)
    return replace(base, magnetic_field=base.magnetic_field + np.outer(signal, ALONG))


@pytest.mark.parametrize("size", [1e-6, 10e-6])
def test_a_hum_with_harmonics_is_named_line_by_line(base: mg.Recording, size: float) -> None:
    gap = mg.find_gap(with_lines(base, [(1.3, size), (2.6, 0.5 * size), (3.9, 0.3 * size)]), candidates=CANDIDATES)
    assert gap.names == ("tone", "tone", "tone")
    assert sorted(effect.setting["frequency"] for effect in gap.effects) == pytest.approx(
        [1.3, 2.6, 3.9], abs=2e-3
    )
    assert gap.verdict == "closed"


def test_lines_that_never_end_are_no_tones_but_something_unknown(base: mg.Recording) -> None:
    comb = with_lines(base, [(0.61 * k, 1.5e-6) for k in range(2, 8)])
    gap = mg.find_gap(comb, candidates=CANDIDATES)
    assert gap.verdict == "unknown"
    assert gap.names == ()
    assert gap.calibration.terms == ()
    assert "an effect with many lines in its spectrum is missing" in gap.sentence
    assert gap.probabilities["unknown"] > 0.9
    assert gap.probabilities.get("tone", 0.0) < 0.1
    assert not gap.calibration.converged


def test_those_that_the_windows_average_away_are_noise(base: mg.Recording) -> None:
    gap = mg.find_gap(with_lines(base, [(0.61 * k, 0.4e-6) for k in range(2, 8)]), candidates=CANDIDATES)
    assert gap.verdict == "none"
    assert gap.calibration.terms == ()
    assert gap.calibration.converged


def test_a_line_that_stands_alone_beside_them_is_still_a_tone(base: mg.Recording) -> None:
    """An unsteady signal, whose lines are in the place of each other, and a steady one."""
    random, step = np.random.default_rng(2), 1 / 200
    unsteady = [(3.2 + step * k, size) for k, size in enumerate(random.uniform(0.4e-6, 0.6e-6, 7))]
    gap = mg.find_gap(with_lines(base, [(4.4, 2e-6), *unsteady]), candidates=CANDIDATES)
    (effect,) = gap.effects
    assert effect.name == "tone"
    assert effect.setting["frequency"] == pytest.approx(4.4, abs=2e-3)


def test_the_ripple_of_a_current_that_is_in_the_model_is_no_tone_and_hides_none() -> None:
    """Half of the ripple is left, as the sensor of the current follows the other half."""
    random, time = np.random.default_rng(3), np.arange(0, 300, 0.1)
    still = mg.Recording(time, 50e-6 * np.eye(3)[np.arange(3000) % 3], 0.01 * random.standard_normal((3000, 3)))
    ripple = np.outer(ALONG, np.sin(2 * np.pi * 2.3 * time)) * 0.2e-6

    def tone(added: float, other: float) -> float:
        white = 0.2e-6 * random.standard_normal((3, 3000))
        value = white + 0.5 * ripple + other * np.outer(ALONG, np.cos(2 * np.pi * 3.7 * time))
        level = float(np.sqrt((value**2).mean()))
        _, line = single_scores(still, Fine(value / level, level, 10.0, time, 0.2, added * ripple), 5.0)
        return line.setting["frequency"] if line.significant else np.nan

    assert tone(0.0, 0.05e-6) == pytest.approx(2.3, abs=2e-3)
    assert np.isnan(tone(1.0, 0.0))
    assert tone(1.0, 0.05e-6) == pytest.approx(3.7, abs=2e-3)
    assert tone(0.1, 0.0) == pytest.approx(2.3, abs=2e-3)  # the current does not explain so much
