"""The Cramér–Rao bound of a simulated recording, and a method's errors and covariance against it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.estimators.smoother.starts import parameters
from magyc_gtsam.factors.chain.chain_values import DELAY, ChainState, SensorNoise
from magyc_gtsam.factors.chain.facts import Fact, quadratic
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation import Simulation, disturb, simulate

_EVERY_SAMPLE = 1e-9  # rad of rotation per window: one window per sample, so that no information is lost


def cramer_rao(simulation: Simulation, facts: Sequence[Fact] = ()) -> Array:
    """Return the bound (12, 12) on the covariance of vech(soft iron, det 1), hard iron T and gyroscope bias rad/s.

    It is the inverse of the information at the truth, and of `facts`, with known delay (zero) and one node per sample.

    Raises:
        MagycError: the recording has no attitude, which gives the true directions, or has a delay.
    """
    recording, truth = simulation.recording, simulation.truth
    if recording.attitude is None or truth.gyro_bias is None or truth.field_strength is None or truth.delay:
        raise MagycError("the bound needs a simulated recording with attitude and without delay")
    samples = Preintegration(*recording.magnetometer, *recording.gyroscope, turn=_EVERY_SAMPLE)
    windows = samples.integrate(truth.gyro_bias)
    chain = FieldChain(windows, SensorNoise(truth.noise["magnetic_field"], truth.noise["angular_rate"]))
    scaled = truth.soft_iron * truth.field_strength
    body = Rotation.from_quat(recording.attitude).inv().apply(simulation.field / np.linalg.norm(simulation.field))
    state = ChainState(
        parameters(scaled, truth.hard_iron, truth.gyro_bias, 0.0),
        np.einsum("ijn,ni->jn", windows.rotation, body),
    )
    information = chain.eliminate(state, chain.unweighted()).information
    information = (information + quadratic(facts, state.parameters)[2])[:DELAY, :DELAY]
    covariance = np.linalg.inv(information).astype(np.float64)
    return fix_scale(scaled, covariance)[2]


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
