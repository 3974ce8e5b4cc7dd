"""The comparison page: the results of all methods on one recording, side by side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from magyc_gtsam.report import compare_charts, compare_words
from magyc_gtsam.report.charts import Figure
from magyc_gtsam.report.html import rendered
from magyc_gtsam.study.outcome import Comparison, MethodOutcome, OutcomeStatus


@dataclass(frozen=True)
class MethodCard:
    """One method with its summary and figures."""

    outcome: MethodOutcome
    summary: str
    caution: str
    figures: tuple[Figure, ...]


def render_comparison(comparison: Comparison) -> str:
    """Return the page as self-contained HTML text."""
    without = [o for o in comparison.outcomes if o.calibration is None]
    verdict = compare_words.judged_comparison(comparison)
    return rendered(
        "compare_template.html",
        comparison.recording,
        samples=len(comparison.inlier),
        headline=verdict.title,
        good=verdict.trusted,
        verdict=verdict,
        result_header=compare_words.result_header(comparison),
        result_rows=compare_words.result_rows(comparison),
        soft_iron_header=compare_words.SOFT_IRON,
        soft_iron=compare_words.soft_iron_rows(comparison),
        motion_header=compare_words.GYROSCOPE,
        motion_rows=compare_words.gyroscope_rows(comparison),
        footnotes=compare_words.footnotes(comparison),
        overview=_overview(comparison),
        linked=[outcome.method for outcome in comparison.calibrated],
        cards=[_card(comparison, o) for o in comparison.by_trust if o.calibration is not None],
        failed=[o for o in without if o.status is OutcomeStatus.FAILED],
        not_run=comparison.not_run,
        impossible=[o for o in without if o.status is OutcomeStatus.IMPOSSIBLE],
    )


def _overview(comparison: Comparison) -> list[compare_charts.DotAxis]:
    if not comparison.calibrated:
        return []
    return [compare_charts.hard_irons(comparison, axis) for axis in range(3)]


def _card(comparison: Comparison, outcome: MethodOutcome) -> MethodCard:
    figures = [compare_charts.ellipsoid(comparison, outcome), compare_charts.strength(comparison, outcome)]
    if outcome.heading is not None and comparison.raw.heading is not None:
        figures.append(compare_charts.heading(comparison, outcome))
    summary = _changes(comparison.raw, outcome, *comparison.recording.field_shown)
    caution = "" if outcome.status is OutcomeStatus.TRUSTED else outcome.reason
    return MethodCard(outcome, ", ".join(summary), caution, tuple(figures))


def _changes(raw: MethodOutcome, outcome: MethodOutcome, scale: float, unit: str) -> Iterable[str]:
    if raw.spread is not None and outcome.spread is not None:
        yield f"field spread {raw.spread * scale:.2f} → {outcome.spread * scale:.2f} {unit}"
    if raw.heading is not None and outcome.heading is not None:
        yield f"heading spread {raw.heading.deviation:.2f}° → {outcome.heading.deviation:.2f}°"
    if outcome.seconds is not None:
        yield f"run time {compare_words.duration(outcome.seconds)}"
