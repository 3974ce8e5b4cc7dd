"""The reason why the calibration of a gap must not be used, and a remedy; short, and the same for every output."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.reasons import MOST_UNEXPLAINED
from magyc_gtsam.foreign_text import MOST_WORDS
from magyc_gtsam.gap.result import Doubt, Effect, Gap, Manoeuvre
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.sensor_faults.full_scale import ClippedField
from magyc_gtsam.sensor_faults.stuck_bit import StuckBit

LOG_MORE = "log current, temperature and depth"
DISTURBED = Doubt(
    f"the field of the place varies by more than {MOST_UNEXPLAINED:.0%} of its strength",
    "choose an interval (start=, end=), or a place away from magnets and steel",
)
_WITHOUT = "choose an interval without the jumps (start=, end=)"


def with_doubt(gap: Gap, doubt: Doubt) -> Gap:
    """Return the gap with its calibration marked as one that must not be used."""
    return replace(gap, doubt=doubt, calibration=doubted(gap.calibration, doubt))


def doubted(calibration: Calibration, doubt: Doubt) -> Calibration:
    """Return the calibration with a message why it must not be used; `export` and `apply` refuse it."""
    message = "; ".join(part for part in (doubt.sentence, calibration.message) if part)
    return replace(calibration, converged=False, message=message)


def with_clipped(gap: Gap, clipped: ClippedField | None) -> Gap:
    """Return the gap, open unless saturation is in the model and the clipped share is small enough for its form."""
    if clipped is None:
        return gap
    gap = replace(gap, calibration=_cut_off(gap.calibration, clipped))
    why = why_clipped(clipped, gap.calibration, gap.verdict in ("none", "closed"))
    if not why:
        return gap
    doubt = doubt_of_clipped(clipped, why)
    return _opened(gap, f"{clipped.where}, {why}: {doubt.action}", doubt)


def _cut_off(calibration: Calibration, clipped: ClippedField) -> Calibration:
    """Return a calibration whose saturation sets in where readings are cut off, and at once.

    The fit is to means of noisy readings, which bend before the full scale; below it a single reading is right as it
    is, and was corrected: by 0.4° of heading in a log of the study of faults.
    """
    setting = {
        "level": min(abs(each) for levels in clipped.levels for each in levels if np.isfinite(each)),
        "fall": 0.0,
    }
    terms = (replace(t, setting=setting) if t.name == "saturation" else t for t in calibration.terms)
    return replace(calibration, terms=tuple(terms))


def why_clipped(clipped: ClippedField, calibration: Calibration, complete: bool) -> str:
    """Return why readings at full scale spoil a calibration, "" if they do not: saturation is in it.

    Args:
        clipped: the readings, too many to be harmless.
        calibration: with the effects of the search as terms.
        complete: whether nothing else is missing.
    """
    if clipped.share > RULES.cut_off:
        return f"at most {RULES.cut_off:.0%} can be modelled"
    if not any(term.name == "saturation" for term in calibration.terms):  # found in this search, or given
        return "which the search did not name"
    return "" if complete else "and something else is missing"


def doubt_of_clipped(clipped: ClippedField, why: str) -> Doubt:
    """Return the doubt about a calibration that readings at full scale spoil, for the reason of `why_clipped`."""
    axes = f"axis {clipped.axes}" if len(clipped.axes) == 1 else f"axes {' and '.join(clipped.axes)}"
    action = "choose a larger full scale, or move what is magnetic away from the sensor"
    return Doubt(f"{axes} of the magnetometer cut off, {why}", action)


def with_stuck_bit(gap: Gap, bit: StuckBit) -> Gap:
    """Return the gap, open because a bit of a sensor is stuck or fails, of which the catalogue has no effect."""
    doubt = Doubt(f"a bit of {bit.place} {bit.state}", "replace the sensor, or mend its driver")
    return _opened(gap, bit.sentence, doubt)


def _opened(gap: Gap, why: str, doubt: Doubt) -> Gap:
    """Return the gap, open unless it lacks information, with both calibrations doubted."""
    verdict = gap.verdict if gap.verdict == "not enough information" else "open"
    base = doubted(gap.base, doubt)
    return with_doubt(replace(gap, verdict=verdict, sentence=f"{why}; {gap.sentence}", base=base), doubt)


def remedy(doubt: Doubt, purpose: str) -> Manoeuvre:
    """Return the next manoeuvre where a doubt is about the calibration itself."""
    return Manoeuvre((), doubt.action, f"{purpose}: {doubt.action}")


def left_open(
    effects: Sequence[Effect], uncorrected: Collection[int], missing: str, manoeuvre: Manoeuvre | None
) -> Doubt:
    """Return the doubt about a gap that is open or unknown.

    Args:
        effects: effects that were named.
        uncorrected: places of those that are named only.
        missing: the remaining misfit, in words; "" without one.
        manoeuvre: the next manoeuvre.
    """
    if missing:
        if not effects:
            return Doubt(missing, LOG_MORE)
        jumps = [f"{e.setting['time']:.0f} s" for e in effects if e.name == "hard-iron-step"]
        if jumps:
            return _beside(missing, (f"jumps at {' and '.join(jumps)}", f"{len(jumps)} jumps"), _WITHOUT)
        labels = [effect.label for effect in effects]
        return _beside(missing, (_named(labels), f"{len(labels)} effects"), LOG_MORE)
    verb = "is" if len(uncorrected) == 1 else "are"
    cause = f"{_named([effects[place].label for place in sorted(uncorrected)])} {verb} not corrected"
    return Doubt(cause, LOG_MORE if manoeuvre is None else manoeuvre.motion)


def shortened(ways: Sequence[str], beside: int) -> str:
    """Return the first of several ways to say a cause that is short enough beside so many words, or the last."""
    return next((way for way in ways if len(way.split()) <= MOST_WORDS - beside), ways[-1])


def _beside(missing: str, named: Sequence[str], action: str) -> Doubt:
    return Doubt(shortened([f"beside {each}, {missing}" for each in named], len(action.split())), action)


def _named(labels: Sequence[str]) -> str:
    return f"“{labels[0]}”" + (f" and {len(labels) - 1} more" if len(labels) > 1 else "")
