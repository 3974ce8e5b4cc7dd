"""The gap page: the disagreement of model and measurement, the effects that explain it, and the remainder."""

from __future__ import annotations

import json

from magyc_gtsam.gap.effects import PHYSICS
from magyc_gtsam.gap.evidence.detectable import ENOUGH
from magyc_gtsam.gap.outcome.described import sentences
from magyc_gtsam.gap.result import Gap
from magyc_gtsam.recording import Recording
from magyc_gtsam.report import gap_charts, gap_words, words
from magyc_gtsam.report.gap_verdict import ON_THIS_LOG, Validation, judged_gap
from magyc_gtsam.report.html import rendered
from magyc_gtsam.report.verdict import Verdict, said
from magyc_gtsam.storage.json_types import json_types


def render_gap(
    recording: Recording,
    gap: Gap,
    validation: Validation | None = None,
    verdict: Verdict | None = None,
) -> str:
    """Return the page as self-contained HTML text.

    Args:
        recording: the recording that was searched.
        gap: the result of the search.
        validation: both models on another recording.
        verdict: the verdict on the gap; judged here if None.
    """
    verdict = verdict or judged_gap(gap, validation)
    return rendered(
        "gap_template.html",
        recording,
        gap=gap,
        changed=gap.after is not gap.before,
        headline=verdict.title,
        good=verdict.trusted,
        verdict=verdict,
        said=said,
        numbers=gap_words.key_numbers(gap),
        story=[*gap_charts.shrinking(recording, gap), *gap_charts.heading_shrinking(recording, gap)],
        maps=gap_charts.maps(recording, gap.before, gap.after),
        lines=gap_words.line_sentences(gap.before),
        effects=[(effect, gap_words.effect_value(effect)) for effect in gap.effects],
        per_cent=gap_words.per_cent,
        probabilities=gap_words.probability_sentence(gap),
        evidence=gap_words.evidence_rows(gap.hypotheses),
        enough=ENOUGH,
        hypothesis_header=(*gap_words.HYPOTHESES, "in words"),
        significant_rows=gap_words.hypothesis_rows([h for h in gap.hypotheses if h.significant], explained=True),
        other_rows=gap_words.hypothesis_rows([h for h in gap.hypotheses if not h.significant], explained=True),
        effect_sentences=[said(sentence) for sentence in sentences(gap.effects)],
        physics=PHYSICS,
        confusions=gap_words.confusion_sentences(gap),
        metric_header=gap_words.METRICS,
        metric_rows=gap_words.metric_rows(gap.before, gap.after),
        validation=validation,
        validation_notes=[]
        if validation is None
        else [said(gap_words.by_label(note)) for note in validation.notes],
        validation_rows=[] if validation is None else gap_words.metric_rows(validation.before, validation.after),
        differs_header=gap_words.DIFFERS,
        differs_rows=[] if validation is None else gap_words.moved_rows(validation.differences),
        moved_header=gap_words.MOVED,
        moved_rows=gap_words.moved_rows(gap.moved),
        assumption_header=gap_words.ASSUMPTIONS,
        assumption_rows=gap_words.assumption_rows(gap),
        parameter_rows=words.parameter_rows(gap.calibration),
        advice=_advice(gap, verdict),
        configuration=json.dumps(json_types(gap.diagnostics), indent=2, ensure_ascii=False),
    )


def _advice(gap: Gap, verdict: Verdict) -> list[str]:
    if verdict.action == ON_THIS_LOG:
        lines = ["Use the correction on this log only, with `magyc-gtsam apply --force`."]
    elif not verdict.trusted:
        lines = [f"Do not use this calibration: {verdict.action}."]
        if gap.verdict in ("none", "closed") and verdict.called:  # rejected because of another recording
            lines.append("Use the correction only after it holds on another log.")
        elif gap.verdict == "unknown":
            lines.append("The calibration was not changed. The evidence below shows what the misfit depends on.")
    elif gap.verdict == "none":
        lines = ["Use the calibration: the data agree with it, as far as this motion can show."]
    else:
        lines = [
            "Use the calibration with its effects: `magyc-gtsam apply` corrects what was added to the model."
            if gap_words.added(gap)
            else "Use the calibration: nothing was added to it, its sigmas allow for what was named.",
            "Record again and test the result on the new log with `--validate`.",
        ]
    if gap.untested:
        names = ", ".join(candidate.label for candidate in gap.untested)
        lines = [*lines, f"Not tested, because the log has no channel for it: {names}."]
    if gap.next_manoeuvre is not None and gap.next_manoeuvre.motion != verdict.action:
        lines = [*lines, gap.next_manoeuvre.sentence]
    return lines
