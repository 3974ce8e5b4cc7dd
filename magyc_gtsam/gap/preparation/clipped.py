"""The effect of a magnetometer that is clipped at its full scale on the verdict of a gap."""

from __future__ import annotations

from dataclasses import replace

from magyc_gtsam.gap.outcome.doubt import doubted, with_doubt
from magyc_gtsam.gap.result import Doubt, Gap
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.sensor_faults.full_scale import ClippedField


def with_clipped(gap: Gap, clipped: ClippedField | None) -> Gap:
    """Return the gap, open unless saturation is in the model and the clipped share is small enough for its form."""
    if clipped is None:
        return gap
    named = any(term.name == "saturation" for term in gap.calibration.terms)  # found in this search, or given
    if named and clipped.share <= RULES.cut_off and gap.verdict in ("none", "closed"):
        return gap
    why = "which the search did not name" if not named else "and something else is missing"
    if clipped.share > RULES.cut_off:
        why = f"at most {RULES.cut_off:.0%} can be modelled"
    remedy = "choose a larger full scale, or move what is magnetic away from the sensor"
    axes = f"axis {clipped.axes}" if len(clipped.axes) == 1 else f"axes {' and '.join(clipped.axes)}"
    doubt = Doubt(f"{axes} of the magnetometer cut off, {why}", remedy)
    doubted_gap = replace(
        gap,
        verdict=gap.verdict if gap.verdict == "not enough information" else "open",
        sentence=f"{clipped.where}, {why}: {remedy}; {gap.sentence}",
        base=doubted(gap.base, doubt),
    )
    return with_doubt(doubted_gap, doubt)
