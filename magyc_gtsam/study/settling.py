"""Study of the share of the data after which MAGYC-IFG settles; the number is missing from the paper's printed text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.simulation import simulate
from magyc_gtsam.study.drawing import Panel, draw_panels
from magyc_gtsam.study.rows import HERE, Running, study_rows
from magyc_gtsam.study.table_one import PUBLISHED, RATE, SAMPLES

_SHARES = tuple(np.round(np.arange(0.0, 1.01, 0.1), 1))


class SettlingCase(NamedTuple):
    """One recording of Table I, and the gyroscope's noise in rad/s."""

    motion: str
    gyroscope_noise: float
    seed: int


@dataclass(frozen=True)
class Settling:
    """One motion of Table I: median and 5 to 95 % range over the runs, shares of the recording.

    `share` is the share after which the current estimate stays within 5 % of the field (hard iron), 5 % (soft iron) and
    15 mrad/s (bias) of the last one.
    """

    motion: str
    share: tuple[float, float, float]


def settling_rows(
    runs: int = 100, *, gyroscope_noise: float = 5e-3, samples: int = SAMPLES, running: Running = HERE
) -> list[Row]:
    """Run MAGYC-IFG over `runs` recordings of each motion of Table I; see `table_one` for the arguments."""
    chosen = [SettlingCase(motion, gyroscope_noise, seed) for seed in range(runs) for motion in PUBLISHED["raw"]]
    return study_rows("settling", partial(worked, samples=samples), chosen, running)


def worked(unit: SettlingCase, samples: int) -> Row:
    """Run one recording."""
    noise = unit.gyroscope_noise
    recording = simulate(unit.motion, samples / RATE, RATE, unit.seed, gyroscope_noise=noise).recording
    return {"share": [calibrate(recording, "magyc-ifg").diagnostics["settled_after"]]}


def settlings(rows: Sequence[Row]) -> list[Settling]:
    """Return one result per motion."""
    result = []
    for motion in PUBLISHED["raw"]:
        middle, low, high = np.percentile([row["share"] for row in rows if row["motion"] == motion], [50, 5, 95])
        result.append(Settling(motion, (float(middle), float(low), float(high))))
    return result


def draw(target: Path, rows: Sequence[Row]) -> None:
    """Draw the share of settled runs over the share of the data."""
    lines = {}
    for motion in PUBLISHED["raw"]:
        own = np.array([row["share"] for row in rows if row["motion"] == motion])
        lines[motion] = [float(np.mean(own <= share)) for share in _SHARES]
    draw_panels(
        target, [Panel("magyc-ifg has settled", "share of the data", "share of the runs", _SHARES, lines, False)]
    )
