"""Drawings of confusion matrices."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from magyc_gtsam.blindtest.scoring import Outcome, confusion


def write_pictures(folder: Path, outcomes: Sequence[Outcome]) -> list[Path]:
    """Write `confusion-<factor>.svg` per strength, of recordings with one effect or none; return the files."""
    files = []
    alone = [o for o in outcomes if o.scenario.set in ("none", "single", "foreign")]
    for factor in sorted({o.scenario.factor for o in alone}, reverse=True):
        of_factor = [o for o in alone if o.scenario.factor == factor]
        target = folder / f"confusion-x{factor:g}.svg"
        draw(target, of_factor, f"Diagnosis (columns) of the hidden effect (rows), strength × {factor:g}")
        files.append(target)
    return files


def draw(target: Path, outcomes: Sequence[Outcome], title: str) -> None:
    """Draw the shares of each row, labelled with the counts."""
    from matplotlib.figure import Figure

    rows, columns, counts = confusion(outcomes)
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    figure = Figure(figsize=(2.6 + 0.34 * len(columns), 2.2 + 0.26 * len(rows)), layout="constrained")
    axes = figure.subplots()
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1.1, aspect="auto")
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=8)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    for row, column in np.argwhere(counts > 0).tolist():
        dark = share[row, column] > 0.55
        axes.text(
            column,
            row,
            str(counts[row, column]),
            ha="center",
            va="center",
            fontsize=7,
            color="white" if dark else "black",
        )
    axes.set_title(title, fontsize=9, loc="left")
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    figure.savefig(target, metadata={"Date": None})
