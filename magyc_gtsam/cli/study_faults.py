"""`magyc-gtsam study faults`: count results that are wrong and trusted, right and trusted, or refused under faults."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.recording import Recording

_BLOCK = 5.0  # s of samples per update of the online method
_SHOWN = 40  # rows of the table that are shown


def batch(recording: Recording) -> Calibration | None:
    """Calibrate by the batch method."""
    from magyc_gtsam.estimators import calibrate

    return calibrate(recording)


def online(recording: Recording) -> Calibration | None:
    """Calibrate by the online method, at the end of the log; the result is trusted only if it has converged."""
    from dataclasses import replace

    from magyc_gtsam.online import OnlineCalibrator

    calibrator = OnlineCalibrator()
    (mag_time, field), (gyro_time, rate) = recording.magnetometer, recording.gyroscope
    edges = np.arange(recording.time[0], recording.time[-1] + _BLOCK, _BLOCK)
    for start in edges:
        rows = slice(*np.searchsorted(mag_time, [start, start + _BLOCK]))
        calibrator.update(mag_time[rows], field[rows])
        rows = slice(*np.searchsorted(gyro_time, [start, start + _BLOCK]))
        calibrator.update(gyro_time[rows], angular_rate=rate[rows])
    result = calibrator.calibration
    if result is None or calibrator.converged:
        return result
    return replace(result, converged=False, message=calibrator.progress.sentence)


def gap(recording: Recording) -> Calibration | None:
    """Calibrate by the gap workflow."""
    from magyc_gtsam.gap import find_gap

    return find_gap(recording).calibration


METHODS = {"batch": batch, "online": online, "gap": gap}


def faults(
    folder: Path,
    seeds: Sequence[int],
    motions: Sequence[str] | None,
    names: Sequence[str],
    methods: Sequence[str],
    workers: int,
    draw: int | None = None,
    strengths: Sequence[str] = (),
) -> int:
    """Run the cases that are not done yet, print the worst cells and write all rows.

    Returns:
        The exit code: 0 if nothing crashed and in no cell whose fault the data show more than 1 in 30 results is wrong
        and trusted, else 1.
    """
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.simulation.motion import AMPLITUDES
    from magyc_gtsam.study.faults.catalogue import FAULTS
    from magyc_gtsam.study.faults.running import STRENGTHS, cases, cells, covered, drawn, run
    from magyc_gtsam.study.faults.scoring import OUTCOMES

    unknown = sorted(set(methods) - set(METHODS))
    if unknown:
        raise MagycError(f"--by: {unknown[0]!r} is not one of {', '.join(METHODS)}")
    every = cases(names or list(FAULTS), motions or list(AMPLITUDES), seeds, strengths or STRENGTHS)
    if draw is not None:
        every = drawn(every, draw, seeds[0])
    with stages() as stage:
        chosen = {name: METHODS[name] for name in methods or METHODS}
        rows = run(folder, every, chosen, workers, stage(f"{len(every)} recordings by {', '.join(chosen)}"))
    table = cells(rows)
    header = ["fault", "strength", "motion", "by", *OUTCOMES, "hard iron µT", "heading °"]
    worst = [
        [
            cell.fault + ("" if FAULTS[cell.fault].shows else " (resembles misaligned chips)"),
            f"{getattr(FAULTS[cell.fault], cell.strength):g} {FAULTS[cell.fault].unit}",
            cell.motion,
            cell.method,
            *(f"{count}" for count in cell.counts.values()),
            f"{1e6 * cell.hard_iron:.1f}",
            f"{cell.heading:.1f}",
        ]
        for cell in table[:_SHOWN]
        if cell.counts[OUTCOMES[0]] or cell.counts["crashed"]
    ]
    if worst:
        show_table(header, worst)
    total = {outcome: sum(cell.counts[outcome] for cell in table) for outcome in OUTCOMES}
    show("", f"{len(rows)} results: " + ", ".join(f"{count} {outcome}" for outcome, count in total.items()))
    hidden = covered(rows)
    if hidden is not None:
        show(
            f"{hidden.count} results under faults that resemble misaligned chips, trusted or not: hard iron within one "
            f"stated sigma on {hidden.axes:.0%} of its axes, on its worst axis in {hidden.hard_iron:.0%}, heading at "
            f"its worst in {hidden.heading:.0%}"
        )
    show(f"{folder / 'faults.parquet'}")
    bad = [c for c in table if FAULTS[c.fault].shows and 30 * c.counts[OUTCOMES[0]] > sum(c.counts.values())]
    return int(bool(bad) or total["crashed"] > 0)
