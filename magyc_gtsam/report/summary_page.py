"""Pages over many logs: a table of calibrations with links, and the history of one instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from importlib import resources
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure as Canvas

from magyc_gtsam.history import History
from magyc_gtsam.report.plots import drawn

_PACKAGE = "magyc_gtsam.report"
_DAY = 86400.0
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Link:
    """A cell of a table that leads to another page."""

    text: str
    href: str


@dataclass(frozen=True)
class Figure:
    """A figure with its caption."""

    svg: Markup
    caption: str


@dataclass(frozen=True)
class Section:
    """A part of a page."""

    title: str
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str | Link]] = ()
    sentences: Sequence[str] = ()
    figures: Sequence[Figure] = field(default_factory=tuple)


def summary_page(title: str, headline: str, good: bool, lead: Sequence[str], sections: Sequence[Section]) -> str:
    """A page as HTML text; works without a network."""
    environment = Environment(
        loader=PackageLoader(_PACKAGE, "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    style = (resources.files(_PACKAGE) / "style.css").read_text(encoding="utf-8")
    values: dict[str, Any] = {
        "title": title,
        "headline": headline,
        "good": good,
        "lead": lead,
        "sections": sections,
    }
    return environment.get_template("summary.html").render(style=Markup(style), **values)


def history_page(history: History, title: str = "History of an instrument") -> str:
    """The page of a history: hard iron over the logs, jumps, contradictions, groups and the next calibration."""
    jumps, names = history_rows(history), history.names
    following = history.next
    values = following.hard_iron * 1e6
    sigma = following.sigma["hard_iron"] * 1e6
    cells = [f"{value:.2f} ± {deviation:.2f} µT" for value, deviation in zip(values, sigma, strict=True)]
    sections = [
        Section(
            "Hard iron from log to log",
            figures=[
                Figure(
                    Markup(_hard_iron(history)),
                    "Lines: the hard iron at each log by all logs; bands: ±1.96 sigma. Dashed: jumps. "
                    "Crosses: logs that contradict the rest.",
                )
            ],
        ),
        Section("Jumps", ("log", "x", "y", "z"), jumps, [] if jumps else ["The hard iron did not jump."]),
        Section(
            "Logs that contradict the rest",
            sentences=[f"{each.name}: {each.sentence}" for each in history.contradictions] or ["None."],
        ),
        Section(
            "Logs that can be of one instrument",
            sentences=[", ".join(names[i] for i in group) for group in history.groups],
        ),
        Section("For the next log", ("hard iron x", "y", "z"), [cells], [following.message]),
    ]
    instruments = len([group for group in history.groups if len(group) > 1]) or 1
    headline = f"{len(history)} logs, {len(jumps)} jump{'s' if len(jumps) != 1 else ''} of the hard iron"
    lead = [
        f"The hard iron walks by {history.walk * 1e6:.2g} µT per √{'day' if _dated(history) else 'log'}.",
    ]
    if instruments > 1:
        lead.append(f"The logs are of {instruments} instruments; the largest group is shown as the instrument's.")
    return summary_page(title, headline, instruments == 1, lead, sections)


def history_rows(history: History) -> list[list[str | Link]]:
    """One row for each jump: the log before which it was, its date, and the size with sigma along x, y, z."""

    def called(index: int) -> str:
        time = history.factors[index].time
        date = "" if time is None else f" ({datetime.fromtimestamp(time, timezone.utc):%Y-%m-%d})"
        return history.names[index] + date

    return [
        [called(index), *(f"{s * 1e6:+.2f} ± {d * 1e6:.2f} µT" for s, d in zip(size, sigma, strict=True))]
        for index, size, sigma in history.jumps
    ]


def _dated(history: History) -> bool:
    return all(factor.time is not None for factor in history.factors)


@drawn(11, 5)
def _hard_iron(canvas: Canvas, history: History) -> None:
    """Hard iron over the largest group's logs, an axis each."""
    rows = sorted({*history.groups[0], *(i for i, f in enumerate(history.factors) if f.mean is None)})
    value = history.hard_iron[rows] * 1e6
    sigma = np.sqrt(np.diagonal(history.hard_iron_covariance[rows], axis1=1, axis2=2)) * 1e6
    dated = _dated(history)
    times = [history.factors[i].time for i in rows]
    at: Any = np.array(rows) + 1
    if dated:
        at = [datetime.fromtimestamp(time, timezone.utc) for time in times if time is not None]
    where = dict(zip(rows, at, strict=True))
    wrong = [where[each.index] for each in history.contradictions if each.index in where]
    all_axes = canvas.subplots(3, 1, sharex=True)
    for axis, (axes, name) in enumerate(zip(all_axes, _AXES, strict=True)):
        low, high = value[:, axis] - 1.96 * sigma[:, axis], value[:, axis] + 1.96 * sigma[:, axis]
        axes.fill_between(at, low, high, alpha=0.25)
        axes.plot(at, value[:, axis], marker=".", markersize=4)
        axes.plot(wrong, [float(value[:, axis].mean())] * len(wrong), "x", color="#b04a9b")
        for index, _, _ in history.jumps:
            if index in where:
                axes.axvline(where[index], linestyle="--", linewidth=0.8, color="#d9730d")
        axes.set_ylabel(f"{name} (µT)")
    all_axes[-1].set_xlabel("date" if dated else "log")
