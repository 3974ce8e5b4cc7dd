"""Find where model and measurement disagree, name the effect, add it, show the gap shrink."""

from __future__ import annotations

from typing import Any

from magyc_gtsam.factors.lazy import attribute
from magyc_gtsam.gap.find import find_gap
from magyc_gtsam.gap.isolability import isolability
from magyc_gtsam.gap.outcome.agreement import Metrics
from magyc_gtsam.gap.result import Effect, Gap, Hypothesis, Isolability

__all__ = ["Effect", "Gap", "Hypothesis", "Isolability", "Metrics", "find_gap", "isolability", "term_factor"]


def __getattr__(name: str) -> Any:
    return attribute(__name__, {"term_factor": "graph"}, name)  # a GTSAM factor; nothing else here needs GTSAM
