"""Study of the accuracy of a calibration by its duration and the size of the motion.

Simulated motions like the paper's, with several amplitudes of pitch and heading, are calibrated after several
durations. The result is the heading error over a level turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.heading_uncertainty import turn_of
from magyc_gtsam.level_turn import calibrated
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation import simulate
from magyc_gtsam.study.rows import HERE, Running, study_rows

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


@dataclass(frozen=True)
class ErrorsByDuration:
    """Results over the runs of one motion and duration.

    Attributes:
        error: root-mean-square heading error over a level turn, deg.
        hard_iron: root-mean-square hard iron error per axis, T.
        stated: root mean square of the heading's stated sigma, deg.
        refused: share of the runs that are not trusted.
    """

    error: float
    hard_iron: float
    stated: float
    refused: float


def units(runs: int) -> list[DurationCase]:
    """Return the units of the whole study."""
    return [
        DurationCase(heading, pitch, seed) for seed in range(runs) for heading in HEADINGS for pitch in PITCHES
    ]


def duration_rows(chosen: Sequence[DurationCase], running: Running = HERE) -> list[Row]:
    """Return one row per unit and duration."""
    return study_rows("duration", worked, chosen, running)


def worked(unit: DurationCase) -> Row:
    """Return one row per entry of `MINUTES`, with squared errors."""
    simulation = simulate((_ROLL, unit.pitch, unit.heading), 60 * max(MINUTES), seed=unit.seed)
    whole = replace(simulation.recording, attitude=None)
    truth = simulation.truth
    turn = turn_of(simulation.recording, truth)
    raw = turn.field @ truth.soft_iron.T + truth.hard_iron
    row: dict[str, list[float]] = {name: [] for name in ("minutes", "error", "hard_iron", "stated", "refused")}
    for minutes in MINUTES:
        calibration = calibrate(whole.between(0, 60 * minutes))
        off = turn.error(calibrated(raw, calibration.soft_iron, calibration.hard_iron))
        stated = np.full(1, np.nan)
        if calibration.covariance is not None:
            stated = turn.systematic(calibration.covariance, calibration.soft_iron)
        row["minutes"].append(minutes)
        row["error"].append(float(np.mean(off**2)))
        row["hard_iron"].append(float(np.mean((calibration.hard_iron - truth.hard_iron) ** 2)))
        row["stated"].append(float(np.mean(stated**2)))
        row["refused"].append(float(not calibration.trusted))
    return row


def cells(rows: Sequence[Row], heading: float) -> Mapping[tuple[float, float], ErrorsByDuration]:
    """Return {(pitch, minutes): result} at an amplitude of heading."""
    result = {}
    for pitch in PITCHES:
        for minutes in MINUTES:
            own = [
                row for row in rows if (row["heading"], row["pitch"], row["minutes"]) == (heading, pitch, minutes)
            ]

            def mean(name: str, own: Sequence[Row] = own) -> float:
                return float(np.mean([row[name] for row in own]))

            result[pitch, minutes] = ErrorsByDuration(
                mean("error") ** 0.5, mean("hard_iron") ** 0.5, mean("stated") ** 0.5, mean("refused")
            )
    return result


def draw(target: Path, rows: Sequence[Row]) -> None:
    """Draw contours of the heading error over minutes and pitch, one panel per amplitude of heading."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    for axes, heading in zip(figure.subplots(1, len(HEADINGS), sharey=True), HEADINGS, strict=True):
        of_motion = cells(rows, heading)
        error: Array = np.array([[of_motion[pitch, minutes].error for minutes in MINUTES] for pitch in PITCHES])
        lines = axes.contour(MINUTES, PITCHES, error, levels=_CONTOURS, colors="#2b8cdb")
        axes.clabel(lines, fmt="%g°", fontsize=8)
        axes.set(xscale="log", yscale="log", xlabel="minutes", title=f"heading ±{heading:g}°")
        axes.set_xticks(MINUTES, [f"{each:g}" for each in MINUTES])
        axes.set_yticks(PITCHES, [f"{each:g}" for each in PITCHES])
        axes.minorticks_off()
    figure.axes[0].set_ylabel("pitch, ±°")
    figure.savefig(target, metadata={"Date": None})
