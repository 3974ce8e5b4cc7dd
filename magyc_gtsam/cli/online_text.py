"""Texts of `magyc-gtsam online`: the line of a report, sentences, and the panel on a terminal."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from magyc_gtsam.live.health import StreamHealth
from magyc_gtsam.option_names import as_options
from magyc_gtsam.report.words import parameter_rows, uncertain

if TYPE_CHECKING:
    from rich.console import RenderableType

    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.cli.online_feed import Feed
    from magyc_gtsam.live.source import LiveSource
    from magyc_gtsam.online import Change, OnlineCalibrator, Progress

_BAR = 24  # characters


def line(feed: Feed, source: LiveSource, health: StreamHealth) -> str:
    """Return the state of a run in one line."""
    online, progress = feed.online, feed.progress
    calibration = online.calibration
    parts = [f"{progress.duration:8.1f} s"]
    if calibration is not None:
        parts += [f"hard iron {hard_iron_text(calibration)} µT", f"coverage {progress.coverage:.0%}"]
    if online.changes:
        parts.append(f"{len(online.changes)} change{'s' if len(online.changes) > 1 else ''}")
    parts.append(source.waiting_for if progress.time is None and source.waiting_for else progress.sentence)
    parts.append(health.sentence)
    if progress.left_out:
        parts.append(f"{progress.left_out} left out")
    return " | ".join(parts)


def left_out_sentence(progress: Progress) -> list[str]:
    """Return a line on the number of samples that were left out; none if there are none."""
    why = "stamps that repeat, go back or leap, and values beyond what the sensors measure"
    if progress.stuck or progress.clipped is not None:
        why = f"those of faulty sensors, {why}"
    return [f"left out: {progress.left_out} samples ({why})"] if progress.left_out else []


def hard_iron_text(calibration: Calibration) -> str:
    """Return the hard iron in µT, with standard deviations if there are any."""
    sigma = calibration.sigma.get("hard_iron", [0.0] * 3)
    return ", ".join(uncertain(h * 1e6, s * 1e6) for h, s in zip(calibration.hard_iron, sigma, strict=True))


def change_sentence(change: Change, online: OnlineCalibrator) -> str:
    """Return a sentence with the time of a change of the hard iron, from the first sample, and its size."""
    step = ", ".join(uncertain(v * 1e6, s * 1e6) for v, s in zip(change.step, change.step_sigma, strict=True))
    return f"hard iron changed at {uncertain(change.time - first_stamp(online), change.time_sigma)} s by {step} µT"


def first_stamp(online: OnlineCalibrator) -> float:
    """Return the stamp (s) of the first sample, from which displayed times count; 0 without one."""
    progress = online.progress
    return 0.0 if progress.time is None else progress.time - progress.duration


def counted_from(calibration: Calibration, first: float) -> Calibration:
    """Return the calibration with the times of its disturbed stretches counted from `first` (s)."""
    disturbed = [[start - first, end - first] for start, end in calibration.diagnostics.get("disturbed") or []]
    return replace(calibration, diagnostics={**calibration.diagnostics, "disturbed": disturbed})


def panel(feed: Feed, source: LiveSource, health: StreamHealth, written: str) -> RenderableType:
    """Return the live view: head, source, parameters, coverage, verdict, weaknesses and changes."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    online, progress = feed.online, feed.progress
    calibration = online.calibration
    head = [source.name, online.method, f"{progress.duration:.1f} s", f"{progress.windows} windows"]
    if progress.left_out:
        head.append(f"{progress.left_out} left out")
    parts: list[RenderableType] = [Text(" · ".join(part for part in (*head, written) if part), style="bold")]
    parts.append(Text(f"source: {health.sentence}", style="dim"))
    if calibration is not None:
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for name in ("", "x", "y", "z"):
            table.add_column(name, justify="left" if not name else "right", no_wrap=True)
        for name, values in parameter_rows(calibration):
            table.add_row(name, *values)
        parts.append(table)
    full = round(_BAR * progress.coverage)
    parts.append(Text(f"directions seen  {'█' * full}{'░' * (_BAR - full)} {progress.coverage:.0%}"))
    sentence = source.waiting_for if progress.time is None and source.waiting_for else progress.sentence
    style = "green" if progress.converged else "yellow"
    parts.append(Text(as_options(sentence if progress.converged else f"not yet: {sentence}"), style=style))
    parts += [Text(f"  weak: {weakness.sentence}") for weakness in progress.weak[:3]]
    parts += [Text(change_sentence(change, online), style="magenta") for change in online.changes[-3:]]
    parts.append(Text("Ctrl-C ends; nothing is lost", style="dim"))
    return Group(*parts)
