"""The figures of a calibration and of a gap by matplotlib, for notebooks and PDF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.gap.outcome.agreement import GapMap, OpenLoop
from magyc_gtsam.heading_uncertainty import systematic
from magyc_gtsam.level_turn import LevelTurn
from magyc_gtsam.recording import Array
from magyc_gtsam.report.analysis import FieldHistory, ellipsoid_outline, spread, summary, time_unit

RAW = "#d9730d"  # orange and blue: distinct to colour-blind readers and on light and dark backgrounds
CALIBRATED = "#2b8cdb"
INK = "#808a94"  # readable on light and dark backgrounds
_MICRO = 1e6
_FLAT = 0.1  # share of the common scale below which the calibrated curve gets its own panel


def legend(figure: Figure, before: str, after: str) -> None:
    """Say below all panels which colour is which."""
    lines = [Line2D([], [], color=colour, label=label) for colour, label in ((RAW, before), (CALIBRATED, after))]
    figure.legend(handles=lines, loc="outside lower center", ncols=2, frameon=False)


def field_projection(
    figure: FigureBase, history: FieldHistory, soft_iron: Array, hard_iron: Array, plane: tuple[int, int]
) -> None:
    """Plot raw and calibrated field, with the fitted ellipsoid and the sphere, along one sensor axis."""
    axes = figure.add_subplot()
    rows = spread(history.calibrated, history.strength / 40)
    for field, colour in ((history.raw, RAW), (history.calibrated, CALIBRATED)):
        x, y = field[rows][:, plane].T * _MICRO
        axes.plot(x, y, ".", color=colour, markersize=2.5, alpha=0.5, rasterized=True, markeredgewidth=0)
    radius, centre = history.strength * _MICRO, hard_iron * _MICRO
    axes.plot(*ellipsoid_outline(soft_iron * radius, centre, plane).T, color=RAW)
    axes.plot(*ellipsoid_outline(np.eye(3) * radius, np.zeros(3), plane).T, color=CALIBRATED)
    axes.locator_params(nbins=5)
    axes.set(
        aspect="equal", adjustable="datalim", xlabel=f"{'xyz'[plane[0]]} (µT)", ylabel=f"{'xyz'[plane[1]]} (µT)"
    )


def field_strength(figure: FigureBase, history: FieldHistory) -> None:
    """Plot the strength of the field over time, raw and calibrated."""
    raw, calibrated = (np.linalg.norm(field, axis=1) * _MICRO for field in (history.raw, history.calibrated))
    before_after(figure, history.time, raw, calibrated, "Strength (µT)", history.strength * _MICRO)


def heading_error(figure: FigureBase, time: Array, error: Array) -> None:
    """Plot the error of the magnetic heading (n, 2) deg, raw and calibrated, over time."""
    before_after(figure, time, error[:, 0], error[:, 1], "Heading error (°)", 0.0)


def level_turn_error(figure: FigureBase, turn: LevelTurn, calibration: Calibration) -> None:
    """Plot the heading error of the raw field over a level turn, and the uncertainty after one that is trusted."""
    sigma = systematic(turn, calibration) if calibration.trusted else None
    rows = 1 if sigma is None else 2
    grid = figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=[3, 2][:rows])[:, 0]
    error = turn.raw_error(calibration.soft_iron, calibration.hard_iron)
    jumps = np.append(np.abs(np.diff(error)) > 180, False)  # avoids a line across the wrap at ±180°
    grid[0].plot(turn.heading, np.where(jumps, np.nan, error), color=RAW)
    grid[0].set_ylabel("Raw (°)")
    if sigma is not None:
        sigma = np.minimum(sigma, 180.0)
        grid[1].fill_between(turn.heading, -sigma, sigma, color=CALIBRATED, alpha=0.4, linewidth=0)
        grid[1].set_ylabel("Calibrated\n±1σ (°)")
    for axes in grid:
        axes.axhline(0, color=INK, linewidth=1, linestyle="--")
    grid[-1].set(xlabel="Heading of a level turn (°)", xticks=range(0, 361, 60), xlim=(0, 360))


def before_after(figure: FigureBase, time: Array, raw: Array, calibrated: Array, label: str, ideal: float) -> None:
    """Plot means as lines, ranges as bands and `ideal` dashed; in two panels where one scale would hide a curve."""
    unit, time_label = time_unit(time)
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


_TICKS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000)


def gap_map(figure: FigureBase, before: GapMap, after: GapMap) -> None:
    """Draw the misfit over one variable, before and after, with the band expected of the right model."""
    axes = figure.add_subplot()
    unit, label = _axis(before)
    centre = before.centre / unit
    axes.fill_between(centre, *before.band.T, color=INK, alpha=0.13, linewidth=0)
    axes.axhline(1.0, color=INK, linewidth=0.8, linestyle="--")
    axes.locator_params(axis="x", nbins=6)
    axes.plot(centre, before.level, color=RAW, marker=".", markersize=4)
    if after is not before:
        axes.plot(after.centre / unit, after.level, color=CALIBRATED, marker=".", markersize=4)
    low = min(before.level.min(), after.level.min(), before.band.min())
    high = max(before.level.max(), after.level.max(), before.band.max())
    axes.set(xlabel=label, ylabel="Misfit (σ)", ylim=(0.9 * low, 1.05 * high))
    if before.over == "frequency" and centre[0] > 0:
        axes.set_xscale("log")
        _plain_ticks(axes, centre)


def open_loop(figure: FigureBase, before: OpenLoop, after: OpenLoop) -> None:
    """Draw the error of the prediction by the gyroscope alone over time, with the band that the model expects."""
    unit, label = time_unit(before.time)
    panels = figure.subplots(3, 1, sharex=True)
    for axis, axes in enumerate(panels):
        time = after.time / unit
        expected = 2.6 * after.sigma[:, axis] * _MICRO
        axes.fill_between(time, -expected, expected, color=INK, alpha=0.13, linewidth=0)
        dots = {"markersize": 2.5, "alpha": 0.6, "rasterized": True}
        axes.plot(before.time / unit, before.error[:, axis] * _MICRO, ".", color=RAW, **dots)
        if after is not before:
            axes.plot(time, after.error[:, axis] * _MICRO, ".", color=CALIBRATED, **dots)
        both = np.abs(np.concatenate([before.error[:, axis], after.error[:, axis]])) * _MICRO
        limit = 1.1 * float(np.quantile(both, 0.999))
        axes.set(ylabel=f"{'xyz'[axis]} (µT)", ylim=(-limit, limit))
    panels[-1].set_xlabel(label)


def _plain_ticks(axes: Axes, values: Sequence[float] | Array) -> None:
    """Set ticks at 1 and 3 of every decade of a logarithmic axis."""
    ticks = [t for t in _TICKS if 0.8 * min(values) <= t <= 1.2 * max(values)]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.set_xticks([], minor=True)


def _axis(gap: GapMap) -> tuple[float, str]:
    """Return divisor and label of a map's variable."""
    if gap.over == "time":
        return time_unit(gap.centre)
    name = gap.over[0].upper() + gap.over[1:]
    return 1.0, f"{name} ({gap.unit})" if gap.unit else name
