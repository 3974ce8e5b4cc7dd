"""The gap as sentences and table rows, for page and terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.evidence.detectable import ENOUGH
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.outcome.agreement import Metrics
from magyc_gtsam.gap.result import Assumption, Effect, Gap, Hypothesis, Isolability, Moved
from magyc_gtsam.gap.samples.noise_effects import COUNTED
from magyc_gtsam.report.words import Number, uncertain

_MICRO = 1e6
_SHOWN = 0.005  # probability from which it is shown
HYPOTHESES = ("hypothesis", "status", "evidence (nats)", "probability", "expected")
_LEAST_PROBABILITY, _MOST_PROBABILITIES = 0.01, 6  # smallest probability in a sentence, and number of them
METRICS = ("", "before", "after")
MOVED = ("parameter", "before", "after", "change (σ)")
DIFFERS = ("parameter that differs", "this log", "other log", "difference (σ)")
ASSUMPTIONS = ("assumption", "simulated", "measured", "")
PLAN = ("effect", "found from", "relevant from", "found when relevant", "remaining", "named as")


def key_numbers(gap: Gap) -> list[Number]:
    """Return the numbers that the page shows first."""
    before, after = gap.before, gap.after
    loop = before.open_loop
    numbers = [
        Number(
            f"Error of the {loop.horizon:.0f} s prediction",
            _arrow(loop.rms * _MICRO, after.open_loop.rms * _MICRO, "µT"),
            f"rms per axis; {after.open_loop.floor * _MICRO:.2f} µT is expected from noise alone",
        )
    ]
    if not len(loop.time):
        numbers = []  # the recording is shorter than the horizon
    if before.heading is not None and after.heading is not None:
        numbers.append(
            Number(
                "Heading error",
                _arrow(before.heading, after.heading, "°").replace(" °", "°"),
                "1σ, against the reference",
            )
        )
    if gap.effects:
        numbers.append(Number("Effects added", str(added(gap)), f"of {len(gap.effects)} named"))
    return numbers


def added(gap: Gap) -> int:
    """Return the number of effects in the calibration; for a field that varies only the sigmas are wider."""
    return sum(effect.applied and effect.name != FIELD_VARIATION for effect in gap.effects)


def effect_value(effect: Effect) -> str:
    """Return the effect's parameters and times, each ± σ; "" for an effect without a unit."""
    values = [uncertain(v, s) for v, s in zip(np.ravel(effect.value), np.ravel(effect.sigma), strict=True)]
    if len(values) > 1:
        values = [f"{name} {value}" for name, value in zip(effect.parameters, values, strict=True)]
    times = [
        f", {key} {uncertain(effect.setting[key], effect.setting[f'{key}_sigma'])} s"
        for key in effect.setting
        if f"{key}_sigma" in effect.setting
    ]
    return f"{', '.join(values)} {effect.unit}{''.join(times)}" if effect.unit else ""


def probability_sentence(gap: Gap) -> str:
    """Return the posterior probabilities of the hypotheses, the likeliest first; "" if nothing was tested."""
    words = {
        "unknown": "something in no catalogue",
        "nothing": "nothing",
        "field-variation": "a field that varies",
    }
    likely = [(name, p) for name, p in gap.probabilities.items() if p >= _LEAST_PROBABILITY][:_MOST_PROBABILITIES]
    told = [f"{words.get(name) or LABELS[name]} {per_cent(p)}" for name, p in likely]
    return f"Probabilities (several can be present): {', '.join(told)}" if told else ""


def per_cent(probability: float) -> str:
    """Return a probability in per cent, as exactly as it is known, and bounded away from 0."""
    if probability < 0.001:
        return "< 0.1 %"
    return f"{100 * probability:.{0 if probability >= 0.1 else 1}f} %"


def hypothesis_label(hypothesis: Hypothesis) -> str:
    """Return the label, with the number of parameters for generic families, whose labels are alike."""
    return hypothesis.label + (f" ({hypothesis.parameters})" if hypothesis.generic else "")


def hypothesis_rows(hypotheses: Sequence[Hypothesis], explained: bool = False) -> list[list[str]]:
    """Return one row per hypothesis, named ones first, then by evidence; columns as in `HYPOTHESES`.

    With `explained`, a last column gives the reason.
    """
    ordered = sorted(hypotheses, key=lambda h: (h.status != "named", -h.evidence))
    return [
        [
            hypothesis_label(h),
            h.status,
            nats_in_words(h.evidence),
            f"{h.probability:.0%}" if h.probability >= _SHOWN else "",
            _expected(h),
            *([h.sentence] if explained else []),
        ]
        for h in ordered
    ]


def nats_in_words(evidence: float) -> str:
    """Return an evidence as text; effects that are counted, not estimated, are certain."""
    if evidence >= COUNTED:
        return "certain"
    digits = 0 if abs(evidence) >= 100 else 1
    return f"{round(evidence, digits) + 0.0:.{digits}f}".replace("-", "−")


def evidence_rows(hypotheses: Sequence[Hypothesis], most: int = 14) -> list[tuple[str, float, str, bool]]:
    """Return (label, bar width in %, evidence as text, significant) per hypothesis, strongest first."""
    shown = sorted(hypotheses, key=lambda h: -h.evidence)[:most]
    top = max([ENOUGH, *(h.evidence for h in shown if h.evidence < COUNTED)])
    size = [float(np.log1p(np.clip(h.evidence, 0.0, top)) / np.log1p(top)) for h in shown]
    return [
        (hypothesis_label(h), 100 * each, nats_in_words(h.evidence), h.significant)
        for h, each in zip(shown, size, strict=True)
    ]


