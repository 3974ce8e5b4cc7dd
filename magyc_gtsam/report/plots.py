"""The report's figures: each function draws one into a figure of its own and returns it as SVG text."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, Locator, LogLocator

from magyc_gtsam.recording import Array, Mask
from magyc_gtsam.report.analysis import (
    Coverage,
    FieldHistory,
    LevelTurn,
    ellipsoid_outline,
    inclination,
    spread,
    summary,
)

RAW = "#d9730d"  # orange and blue keep apart for colour-blind eyes and on light and dark ground
CALIBRATED = "#2b8cdb"
DISTURBED = "#b04a9b"
INK = "#010203"  # stands for the page's own text colour
_MICRO = 1e6
_FLAT = 0.1  # share of the axis below which the calibrated curve gets a scale of its own
_STYLE = {
    "font.family": "sans-serif",
    "font.size": 10.5,
    "axes.titlesize": 10.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.15,
    "grid.linewidth": 0.8,
    "lines.linewidth": 1.2,
    "svg.fonttype": "none",
    "svg.hashsalt": "magyc-gtsam",
} | dict.fromkeys(
    ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color", "grid.color"), INK
)

Parameters = ParamSpec("Parameters")


def drawn(
    width: float, height: float
) -> Callable[[Callable[Concatenate[Figure, Parameters], None]], Callable[Parameters, str]]:
    """Turn a function that draws into a figure into one that returns SVG, `width` × `height` inches."""

    def decorate(draw: Callable[Concatenate[Figure, Parameters], None]) -> Callable[Parameters, str]:
        @wraps(draw)
        def run(*args: Parameters.args, **kwargs: Parameters.kwargs) -> str:
            with matplotlib.rc_context(_STYLE):
                figure = Figure(figsize=(width, height), layout="constrained")
                draw(figure, *args, **kwargs)
                return _svg(figure)

        return run

    return decorate


def _svg(figure: Figure) -> str:
    """SVG to stand inside a page: no prolog, no size, no ids or styles of its own, the page's text colour."""
    text = io.StringIO()
    no_metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(text, format="svg", dpi=150, transparent=True, metadata=no_metadata)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<style.*?</style>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    return svg.replace(INK, "currentColor")


@drawn(3.0, 3.1)
def field_projection(
    figure: Figure, history: FieldHistory, soft_iron: Array, hard_iron: Array, plane: tuple[int, int]
) -> None:
    """Raw and calibrated field, with the fitted ellipsoid and the sphere, seen along one sensor axis."""
    axes = figure.add_subplot()
    rows = spread(history.calibrated, history.strength / 40)
    for field, colour in ((history.raw, RAW), (history.calibrated, CALIBRATED)):
        x, y = field[rows][:, plane].T * _MICRO
        axes.plot(x, y, ".", color=colour, markersize=2.5, alpha=0.5, rasterized=True, markeredgewidth=0)
    outlines(axes, soft_iron, hard_iron * _MICRO, history.strength * _MICRO, "µT", plane)


def outlines(axes: Axes, matrix: Array, centre: Array, radius: float, unit: str, plane: tuple[int, int]) -> None:
    """The ellipsoid {matrix x + centre, ‖x‖ = radius} and the sphere that calibration makes of it, along an axis."""
    axes.plot(*ellipsoid_outline(matrix * radius, centre, plane).T, color=RAW)
    axes.plot(*ellipsoid_outline(np.eye(3) * radius, np.zeros(3), plane).T, color=CALIBRATED)
    axes.plot(*centre[list(plane)], "+", color=RAW, markersize=9)
    axes.plot(0, 0, "+", color=CALIBRATED, markersize=9)
    axes.locator_params(nbins=5)
    axes.set(
        aspect="equal",
        adjustable="datalim",
        xlabel=f"{'xyz'[plane[0]]} ({unit})",
        ylabel=f"{'xyz'[plane[1]]} ({unit})",
    )


@drawn(3.0, 3.1)
def coverage_map(figure: Figure, coverage: Coverage) -> None:
    """Directions of the calibrated field in sensor axes, the whole sphere equal-area, shaded by time."""
    axes = figure.add_subplot(projection="polar")
    seconds = np.ma.masked_equal(coverage.seconds, 0)
    low, high = float(seconds.min()), float(seconds.max())
    ticks: Locator = LogLocator(subs=(1, 2, 5) if high < 300 * low else (1,))  # or their labels would touch
    if high < 3 * low:  # which may hold none of these, or many that overlap: its ends will do
        ticks = FixedLocator([low, high] if high > 1.2 * low else [np.sqrt(low * high)])
    mesh = axes.pcolormesh(
        coverage.longitude,
        _lambert(coverage.middle * coverage.sine),
        seconds,
        cmap="viridis_r",
        norm=LogNorm(0.95 * low, 1.05 * high),
        linewidth=0,
        rasterized=True,
    )
    axes.set(ylim=(0, 1), yticks=_lambert(np.array([0.0])), yticklabels=[])
    axes.set_xticks(np.radians([0, 90, 180, 270]), ["+x", "+y", "−x", "−y"])
    axes.tick_params(pad=0)
    bar = figure.colorbar(
        mesh, ax=axes, label="Time spent (s)", location="bottom", shrink=0.8, aspect=30, format="%.3g", ticks=ticks,
    )  # fmt: skip
    bar.minorticks_off()  # which overlap where the times span little


def _lambert(sine: Array) -> Array:
    """Radius in Lambert's equal-area map, of unit radius, of a direction with that sine of latitude."""
    return np.asarray(np.sqrt((1 - sine) / 2))


