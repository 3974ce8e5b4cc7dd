"""How good a calibration is: the measures of the papers, each with its source.

Model of all of them: y = matrix · m + offset with ‖m‖ = 1, in the unit of the samples. `model` gives it for a
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
    """(matrix (3, 3), offset (3,)) in T: soft iron times field strength, and hard iron.

    Raises:
        MagycError: the calibration does not say its field strength.
    """
    if calibration.field_strength is None:
        raise MagycError(f"the calibration of method {calibration.method!r} states no field strength")
    return calibration.soft_iron * calibration.field_strength, calibration.hard_iron


def normalised_model_error(
    matrix: ArrayLike, offset: ArrayLike, true_matrix: ArrayLike, true_offset: ArrayLike
) -> float:
    """Autocal (39), and (40) with a reference for the truth: ‖[K b] − [K b]_true‖ / ‖[K b]_true‖, Frobenius.

    Both matrices must fix their rotation alike (symmetric both, or triangular both).
    """
    estimate = np.column_stack([matrix, offset])
    truth = np.column_stack([true_matrix, true_offset])
    return float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))


def sensor_estimation_error(matrix: ArrayLike, offset: ArrayLike, samples: ArrayLike) -> float:
    """Autocal, section on real data, 2): root mean square of ‖K x + b − m‖ with the directions of (41).

    In the unit of the samples (n, 3); meant for samples without outliers that the model was not fitted to.
    """
    directions = closest_points(np.asarray(matrix), np.asarray(offset), np.asarray(samples).T).direction.T
    residual = directions @ np.asarray(matrix).T + offset - np.asarray(samples)
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def offset_error(offset: ArrayLike, true_offset: ArrayLike) -> float:
    """Review (69): J_h = ‖h_true − h‖."""
    return float(np.linalg.norm(np.subtract(true_offset, offset)))


def matrix_error(matrix: ArrayLike, true_matrix: ArrayLike) -> float:
    """Review (71) to (73): J_T = min over R in O(3) of ‖T − T_true R‖, Frobenius; a Procrustes problem."""
    matrix, true_matrix = np.asarray(matrix), np.asarray(true_matrix)
    left, _, right = np.linalg.svd(true_matrix.T @ matrix)
    return float(np.linalg.norm(matrix - true_matrix @ left @ right))


def model_cost(
    matrix: ArrayLike, offset: ArrayLike, true_matrix: ArrayLike, true_offset: ArrayLike, *, squared: bool = True
) -> float:
    """Review (74): J = J_h + J_T, and (75) with matrix = I and offset = 0.

    squared: add the squares, the only reading under which the review's Table 2 can be reached; it prints the
    plain norms.
    """
    power = 2 if squared else 1
    return offset_error(offset, true_offset) ** power + matrix_error(matrix, true_matrix) ** power


@dataclass(frozen=True)
class RunScores:
    """Review (77) to (79) over the runs of one method.

    robustness: share of the runs with J < δ J_o; accuracy: 1/ρ, one over the mean J of those runs; time: τ,
    their mean run time in s. The latter two are NaN where no run succeeded.
    """

    robustness: float
    accuracy: float
    time: float


def scores(
    cost: Sequence[float], trivial_cost: Sequence[float], time: Sequence[float], *, delta: float = 1.0
) -> RunScores:
    """Review (76) to (79).

    Args:
        cost: J (74) of each run; infinite where the method gave nothing.
        trivial_cost: J_o (75) of each run.
        time: s, run time of each run.
        delta: δ in (0, 1], which the review does not state.
    """
    J, success = np.asarray(cost), np.asarray(cost) < delta * np.asarray(trivial_cost)
    if not success.any():
        return RunScores(0.0, float("nan"), float("nan"))
    return RunScores(float(success.mean()), float(1 / J[success].mean()), float(np.asarray(time)[success].mean()))


def real_data_cost(matrix: ArrayLike, offset: ArrayLike, samples: ArrayLike) -> float:
    """Review (81), (82): J_r = mean of (‖T⁻¹(y − h)‖² − 1)² over the samples (n, 3); needs no truth."""
    field = np.linalg.solve(np.asarray(matrix), (np.asarray(samples) - offset).T)
    return float(np.mean((np.sum(field**2, axis=0) - 1) ** 2))


def heading_error(field: ArrayLike, attitude: ArrayLike, declination: float | None = None) -> Array:
    """(n,) rad: direction of the horizontal field in the world frame, 0 for a perfect compass.

    MAGYC, section V, takes its root mean square.

    Args:
        field: (n, 3) calibrated field in sensor axes, any unit.
        attitude: (n, 4) quaternion x, y, z, w, sensor→world, the world's z axis vertical; NaN where unknown.
        declination: rad from the world's x axis towards its y axis; None counts from the mean direction.
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
    """deg, standard deviation of `heading_error` about the mean direction, where the attitude is known."""
    return float(np.degrees(np.nanstd(heading_error(field, attitude))))


def soft_iron_distance(one: ArrayLike, other: ArrayLike, *, scale: bool = False) -> float:
    """Geodesic distance of two soft irons (3, 3): the affine-invariant metric on symmetric positive matrices.

    √Σ log² λ_i with the eigenvalues λ_i of one⁻¹ other (Förstner and Moonen 1999; Pennec et al. 2006): 0.01 is a
    relative difference of 1 % along one axis, in whatever axes and units the two are written.

    Args:
        one, other: symmetric positive definite.
        scale: count a common factor too. By default both are taken at determinant 1, as the field's strength
            is a convention.

    Raises:
        MagycError: one of them is not symmetric positive definite.
    """
    matrices = [np.asarray(each, dtype=np.float64) for each in (one, other)]
    for each in matrices:
        if (
            not np.allclose(each, each.T, rtol=0, atol=1e-9 * np.abs(each).max())
            or np.linalg.eigvalsh(each)[0] <= 0
        ):
            raise MagycError(f"soft iron {each.tolist()} is not symmetric positive definite")
    from scipy.linalg import eigh

    logarithm = np.log(eigh(matrices[1], matrices[0], eigvals_only=True))
    if not scale:
        logarithm = logarithm - logarithm.mean()
    return float(np.linalg.norm(logarithm))


def _turned(quaternion: Array, vector: Array) -> Array:
    """(n, 3) vectors turned by (n, 4) quaternions x, y, z, w; scipy's Rotation takes longer to import than to run."""
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    axis, scalar = unit[:, :3], unit[:, 3:]
    twice = 2 * np.cross(axis, vector)
    return np.asarray(vector + scalar * twice + np.cross(axis, twice))
