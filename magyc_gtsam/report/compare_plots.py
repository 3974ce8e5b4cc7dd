"""The figures of the comparison page, as Fig. 7 of the Autocal paper: ellipsoids, and norms before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from magyc_gtsam.recording import Array
from magyc_gtsam.report.analysis import ellipsoid_outline, spread
from magyc_gtsam.report.plots import CALIBRATED, DISTURBED, RAW, before_after, drawn
from magyc_gtsam.study.comparison import Comparison, Outcome, Status
from magyc_gtsam.study.heading import HeadingError

_FAR = 1.5  # times the samples' extent, up to which the panels make room for ellipsoids


@dataclass(frozen=True)
class Cloud:
    """What all ellipsoid figures have in common, in the unit shown.

    Attributes:
        unit: "µT" or "counts".
        inlier, outlier: (n, 3) samples to draw, those that fit and those that do not.
        middle, reach: (3,) and half the width of the panels.
    """

    unit: str
    inlier: Array
    outlier: Array
    middle: Array
    reach: float


def cloud(comparison: Comparison) -> Cloud:
    """The samples to draw, and panels that hold them and the ellipsoids of trusted methods."""
    scale, unit = comparison.recording.field_shown
    field = comparison.recording.magnetometer.value * scale
    low, high = field.min(axis=0), field.max(axis=0)
    extent = float((high - low).max())
    bounds = [low, high]
    for outcome in comparison.trusted:
        if outcome.calibration is not None and outcome.strength is not None:
            half = np.linalg.norm(outcome.calibration.soft_iron, axis=1) * outcome.strength * scale
            centre = outcome.calibration.hard_iron * scale
            bounds += [
                np.maximum(centre - half, low - _FAR * extent),
                np.minimum(centre + half, high + _FAR * extent),
            ]
    low, high = np.min(bounds, axis=0), np.max(bounds, axis=0)
    kept = comparison.inlier
    reach = 0.55 * float((high - low).max())
    return Cloud(unit, _apart(field[kept], extent), _apart(field[~kept], extent), 0.5 * (low + high), reach)


def _apart(field: Array, extent: float) -> Array:
    """Of samples that lie upon each other, one."""
    return field[spread(field, extent / 60)] if len(field) else field


@drawn(3.6, 3.5)
def ellipsoid(figure: Figure, samples: Cloud, matrix: Array, centre: Array, plane: tuple[int, int]) -> None:
    """Raw samples, those that fit no ellipsoid crossed, and the ellipsoid {matrix x + centre, ‖x‖ = 1}."""
    axes = figure.add_subplot()
    for field, mark, colour, alpha in (
        (samples.inlier, ".", CALIBRATED, 0.5),
        (samples.outlier, "x", DISTURBED, 0.9),
    ):
        axes.plot(*field[:, plane].T, mark, color=colour, markersize=3, alpha=alpha, rasterized=True)
    axes.plot(*ellipsoid_outline(matrix, centre, plane).T, color=RAW, linewidth=1.5)
    axes.plot(*centre[list(plane)], "+", color=RAW, markersize=9)
    (x, y), reach = samples.middle[list(plane)], samples.reach
    axes.set(
        aspect="equal",
        xlim=(x - reach, x + reach),
        ylim=(y - reach, y + reach),
        xlabel=f"{'xyz'[plane[0]]} ({samples.unit})",
        ylabel=f"{'xyz'[plane[1]]} ({samples.unit})",
    )


@drawn(4.7, 2.9)
def strength(figure: Figure, comparison: Comparison, outcome: Outcome) -> None:
    """Strength of the field over time, before and after."""
    assert outcome.calibration is not None
    time, field = comparison.recording.magnetometer
    scale, unit = comparison.recording.field_shown
    raw, calibrated = (np.linalg.norm(f, axis=1) * scale for f in (field, outcome.calibration.apply(field)))
    before_after(figure, time - comparison.recording.time[0], raw, calibrated, unit, float(np.median(calibrated)))


@drawn(4.7, 2.9)
def heading(figure: Figure, raw: HeadingError, calibrated: HeadingError) -> None:
    """Error of the magnetic heading against the reference over time, before and after."""
    before_after(figure, raw.time, raw.error, calibrated.error, "Error (°)", 0.0)


@drawn(3.6, 3.7)
def hard_irons(figure: Figure, comparison: Comparison, axis: int) -> None:
    """Hard iron of every method along an axis, with 1σ where the method states it; a triangle: beyond the figure."""
    outcomes = comparison.calibrated
    scale, unit = comparison.recording.field_shown
    rows = np.arange(len(outcomes))[::-1]
    every = np.array([o.calibration.hard_iron for o in outcomes if o.calibration]) * scale
    unknown = np.full(3, np.nan)
    sigma = (
        np.array([o.calibration.sigma.get("hard_iron", unknown)[axis] for o in outcomes if o.calibration]) * scale
    )
    trusted = np.array([o.status is Status.TRUSTED for o in outcomes])
    seen = every[trusted] if trusted.any() else every
    reach = 0.7 * max(float(np.ptp(seen, axis=0).max()), float(np.nanmax([0.0, *sigma[trusted]])), 1e-6)
    centre = 0.5 * (seen[:, axis].min() + seen[:, axis].max())
    low, high, value = centre - 1.5 * reach, centre + 1.5 * reach, every[:, axis]
    rank = np.where(value < low, -1, np.where(value > high, 1, 0))
    axes = figure.add_subplot()
    for good, colour in ((True, CALIBRATED), (False, DISTURBED)):
        for place, mark in ((-1, "<"), (0, "o"), (1, ">")):
            chosen = (trusted == good) & (rank == place)
            axes.plot(np.clip(value[chosen], low, high), rows[chosen], mark, color=colour, markersize=5)
        chosen = (trusted == good) & (rank == 0)
        axes.errorbar(value[chosen], rows[chosen], xerr=sigma[chosen], fmt="none", ecolor=colour, linewidth=1.5)
    margin = 0.05 * (high - low)
    axes.set(xlabel=f"{'xyz'[axis]} ({unit})", xlim=(low - margin, high + margin))
    axes.set_yticks(rows, [o.method for o in outcomes])
