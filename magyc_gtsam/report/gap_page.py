"""The gap page: where model and measurement disagree, what it was named, and how it shrank."""

from __future__ import annotations

import json

from markupsafe import Markup

from magyc_gtsam.gap.result import Gap, Metrics
from magyc_gtsam.json_types import json_types
from magyc_gtsam.recording import Recording
from magyc_gtsam.report import gap_plots, gap_words, words
from magyc_gtsam.report.html import Figure, rendered


def render_gap(recording: Recording, gap: Gap, validation: gap_words.Validation | None = None) -> str:
    """The page as HTML text, self-contained.

    Args:
        recording: what was searched.
        gap: the result.
        validation: both models on another recording.
    """
    return rendered(
        "gap_template.html",
        recording,
        gap=gap,
        changed=gap.after is not gap.before,
        headline=gap_words.title(gap),
        good=gap_words.closed(gap),
        said=gap_words.said,
        numbers=gap_words.key_numbers(gap),
        maps=_maps(gap.before, gap.after),
        lines=gap_words.line_sentences(gap.before),
        effects=[(effect, gap_words.effect_value(effect)) for effect in gap.effects],
        evidence=Figure(
            Markup(gap_plots.evidence(gap.hypotheses)),
            "Evidence",
            "Over its threshold, which the upright marks show; orange: significant.",
        ),
        hypothesis_header=(*gap_words.HYPOTHESES, "in words"),
        significant_rows=gap_words.hypothesis_rows([h for h in gap.hypotheses if h.significant], explained=True),
        other_rows=gap_words.hypothesis_rows([h for h in gap.hypotheses if not h.significant], explained=True),
        confusions=gap_words.confusion_sentences(gap),
        metric_header=gap_words.METRICS,
        metric_rows=gap_words.metric_rows(gap.before, gap.after),
        validation=validation,
        validation_rows=[] if validation is None else gap_words.metric_rows(validation.before, validation.after),
        differs_header=gap_words.DIFFERS,
        differs_rows=[] if validation is None else gap_words.moved_rows(validation.differences),
        loops=_loops(gap, recording.name, validation),
        moved_header=gap_words.MOVED,
        moved_rows=gap_words.moved_rows(gap.moved),
        assumption_header=gap_words.ASSUMPTIONS,
        assumption_rows=gap_words.assumption_rows(gap),
        parameter_rows=words.parameter_rows(gap.calibration),
        advice=_advice(gap),
        configuration=json.dumps(json_types(gap.diagnostics), indent=2, ensure_ascii=False),
    )


def _maps(before: Metrics, after: Metrics) -> list[Figure]:
    later = {gap.over: gap for gap in after.maps}
    figures = []
    for gap in before.maps:
        then = gap if after is before else later.get(gap.over, gap)
        worst = "Inside the band" if gap.worst <= 1 else f"Up to {gap.worst:.2f} times the band"
        closing = "" if then is gap else f", then {'inside it' if then.worst <= 1 else f'{then.worst:.2f} times'}"
        figures.append(Figure(Markup(gap_plots.gap_map(gap, then)), f"Over {gap.over}", f"{worst}{closing}."))
    return figures


def _loops(gap: Gap, name: str, validation: gap_words.Validation | None) -> list[Figure]:
    pairs = [(name or "this recording", gap.before, gap.after)]
    if validation is not None:
        pairs.append((validation.name, validation.before, validation.after))
    return [
        Figure(
            Markup(gap_plots.open_loop(before.open_loop, after.open_loop)),
            f"Prediction over {before.open_loop.horizon:.0f} s: {where}",
            f"Measured less predicted. Band: 99 % of what the {'new ' if after is not before else ''}model expects.",
        )
        for where, before, after in pairs
        if len(before.open_loop.time)  # none in a recording shorter than the horizon
    ]


def _advice(gap: Gap) -> list[str]:
    lines = {
        "none": ["Use the calibration as it is: in all that this motion shows, the data agree with it."],
        "closed": [
            "Use the calibration with its terms; the parameters of other autopilots cannot hold them.",
            "Record again and give the new log with --validate: the gap should stay closed.",
        ],
        "unknown": [
            "Nothing was changed. Look at the maps above for what goes with the misfit.",
            "Record more channels beside the sensors (current, temperature, depth, position), and search again.",
        ],
        "open": [
            "The named effect is not, or not wholly, corrected: remove its cause, or treat the data with care.",
        ],
        "not enough information": ["Do not use this calibration. Record again with more motion, and search then."],
    }[gap.verdict]
    if gap.untested:
        names = ", ".join(candidate.label for candidate in gap.untested)
        lines = [*lines, f"Not tested for want of a channel: {names}."]
    if gap.next_manoeuvre is not None:
        lines = [*lines, gap.next_manoeuvre.sentence]
    return lines
