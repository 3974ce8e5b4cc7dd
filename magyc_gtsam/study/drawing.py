"""Figures of lines over a condition, in panels side by side as in the papers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Panel:
    """One panel: {name: one value per entry of `x`}; values that are not finite are left out."""

    title: str
    across: str
    up: str
    x: Sequence[float] | Sequence[str]
    lines: Mapping[str, Sequence[float]]
    logarithmic: bool = True


def draw_panels(target: Path, panels: Sequence[Panel], columns: int = 3) -> None:
    """Write the panels as SVG; a name has the same colour in all panels."""
    from matplotlib.figure import Figure

    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(3.6 * columns, 2.9 * rows + 0.6), layout="constrained")
    names = list(dict.fromkeys(name for panel in panels for name in panel.lines))
    handles = {}
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        for name, values in panel.lines.items():
            place = names.index(name)
            (handles[name],) = axes.plot(
                range(len(panel.x)),
                [value if np.isfinite(value) else np.nan for value in values],
                color=f"C{place % 10}",
                linestyle=("-", "--", ":")[place // 10 % 3],
                marker=".",
            )
        axes.set_xticks(range(len(panel.x)), [each if isinstance(each, str) else f"{each:g}" for each in panel.x])
        axes.set(title=panel.title, xlabel=panel.across, ylabel=panel.up)
        if panel.logarithmic:
            axes.set_yscale("log")
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=8)
    figure.savefig(target, metadata={"Date": None})
