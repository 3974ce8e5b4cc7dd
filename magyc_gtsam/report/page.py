"""The report page of a calibration: verdict, figures, parameters and advice."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.residuals import WindowResiduals, window_residuals
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.heading_uncertainty import systematic, turn_of
from magyc_gtsam.level_turn import LevelTurn, inclination
from magyc_gtsam.recording import Array, Mask, Recording
from magyc_gtsam.report import words
from magyc_gtsam.report.analysis import (
    DISTURBED_WEIGHT,
    Coverage,
    FieldHistory,
    coverage,
    disturbed_stretches,
    field_history,
)
from magyc_gtsam.report.charts import Figure, Frame, Series, chart, origin, over_time, sphere, time_frame
from magyc_gtsam.report.html import rendered
from magyc_gtsam.report.verdict import Verdict, degrees, judged
from magyc_gtsam.storage.files import expect_path, write_text

_MICRO = 1e6
_MOST_RESIDUALS = 1500  # windows drawn per chart


@dataclass(frozen=True)
class ResidualSection:
    """Figures of the residuals, and the stretches of time that do not fit the model."""

    figures: tuple[Figure, ...]
    stretches: tuple[tuple[float, float], ...]


def write_report(
    target: str | os.PathLike[str],
    recording: Recording,
    calibration: Calibration,
    residuals: WindowResiduals | None = None,
    verdict: Verdict | None = None,
) -> Path:
    """Write the report of one calibration as one self-contained HTML file.

    Args:
        target: the file (its name ends in .html), or a directory that receives `report.html`: an existing one, or a
            name without a suffix.
        recording: the recording the calibration was made from.
        calibration: the calibration.
        residuals: residuals of the method's windows; None for methods without windows.
        verdict: the verdict on the calibration; judged here if None.

    Returns:
        The path of the file, written atomically.

    Raises:
        MagycError: a name with another suffix, or the file cannot be written.
    """
    path = expect_path("report", target)
    if path.is_dir() or not path.suffix:
        path = path / "report.html"
    elif path.suffix.lower() != ".html":
        raise MagycError(f"report: the name of the file must end in .html or .pdf, got {path.name!r}")
    write_text(path, render(recording, calibration, residuals, verdict))
    return path


def residuals_of(recording: Recording, calibration: Calibration) -> WindowResiduals | None:
    """Return the residuals of the windows; None where there is no gyroscope or no bias of it."""
    if recording.angular_rate is None or calibration.gyro_bias is None:
        return None
    return window_residuals(recording, calibration)


def render(
    recording: Recording,
    calibration: Calibration,
    residuals: WindowResiduals | None = None,
    verdict: Verdict | None = None,
) -> str:
    """Return the report as HTML text."""
    verdict = verdict or judged(calibration, recording)
    history = field_history(recording, calibration)
    visited = coverage(history.time, history.calibrated)
    turn = turn_of(recording, calibration)
    fit = None if residuals is None else _residual_section(recording, residuals)
    time = history.time + float(recording.time[0]) - origin(recording)
    stretches = () if fit is None else fit.stretches
    return rendered(
        "template.html",
        recording,
        headline=verdict.title,
        good=verdict.trusted,
        verdict=verdict,
        samples=int(recording.magnetic_field_fresh.sum()),
        calibration=calibration,
        cautions=words.cautions(history),
        numbers=words.key_numbers(calibration, verdict, history, turn, visited),
        field=_sphere_figure(calibration, history, visited),
        strength=_strength_figure(history, time, stretches),
        time_figures=[*_time_figures(history, time), *_turn_figures(calibration, verdict, turn)],
        has_reference=history.up is not None,
        residuals=fit,
        stretch=words.stretch,
        parameters=words.parameter_rows(calibration),
        other_terms=words.other_terms(calibration),
        advice=words.advice(recording, calibration, stretches),
        exports=words.exports(calibration),
        configuration=words.configuration(calibration),
    )


def _sphere_figure(calibration: Calibration, history: FieldHistory, visited: Coverage) -> Figure:
    raw, calibrated = history.raw * _MICRO, history.calibrated * _MICRO
    radius = history.strength * _MICRO
    fitted = (calibration.soft_iron * radius, calibration.hard_iron * _MICRO, "raw")
    return sphere(
        f"The field in sensor axes (µT); {visited.share:.0%} of its directions visited",
        "Drag to turn. Raw points should lie on the fitted ellipsoid, calibrated points on the sphere about zero. "
        "Bare areas of the sphere are directions that the field did not take.",
        [("raw", "raw", raw), ("calibrated", "calibrated", calibrated)],
        radius,
        outlines=[fitted, (np.eye(3) * radius, np.zeros(3), "calibrated")],
        coverage=visited,
    )


def _strength_figure(history: FieldHistory, time: Array, stretches: Sequence[tuple[float, float]]) -> Figure:
    raw, calibrated = (np.linalg.norm(field, axis=1) * _MICRO for field in (history.raw, history.calibrated))
    return over_time(
        "Strength of the field",
        "Drag over an interval to copy it for the command line and to zoom the charts below. Lines: means; bands: "
        "range of the samples; dashed: strength of the calibrated field; shaded: disturbed.",
        time,
        [("raw", "raw", raw), ("calibrated", "calibrated", calibrated)],
        "Strength (µT)",
        strip=True,
        levels=[history.strength * _MICRO],
        spans=stretches,
        wide=True,
    )


def _time_figures(history: FieldHistory, time: Array) -> list[Figure]:
    figures = []
    if history.up is not None:
        raw, calibrated = inclination(history.raw, history.up), inclination(history.aligned, history.up)
        figures.append(
            over_time(
                "Dip",
                f"Angle of the field below the horizontal, by the {history.up_from}. It should be constant after "
                "calibration.",
                time,
                [("raw", "raw", raw), ("calibrated", "calibrated", calibrated)],
                "Dip (°)",
                levels=[float(np.nanmedian(calibrated))],
            )
        )
    if history.heading_error is not None:
        raw, calibrated = history.heading_error.T
        figures.append(
            over_time(
                "Heading error against the reference",
                f"Standard deviation {np.nanstd(raw):.2f}° raw, {np.nanstd(calibrated):.2f}° calibrated: sensor noise "
                "included, mean removed.",
                time,
                [("raw", "raw", raw), ("calibrated", "calibrated", calibrated)],
                "Error (°)",
                levels=[0.0],
            )
        )
    return figures


def _turn_figures(calibration: Calibration, verdict: Verdict, turn: LevelTurn) -> list[Figure]:
    error = turn.raw_error(calibration.soft_iron, calibration.hard_iron)
    jumps = np.append(np.abs(np.diff(error)) > 180, False)  # avoids a line across the wrap at ±180°
    about = f"A turn about {turn.about}, at a dip of {turn.dip:.0f}°."
    frame = Frame("Heading (°)", "Error (°)", levels=[0.0], xlim=(0, 360))
    figures = [
        chart(
            "Level turn: error of the raw compass",
            f"{about} The largest error is {np.abs(error).max():.1f}°.",
            turn.heading,
            [Series("raw", "raw", np.where(jumps, np.nan, error))],
            frame,
        )
    ]
    sigma = systematic(turn, calibration)
    if sigma is None or not verdict.trusted:  # the covariance of a result that is not trusted bounds nothing
        return figures
    sigma = np.minimum(sigma, 180.0)
    figures.append(
        chart(
            "Level turn: error after calibration",
            f"±1σ of the systematic error from the covariance; at worst {degrees(verdict.heading.systematic)}.",
            turn.heading,
            [Series("calibrated ±1σ", "calibrated", low=-sigma, high=sigma)],
            frame,
        )
    )
    return figures


def _residual_section(recording: Recording, residuals: WindowResiduals) -> ResidualSection:
    time = residuals.time - origin(recording)
    middle = (time[1:] + time[:-1]) / 2
    joined = np.isfinite(residuals.link_sigma)  # links across a gap in the data have no sigma
    fits = [
        ("Magnetometer", time, residuals.magnetic_field, residuals.magnetic_sigma, residuals.magnetic_weight),
        (
            "Gyroscope",
            middle[joined],
            residuals.link[joined],
            residuals.link_sigma[joined],
            residuals.link_weight[joined],
        ),
    ]
    figures: list[Figure] = []
    stretches: list[tuple[float, float]] = []
    for name, at, value, sigma, weight in fits:
        whitened = value / sigma[:, None]
        kept = weight >= DISTURBED_WEIGHT
        disturbed = disturbed_stretches(at, weight)
        stretches += disturbed
        figures += [
            _residuals_over_time(name, at, whitened, kept, weight),
            _histogram(name, whitened, kept),
        ]
    return ResidualSection(tuple(figures), tuple(_merged(stretches)))


def _residuals_over_time(name: str, time: Array, whitened: Array, kept: Mask, weight: Array) -> Figure:
    every = -(-len(time) // _MOST_RESIDUALS)
    time, shown, fits = time[::every], np.clip(whitened[::every], -10, 10), kept[::every]
    series = [
        Series(axis, colour, np.where(fits, column, np.nan), style="dots")
        for axis, colour, column in zip("xyz", ("calibrated", "second", "third"), shown.T, strict=True)
    ]
    worst = np.take_along_axis(shown, np.abs(shown).argmax(axis=1)[:, None], axis=1)[:, 0]
    series.append(Series("disturbed", "disturbed", np.where(fits, np.nan, worst), style="dots"))
    return chart(
        f"{name}: residual over time",
        f"Residual of each window over its σ, clipped at ±10; dashed: ±3σ. {(~kept).sum()} of {len(kept)} windows have "
        f"less than half the weight; the mean weight is {weight.mean():.2f}.",
        time,
        series,
        time_frame(time, "Residual (σ)", levels=(-3.0, 3.0)),
    )


def _histogram(name: str, whitened: Array, kept: Mask) -> Figure:
    noise = whitened[kept] if kept.any() else whitened
    share, edges = np.histogram(np.clip(noise.ravel(), -5, 5), bins=np.linspace(-5, 5, 51), density=True)
    x = (edges[1:] + edges[:-1]) / 2
    return chart(
        f"{name}: residual against noise",
        f"Line: expected from the stated noise alone. The standard deviation is {noise.std():.2f}; a value well above "
        "1 is more than noise.",
        x,
        [
            Series("found", "calibrated", share, style="bars"),
            Series("noise", "ink", np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi)),
        ],
        Frame("Residual (σ)", "Share per σ"),
    )


def _merged(stretches: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    merged: list[tuple[float, float]] = []
    for start, end in sorted(stretches):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged
