"""Accuracy measures of calibrations from the literature.

All use the model y = matrix · m + offset with ‖m‖ = 1, in the unit of the samples; `model` returns it for a
`Calibration`. "Review" is Papafotis, Nikitas and Sotiriadis, Sensors 2021, 21, 5288; "Autocal" is the robust
autocalibration paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array


def model(calibration: Calibration) -> tuple[Array, Array]:
    """Return matrix (3, 3) T, the soft iron times the field strength, and offset (3,) T, the hard iron.

    Raises:
        MagycError: the calibration has no field strength.
    """
    if calibration.field_strength is None:
        raise MagycError(
            f"the calibration of method {calibration.method!r} has no field strength, which this measure needs"
        )
    return calibration.soft_iron * calibration.field_strength, calibration.hard_iron


def normalised_model_error(
    matrix: ArrayLike, offset: ArrayLike, true_matrix: ArrayLike, true_offset: ArrayLike
) -> float:
    """Return ‖[K b] − [K b]_true‖ / ‖[K b]_true‖ in the Frobenius norm: Autocal (39), or (40) with a reference.

    Both matrices must fix their rotation in the same way (both symmetric, or both triangular).
    """
    estimate = np.column_stack([matrix, offset])
    truth = np.column_stack([true_matrix, true_offset])
    return float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))


def sensor_estimation_error(matrix: ArrayLike, offset: ArrayLike, samples: ArrayLike) -> float:
    """Return the root mean square of ‖K x + b − m‖ with the directions of (41): Autocal, section on real data, 2).

    It has the unit of the samples (n, 3), which should be free of outliers and not have been used for the fit.
    """
    directions = closest_points(np.asarray(matrix), np.asarray(offset), np.asarray(samples).T).direction.T
    residual = directions @ np.asarray(matrix).T + offset - np.asarray(samples)
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def offset_error(offset: ArrayLike, true_offset: ArrayLike) -> float:
    """Return J_h = ‖h_true − h‖: Review (69)."""
    return float(np.linalg.norm(np.subtract(true_offset, offset)))


def matrix_error(matrix: ArrayLike, true_matrix: ArrayLike) -> float:
    """Return J_T = min over R in O(3) of ‖T − T_true R‖ (Frobenius), a Procrustes problem: Review (71–73)."""
    matrix, true_matrix = np.asarray(matrix), np.asarray(true_matrix)
    left, _, right = np.linalg.svd(true_matrix.T @ matrix)
    return float(np.linalg.norm(matrix - true_matrix @ left @ right))


def model_cost(matrix: ArrayLike, offset: ArrayLike, true_matrix: ArrayLike, true_offset: ArrayLike) -> float:
    """Return J = J_h² + J_T²: Review (74), or (75) with matrix = I and offset = 0.

    The review prints the sum of the plain norms, but its Table 2 can only be reproduced with squares.
    """
    return offset_error(offset, true_offset) ** 2 + matrix_error(matrix, true_matrix) ** 2


@dataclass(frozen=True)
class RunScores:
    """Scores of one method over its runs: Review (77)–(79).

    Attributes:
        robustness: share of the successful runs, those with J < δ J_o.
        accuracy: 1/ρ, the inverse of the mean J of the successful runs; NaN without any.
        time: τ, s, mean run time of the successful runs; NaN without any.
    """

    robustness: float
    accuracy: float
    time: float


def scores(
    cost: Sequence[float], trivial_cost: Sequence[float], time: Sequence[float], *, delta: float = 1.0
) -> RunScores:
    """Return the scores of one method over its runs: Review (76)–(79).

    Args:
        cost: J (74) of each run; infinite if the method failed.
        trivial_cost: J_o (75) of each run.
        time: s, run time of each run.
        delta: δ in (0, 1], which the review does not state.
    """
    J, success = np.asarray(cost), np.asarray(cost) < delta * np.asarray(trivial_cost)
    if not success.any():
        return RunScores(0.0, float("nan"), float("nan"))
    return RunScores(float(success.mean()), float(1 / J[success].mean()), float(np.asarray(time)[success].mean()))


def real_data_cost(matrix: ArrayLike, offset: ArrayLike, samples: ArrayLike) -> float:
    """Return J_r, the mean of (‖T⁻¹(y − h)‖² − 1)² over the samples (n, 3); needs no truth: Review (81), (82)."""
    field = np.linalg.solve(np.asarray(matrix), (np.asarray(samples) - offset).T)
    return float(np.mean((np.sum(field**2, axis=0) - 1) ** 2))


def heading_error(field: ArrayLike, attitude: ArrayLike, declination: float | None = None) -> Array:
    """Return the heading error (n,) rad: the direction of the horizontal field in the world frame minus declination.

    Its root mean square is the measure of MAGYC, section V.

    Args:
        field: (n, 3) calibrated field in sensor axes, any unit.
        attitude: (n, 4) quaternion x, y, z, w, sensor→world, with a vertical z axis of the world; NaN where unknown.
        declination: rad from the world's x axis towards its y axis; None for the mean direction of the field.

    Returns:
        NaN where the attitude is unknown.
    """
    field, attitude = np.asarray(field), np.asarray(attitude)
    error = np.full(len(field), np.nan)
    known = np.isfinite(attitude).all(axis=1)
    world = _turned(attitude[known], field[known])
    direction = world[:, 0] + 1j * world[:, 1]
    direction /= np.maximum(np.abs(direction), np.finfo(float).tiny)
    reference = direction.mean() if declination is None else np.exp(1j * declination)
    error[known] = np.angle(direction * np.conj(reference))
    return error


def heading_deviation(field: ArrayLike, attitude: ArrayLike) -> float:
    """Return the standard deviation (deg) of `heading_error` about the mean direction, where the attitude is known."""
    return float(np.degrees(np.nanstd(heading_error(field, attitude))))


def _turned(quaternion: Array, vector: Array) -> Array:
    """Rotate vectors (n, 3) by quaternions (n, 4) x, y, z, w; importing scipy's Rotation would take longer."""
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    axis, scalar = unit[:, :3], unit[:, 3:]
    twice = 2 * np.cross(axis, vector)
    return np.asarray(vector + scalar * twice + np.cross(axis, twice))
