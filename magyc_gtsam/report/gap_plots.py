"""Figures of the gap page: where the gap is, the evidence, and prediction before and after."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from magyc_gtsam.gap.result import GapMap, Hypothesis, OpenLoop
from magyc_gtsam.recording import Array
from magyc_gtsam.report.gap_words import hypothesis_label
from magyc_gtsam.report.plots import CALIBRATED, INK, RAW, clock, drawn

_MICRO = 1e6
_TICKS = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000)
_SHOWN = 14  # hypotheses in the figure; the table has all


@drawn(4.3, 2.9)
def gap_map(figure: Figure, before: GapMap, after: GapMap) -> None:
    """Misfit over one variable, before and after, with the band in which the right model would stay."""
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


@drawn(4.7, 5.4)
def evidence(figure: Figure, hypotheses: Sequence[Hypothesis]) -> None:
    """Evidence over its threshold, strongest first; generic families, which only say where, hollow."""
    shown = sorted(hypotheses, key=lambda h: -h.statistic / h.threshold)[:_SHOWN][::-1]
    axes = figure.add_subplot()
    ratio = [max(h.statistic / h.threshold, 1e-2) for h in shown]
    colours = [RAW if h.significant else CALIBRATED for h in shown]
    bars = axes.barh(range(len(shown)), ratio, color=colours, height=0.4)
    for bar, hypothesis in zip(bars, shown, strict=True):
        if hypothesis.generic:
            bar.set(fill=False, edgecolor=bar.get_facecolor(), linewidth=1.2)
    rows = np.arange(len(shown))
    axes.vlines(np.ones(len(shown)), rows - 0.24, rows + 0.2, color=INK, linewidth=1.5)
    axes.set(xscale="log", xlabel="Evidence / its 1 % threshold")
    _plain_ticks(axes, [*ratio, 1.0])
    for row, hypothesis in enumerate(shown):  # above its bar, which leaves the width of a phone to both
        axes.annotate(
            hypothesis_label(hypothesis), (0, row + 0.33), (2, 0), ("axes fraction", "data"), "offset points"
        )
    axes.set(yticks=[], ylim=(-0.5, len(shown) - 0.1))


@drawn(4.7, 3.4)
def open_loop(figure: Figure, before: OpenLoop, after: OpenLoop) -> None:
    """Error of a prediction by the gyroscope alone, over time, with the band that the model expects."""
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
    figure.align_ylabels()
    panels[-1].set_xlabel(label)


def _plain_ticks(axes: Axes, values: Sequence[float] | Array) -> None:
    """1 and 3 of every decade, on a logarithmic axis."""
    ticks = [t for t in _TICKS if 0.8 * min(values) <= t <= 1.2 * max(values)]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.set_xticks([], minor=True)


def _axis(gap: GapMap) -> tuple[float, str]:
    """Divisor and label of a map's variable."""
    if gap.over == "time":
        return clock(gap.centre)
    name = gap.over[0].upper() + gap.over[1:]
    return 1.0, f"{name} ({gap.unit})" if gap.unit else name
