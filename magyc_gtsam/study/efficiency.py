"""Comparison of a method's errors with the Cramér–Rao bound, and a test of the consistency of its covariance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation import disturb, simulate
from magyc_gtsam.study.bound import cramer_rao

BLOCKS = {"soft iron": slice(0, 6), "hard iron": slice(6, 9), "gyroscope bias": slice(9, 12)}
FREEDOMS = 11  # 6 − 1 + 3 + 3


@dataclass(frozen=True)
class Efficiency:
    """The results of `runs` simulated recordings of one motion.

    Attributes:
        motion, runs: motion, and number of runs.
        ratio: root-mean-square error over the Cramér–Rao bound, per block of BLOCKS.
        rmse: root-mean-square error of the block's norm: 1, T, rad/s.
        nees: mean normalised estimation error squared; FREEDOMS if the covariance is consistent.
        band: 95 % band of `nees` for a consistent covariance.
        refused: number of runs whose result the method did not trust; they count like all others.
    """

    motion: str
    runs: int
    ratio: dict[str, float]
    rmse: dict[str, float]
    nees: float
    band: tuple[float, float]
    refused: int


def error(estimate: Calibration, truth: Calibration) -> Array:
    """Return the error (12,), estimate minus truth: vech(soft iron), hard iron T, gyroscope bias rad/s."""
    bias = (
        np.zeros(3)
        if estimate.gyro_bias is None or truth.gyro_bias is None
        else estimate.gyro_bias - truth.gyro_bias
    )
    return np.concatenate([vech(estimate.soft_iron - truth.soft_iron), estimate.hard_iron - truth.hard_iron, bias])


def nees(deviation: Array, covariance: Array) -> float:
    """Return eᵀ Σ⁺ e, with the pseudo-inverse because the scale of the soft iron is fixed."""
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale)
    whitened = deviation / scale
    return float(whitened @ np.linalg.pinv(correlation, rcond=1e-9, hermitian=True) @ whitened)


def efficiency(
    motion: str,
    runs: int = 100,
    *,
    gyroscope_noise: float = 5e-3,
    disturbed: float = 0.0,
    method: Callable[[Recording], Calibration] = calibrate,
    first_seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Efficiency:
    """Calibrate `runs` recordings and compare the errors with the bound of the undisturbed data.

    Args:
        motion: as in `simulate`.
        runs: number of recordings.
        gyroscope_noise: of the simulation, rad/s.
        disturbed: share of the one-second stretches to which up to 50 µT are added.
        method: recording → calibration with covariance.
        first_seed: seed of the first recording; the others follow.
        progress: called with the share done.
    """
    deviations, bounds, consistency, refused = [], [], [], 0
    for seed in range(first_seed, first_seed + runs):
        simulation = simulate(motion, seed=seed, gyroscope_noise=gyroscope_noise)
        recording = disturb(simulation.recording, disturbed, seed=seed) if disturbed else simulation.recording
        estimate = method(recording)
        refused += not estimate.converged
        deviation = error(estimate, simulation.truth)
        deviations.append(deviation)
        bounds.append(np.diag(cramer_rao(simulation)))
        if estimate.covariance is not None:
            consistency.append(nees(deviation, estimate.covariance))
        if progress:
            progress((seed + 1 - first_seed) / runs)
    square, bound = np.mean(np.square(deviations), axis=0), np.mean(bounds, axis=0)
    half = 1.96 * np.sqrt(2 * FREEDOMS / runs)
    return Efficiency(
        motion,
        runs,
        {name: float(np.sqrt(square[block].sum() / bound[block].sum())) for name, block in BLOCKS.items()},
        {name: float(np.sqrt(square[block].sum())) for name, block in BLOCKS.items()},
        float(np.mean(consistency)) if consistency else float("nan"),
        (FREEDOMS - half, FREEDOMS + half),
        refused,
    )
