"""The comparison page: all methods on one recording side by side, with figures after Fig. 7 of the Autocal paper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.recording import Array
from magyc_gtsam.report import compare_words
from magyc_gtsam.report.charts import Figure, origin, over_time, sphere
from magyc_gtsam.report.html import rendered
from magyc_gtsam.report.words import uncertain
from magyc_gtsam.study.outcome import Comparison, MethodOutcome, OutcomeStatus

_BEYOND = 1.5  # half width of the scale in spreads of the trusted methods; estimates beyond are drawn at the edge


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


def _overview(comparison: Comparison) -> list[DotAxis]:
    if not comparison.calibrated:
        return []
    return [_hard_irons(comparison, axis) for axis in range(3)]


def _card(comparison: Comparison, outcome: MethodOutcome) -> MethodCard:
    figures = [_ellipsoid(comparison, outcome), _strength(comparison, outcome)]
    if outcome.heading is not None and comparison.raw.heading is not None:
        figures.append(_heading(comparison, outcome))
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


@dataclass(frozen=True)
class DotAxis:
    """The estimates along one axis, and the labels at both ends and in the middle of their scale."""

    axis: str
    dots: list[Dot]
    ticks: tuple[str, str, str]


@dataclass(frozen=True)
class Dot:
    """One method's estimate on a scale: its position `left`, its bar from `start` over `width`, in %, and its text."""

    method: str
    left: float
    start: float
    width: float
    words: str
    trusted: bool
    beyond: bool


def _ellipsoid(comparison: Comparison, outcome: MethodOutcome) -> Figure:
    """Draw the raw samples, the outliers in another colour, and the method's ellipsoid."""
    calibration, strength = outcome.calibration, outcome.strength
    assert calibration is not None
    assert strength is not None
    scale, unit = comparison.recording.field_shown
    field = comparison.recording.magnetometer.value * scale
    clouds = [("samples", "raw", field[comparison.inlier])]
    if not comparison.inlier.all():
        clouds.append(("samples that do not fit", "disturbed", field[~comparison.inlier]))
    radius = float(np.median(np.linalg.norm(field - field.mean(axis=0), axis=1)))
    matrix, centre = calibration.soft_iron * strength * scale, calibration.hard_iron * scale
    return sphere(f"Samples and ellipsoid ({unit})", "", clouds, radius, outlines=[(matrix, centre, "ink")])


def _strength(comparison: Comparison, outcome: MethodOutcome) -> Figure:
    """Draw the strength of the field over time, before and after."""
    assert outcome.calibration is not None
    time, field = comparison.recording.magnetometer
    scale, unit = comparison.recording.field_shown
    raw, calibrated = (np.linalg.norm(f, axis=1) * scale for f in (field, outcome.calibration.corrected(field)))
    return over_time(
        "Strength before and after",
        "",
        time - origin(comparison.recording),
        [("raw", "raw", raw), ("calibrated", "calibrated", calibrated)],
        f"Strength ({unit})",
        levels=[float(np.median(calibrated))],
    )


def _heading(comparison: Comparison, outcome: MethodOutcome) -> Figure:
    """Draw the error of the magnetic heading against the reference over time, before and after."""
    raw, calibrated = comparison.raw.heading, outcome.heading
    assert raw is not None
    assert calibrated is not None
    return over_time(
        "Heading error before and after",
        "",
        raw.time,
        [("raw", "raw", raw.error), ("calibrated", "calibrated", calibrated.error)],
        "Error (°)",
        levels=[0.0],
    )


def _hard_irons(comparison: Comparison, axis: int) -> DotAxis:
    """Return the hard iron of every method along an axis, on a scale set by the trusted methods."""
    outcomes = [o for o in comparison.by_trust if o.calibration is not None]
    scale, unit = comparison.recording.field_shown
    value, sigma = _estimates(outcomes, axis, scale)
    trusted = np.array([o.status is OutcomeStatus.TRUSTED for o in outcomes])
    every = np.array([o.calibration.hard_iron for o in outcomes if o.calibration]) * scale
    seen = every[trusted] if trusted.any() else every
    bars = [0.0, *np.nan_to_num(sigma[trusted])]
    reach = _BEYOND * 0.7 * max(float(np.ptp(seen, axis=0).max()), max(bars), 1e-6)
    low = 0.5 * (seen[:, axis].min() + seen[:, axis].max()) - reach
    place = 100 * (value - low) / (2 * reach)
    half = 50 * np.nan_to_num(sigma) / reach
    start, end = np.clip(place - half, 0, 100), np.clip(place + half, 0, 100)
    dots = [
        Dot(
            o.method,
            float(np.clip(at, 1, 99)),
            float(first),
            float(last - first),
            f"{uncertain(v, s) if s > 0 else f'{v:.2f}'} {unit}",
            bool(good),
            not 0 < at < 100,
        )
        for o, at, first, last, v, s, good in zip(outcomes, place, start, end, value, sigma, trusted, strict=True)
    ]
    decimals = int(np.clip(2 - np.floor(np.log10(reach)), 0, 6))
    left, middle, right = (f"{low + share * reach:.{decimals}f}" for share in (0, 1, 2))
    return DotAxis("xyz"[axis], dots, (left, middle, f"{right} {unit}"))


def _estimates(outcomes: Sequence[MethodOutcome], axis: int, scale: float) -> tuple[Array, Array]:
    unknown = np.full(3, np.nan)
    known = [o.calibration for o in outcomes if o.calibration is not None]
    value = np.array([calibration.hard_iron[axis] for calibration in known]) * scale
    sigma = np.array([calibration.sigma.get("hard_iron", unknown)[axis] for calibration in known]) * scale
    return value, sigma
