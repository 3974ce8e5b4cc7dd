"""The comparison's numbers as records for a file, and as table texts for the terminal and the page."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np

from magyc_gtsam.factors.chain.vech import ENTRIES
from magyc_gtsam.foreign_text import cause_and_action, clauses
from magyc_gtsam.recording import Array
from magyc_gtsam.report.verdict import Verdict
from magyc_gtsam.report.words import uncertain
from magyc_gtsam.study.outcome import Comparison, MethodOutcome, OutcomeStatus

_HUGE = 1e5  # in the unit shown; larger values are written without decimals


def records(comparison: Comparison) -> list[dict[str, Any]]:
    """Return one flat record per method, "raw" first: units in the names, None where a method has no such number."""
    unit = comparison.recording.magnetic_field_unit
    rows = []
    for outcome in (comparison.raw, *comparison.outcomes):
        calibration, heading = outcome.calibration, outcome.heading
        row: dict[str, Any] = {
            "method": outcome.method,
            "status": "" if outcome is comparison.raw else str(outcome.status),
            "reason": outcome.reason,
            "note": outcome.note,
            "run_time_s": outcome.seconds,
            f"field_spread_{unit}": outcome.spread,
            f"field_spread_inliers_{unit}": outcome.inlier_spread,
            f"field_strength_{unit}": outcome.strength,
            "heading_spread_deg": None if heading is None else heading.deviation,
        }
        sigma = {} if calibration is None else calibration.sigma
        upper = np.triu_indices(3)
        for name, value, deviation, axes in (
            (
                "soft_iron",
                None if calibration is None else calibration.soft_iron[upper],
                sigma["soft_iron"][upper] if sigma else None,
                ENTRIES,
            ),
            (
                "hard_iron",
                None if calibration is None else calibration.hard_iron,
                sigma.get("hard_iron"),
                [f"{axis}_{unit}" for axis in "xyz"],
            ),
            (
                "gyro_bias",
                None if calibration is None else calibration.gyro_bias,
                sigma.get("gyro_bias"),
                [f"{axis}_rad/s" for axis in "xyz"],
            ),
        ):
            row |= {f"{name}_{axis}": _number(value, i) for i, axis in enumerate(axes)}
            row |= {f"{name}_{axis}_sigma": _number(deviation, i) for i, axis in enumerate(axes)}
        estimated = calibration is not None and calibration.delay_sigma is not None
        row["delay_s"] = calibration.delay if calibration is not None and estimated else None
        row["delay_s_sigma"] = calibration.delay_sigma if calibration is not None else None
        rows.append(row)
    return rows


def csv_text(comparison: Comparison) -> str:
    """Return `records` as CSV; cells without a number are empty."""
    rows = records(comparison)
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0].keys())
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def to_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as JSON types, calibrations included."""
    outcomes = [
        record | {"calibration": None if outcome.calibration is None else outcome.calibration.to_dict()}
        for record, outcome in zip(records(comparison), (comparison.raw, *comparison.outcomes), strict=True)
    ]
    return {
        "recording": comparison.recording.name,
        "magnetic_field_unit": comparison.recording.magnetic_field_unit,
        "samples": len(comparison.inlier),
        "inliers": int(comparison.inlier.sum()),
        "inliers_from": comparison.inlier_from,
        "delay_s": comparison.delay,
        "delay_from": comparison.delay_from,
        "not_run": list(comparison.not_run),
        "notes": list(comparison.recording.notes),
        "outcomes": outcomes,
    }


def judged_comparison(comparison: Comparison) -> Verdict:
    """Return the verdict: the reference method to use, and the number of methods with a trusted result."""
    ran = sum(o.status is not OutcomeStatus.IMPOSSIBLE for o in comparison.outcomes)
    best, good = comparison.recommended, len(comparison.trusted)
    if ran == 0:
        return Verdict(
            False, "none of the methods has what it needs", called="This log allows none of the methods"
        )
    counted = f"{good} of {ran} methods gave a result to trust"
    if best is None:
        return Verdict(False, f"none of {ran} methods gave a result to trust", called="Use none of these")
    why = "the most accurate of them" if best is comparison.reference else "its calibrated field varies least"
    return Verdict(True, worth=f"{counted}, and it is {why}" if good > 1 else counted, called=f"Use {best.method}")


