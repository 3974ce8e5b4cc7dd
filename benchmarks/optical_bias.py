"""The gyroscope's errors by an optical attitude, as a truth for calibrations of real recordings."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import magyc_gtsam as mg
from magyc_gtsam.recording import Array


class GyroscopeByOptics(NamedTuple):
    """What a gyroscope adds to the rate.

    Attributes:
        bias: (3,) rad/s.
        bias_covariance: (3, 3).
        matrix: (3, 3) of the rate: scales on its diagonal, and a rotation against the markers.
        matrix_covariance: (9, 9), row by row.
        lag: of the gyroscope behind the cameras, s.
    """

    bias: Array
    bias_covariance: Array
    matrix: Array
    matrix_covariance: Array
    lag: float


def gyroscope_by_optics(recording: mg.Recording, attitude_time: Array, attitude: Rotation) -> GyroscopeByOptics:
    """Errors of the gyroscope, by least squares.

    −Log(ΔR_gyroᵀ ΔR_optical) = (b + E ω) Δt − τ Δω over half a second, E and τ free (3, 3). The covariance is a
    sandwich over blocks of 5 s.
    """
    gyro_time, rate = recording.gyroscope
    edges = np.arange(max(attitude_time[0], gyro_time[0]), min(attitude_time[-1], gyro_time[-1]), 0.5)
    at = np.searchsorted(attitude_time, edges)
    holes = np.array([np.max(np.diff(attitude_time[a : b + 2]), initial=0.0) for a, b in itertools.pairwise(at)])
    optical = Slerp(attitude_time, attitude)(np.clip(edges, attitude_time[0], attitude_time[-1]))
    fine = np.unique(np.concatenate([gyro_time, edges]))
    value = np.stack([np.interp(fine, gyro_time, column) for column in rate.T], axis=1)
    steps = Rotation.from_rotvec(0.5 * (value[1:] + value[:-1]) * np.diff(fine)[:, None])
    cuts = np.searchsorted(fine, edges)
    turned = Rotation.concatenate([product(steps[a:b]) for a, b in itertools.pairwise(cuts)])
    left = -(turned.inv() * (optical[:-1].inv() * optical[1:])).as_rotvec()
    smooth = np.stack([np.convolve(column, np.full(9, 1 / 9), "same") for column in rate.T], axis=1)
    at_edge = np.stack([np.interp(edges, gyro_time, column) for column in smooth.T], axis=1)
    design = np.concatenate([np.full((len(left), 1), 0.5), turned.as_rotvec(), -np.diff(at_edge, axis=0)], axis=1)
    good = (np.linalg.norm(left, axis=1) < 0.2) & (holes < 0.1)
    weight = good.astype(float)
    for _ in range(5):
        solution = np.linalg.lstsq(design * np.sqrt(weight)[:, None], left * np.sqrt(weight)[:, None], rcond=None)[
            0
        ]
        residual = left - design @ solution
        scale = np.median(np.linalg.norm(residual[good], axis=1))
        weight = good / (1 + (residual**2).sum(1) / (2 * scale) ** 2)
    inverse = np.linalg.inv(design.T @ (design * weight[:, None]))
    block = ((edges[:-1] - edges[0]) // 5).astype(int)
    score = np.einsum("n,na,ni->nai", weight, design, residual)
    summed = np.zeros((block.max() + 1, 7, 3))
    np.add.at(summed, block, score)
    influence = np.einsum("ab,kbi->kia", inverse, summed)  # of each block on the solution, axis by axis
    of_bias, of_matrix = influence[:, :, 0], influence[:, :, 1:4].reshape(len(influence), 9)
    return GyroscopeByOptics(
        solution[0],
        of_bias.T @ of_bias,
        solution[1:4].T,
        of_matrix.T @ of_matrix,
        float(np.trace(solution[4:]) / 3),
    )


def product(steps: Rotation) -> Rotation:
    """Of rotations in order, by halves."""
    while len(steps) > 1:
        rest = steps[-1:] if len(steps) % 2 else None
        joined = steps[: len(steps) - len(steps) % 2 : 2] * steps[1::2]
        steps = joined if rest is None else Rotation.concatenate([joined, rest])
    return steps[0]
