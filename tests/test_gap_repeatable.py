"""The same log gives the same result to the last bit, in another process too."""

from __future__ import annotations

import os
import subprocess
import sys

_SCRIPT = """
import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario, seed_of
name = "single-wide-soft-iron-step-x0.5-03"
gap = mg.find_gap(generate(Scenario(name, "single", "wide", seed_of(name, 411), (("soft-iron-step", 0.5),))).recording)
print(sorted(gap.probabilities.items()), gap.calibration.hard_iron.tolist())
"""


def test_a_gap_does_not_depend_on_the_order_of_sets() -> None:
    """Strings are in another order in each process; of products of effects the sums were."""
    printed = {
        subprocess.run(
            [sys.executable, "-c", _SCRIPT],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(printed) == 1
    assert "soft-iron-step" in printed.pop()