def metric_rows(before: Metrics, after: Metrics) -> list[list[str]]:
    """Return one row per metric of a recording; columns as in `METRICS`."""
    loop = before.open_loop
    rows = [
        [
            f"Error of the {loop.horizon:.0f} s prediction, rms per axis (µT)",
            f"{loop.rms * _MICRO:.3f}",
            f"{after.open_loop.rms * _MICRO:.3f}",
        ],
        [
            "Expected from noise alone (µT)",
            f"{loop.floor * _MICRO:.3f}",
            f"{after.open_loop.floor * _MICRO:.3f}",
        ],
    ]
    if not len(loop.time):
        rows = []  # the recording is shorter than the horizon
    rows += [
        ["Held-out log-likelihood per window", f"{before.held_out:.4f}", f"{after.held_out:.4f}"],
        ["Whiteness of the innovations (1 is white)", f"{before.whiteness:.2f}", f"{after.whiteness:.2f}"],
    ]
    if before.heading is not None and after.heading is not None:
        rows.append(["Heading error, 1σ (°)", f"{before.heading:.3f}", f"{after.heading:.3f}"])
    for key, name, scale in (
        ("magnetic_field", "Magnetometer noise needed (µT)", _MICRO),
        ("angular_rate", "Gyroscope noise needed (mrad/s)", 1e3),
    ):
        if key in before.noise:
            rows.append([name, f"{before.noise[key] * scale:.3g}", f"{after.noise[key] * scale:.3g}"])
    return rows


def line_sentences(metrics: Metrics) -> list[str]:
    """Return a sentence per line in the spectrum of the misfit."""
    return [
        f"The spectrum of the misfit has a line at {line.frequency:.3g} Hz with {line.amplitude * _MICRO:.2f} µT: a "
        "tone, or the period of the motion if an effect is missing."
        for line in metrics.lines
    ]


def moved_rows(moved: Sequence[Moved]) -> list[list[str]]:
    """Return one row per parameter that moved; columns as in `MOVED`."""
    return [
        [f"{m.name} ({m.unit})" if m.unit else m.name, f"{m.before:.4g}", f"{m.after:.4g}", f"{m.sigmas:+.1f}"]
        for m in moved
    ]


def assumption_rows(gap: Gap) -> list[list[str]]:
    """Return one row per assumption of the user's simulator; columns as in `ASSUMPTIONS`."""

    def measured(a: Assumption) -> str:
        return uncertain(a.measured, a.sigma) if a.sigma > 0 else f"{a.measured:.4g}"

    return [
        [
            f"{a.what} ({a.unit})" if a.unit else a.what,
            *((f"{a.simulated:.4g}", measured(a)) if a.compared else ("–", "–")),
            "rejected" if a.rejected else "agrees" if a.compared else "not compared",
        ]
        for a in gap.assumptions
    ]


def by_label(note: str) -> str:
    """Return a note "name: sentence" on an effect with the effect's label in place of its name."""
    name, colon, sentence = note.partition(": ")
    return f"{LABELS.get(name, name)}{colon}{sentence}"


def confusion_sentences(gap: Gap) -> list[str]:
    """Return which other effects each named effect could be confused with."""
    sentences = []
    untested = {u.name for u in gap.untested}
    named = {effect.name for effect in gap.effects}
    for effect in gap.effects:
        alike = ", ".join(LABELS.get(name, name) for name in effect.ambiguous_with if name not in untested)
        if alike and named.issuperset(effect.ambiguous_with):
            sentences.append(f"{effect.label}: it can be distinguished from {alike} only with both in the model.")
            continue
        unseen = ", ".join(LABELS.get(name, name) for name in effect.ambiguous_with if name in untested)
        if alike:
            sentences.append(f"{effect.label}: this motion cannot distinguish it from {alike}.")
        if unseen:
            sentences.append(
                f"{effect.label}: it may also be {unseen}, which cannot be tested without its channel."
            )
        if not effect.ambiguous_with and effect.name in TERMS:
            sentences.append(f"{effect.label}: no other candidate explains these data as well.")
    return list(dict.fromkeys(sentences))


def plan_rows(table: Sequence[Isolability]) -> list[list[str]]:
    """Return one row per effect of an isolability table; columns as in `PLAN`."""
    return [
        [
            row.name,
            f"{row.smallest:.3g} {row.unit}" if np.isfinite(row.smallest) else "never",
            f"{row.matters:.3g} {row.unit}",
            "yes" if row.smallest <= row.matters else "no",
            f"{row.left:.0%}" if np.isfinite(row.left) else "",
            _named_as(row),
        ]
        for row in table
    ]


def _named_as(row: Isolability) -> str:
    """Return the effect's name and the names it is confused with, each with its share of the cases."""
    if not np.isfinite(row.smallest):
        return ""
    return " or ".join([row.name, *(f"{name} ({share:.0%})" for name, share in row.confused_with.items())])


def _arrow(before: float, after: float, unit: str) -> str:
    same = before == after
    return f"{before:.2f} {unit}" if same else f"{before:.2f} → {after:.2f} {unit}"


def _expected(h: Hypothesis) -> str:
    if h.generic or not len(np.ravel(h.expected)):
        return ""
    values, sigmas = np.ravel(h.expected), np.ravel(h.sigma)
    if len(values) > 3:
        return f"|{np.linalg.norm(values):.3g}| {h.unit}"
    return f"{', '.join(uncertain(v, s) for v, s in zip(values, sigmas, strict=True))} {h.unit}"
