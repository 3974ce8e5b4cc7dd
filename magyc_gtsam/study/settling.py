"""Study of the share of the data after which MAGYC-IFG settles; the number is missing from the paper's printed text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.simulation import simulate
from magyc_gtsam.study.drawing import Panel, draw_panels
from magyc_gtsam.study.rows import Cell
from magyc_gtsam.study.table_one import PUBLISHED, RATE, SAMPLES

_SHARES = tuple(np.round(np.arange(0.0, 1.01, 0.1), 1))


class SettlingCase(NamedTuple):
    """One recording of Table I, and the gyroscope's noise in rad/s."""

    motion: str
    gyroscope_noise: float
    seed: int


def units(runs: int, gyroscope_noise: float = 5e-3) -> list[SettlingCase]:
    """Return `runs` recordings of each motion of Table I."""
    return [SettlingCase(motion, gyroscope_noise, seed) for seed in range(runs) for motion in PUBLISHED["raw"]]


def worked(unit: SettlingCase, samples: int = SAMPLES) -> Row:
    """Return the share of one recording after which MAGYC-IFG stands still.

    From there on its estimate stays within 5 % of the field (hard iron), 5 % (soft iron) and 15 mrad/s (bias) of the
    last one.
    """
    noise = unit.gyroscope_noise
    recording = simulate(unit.motion, samples / RATE, RATE, unit.seed, gyroscope_noise=noise).recording
    return {"share": [calibrate(recording, "magyc-ifg").diagnostics["settled_after"]]}


def draw(target: Path, rows: Sequence[Row]) -> None:
    """Draw the share of settled runs over the share of the data."""
    lines = {}
    for motion in PUBLISHED["raw"]:
        own = np.array(Cell(rows, motion=motion).column("share"))
        lines[motion] = [float(np.mean(own <= share)) for share in _SHARES]
    draw_panels(
        target, [Panel("magyc-ifg has settled", "share of the data", "share of the runs", _SHARES, lines, False)]
    )
