"""Pages about many logs: a table of calibrations with links, and the history of one instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.history import History
from magyc_gtsam.history.doubt import date_of, last_unused
from magyc_gtsam.history.log_factor import HARD_IRON, LogFactor
from magyc_gtsam.recording import Array
from magyc_gtsam.report.charts import Figure, Frame, Series, chart
from magyc_gtsam.report.html import rendered
from magyc_gtsam.report.verdict import Verdict, said
from magyc_gtsam.report.words import parameter_rows

_AXES = ("x", "y", "z")
_BAND = 1.96  # sigmas
_BARS = "Bars: 95% interval (±1.96σ)."


@dataclass(frozen=True)
class PageLink:
    """A table cell that links to another page."""

    text: str
    href: str


@dataclass(frozen=True)
class Section:
    """A section of a page."""

    title: str
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str | PageLink]] = ()
    sentences: Sequence[str] = ()
    figures: Sequence[Figure] = ()


def summary_page(title: str, headline: str, good: bool, lead: Sequence[str], sections: Sequence[Section]) -> str:
    """Return a page as self-contained HTML text."""
    return rendered("summary.html", about=title, headline=headline, good=good, lead=lead, sections=sections)


def by_log(names: Sequence[str], hard_iron: Array, sigma: Array) -> list[Figure]:
    """Draw the separate estimate of each log's hard iron, one figure per axis.

    Args:
        names: (k,) names of the logs.
        hard_iron, sigma: (k, 3) µT, from trusted calibrations.
    """
    at = np.arange(1, len(names) + 1, dtype=np.float64)
    figures = []
    for axis, value, deviation in zip(_AXES, hard_iron.T, _BAND * sigma.T, strict=True):
        series = [Series("", "calibrated", value, value - deviation, value + deviation, style="errors")]
        frame = Frame("Log", f"{axis} (µT)", xlim=(0.5, len(names) + 0.5), more={"names": list(names)})
        figures.append(
            chart(f"Hard iron along {axis}", f"{_BARS} Hover for the name of the log.", at, series, frame)
        )
    return figures


def history_page(history: History) -> str:
    """Return the page of a history: hard iron over the logs, jumps, unused logs, groups, the next calibration."""
    jumps, names = history_rows(history), history.names
    following = history.next
    parameters = [[name, *cells, *[""] * (3 - len(cells))] for name, cells in parameter_rows(following)]
    sections = [
        Section("Hard iron from log to log", figures=_hard_iron(history)),
        Section(
            "Jumps",
            ("before log", "x", "y", "z"),
            jumps,
            [] if jumps else ["The hard iron did not jump."],
        ),
        Section(
            "Logs that are not used",
            sentences=[f"{each.name}: {each.sentence}" for each in history.contradictions] or ["None."],
        ),
        Section("Parts of logs that are not used", sentences=parts_left_out(history.factors) or ["None."]),
        Section(
            "Logs that can be of one instrument",
            sentences=[", ".join(names[i] for i in group) for group in history.groups],
        ),
    ]
    verdict = judged_history(history)
    if verdict.trusted:
        sections.append(Section("For the next log", ("", "x", "y", "z"), parameters, [following.message]))
    return summary_page(
        "History of an instrument", verdict.title, verdict.trusted, [said(verdict.reason)], sections
    )


def parts_left_out(factors: Sequence[LogFactor]) -> list[str]:
    """Return a sentence on each part of a log that was left out because a sensor was faulty."""
    return [f"{factor.name}: left out: {where}" for factor in factors for where in factor.left_out]


def judged_history(history: History) -> Verdict:
    """Return the verdict on a history, for page, terminal and exit code."""
    jumps = len(history.jumps)
    if history.doubt is not None:
        return Verdict(False, history.doubt.cause, history.doubt.action, called=history.doubt.called)
    times = {0: "did not jump", 1: "jumped once"}.get(jumps, f"jumped {jumps} times")
    refits = len(history.refits)
    if refits:
        times += ", and the soft iron with it" if jumps == 1 else f", {refits} of them with the soft iron"
    calibrated = [factor for factor in history.factors if factor.mean is not None]
    undated = [factor.name for factor in calibrated if factor.time is None]
    span = "from one log to the next" if undated else "per square root of a day"
    if 0 < len(undated) < len(calibrated):
        span += (
            f", since {undated[0]} has no date" if len(undated) == 1 else f", since {len(undated)} have no date"
        )
    low, high = history.next.diagnostics["walk_interval"]
    scatter = f"{history.walk * 1e6:.2g} µT (1σ; with 68% probability {low:.2g} to {high:.2g}) {span}"
    between = "otherwise " if jumps else ""
    excluded = len(history.contradictions)
    exclusion = f"; {excluded} more {'logs' if excluded > 1 else 'log'} left out" if excluded else ""
    if last_unused(history.factors, history.times) is not None:
        exclusion += ", the last one among them" if excluded > 1 else ", the last one"
    used = len(history) - excluded
    changes = f"the hard iron {times}; it {between}changes by {scatter}"
    if used == 1:
        changes = "how much the hard iron changes is not known from one log"
    return Verdict(
        True,
        worth=f"{changes}{exclusion}",
        called=f"{used} logs of one instrument" if used > 1 else "1 log",
    )


def history_rows(history: History) -> list[list[str | PageLink]]:
    """Return one row per jump: the log that follows it, with its date, and the size ± σ along x, y, z.

    The name of a log before which the soft iron changed, too, says so.
    """

    def dated_name(index: int) -> str:
        time = history.factors[index].time
        date = "" if time is None else f" ({date_of(time)})"
        return history.names[index] + date + (", with the soft iron" if index in history.refits else "")

    return [
        [dated_name(index), *(f"{s * 1e6:+.2f} ± {d * 1e6:.2f} µT" for s, d in zip(size, sigma, strict=True))]
        for index, size, sigma in history.jumps
    ]


def _hard_iron(history: History) -> list[Figure]:
    """Draw the hard iron over the logs of the largest group, one figure per axis, with each log's own estimate."""
    rows = sorted({*history.groups[0], *(each.index for each in history.contradictions)})
    times, dated = history.times, history.times is not None
    at = np.array([i + 1 if times is None else times[i] for i in rows], dtype=np.float64)
    order = np.argsort(at, kind="stable")
    rows, at = [rows[k] for k in order], at[order]
    member = np.isin(rows, history.groups[0])
    alone = np.full((len(rows), 3), np.nan)
    for k, i in enumerate(rows):
        mean = history.factors[i].mean
        if mean is not None:
            alone[k] = mean[HARD_IRON]
    # The line passes over a log that is not used, and between the neighbours of a log of another instrument.
    own = ~np.isin(rows, [i for group in history.groups[1:] for i in group])
    sigma = np.sqrt(np.diagonal(history.hard_iron_covariance[rows], axis1=1, axis2=2))
    value, band = (
        np.column_stack([np.interp(at, at[own], column[own]) for column in 1e6 * each.T])
        for each in (history.hard_iron[rows], _BAND * sigma)
    )
    first = float(at[0]) if dated else 0.0
    where = dict(zip(rows, (at - first).tolist(), strict=True))
    more = {
        "names": [history.names[i] for i in rows],
        "marks": [where[index] for index, _, _ in history.jumps if index in where],
        **({"dates": first} if dated else {}),
    }
    figures = []
    for k, axis in enumerate(_AXES):
        series = [
            Series("by all logs", "calibrated", value[:, k], value[:, k] - band[:, k], value[:, k] + band[:, k]),
            Series("the log alone", "raw", np.where(member, alone[:, k], np.nan), style="errors"),
        ]
        if np.isfinite(alone[~member]).any():
            series.append(
                Series("contradicts", "disturbed", np.where(member, np.nan, alone[:, k]), style="errors")
            )
        frame = Frame("Date" if dated else "Log", f"{axis} (µT)", more=more)
        dashed = " Dashed: jumps." if more["marks"] else ""
        figures.append(
            chart(f"Hard iron along {axis}", f"Band: 95% interval (±{_BAND}σ).{dashed}", at - first, series, frame)
        )
    return figures
