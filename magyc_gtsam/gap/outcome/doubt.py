"""The reason why the calibration of a gap must not be used, and a remedy; short, and the same for every output."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.foreign_text import MOST_WORDS
from magyc_gtsam.gap.result import Doubt, Effect, Gap, Manoeuvre

_LOG_MORE = "log current, temperature and depth"
_WITHOUT = "choose an interval without the jumps (start=, end=)"


def with_doubt(gap: Gap, doubt: Doubt) -> Gap:
    """Return the gap with its calibration marked as one that must not be used."""
    return replace(gap, doubt=doubt, calibration=doubted(gap.calibration, doubt))


def doubted(calibration: Calibration, doubt: Doubt) -> Calibration:
    """Return the calibration with a message why it must not be used; `export` and `apply` refuse it."""
    message = "; ".join(part for part in (doubt.sentence, calibration.message) if part)
    return replace(calibration, converged=False, message=message)


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
            return Doubt(missing, _LOG_MORE)
        jumps = [f"{e.setting['time']:.0f} s" for e in effects if e.name == "hard-iron-step"]
        if jumps:
            return _shortest(missing, (f"jumps at {' and '.join(jumps)}", f"{len(jumps)} jumps"), _WITHOUT)
        labels = [effect.label for effect in effects]
        return _shortest(missing, (_named(labels), f"{len(labels)} effects"), _LOG_MORE)
    verb = "is" if len(uncorrected) == 1 else "are"
    cause = f"{_named([effects[place].label for place in sorted(uncorrected)])} {verb} not corrected"
    return Doubt(cause, _LOG_MORE if manoeuvre is None else manoeuvre.motion)


def _shortest(missing: str, beside: Sequence[str], action: str) -> Doubt:
    """Return the first doubt that is short enough, or the last."""
    doubts = [Doubt(f"beside {each}, {missing}", action) for each in beside]
    return next((doubt for doubt in doubts if len(doubt.sentence.split()) <= MOST_WORDS), doubts[-1])


def _named(labels: Sequence[str]) -> str:
    return f"“{labels[0]}”" + (f" and {len(labels) - 1} more" if len(labels) > 1 else "")
