"""Marginals of the posterior: the probability of each effect, of an unknown effect, and of none."""

from __future__ import annotations

from collections.abc import Mapping

from magyc_gtsam.gap.evidence.posterior import Set

NOTHING, UNKNOWN = "nothing", "unknown"


def marginals(posterior: Mapping[Set, float]) -> dict[str, float]:
    """Return {name, `UNKNOWN` or `NOTHING`: probability}, the most probable first."""
    result = {NOTHING: 0.0, UNKNOWN: 0.0}
    for (names, unknown), probability in posterior.items():
        for name in dict.fromkeys(names):
            result[name] = result.get(name, 0.0) + probability
        if unknown:
            result[UNKNOWN] += probability
        elif not names:
            result[NOTHING] += probability
    stated = {what: min(probability, 1.0) for what, probability in result.items()}  # sums are rounded
    return dict(sorted(stated.items(), key=lambda one: -one[1]))
