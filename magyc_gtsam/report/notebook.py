"""Display of calibrations, gaps and comparisons in a notebook: figures by matplotlib and short HTML."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.signals import check_field_units
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.result import Gap
from magyc_gtsam.heading_uncertainty import turn_of
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.expected import expect_recording
from magyc_gtsam.report import words
from magyc_gtsam.report.analysis import field_history
from magyc_gtsam.report.gap_verdict import judged_gap
from magyc_gtsam.report.gap_words import effect_value
from magyc_gtsam.report.verdict import judged
from magyc_gtsam.storage.files import expect_path, whole_file
from magyc_gtsam.study.outcome import Comparison

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_calibration(calibration: Calibration, recording: Recording | None = None) -> Figure:
    """Plot the field before and after calibration, its strength and the heading error.

    Args:
        calibration: the calibration to plot.
        recording: the recording it was made from; None if the calibration holds it.

    Raises:
        MagycError: neither gives the recording.
    """
    from magyc_gtsam.report import plots

    recording = _recording_of(calibration, recording)
    history = field_history(recording, calibration)
    figure = _figure()
    halves: Any = figure.subfigures(2, 1)
    upper, lower = halves
    for part, plane in zip(upper.subfigures(1, 3), ((0, 1), (0, 2), (1, 2)), strict=True):
        plots.field_projection(part, history, calibration.soft_iron, calibration.hard_iron, plane)
    left, right = lower.subfigures(1, 2)
    plots.field_strength(left, history)
    if history.heading_error is not None:
        plots.heading_error(right, history.time, history.heading_error)
    else:
        plots.level_turn_error(right, turn_of(recording, calibration), calibration)
    plots.legend(figure, "raw", "calibrated")
    figure.suptitle(judged(calibration, recording).sentence, fontsize=10)
    return figure


def plot_gap(gap: Gap) -> Figure:
    """Plot the prediction before and after, and the misfit maps."""
    from magyc_gtsam.report import plots

    later = {each.over: each for each in gap.after.maps}
    shown = [each for each in gap.before.maps if len(each.centre) > 1][:4]
    figure = _figure()
    halves: Any = figure.subfigures(2, 1)
    upper, lower = halves
    if len(gap.before.open_loop.time):
        plots.open_loop(upper, gap.before.open_loop, gap.after.open_loop)
    parts = np.ravel(lower.subfigures(1, len(shown))) if shown else ()
    for part, each in zip(parts, shown, strict=True):
        plots.gap_map(part, each, each if gap.after is gap.before else later.get(each.over, each))
    plots.legend(figure, "before", "after")
    figure.suptitle(judged_gap(gap).title, fontsize=10)
    return figure


def report(calibration: Calibration, path: str | os.PathLike[str], recording: Recording | None = None) -> Path:
    """Write the page of a calibration as an HTML file, or its figures if the name ends in .pdf; return the path."""
    recording = _recording_of(calibration, recording)
    file = expect_path("report", path)
    if file.suffix.lower() == ".pdf":
        figures = plot_calibration(calibration, recording)
        with whole_file(file) as part:
            figures.savefig(part, format="pdf", metadata={"Creator": "magyc-gtsam"})
        return file
    from magyc_gtsam.report.page import residuals_of, write_report

    return write_report(path, recording, calibration, residuals_of(recording, calibration))


def html_of(value: Calibration | Gap | Comparison) -> str:
    """Return a verdict and a table as HTML, for the notebook's display."""
    if isinstance(value, Calibration):
        rows = [[name, *values] for name, values in words.parameter_rows(value)]
        return _html(judged(value, value.recording).sentence, ("", "x", "y", "z"), rows)
    if isinstance(value, Gap):
        rows = [[e.label, effect_value(e), "added" if e.applied else "not corrected"] for e in value.effects]
        return _html(judged_gap(value).sentence, ("effect", "value", ""), rows)
    from magyc_gtsam.report import compare_words

    header, rows = compare_words.short_header(value), compare_words.short_rows(value)
    return _html(compare_words.judged_comparison(value).sentence, header, rows)


def _html(sentence: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def cells(tag: str, values: Sequence[str]) -> str:
        return "".join(f"<{tag} style='text-align:left'>{html.escape(each)}</{tag}>" for each in values)

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    table = f"<table><thead><tr>{cells('th', header)}</tr></thead><tbody>{body}</tbody></table>" if rows else ""
    return f"<p><b>{html.escape(sentence)}</b></p>{table}"


def _recording_of(calibration: Calibration, recording: Recording | None) -> Recording:
    recording = recording if recording is not None else calibration.recording
    if recording is None:
        raise MagycError("the calibration does not hold its recording (it was loaded or changed): pass recording=")
    expect_recording("recording", recording)
    check_field_units(recording, calibration.magnetic_field_unit)
    return recording


def _figure() -> Figure:
    """Return a figure of pyplot, which a notebook displays, closed so that it is displayed only once."""
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(11.0, 6.6), layout="constrained")
    plt.close(figure)
    return figure
