"""Names that explain as much as each other."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.gap.naming import faint


def test_beside_colour_a_name_must_pass_clearly() -> None:
    white: Any = (SimpleNamespace(name="timing"),)
    coloured: Any = (*white, SimpleNamespace(name="coloured-noise"))
    score: Any = SimpleNamespace(name="eddy-plane", statistic=78.0, threshold=72.0)
    assert faint(score, coloured)
    assert not faint(score, white)
    score.statistic = 102.0
    assert not faint(score, coloured)
    # What lies between the settings of a grid may explain more.
    passed: Any = SimpleNamespace(name="local-anomaly", statistic=85.0, threshold=72.0)
    assert not faint(passed, coloured)


def test_two_causes_are_not_one_drift() -> None:
    """Iron that warms and is moved once; neither explains as much as a drift of many modes does."""
    named = []
    for seed in range(70, 73):
        recording = mg.simulate("wide", 200, seed=seed, channels=["temperature"]).recording
        time = recording.time
        warmth, jump = 4 * (1 - np.exp(-time / 80)), np.array([-1.2, 1.6, 0.2])
        extra = warmth[:, None] * np.array([0.3e-6, 0.2e-6, -0.24e-6]) + np.outer(time > 130, jump * 1e-6)
        field = recording.magnetic_field + extra
        gap = mg.find_gap(replace(recording, magnetic_field=field, channels={"temperature": 15 + warmth}))
        named.append(set(gap.names))
        for step in gap.effects:
            if step.name == "hard-iron-step":
                assert np.linalg.norm(step.value - jump) < 4 * np.linalg.norm(step.sigma)
    assert named.count({"temperature-hard-iron", "hard-iron-step"}) >= 2, named
