"""The report's texts: key numbers, parameters with their uncertainty, advice and exports."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.export import TARGETS
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.level_turn import LevelTurn
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.report.analysis import Coverage, FieldHistory
from magyc_gtsam.report.verdict import Verdict, degrees

_MICRO = 1e6
# Terms that `calibrate` may add, with a value for each axis: their names on the page and the factor from SI units.
_TERMS = {
    "misalignment": ("Misalignment of the chips (°)", float(np.degrees(1))),
    "gyro-scale": ("Gyroscope scale, read too large by (%)", 1e2),
}
_TARGET_NAMES = {"px4": "PX4", "ardupilot": "ArduPilot", "vectornav": "VectorNav", "ros": "ROS 2"}
_LONG = 12  # longer lists among the options are summarised


@dataclass(frozen=True)
class Number:
    """A number that a page shows first: its name, its value as text, and its meaning."""

    what: str
    value: str
    meaning: str


def cautions(history: FieldHistory) -> list[str]:
    """Return warnings that apply even where the verdict is good."""
    sentences = []
    if _spread(history.calibrated) > _spread(history.raw):
        sentences.append("The strength of the calibrated field varies more than that of the raw field.")
    if history.heading_error is not None:
        raw, calibrated = np.nanstd(history.heading_error, axis=0)
        if calibrated > raw:
            sentences.append("The heading agrees less with the reference after calibration than before.")
    return sentences


def _spread(field: Array) -> float:
    return float(np.linalg.norm(field, axis=1).std())


def key_numbers(
    calibration: Calibration, verdict: Verdict, history: FieldHistory, turn: LevelTurn, visited: Coverage
) -> list[Number]:
    """Return the numbers that the page shows first."""
    before, after = (_three_digits(_spread(field) * _MICRO) for field in (history.raw, history.calibrated))
    numbers = [Number("Field strength varies by", f"{before} → {after} µT", "1σ, raw → calibrated")]
    if history.heading_error is not None:
        raw, calibrated = np.nanstd(history.heading_error, axis=0)
        numbers.append(
            Number(
                "Heading error",
                f"{raw:.1f} → {calibrated:.1f}°",
                "1σ, raw → calibrated",
            )
        )
    else:
        largest = float(np.abs(turn.raw_error(calibration.soft_iron, calibration.hard_iron)).max())
        numbers.append(Number("Heading corrected by up to", f"{largest:.1f}°", "in a level turn"))
    heading = verdict.heading
    if verdict.trusted:  # the covariance of another result does not bound its error
        numbers.append(
            Number(
                "Systematic heading error",
                degrees(heading.systematic),
                f"1σ, the worst heading of a level turn; single samples {degrees(heading.per_sample)}",
            )
        )
    numbers += [
        Number("Field strength", f"{history.strength * _MICRO:.2f} µT", "of the calibrated field"),
        Number(
            "Hard iron",
            f"{_three_digits(float(np.linalg.norm(calibration.hard_iron)) * _MICRO)} µT",
            "length of the vector",
        ),
        Number(
            "Directions visited",
            f"{visited.share:.0%}" if visited.share >= 0.005 else "under 1%",
            "of the sphere around the sensor",
        ),
    ]
    return numbers


def _three_digits(value: float) -> str:
    """Return the value with three significant digits, at most two of them decimals."""
    return f"{value:.{int(np.clip(2 - np.floor(np.log10(max(value, 1e-9))), 0, 2))}f}"


def uncertain(value: float, sigma: float) -> str:
    """Return "value ± sigma", both to two digits of sigma; without ± if sigma is 0 or NaN."""
    if not sigma > 0:
        return f"{value:.4f}"
    decimals = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 7))
    value = round(float(value), decimals) + 0.0  # never -0
    return f"{value:.{decimals}f} ±\N{NO-BREAK SPACE}{sigma:.{decimals}f}".replace("-", "−")


def _has_row(term: Term) -> bool:
    return term.name in _TERMS and len(term.value) == 3


def other_terms(calibration: Calibration) -> list[str]:
    """Return the terms without a row among the parameters, with their values in SI units."""
    terms = [term for term in calibration.terms if not _has_row(term)]
    return [f"{term.name} (SI units): {', '.join(map(str, term.value.tolist()))}" for term in terms]


def parameter_rows(calibration: Calibration) -> list[tuple[str, list[str]]]:
    """Return one row per parameter: (name with its unit, one text per axis or a single text)."""
    sigma = calibration.sigma
    unknown = np.full(3, np.nan)

    def row(name: str, value: Array, deviation: Array, scale: float = 1.0) -> tuple[str, list[str]]:
        return name, [uncertain(v * scale, s * scale) for v, s in zip(value, deviation, strict=True)]

    soft_iron_sigma = sigma.get("soft_iron", np.full((3, 3), np.nan))
    names = ("Soft iron", "", "")
    rows = [row(*each) for each in zip(names, calibration.soft_iron, soft_iron_sigma, strict=True)]
    rows.append(row("Hard iron (µT)", calibration.hard_iron, sigma.get("hard_iron", unknown), _MICRO))
    if calibration.gyro_bias is not None:
        bias, bias_sigma = calibration.gyro_bias, sigma.get("gyro_bias", unknown)
        rows.append(row("Gyroscope bias (mrad/s)", bias, bias_sigma, 1e3))
        rows.append(row("Gyroscope bias (°/s)", bias, bias_sigma, float(np.degrees(1))))
    for term in calibration.terms:
        if _has_row(term):
            name, factor = _TERMS[term.name]
            rows.append(row(name, term.value, term.sigma, factor))
    if calibration.delay or calibration.delay_sigma is not None:
        delay_sigma = np.nan if calibration.delay_sigma is None else calibration.delay_sigma
        rows.append(("Magnetometer lags by (ms)", [uncertain(calibration.delay * 1e3, delay_sigma * 1e3)]))
    if calibration.field_strength is not None:
        rows.append(("Field strength (µT)", [f"{calibration.field_strength * _MICRO:.3f}"]))
    for key, name, scale in (
        ("magnetic_field", "Magnetometer noise, 1σ per sample (µT)", _MICRO),
        ("angular_rate", "Gyroscope noise, 1σ per sample (mrad/s)", 1e3),
    ):
        if key in calibration.noise:
            rows.append((name, [f"{calibration.noise[key] * scale:.3g}"]))
    return rows


def stretch(seconds: tuple[float, float]) -> str:
    """Return a stretch of time as text: "120–150 s (2:00–2:30)"."""
    start, end = int(np.floor(seconds[0])), int(np.ceil(seconds[1]))
    return f"{start}–{end} s ({start // 60}:{start % 60:02d}–{end // 60}:{end % 60:02d})"


def advice(recording: Recording, calibration: Calibration, disturbed: Sequence[tuple[float, float]]) -> list[str]:
    """Return the next steps, most urgent first."""
    lines = []
    if calibration.observability is not None:
        remedies: dict[str, list[str]] = {}
        for weakness in calibration.observability.weak:
            remedies.setdefault(weakness.remedy, []).append(weakness.what)
        lines += [
            f"{remedy[0].upper()}{remedy[1:]}, to determine {', '.join(weak)}."
            for remedy, weak in remedies.items()
        ]
    if disturbed:
        listed = ", ".join(stretch(seconds) for seconds in disturbed[:5])
        more = f" and {len(disturbed) - 5} more" if len(disturbed) > 5 else ""
        lines.append(
            f"Look at what was near the sensor or switched on at {listed}{more}: "
            "these windows do not fit the model and were given less weight."
        )
    gaps = recording.gaps
    if gaps:
        longest = max(gaps, key=lambda gap: gap.duration)
        lines.append(
            f"Check the logger: the data have {len(gaps)} gap{'s' if len(gaps) > 1 else ''}, the longest of "
            f"{longest.duration:.1f} s after {longest.start - recording.time[0]:.0f} s."
        )
    if calibration.trusted and not calibration.configuration.get("calibrated_before"):
        lines.append("Paste the parameters and record again: the strength of the field should then stay constant.")
    return lines


def exports(calibration: Calibration) -> list[tuple[str, str, bool]]:
    """Return (target, text to paste or why there is none, whether it can be pasted); empty if not trusted."""
    if not calibration.trusted:
        return []
    result = []
    for target in TARGETS:
        try:
            result.append((_TARGET_NAMES.get(target, target), calibration.export(target), True))
        except MagycError as error:
            result.append((_TARGET_NAMES.get(target, target), str(error), False))
    return result


def configuration(calibration: Calibration) -> str:
    """Return the method's options and diagnostics as readable JSON."""
    values = {
        "method": calibration.method,
        "configuration": dict(calibration.configuration),
        "noise": dict(calibration.noise),
        "diagnostics": dict(calibration.diagnostics),
    }
    return json.dumps(_short(values), indent=2, ensure_ascii=False, default=str)


def _short(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _short(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        if len(value) > _LONG:
            return f"{len(value)} values"
        rows = [_short(item) for item in value]
        inner = sum(len(row) for row in rows if isinstance(row, list))
        return f"{len(rows)} rows, {inner} values" if inner > _LONG else rows
    return value