def short_header(comparison: Comparison) -> list[str]:
    """Return the column names of `short_rows`."""
    _, unit = comparison.recording.field_shown
    header = ["method", "status", f"hard iron ({unit})", f"spread ({unit})"]
    return [*header, *(["heading (°)"] if comparison.raw.heading is not None else []), "time"]


def short_rows(comparison: Comparison) -> list[list[str]]:
    """Return one row per calibrated method for a terminal of 80 columns; `remarks` names the other methods."""
    scale, _ = comparison.recording.field_shown
    rows = []
    for outcome in (comparison.raw, *comparison.by_trust):
        if outcome.calibration is None:
            continue
        raw = outcome is comparison.raw
        iron = "" if raw else ", ".join(_brief(value * scale) for value in outcome.calibration.hard_iron)
        row = [outcome.method, "" if raw else str(outcome.status), iron]
        row.append("" if outcome.inlier_spread is None else _brief(outcome.inlier_spread * scale))
        if comparison.raw.heading is not None:
            row.append("" if outcome.heading is None else f"{outcome.heading.deviation:.2f}")
        rows.append([*row, duration(outcome.seconds)])
    return rows


def _brief(value: float) -> str:
    """Return the value in about six characters."""
    size = abs(value)
    return f"{value:.2f}" if size < 100 else f"{value:.0f}" if size < _HUGE else f"{value:.0e}"


def result_header(comparison: Comparison) -> list[str]:
    """Return the column names of `result_rows`."""
    _, unit = comparison.recording.field_shown
    header = ["method", "status", *(f"hard iron {axis} ({unit})" for axis in "xyz"), f"field spread ({unit})"]
    if not comparison.inlier.all():
        header.append("of inliers")
    if comparison.raw.heading is not None:
        header.append("heading spread (°)")
    return [*header, "run time"]


def result_rows(comparison: Comparison) -> list[list[str]]:
    """Return one row per method, "raw" first: method, status, hard iron ± σ, spreads of field and heading, run time."""
    scale, _ = comparison.recording.field_shown
    rows = []
    for outcome in (comparison.raw, *comparison.by_trust):
        raw = outcome is comparison.raw
        row = [outcome.method, "" if raw else str(outcome.status)]
        row += [""] * 3 if raw else _triple(outcome, "hard_iron", scale)
        row.append(_text(outcome.spread, scale))
        if not comparison.inlier.all():
            row.append(_text(outcome.inlier_spread, scale))
        if comparison.raw.heading is not None:
            row.append("" if outcome.heading is None else f"{outcome.heading.deviation:.2f}")
        rows.append([*row, duration(outcome.seconds)])
    return rows


SOFT_IRON = ("method", *(f"soft iron {name}" for name in ENTRIES))
GYROSCOPE = ("method", *(f"gyroscope bias {axis} (mrad/s)" for axis in "xyz"), "delay (ms)")


def soft_iron_rows(comparison: Comparison) -> list[list[str]]:
    """Return the soft iron ± σ of each calibrated method; columns as in `SOFT_IRON`."""
    rows = []
    upper = np.triu_indices(3)
    for outcome in comparison.by_trust:
        calibration = outcome.calibration
        if calibration is None:
            continue
        sigma = calibration.sigma.get("soft_iron", np.full((3, 3), np.nan))
        soft_iron = [uncertain(v, s) for v, s in zip(calibration.soft_iron[upper], sigma[upper], strict=True)]
        rows.append([outcome.method, *soft_iron])
    return rows


