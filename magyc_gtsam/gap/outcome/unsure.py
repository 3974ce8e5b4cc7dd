"""What may be missing if something certainly is, though no effect is probable enough to be named: in words."""

from __future__ import annotations

from collections.abc import Mapping

from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.evidence.posterior import UNKNOWN
from magyc_gtsam.gap.outcome.described import FIELD_VARIES, enumerated
from magyc_gtsam.gap.outcome.doubt import LOG_MORE, shortened
from magyc_gtsam.gap.result import Doubt, Manoeuvre

_SPELLED = 3  # effects that a sentence lists
_BESIDE = 11  # words of a doubt beside what is missing


def one_of(unsure: Mapping[str, float]) -> str:
    """Return that one of {effect of the catalogue or `UNKNOWN`: probability} is missing."""
    return f"{_missing(unsure, _SPELLED)}, but none is probable enough to be named"


def in_brief(unsure: Mapping[str, float], beside: int = _BESIDE) -> str:
    """Return the same in few words, beside so many others: the effects that are named, and the remedy."""
    return shortened([_missing(unsure, count) for count in (2, 1)], beside)


def which(unsure: Mapping[str, float]) -> Manoeuvre | None:
    """Return the manoeuvre that shows the most probable effect; None if it is not one of the catalogue."""
    name = next(iter(unsure))
    if name not in TERMS:
        return None
    motion = TERMS[name].motion
    return Manoeuvre(tuple(unsure), motion, f"to see whether “{LABELS[name]}” is present: {motion}")


def doubt_whether(unsure: Mapping[str, float]) -> Doubt:
    """Return the doubt about a calibration without named effects."""
    wanted = which(unsure)
    action = LOG_MORE if wanted is None else wanted.motion
    return Doubt(in_brief(unsure, len(action.split())), action)


def _missing(unsure: Mapping[str, float], count: int) -> str:
    said = {name: _said(name, probability) for name, probability in unsure.items()}
    if len(said) == 1 or count == 1:  # the first that has a name
        return f"{next(words for name, words in said.items() if name != UNKNOWN)} or another effect is missing"
    return f"one of {enumerated(list(said.values())[:count])} is missing"


def _said(name: str, probability: float) -> str:
    label = "an unknown effect" if name == UNKNOWN else f"“{LABELS.get(name, FIELD_VARIES)}”"
    return f"{label} ({probability:.0%})"
