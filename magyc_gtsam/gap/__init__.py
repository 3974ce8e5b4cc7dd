"""Find where model and measurement disagree, name the effect, add it, show the gap shrink."""

from magyc_gtsam.gap.find import find_gap
from magyc_gtsam.gap.graph import term_factor
from magyc_gtsam.gap.isolability import isolability
from magyc_gtsam.gap.result import Effect, Gap, Hypothesis, Isolability, Metrics

__all__ = ["Effect", "Gap", "Hypothesis", "Isolability", "Metrics", "find_gap", "isolability", "term_factor"]
