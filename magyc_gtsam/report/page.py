"""The report page: what to trust, what it looks like, what to do next."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Protocol

import numpy as np
from markupsafe import Markup

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.report import plots, words
from magyc_gtsam.report.analysis import (
    DISTURBED_WEIGHT,
    Coverage,
    FieldHistory,
    LevelTurn,
    coverage,
    disturbed_stretches,
    field_history,
    level_turn,
)
from magyc_gtsam.report.html import Figure, rendered, write_page


class Residuals(Protocol):
    """What the residual section needs: windowed residuals of both measurement groups.

    Attributes:
        time: (n,) s, window centres, on the recording's clock.
        magnetic_field: (n, 3) T, sensor axes.
        magnetic_sigma, magnetic_weight: (n,) T and robust weight in [0, 1].
        link: (n − 1, 3) rad, difference of neighbouring field directions from the gyroscope's.
        link_sigma, link_weight: (n − 1,) rad, infinite across a hole, and robust weight in [0, 1].
    """

    @property
    def time(self) -> Array: ...
    @property
    def magnetic_field(self) -> Array: ...
    @property
    def magnetic_sigma(self) -> Array: ...
    @property
    def magnetic_weight(self) -> Array: ...
    @property
    def link(self) -> Array: ...
    @property
    def link_sigma(self) -> Array: ...
    @property
    def link_weight(self) -> Array: ...


@dataclass(frozen=True)
class ResidualSection:
    """Figures of the residuals and the stretches that do not fit."""

    figures: tuple[Figure, ...]
    stretches: tuple[tuple[float, float], ...]


def write_report(
    target: str | os.PathLike[str],
    recording: Recording,
    calibration: Calibration,
    residuals: Residuals | None = None,
) -> Path:
    """Write the report of one calibration as one self-contained HTML file.

    Args:
        target: the file (its name ends in .html), or a directory that receives `report.html`.
        recording: what was calibrated from.
        calibration: the result.
        residuals: of the method's windows; None for methods without any.

    Returns:
        The file written, in one step.
    """
    path = Path(target)
    if path.suffix != ".html":
        path = path / "report.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_page(path, render(recording, calibration, residuals))
    return path


def render(recording: Recording, calibration: Calibration, residuals: Residuals | None = None) -> str:
    """The report as HTML text."""
    history = field_history(recording, calibration)
    visited = coverage(history.time, history.calibrated)
    turn = level_turn(calibration, history)
    fit = None if residuals is None else _residual_section(residuals, float(recording.time[0]))
    script = (resources.files("magyc_gtsam.report") / "copy.js").read_text(encoding="utf-8")
    return rendered(
        "template.html",
        recording,
        headline="Calibrated" if calibration.trusted else "Do not use this calibration",
        good=calibration.trusted,
        script=Markup(script),
        samples=len(history.time),
        calibration=calibration,
        reasons=words.reasons(calibration),
        cautions=words.cautions(calibration, history),
        numbers=words.key_numbers(calibration, history, turn, visited),
        field_figures=_field_figures(calibration, history, visited),
        time_figures=[*_time_figures(history), _turn_figure(turn)],
        has_reference=history.up is not None,
        residuals=fit,
        stretch=words.stretch,
        parameters=words.parameter_rows(calibration),
        advice=words.advice(recording, calibration, () if fit is None else fit.stretches),
        exports=words.exports(calibration),
        configuration=words.configuration(calibration),
    )


def _field_figures(calibration: Calibration, history: FieldHistory, visited: Coverage) -> list[Figure]:
    figures = []
    for plane, gone in (((0, 1), "z"), ((0, 2), "y"), ((1, 2), "x")):
        svg = plots.field_projection(history, calibration.soft_iron, calibration.hard_iron, plane)
        figures.append(Figure(Markup(svg), f"Seen along {gone}", ""))
    middle, rim = ("+z", "−z") if visited.middle > 0 else ("−z", "+z")
    directions = Figure(
        Markup(plots.coverage_map(visited)),
        f"Directions of the field: {visited.share:.0%}",
        f"The whole sphere around the sensor: {middle} in the middle, {rim} at the rim; blank: never.",
    )
    return [*figures, directions]


def _time_figures(history: FieldHistory) -> list[Figure]:
    figures = [
        Figure(
            Markup(plots.field_strength(history)),
            "Field strength",
            "Lines: means; bands: range of the samples; dashed: strength of the calibrated field. "
            "A step or a bump that is left after calibration is a disturbance.",
        )
    ]
    if history.up is not None:
        figures.append(
            Figure(
                Markup(plots.field_inclination(history, history.up)),
                "Dip",
                f"Angle of the field below the horizontal, by the {history.up_from}. "
                "It should be constant after calibration.",
            )
        )
    if history.heading_error is not None:
        raw, calibrated = np.nanstd(history.heading_error, axis=0)
        figures.append(
            Figure(
                Markup(plots.heading_error(history.time, history.heading_error)),
                "Heading error against the reference",
                f"Standard deviation {raw:.2f}° raw, {calibrated:.2f}° calibrated, with the noise of each "
                "sample but without the mean.",
            )
        )
    return figures


def _turn_figure(turn: LevelTurn) -> Figure:
    caption = (
        f"A turn about {turn.about}, at the recording's dip of {turn.inclination:.0f}°. "
        f"Raw: off by up to {np.abs(turn.error).max():.1f}°. "
    )
    if turn.sigma is None:
        caption += "This method states no uncertainty, so none is drawn for the calibrated heading."
    else:
        caption += f"Calibrated: uncertain by {words.worst_heading(turn)} at worst (1σ), by the covariance."
    return Figure(Markup(plots.level_turn_error(turn)), "Heading error over a level turn", caption)


def _residual_section(residuals: Residuals, start: float) -> ResidualSection:
    time = residuals.time - start
    middle = (time[1:] + time[:-1]) / 2
    joined = np.isfinite(residuals.link_sigma)  # not across a hole of the data
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
        noise = whitened[kept] if kept.any() else whitened
        figures += [
            Figure(
                Markup(plots.residuals(at, whitened, kept, disturbed)),
                f"{name}: residual over time",
                "In units of its own σ, drawn up to ±10; dotted: ±3. Purple: below half the weight, "
                f"{(~kept).sum()} of {len(at)} windows. Mean weight {weight.mean():.2f}.",
            ),
            Figure(
                Markup(plots.residual_histogram(noise)),
                f"{name}: residual against noise",
                "Line: what the stated noise alone would give. "
                f"Standard deviation {noise.std():.2f}: up to about 1 is noise, more is not.",
            ),
        ]
    return ResidualSection(tuple(figures), tuple(_merged(stretches)))


def _merged(stretches: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    merged: list[tuple[float, float]] = []
    for start, end in sorted(stretches):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged
