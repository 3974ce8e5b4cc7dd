"""Study of the accuracy of a calibration by its duration and the size of the motion.

Simulated motions like the paper's, with several amplitudes of pitch and heading, are calibrated after several
durations. The result is the heading error over a level turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.heading_uncertainty import systematic, turn_of
from magyc_gtsam.level_turn import calibrated
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation import simulate
from magyc_gtsam.study.rows import Cell

PITCHES = (2.0, 5.0, 10.0, 20.0, 45.0)  # deg
HEADINGS = (90.0, 360.0)  # deg
MINUTES = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_ROLL = 5.0  # deg
_CONTOURS = (0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0)  # deg


class DurationCase(NamedTuple):
    """One recording: amplitudes of heading and pitch, deg, and seed; calibrated after all durations."""

    heading: float
    pitch: float
    seed: int


def units(runs: int) -> list[DurationCase]:
    """Return the units of the whole study."""
    return [
        DurationCase(heading, pitch, seed) for seed in range(runs) for heading in HEADINGS for pitch in PITCHES
    ]


def worked(unit: DurationCase) -> Row:
    """Return one row per entry of `MINUTES`.

    Their columns are the mean square of the heading error over a level turn and of its stated sigma, deg², of the hard
    iron error per axis, T², and whether the result is not trusted.
    """
    simulation = simulate((_ROLL, unit.pitch, unit.heading), 60 * max(MINUTES), seed=unit.seed)
    whole = replace(simulation.recording, attitude=None)
    truth = simulation.truth
    turn = turn_of(simulation.recording, truth)
    raw = turn.field @ truth.soft_iron.T + truth.hard_iron
    row: dict[str, list[float]] = {name: [] for name in ("minutes", "error", "hard_iron", "stated", "refused")}
    for minutes in MINUTES:
        calibration = calibrate(whole.between(0, 60 * minutes))
        off = turn.error(calibrated(raw, calibration.soft_iron, calibration.hard_iron))
        sigma = systematic(turn, calibration)
        stated = np.full(1, np.nan) if sigma is None else sigma
        row["minutes"].append(minutes)
        row["error"].append(float(np.mean(off**2)))
        row["hard_iron"].append(float(np.mean((calibration.hard_iron - truth.hard_iron) ** 2)))
        row["stated"].append(float(np.mean(stated**2)))
        row["refused"].append(float(not calibration.trusted))
    return row


def draw(target: Path, rows: Sequence[Row]) -> None:
    """Draw contours of the heading error over minutes and pitch, one panel per amplitude of heading."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    for axes, heading in zip(figure.subplots(1, len(HEADINGS), sharey=True), HEADINGS, strict=True):
        error: Array = np.array(
            [
                [Cell(rows, heading=heading, pitch=pitch, minutes=minutes).root("error") for minutes in MINUTES]
                for pitch in PITCHES
            ]
        )
        lines = axes.contour(MINUTES, PITCHES, error, levels=_CONTOURS, colors="#2b8cdb")
        axes.clabel(lines, fmt="%g°", fontsize=8)
        axes.set(xscale="log", yscale="log", xlabel="minutes", title=f"heading ±{heading:g}°")
        axes.set_xticks(MINUTES, [f"{each:g}" for each in MINUTES])
        axes.set_yticks(PITCHES, [f"{each:g}" for each in PITCHES])
        axes.minorticks_off()
    figure.axes[0].set_ylabel("pitch, ±°")
    figure.savefig(target, metadata={"Date": None})
