"""The verdict on a gap, from its own recording and from a validation recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.foreign_text import MOST_WORDS, clauses, two_digits
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.outcome.agreement import Metrics
from magyc_gtsam.gap.outcome.described import sentences
from magyc_gtsam.gap.outcome.doubt import with_doubt
from magyc_gtsam.gap.result import Doubt, Effect, Gap, Moved
from magyc_gtsam.gap.validation import SWEPT
from magyc_gtsam.report.verdict import Verdict, said

_WORSE = 0.005  # loss in nats per window that the correction may cause on the other recording
_BETTER = 0.98  # ratio of prediction errors with and without correction, below which the correction helps there
_NOISIER = 1.25  # ratio of the noise levels from which they count as different
_FOREIGN = 0.1  # share of the field; a larger prediction error means another instrument, not a missing effect
ON_THIS_LOG = "use the correction on this log only"
MOST_EFFECTS = 3  # largest number of effects named singly in the verdict
TITLES = {
    "none": "Nothing was found missing",
    "closed": "Gap found and closed",
    "unknown": "Something is missing, and it has no name",
    "open": "Gap found, not closed",
    "not enough information": "Nothing could be tested",
}


@dataclass(frozen=True, eq=False)
class Validation:
    """The models before and after the search, compared on another recording.

    Attributes:
        name: name of the recording.
        swept: sweep of its field, T.
        before, after: agreement with it of the twelve parameters alone, and of the model with the effects found.
        differences: the parameters that differ significantly when the recording is fitted by itself.
        notes: sentences on the effects that are dated in the recording in which they were found.
    """

    name: str
    swept: float
    before: Metrics
    after: Metrics
    differences: tuple[Moved, ...] = ()
    notes: tuple[str, ...] = ()


def closed(gap: Gap) -> bool:
    """Return whether nothing was missing, or every missing effect is now in the model."""
    return gap.verdict in ("none", "closed")


def contradicted(gap: Gap, validation: Validation) -> tuple[str, Doubt, str] | None:
    """Return the reason why the result does not hold on the other recording: (title, doubt, explanation); None if it
    holds.
    """
    loop, strength = validation.after.open_loop, gap.calibration.field_strength
    assert strength is not None
    name = validation.name
    if not len(loop.time):
        return (
            f"The result cannot be judged by {name}",
            Doubt(
                f"it holds no stretch of more than {loop.horizon:g} s to predict", "give a log of a minute or more"
            ),
            "",
        )
    if validation.swept < SWEPT * strength:
        return (
            f"The result cannot be judged by {name}",
            Doubt(
                f"its field swept {validation.swept * 1e6:.1f} µT", "give a log that turns through all headings"
            ),
            f"at least {SWEPT * strength * 1e6:.0f} µT are needed for iron and gyroscope to show",
        )
    fails = f"The result does not hold on {name}"
    if loop.rms > max(_FOREIGN * strength, 3 * loop.floor, 2 * gap.after.open_loop.rms):
        off = f"its {loop.horizon:g} s prediction is off by {loop.rms * 1e6:.1f} µT"
        return (
            fails,
            Doubt(off, "give a log of the same instrument and mounting"),
            f"at most {_FOREIGN:.0%} of the field is tolerated: another instrument, another mounting or changed iron",
        )
    if validation.differences:
        worst, more = validation.differences[0], len(validation.differences) - 1
        differs = f"there {worst.name} is {worst.after:.3g} {worst.unit}, not {worst.before:.3g}"
        others = f", and {more} more differ" if more else ""
        return (
            fails,
            Doubt(differs, "give a log of the same iron and mounting, or calibrate again"),
            f"{worst.name} differs by {abs(worst.sigmas):.0f} sigmas{others}: changed iron, another mounting or "
            "another delay",
        )
    before, after = validation.before.held_out, validation.after.held_out
    # The likelihood also falls where only the noise differs; the prediction error shows whether the correction helps.
    if after > before - _WORSE or loop.rms < _BETTER * validation.before.open_loop.rms:
        return None
    fell = [f"{value:.3f}".replace("-", "−") for value in (before, after)]
    return (
        fails,
        Doubt("the correction makes its prediction no better", ON_THIS_LOG),
        f"the log-likelihood per window falls from {fell[0]} to {fell[1]} there: what was found is not there, or "
        "is not a property of the instrument",
    )


def noise_there(validation: Validation) -> str:
    """Return a sentence if the noise level of the other recording differs; otherwise ""."""
    over_time = next((m for m in validation.after.maps if m.over == "time"), None)
    if over_time is None or not over_time.share.sum() > 0:
        return ""
    ratio = float(np.sqrt(over_time.share @ over_time.level**2 / over_time.share.sum()))
    if 1 / _NOISIER < ratio < _NOISIER:
        return ""
    return f"The noise level differs on {validation.name}: {ratio:.1f} times that of this log."


def judged_gap(gap: Gap, validation: Validation | None = None, unjudged: str = "") -> Verdict:
    """Return the verdict on a gap, which terminal, page, files and exit code share.

    Args:
        gap: the result of the search.
        validation: its validation on another recording.
        unjudged: why the other recording could not validate it; "" if it could.
    """
    whole = (*clauses(gap.sentence), *sentences(gap.effects))
    noise = "" if validation is None else noise_there(validation)
    contradiction = None if validation is None else contradicted(gap, validation)
    if unjudged:
        contradiction = "The result could not be judged on the other log", Doubt(unjudged, "give another log"), ""
    if gap.doubt is not None:
        doubts = [] if contradiction is None else [f"{contradiction[0]}: {contradiction[1].cause}"]
        # If the gap is closed, the doubt is about the calibration, not about the effects found.
        called = "" if closed(gap) else title(gap)
        return _refused(called, gap.doubt, (*doubts, title(gap), *whole, noise))
    if contradiction is not None:
        called, doubt, more = contradiction
        return _refused(called, doubt, (more, f"On its own log: {title(gap)}", *whole, noise))
    holds = f"The correction holds on {validation.name}" if validation is not None and gap.effects else ""
    worth = _found(gap)
    return Verdict(True, worth=worth, details=_details((holds, *whole, noise), worth), called=title(gap))


def _refused(called: str, doubt: Doubt, details: Sequence[str]) -> Verdict:
    return Verdict(
        False, doubt.cause, doubt.action, details=_details(details, doubt.cause, called), called=said(called)[:-1]
    )


def _found(gap: Gap) -> str:
    """Return the effects found in at most `MOST_WORDS` words or as a list of names."""
    effects = sorted(gap.effects, key=lambda effect: effect.name not in TERMS)
    if not effects:
        return clauses(gap.sentence)[0]
    if len(effects) == 1 and len(effects[0].sentence.split()) <= MOST_WORDS:
        return effects[0].sentence
    labels = dict.fromkeys(effect.label for effect in effects)
    named = [f"{label}{_sizes([effect for effect in effects if effect.label == label])}" for label in labels]
    most = MOST_EFFECTS if len(named) > MOST_EFFECTS + 1 else len(named)
    rest = [f"{len(named) - most} more"] if len(named) > most else []
    return ", ".join(named[:most] + rest)


def _sizes(alike: Sequence[Effect]) -> str:
    """Return the largest value of each effect of one label in brackets, as the details have it; "" without a unit."""
    if not alike[0].unit:
        return ""
    return f" ({', '.join(two_digits(float(np.abs(each.value).max())) for each in alike)} {alike[0].unit})"


def _details(sentences: Sequence[str], *shown: str) -> tuple[str, ...]:
    """Return each sentence once, without those in `shown`."""
    return tuple(dict.fromkeys(said(each) for each in sentences if each and said(each) not in map(said, shown)))


def as_judged(gap: Gap, verdict: Verdict) -> Gap:
    """Return the gap with the verdict's doubt on its calibration, so that every output rejects it alike."""
    if verdict.trusted or gap.doubt is not None:
        return gap
    title = f"{verdict.title[:1].lower()}{verdict.title[1:]}"
    return with_doubt(gap, Doubt(f"{title}, {verdict.cause}", verdict.action))


def title(gap: Gap) -> str:
    """Return the verdict as a heading."""
    return TITLES[gap.verdict]
