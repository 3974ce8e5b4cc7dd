"""The comparison page: all methods on one recording, to see which to believe."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from markupsafe import Markup

from magyc_gtsam.report import compare_plots, compare_words
from magyc_gtsam.report.html import Figure, rendered
from magyc_gtsam.study.comparison import Comparison, Outcome, Status


@dataclass(frozen=True)
class Card:
    """A method with its figures."""

    outcome: Outcome
    summary: str
    caution: str
    ellipsoids: tuple[Figure, ...]
    figures: tuple[Figure, ...]


def render_comparison(comparison: Comparison) -> str:
    """The page as HTML text, self-contained."""
    cloud = compare_plots.cloud(comparison)
    without = [o for o in comparison.outcomes if o.calibration is None]
    return rendered(
        "compare_template.html",
        comparison.recording,
        samples=len(comparison.inlier),
        headline=_headline(comparison),
        good=bool(comparison.trusted),
        result_header=compare_words.result_header(comparison),
        result_rows=compare_words.result_rows(comparison),
        parameter_header=compare_words.parameter_header(),
        parameter_rows=compare_words.parameter_rows(comparison),
        footnotes=compare_words.footnotes(comparison),
        heading=comparison.raw.heading is not None,
        outliers=not comparison.inlier.all(),
        overview=_overview(comparison),
        linked=[outcome.method for outcome in comparison.calibrated],
        cards=[_card(comparison, outcome, cloud) for outcome in comparison.calibrated],
        failed=[o for o in without if o.status is Status.FAILED],
        not_run=comparison.not_run,
        impossible=[o for o in without if o.status is Status.IMPOSSIBLE],
    )


def _headline(comparison: Comparison) -> str:
    ran = sum(o.status is not Status.IMPOSSIBLE for o in comparison.outcomes)
    good = len(comparison.trusted)
    if ran == 0:
        return "This log allows none of the methods"
    if good == 0:
        return f"None of {ran} methods gave a result to trust"
    return f"{good} of {ran} methods gave a result to trust"


def _overview(comparison: Comparison) -> list[Figure]:
    if not comparison.calibrated:
        return []
    return [
        Figure(Markup(compare_plots.hard_irons(comparison, axis)), f"Hard iron along {name}")
        for axis, name in enumerate("xyz")
    ]


def _card(comparison: Comparison, outcome: Outcome, samples: compare_plots.Cloud) -> Card:
    calibration, strength = outcome.calibration, outcome.strength
    assert calibration is not None
    assert strength is not None
    scale, unit = comparison.recording.field_shown
    matrix, centre = calibration.soft_iron * strength * scale, calibration.hard_iron * scale
    ellipsoids = [
        Figure(Markup(compare_plots.ellipsoid(samples, matrix, centre, plane)), f"Ellipsoid seen along {gone}")
        for plane, gone in (((0, 1), "z"), ((0, 2), "y"), ((1, 2), "x"))
    ]
    figures = [Figure(Markup(compare_plots.strength(comparison, outcome)), "Strength before and after")]
    if outcome.heading is not None and comparison.raw.heading is not None:
        svg = compare_plots.heading(comparison.raw.heading, outcome.heading)
        figures.append(Figure(Markup(svg), "Heading error before and after"))
    summary = _changes(comparison.raw, outcome, scale, unit)
    caution = "" if outcome.status is Status.TRUSTED else outcome.reason
    return Card(outcome, ", ".join(summary), caution, tuple(ellipsoids), tuple(figures))


def _changes(raw: Outcome, outcome: Outcome, scale: float, unit: str) -> Iterable[str]:
    if raw.spread is not None and outcome.spread is not None:
        yield f"field spread {raw.spread * scale:.2f} → {outcome.spread * scale:.2f} {unit}"
    if raw.heading is not None and outcome.heading is not None:
        yield f"heading spread {raw.heading.deviation:.2f}° → {outcome.heading.deviation:.2f}°"
    if outcome.seconds is not None:
        yield f"run time {compare_words.duration(outcome.seconds)}"