def gyroscope_rows(comparison: Comparison) -> list[list[str]]:
    """Return gyroscope bias and delay ± σ of the methods that estimate one of them; columns as in `GYROSCOPE`."""
    rows = []
    for outcome in comparison.by_trust:
        calibration = outcome.calibration
        if calibration is None or (calibration.gyro_bias is None and calibration.delay_sigma is None):
            continue
        delay = (
            ""
            if calibration.delay_sigma is None
            else uncertain(calibration.delay * 1e3, calibration.delay_sigma * 1e3)
        )
        rows.append([outcome.method, *_triple(outcome, "gyro_bias", 1e3), delay])
    return rows


def remarks(comparison: Comparison) -> list[str]:
    """Return a sentence with the first reason for each method that is not trusted, and the notes on single methods.

    Of a method that failed it is the whole message, whose remedy comes last.

    The page shows all reasons.
    """
    sentences = [
        f"{o.method} {o.status}: {o.reason if o.status is OutcomeStatus.FAILED else _first(o.reason)}"
        for o in comparison.by_trust
        if o.status is not OutcomeStatus.TRUSTED
    ]
    if comparison.not_run:
        sentences.append(f"interrupted before {', '.join(comparison.not_run)}")
    notes = dict.fromkeys(o.note for o in comparison.outcomes if o.note)
    shared = {note: ", ".join(o.method for o in comparison.outcomes if o.note == note) for note in notes}
    return sentences + [f"{names}: {note}" for note, names in shared.items()]


def _first(reason: str) -> str:
    """Return the first reason in at most 30 words."""
    first = next(iter(clauses(reason)), "no reason given")
    return ": ".join(part for part in cause_and_action(first) if part)


def footnotes(comparison: Comparison) -> list[str]:
    """Return the explanations that apply to the numbers of all methods."""
    sentences = ["Field spread: standard deviation of the calibrated field's strength."]
    if not comparison.inlier.all():
        out = int((~comparison.inlier).sum())
        sentences.append(
            f"{out:,} of {len(comparison.inlier):,} samples lie off the ellipsoid of {comparison.inlier_from}; "
            "the others are the inliers."
        )
    if comparison.raw.heading is not None:
        way = "later" if comparison.delay > 0 else "earlier"
        late = f", the field taken {abs(comparison.delay) * 1e3:.1f} ms {way}, as {comparison.delay_from} found it"
        estimate = comparison.recording.attitude_is == "estimate"
        reference = (
            "attitude of the log, an estimate that the magnetometer took part in"
            if estimate
            else "reference attitude"
        )
        sentences.append(
            f"Heading spread: standard deviation of the magnetic heading against the {reference}"
            f"{late if comparison.delay_from else ''}."
        )
    if comparison.recording.magnetic_field_unit == "counts":
        sentences.append(
            "The field is in raw counts as the log holds them; what one count is in tesla is not known."
        )
    return sentences


def duration(seconds: float | None) -> str:
    """Return a run time as text: "12 ms", "3.40 s", "25 s"."""
    if seconds is None:
        return ""
    return (
        f"{seconds * 1e3:.2g} ms"
        if seconds < 0.0995
        else f"{seconds:.2f} s"
        if seconds < 10
        else f"{seconds:.0f} s"
    )


def _triple(outcome: MethodOutcome, name: str, scale: float) -> list[str]:
    value = None if outcome.calibration is None else getattr(outcome.calibration, name)
    if outcome.calibration is None or value is None:
        return [""] * 3
    sigma = outcome.calibration.sigma.get(name, np.full(3, np.nan))
    return [
        uncertain(v * scale, s * scale) if s > 0 else _text(v, scale) for v, s in zip(value, sigma, strict=True)
    ]


def _number(values: Array | None, index: int) -> float | None:
    return None if values is None else float(values[index])


def _text(value: float | None, scale: float) -> str:
    if value is None:
        return ""
    return f"{value * scale:.2f}" if abs(value * scale) < _HUGE else f"{value * scale:.1e}"
