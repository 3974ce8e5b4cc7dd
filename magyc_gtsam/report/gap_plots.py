"""Figures of a gap by matplotlib: the misfit maps, and the prediction before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from magyc_gtsam.gap.outcome.agreement import GapMap, OpenLoop
from magyc_gtsam.recording import Array
from magyc_gtsam.report.plots import CALIBRATED, INK, RAW, clock

_MICRO = 1e6
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
    unit, label = clock(before.time)
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
        return clock(gap.centre)
    name = gap.over[0].upper() + gap.over[1:]
    return 1.0, f"{name} ({gap.unit})" if gap.unit else name