@drawn(4.7, 3.1)
def field_strength(figure: Figure, history: FieldHistory) -> None:
    """Strength of the field over time, raw and calibrated."""
    raw, calibrated = (np.linalg.norm(field, axis=1) * _MICRO for field in (history.raw, history.calibrated))
    before_after(figure, history.time, raw, calibrated, "Strength (µT)", history.strength * _MICRO)


@drawn(4.7, 3.1)
def field_inclination(figure: Figure, history: FieldHistory, up: Array) -> None:
    """Angle of the field below the horizontal over time, raw and calibrated."""
    raw, calibrated = inclination(history.raw, up), inclination(history.aligned, up)
    before_after(figure, history.time, raw, calibrated, "Dip (°)", float(np.nanmedian(calibrated)))


@drawn(4.7, 3.1)
def heading_error(figure: Figure, time: Array, error: Array) -> None:
    """Error of the magnetic heading against the reference over time, raw and calibrated."""
    before_after(figure, time, error[:, 0], error[:, 1], "Error (°)", 0.0)


@drawn(4.7, 3.4)
def level_turn_error(figure: Figure, turn: LevelTurn) -> None:
    """Heading error over a level turn: of the raw field, and the calibration's own uncertainty."""
    rows = 1 if turn.sigma is None else 2
    grid = figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=[3, 2][:rows])[:, 0]
    jumps = np.append(np.abs(np.diff(turn.error)) > 180, False)  # from −180° to 180°, not to be joined
    grid[0].plot(turn.heading, np.where(jumps, np.nan, turn.error), color=RAW)
    grid[0].set_ylabel("Raw (°)")
    if turn.sigma is not None:
        sigma = np.minimum(turn.sigma, 180.0)  # more than all of it there is not
        grid[1].fill_between(turn.heading, -sigma, sigma, color=CALIBRATED, alpha=0.4, linewidth=0)
        grid[1].set_ylabel("Calibrated\n±1σ (°)")
    for axes in grid:
        axes.axhline(0, color=INK, linewidth=1, linestyle="--")
    figure.align_ylabels()
    grid[-1].set(xlabel="Heading (°)", xticks=range(0, 361, 60), xlim=(0, 360))


@drawn(4.7, 3.4)
def residuals(
    figure: Figure, time: Array, whitened: Array, kept: Mask, disturbed: list[tuple[float, float]]
) -> None:
    """Whitened residuals (n, 3) over time, one row per sensor axis, those not kept (n,) in another colour."""
    unit, label = clock(time)
    limit, step = (10, 5) if (np.abs(whitened) > 4).any() else (4, 3)
    panels = figure.subplots(3, 1, sharex=True)
    for axes, column, name in zip(panels, whitened.T, "xyz", strict=True):
        for start, end in disturbed:
            axes.axvspan(start / unit, end / unit, color=DISTURBED, alpha=0.25, linewidth=0)
        clipped = np.clip(column, -limit, limit)
        for rows, colour in ((kept, CALIBRATED), (~kept, DISTURBED)):
            style = {"markersize": 3, "alpha": 0.6, "rasterized": True}
            axes.plot(time[rows] / unit, clipped[rows], ".", color=colour, **style)
        for level in (-3, 3):
            axes.axhline(level, color=INK, linewidth=0.8, linestyle=":")
        axes.set(ylabel=f"{name} (σ)", ylim=(-1.08 * limit, 1.08 * limit), yticks=(-step, 0, step))
    figure.align_ylabels()
    panels[-1].set_xlabel(label)


@drawn(4.7, 3.4)
def residual_histogram(figure: Figure, whitened: Array) -> None:
    """Histogram of the whitened residuals, beyond ±5 in the last bars, against the unit normal."""
    axes = figure.add_subplot()
    bins = np.linspace(-5, 5, 51).tolist()
    axes.hist(np.clip(whitened.ravel(), -5, 5), bins=bins, density=True, color=CALIBRATED)
    x = np.linspace(-5, 5, 201)
    axes.plot(x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), color=INK)
    axes.set(xlabel="Residual (σ)", ylabel="Share per σ", xlim=(-5.1, 5.1))


def before_after(figure: Figure, time: Array, raw: Array, calibrated: Array, label: str, ideal: float) -> None:
    """Means as lines, ranges as bands, `ideal` dashed; in two rows where one scale would hide one of them."""
    unit, time_label = clock(time)
    low, high = np.nanpercentile(calibrated, [1, 99])
    both = np.append(raw, calibrated)
    apart = high - low < _FLAT * (np.nanmax(both) - np.nanmin(both))
    rows = figure.subplots(2 if apart else 1, 1, sharex=True, squeeze=False)[:, 0]
    for axes, value, colour in ((rows[0], raw, RAW), (rows[-1], calibrated, CALIBRATED)):
        middle, mean, lowest, highest = summary(time, value)
        axes.fill_between(middle / unit, lowest, highest, color=colour, alpha=0.25, linewidth=0)
        axes.plot(middle / unit, mean, color=colour)
        axes.set_ylabel(label)
    rows[-1].axhline(ideal, color=INK, linewidth=1, linestyle="--")
    rows[-1].set(xlabel=time_label, xlim=(time[0] / unit, time[-1] / unit))
    figure.align_ylabels()


def clock(time: Array) -> tuple[float, str]:
    """Seconds per unit of a time axis, and its label."""
    span = float(time[-1] - time[0])
    if span <= 1200:
        return 1.0, "Time (s)"
    return (60.0, "Time (min)") if span <= 3 * 3600 else (3600.0, "Time (h)")
