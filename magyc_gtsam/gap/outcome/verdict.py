"""The verdict in one sentence, and the next manoeuvre."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from magyc_gtsam.gap.effects import LABELS, MOMENTS, NAMES, TERMS
from magyc_gtsam.gap.evidence.generic import families
from magyc_gtsam.gap.evidence.neighbours import label_of, product_of
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.naming.named import LINES, Found
from magyc_gtsam.gap.outcome.described import FIELD_VARIES, sentences
from magyc_gtsam.gap.outcome.unsure import one_of
from magyc_gtsam.gap.result import Effect, Hypothesis, Manoeuvre, Verdict
from magyc_gtsam.gap.rules import RULES

_SPELLED = 3  # effects that a sentence names
_FIRM = (*TERMS, "axis-order", FIELD_VARIATION)  # beside which something else may be missing


def verdict(found: Sequence[Found], left: Sequence[str], uncorrected: Collection[int]) -> Verdict:
    """Return the verdict in one word.

    Args:
        found: effects that were found.
        left: names of what is present beside them.
        uncorrected: places in `found` of effects that are named only.
    """
    if left:
        return "open" if any(one.name in _FIRM for one in found) else "unknown"
    if not found:
        return "none"
    return "open" if uncorrected else "closed"


def sentence_of(word: Verdict, effects: Sequence[Effect], where: str) -> str:
    """Return the verdict in one sentence for a navigator.

    Args:
        word: the verdict.
        effects: effects that were found.
        where: what is missing beside them, in words; "" if nothing is.
    """
    if word == "none":
        return "the model and the data agree"
    if where:
        firm = "; ".join(effect.sentence for effect in effects if effect.name in _FIRM)
        return f"{firm}; beside that, {where}" if word == "open" else f"{where}; nothing was changed"
    # Effects that change the heading come before effects on the noise.
    ordered = sorted(effects, key=lambda effect: effect.name not in TERMS and effect.name != "axis-order")
    return "; ".join(sentences(ordered))


def among(names: Sequence[str]) -> str:
    """Return the set of candidates in words."""
    return "in the catalogue" if set(names) == set(NAMES) else "among the candidates"


def unseen(hypotheses: Sequence[Hypothesis], untested: int, given: Collection[str]) -> str:
    """Return the limits of the verdict "none": effects that are too small, or that would not have been found.

    Args:
        hypotheses: what was tested.
        untested: number of effects that could not be.
        given: names of the effects that the given calibration has.
    """
    blind = [h.label for h in hypotheses if h.status == "not enough information" and h.name in TERMS]
    parts = [
        f"“{h.label}” is in the given calibration, and its probability on this log is {h.probability:.0%}"
        if h.name in given
        else f"“{h.label}” is possible ({h.probability:.0%}), but too weak to be distinguished from other weak effects"
        for h in hypotheses
        if h.status == "possible"
    ]
    if blind:
        named = ", ".join(blind[:_SPELLED])
        more = f" and {len(blind) - _SPELLED} more" if len(blind) > _SPELLED else ""
        parts.append(f"this motion could not have shown every relevant value of {named}{more}")
    if untested:
        effects = "1 effect" if untested == 1 else f"{untested} effects"
        parts.append(f"{effects} could not be tested, for want of a channel in the log")
    return "; ".join(parts) or "every relevant value of the tested effects would have been detected"


def place_of(left: str, twin: Twin) -> str:
    """Return the variable that what remains, a family or `LINES`, depends on, in words."""
    if left == LINES:
        return "an effect with many lines in its spectrum is missing"
    return missing(left, next((family.place for family in families(twin) if family.name == left), ""))


def missing(name: str, place: str) -> str:
    """Return that something is missing: a generic family by its variable `place`, else what resembles an effect."""
    if place:
        return f"an effect that varies with {place} is missing"
    label = LABELS.get(name) or (label_of(name) if product_of(name) else "")
    if label:
        return f"an effect similar to “{label}” is missing"
    return "an effect that follows no logged variable is missing"


def absent(left: Sequence[str], unsure: Mapping[str, float], twin: Twin, catalogue: str) -> str:
    """Return what is missing with the reason why it has no name, in words; "" if nothing is.

    Args:
        left: names of what is present beside the named effects.
        unsure: {name: probability} of effects of the catalogue of which one is probably present.
        twin: of the recording.
        catalogue: the set of candidates, in words.
    """
    if not left:
        return ""
    if unsure:
        return one_of(unsure)
    where = place_of(left[0], twin)
    return f"{where}, but of a different form" if "similar to" in where else f"{where}, and it is not {catalogue}"


def manoeuvre(
    hypotheses: Sequence[Hypothesis],
    twin: Twin,
    found: Sequence[Found],
    left: Sequence[str],
    uncorrected: Iterable[int],
) -> Manoeuvre | None:
    """Return the next manoeuvre.

    Its motion determines an effect that is named only, distinguishes an effect from its rivals, identifies what is
    missing, or makes effects detectable. None if no manoeuvre is needed.

    Args:
        hypotheses: all candidates.
        twin: of the recording.
        found: effects that were found.
        left: names of what is present beside them.
        uncorrected: places in `found` of effects that are named only.
    """
    for place in uncorrected:
        one = found[place]
        motion = TERMS[one.name].motion
        return Manoeuvre((one.name,), motion, f"to correct “{LABELS[one.name]}”: {motion}")
    for f in found:
        if f.rivals and f.name in TERMS:
            names = (f.name, *f.rivals)
            needed = TERMS[f.rivals[0]].missing(twin)
            motion = f"log the {needed[0]} as well" if needed else TERMS[f.name].motion
            labels = " from ".join(LABELS.get(n, FIELD_VARIES) for n in names[:2])
            return Manoeuvre(names, motion, f"to distinguish {labels}: {motion}")
    if left:
        motion = (
            "repeat the recording with every channel logged (currents, temperature, depth), at the same motion"
        )
        return Manoeuvre((), motion, f"to identify the effect: {motion}")
    # No motion shows what happened at a moment.
    others = (h for h in hypotheses if h.name not in MOMENTS)
    unsure = (h for h in others if h.status in ("possible", "not enough information"))
    blind = sorted((h for h in unsure if h.power < RULES.would_be_found), key=lambda h: h.power)
    if blind:
        term = TERMS[blind[0].name]
        return Manoeuvre(tuple(h.name for h in blind), term.motion, f"to test for “{term.label}”: {term.motion}")
    return None
