"""Names that explain as much as each other, and what more is known of them later."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.search import search
from magyc_gtsam.gap.search.naming import faint
from magyc_gtsam.gap.search.steps import _asked


def test_what_is_left_decides_only_where_it_is_less_than_what_is_explained() -> None:
    def decided(*each: tuple[float, str, float]) -> Any:
        """Of names with their evidence and with what is left beside them."""
        looks = [
            (evidence, name, SimpleNamespace(scores=[SimpleNamespace(name="x", evidence=left)], gains={"x": 1.0}))
            for evidence, name, left in each
        ]
        return search._best(looks)[1]  # type: ignore[arg-type]

    assert decided((175.0, "current", 50.0), (169.0, "drift", 5.0)) == "drift"
    assert decided((175.0, "current", 220.0), (169.0, "drift", 209.0)) == "current"


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
    candidates = [
        "temperature-hard-iron",
        "temperature-gyro",
        "hard-iron-step",
        "hard-iron-drift",
        "local-anomaly",
    ]
    recording = mg.simulate("wide", 200, seed=70, channels=["temperature"]).recording
    time = recording.time
    warmth, jump = 4 * (1 - np.exp(-time / 80)), np.array([-1.2, 1.6, 0.2])
    extra = warmth[:, None] * np.array([0.3e-6, 0.2e-6, -0.24e-6]) + np.outer(time > 130, jump * 1e-6)
    field = recording.magnetic_field + extra
    warmed = replace(recording, magnetic_field=field, channels={"temperature": 15 + warmth})
    gap = mg.find_gap(warmed, candidates=candidates)
    assert set(gap.names) == {"temperature-hard-iron", "hard-iron-step"}
    for step in gap.effects:
        if step.name == "hard-iron-step":
            assert np.linalg.norm(step.value - jump) < 4 * np.linalg.norm(step.sigma)


def test_a_weak_name_beside_a_strong_rival_explains_a_fifth_of_it() -> None:
    """Of what each explains in one model; what is strong by itself stands, as do the plates of a matrix."""

    def asked(weights: dict[str, float], index: int, uneven: str = "") -> float:
        terms = [Active(n, {"uneven": 1.0} if n == uneven else {}, np.zeros(3)) for n in weights]
        current: Any = SimpleNamespace(
            model=SimpleNamespace(terms=terms), weight_of=lambda i: list(weights.values())[i]
        )
        return _asked(current, index, range(len(terms)))

    assert asked({"misalignment": 300.0, "cubic": 47.0}, 1) == pytest.approx(60.0)
    assert asked({"misalignment": 3000.0, "cubic": 47.0}, 1) == pytest.approx(100.0)
    assert asked({"misalignment": 300.0, "hard-iron-step": 47.0}, 1) == 0
    # No loop is quite of the form of another.
    assert asked({"hysteresis": 3000.0, "eddy-plane": 147.0}, 1) == pytest.approx(600.0)
    assert asked({"hysteresis": 3000.0, "eddy-plane": 147.0}, 1, uneven="eddy-plane") == pytest.approx(600.0)
    assert asked({"timing": 3000.0, "eddy-plane": 47.0}, 1, uneven="eddy-plane") == 0
    assert asked({"timing": 47.0, "eddy-plane": 3000.0}, 0, uneven="eddy-plane") == 0
