"""After which share of the data MAGYC-IFG has settled; the paper says it does, its printed text has lost the number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.estimators import calibrate
from magyc_gtsam.simulation import simulate
from magyc_gtsam.study.table_one import PUBLISHED, RATE, SAMPLES


@dataclass(frozen=True)
class Settling:
    """One motion of Table I: median and 5 to 95 % range over the runs, shares of the recording.

    share: after which the current estimate never again left the last one by more than 5 % of the field (hard
    iron), 5 % (soft iron) or 15 mrad/s (bias).
    """

    motion: str
    share: tuple[float, float, float]


def settling(
    runs: int = 100,
    *,
    gyroscope_noise: float = 5e-3,
    samples: int = SAMPLES,
    progress: Callable[[float], None] | None = None,
) -> list[Settling]:
    """Run MAGYC-IFG over `runs` recordings of each motion of Table I; see `table_one` for the arguments."""
    motions = list(PUBLISHED["raw"])
    result: list[Settling] = []
    for motion in motions:
        shares = []
        for seed in range(runs):
            recording = simulate(motion, samples / RATE, RATE, seed, gyroscope_noise=gyroscope_noise).recording
            shares.append(calibrate(recording, "magyc-ifg").diagnostics["settled_after"])
            if progress:
                progress((len(result) + (seed + 1) / runs) / len(motions))
        middle, low, high = np.percentile(shares, [50, 5, 95])
        result.append(Settling(motion, (float(middle), float(low), float(high))))
    return result
