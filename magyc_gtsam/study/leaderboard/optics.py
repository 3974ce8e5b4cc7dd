"""Calibration of a recording by its optical attitude, as a reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, Slerp

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording


@dataclass(frozen=True)
class OpticsLimits:
    """Constants of the fit.

    Attributes:
        turning: rad/s, smallest rate of the rows used: BROAD rests in one attitude for a quarter to a half of a trial,
            and turns at 0.3 to 16 rad/s in between.
        interval: s, over which the rate is measured; the cameras' noise of 0.5° is 0.02 rad/s over it.
        rows: largest number of rows used of a recording, evenly spaced; 6,000 keep the third digit of the hard iron.
        fewest: fewest samples for a fit.
        latest: s, largest delay of the magnetometer relative to the cameras, in both directions; phones have at most
            0.06.
        hole: s, longest gap of the reference that is interpolated.
        block: s, distance within which residuals count as one draw, because the room's field varies along the path.
    """

    turning: float = 0.1
    interval: float = 0.5
    rows: int = 6000
    fewest: int = 100
    latest: float = 0.1
    hole: float = 0.1
    block: float = 5.0


LIMITS = OpticsLimits()
_PASSES = 4  # Gauss–Newton steps; the initial error is a hundredth of a radian


@dataclass(frozen=True, eq=False)
class Reference:
    """The calibration of a recording by its optical attitude.

    Attributes:
        calibration: affine fit with a constant field in the world.
        covariance: (3, 3) T², of its hard iron, by a sandwich estimator over blocks.
        delay: delay of the magnetometer relative to the cameras, s.
        time: (n,) s, evenly spaced magnetometer samples while the sensor turns.
        rotation: (n, 3, 3) sensor to world at these samples, earlier by the delay.
    """

    calibration: Calibration
    covariance: Array
    delay: float
    time: Array
    rotation: Array


def reference_of(recording: Recording) -> Reference:
    """Fit matrix, hard iron and delay to the optical attitude.

    With z = R (C m − c) and f its mean, the share of z that is not constant is 1 − ‖f‖² / mean ‖z‖². Its minimum over
    (C, c) is linear: with G = R [mᵀ ⊗ I, −I] it is one minus the largest eigenvalue of E[G] E[GᵀG]⁻¹ E[G]ᵀ, (3, 3).
    The delay minimises this share; then m = A Rᵀ f + h is fitted by least squares.

    Raises:
        MagycError: no reference attitude, or one that hardly turns.
    """
    reference, time, field = _turning(recording)

    def turned(delay: float) -> Array:
        matrices: Array = reference(time - delay).as_matrix()
        return matrices

    def lost(delay: float) -> float:
        return 1.0 - _direction(turned(delay), field)[0]

    steps = np.linspace(-LIMITS.latest, LIMITS.latest, 21)
    best = float(steps[np.argmin([lost(delay) for delay in steps])])
    width = float(steps[1] - steps[0])
    delay = float(minimize_scalar(lost, bounds=(best - width, best + width), method="bounded").x)
    rotation = turned(delay)
    direction = _direction(rotation, field)[1]
    matrix, iron, covariance = _forward(rotation, direction, field, (time - time[0]) // LIMITS.block)
    strength = float(np.cbrt(abs(np.linalg.det(matrix))))
    calibration = Calibration(matrix / strength, iron, field_strength=strength, method="optics")
    return Reference(calibration, covariance, delay, time, rotation)


def _forward(rotation: Array, direction: Array, field: Array, block: Array) -> tuple[Array, Array, Array]:
    """Fit m = A Rᵀ f + h by least squares over A, h and the direction f from an initial f; return also cov(h)."""
    count = len(field)
    for _ in range(_PASSES):
        body = np.einsum("nji,j->ni", rotation, direction)
        design = np.concatenate([body, np.ones((count, 1))], axis=1)
        linear = np.linalg.lstsq(design, field, rcond=None)[0]
        sideways = np.linalg.svd(direction[None])[2][1:]
        moved = np.einsum("nji,bj->nbi", rotation, sideways) @ linear[:3]  # (n, 2, 3)
        jacobian = np.zeros((count, 3, 14))
        for axis in range(3):
            jacobian[:, axis, 4 * axis : 4 * axis + 4] = design
        jacobian[:, :, 12:] = moved.transpose(0, 2, 1)
        residual = field - design @ linear
        inverse = np.linalg.inv(np.einsum("nik,nil->kl", jacobian, jacobian))
        step = inverse @ np.einsum("nik,ni->k", jacobian, residual)
        direction = direction + step[12:] @ sideways
        direction /= np.linalg.norm(direction)
    summed = np.zeros((int(block.max()) + 1, 14))
    np.add.at(summed, block.astype(int), np.einsum("nik,ni->nk", jacobian, residual))
    influence = summed @ inverse[:, [3, 7, 11]]
    return linear[:3].T, linear[3], influence.T @ influence


def _turning(recording: Recording) -> tuple[Slerp, Array, Array]:
    """Return the reference, and time and field of the magnetometer's samples while it turns.

    The reference is interpolated, not the field: an interpolated field has less noise between samples than at them,
    which would bias a delay towards the former.
    """
    attitude = recording.attitude
    if attitude is None:
        raise MagycError(f"recording {recording.name!r} has no reference attitude")
    known = np.isfinite(attitude).all(axis=1)
    if known.sum() < 2:
        raise MagycError(f"recording {recording.name!r} has no reference attitude")
    seen, quaternion = recording.time[known], attitude[known]
    later = np.minimum(np.searchsorted(seen, seen + LIMITS.interval), len(seen) - 1)
    cosine = np.abs(np.einsum("ni,ni->n", quaternion, quaternion[later]))
    angle = 2 * np.arccos(np.clip(cosine, 0.0, 1.0))
    turns = angle > LIMITS.turning * np.maximum(seen[later] - seen, 1e-3)
    time, field = recording.magnetometer
    margin = LIMITS.latest + 0.1 * LIMITS.latest
    first, last = (np.searchsorted(seen, time + side * margin) for side in (-1, 1))
    within = (first > 0) & (last < len(seen))
    first, last = first - 1, np.minimum(last, len(seen) - 1)
    whole = seen[last] - seen[first] < 2 * margin + 2 * LIMITS.hole
    rows = np.flatnonzero(within & whole & turns[first])
    if len(rows) < LIMITS.fewest:
        raise MagycError(f"recording {recording.name!r} hardly turns by its reference attitude")
    rows = rows[:: -(-len(rows) // LIMITS.rows)]
    return Slerp(seen, Rotation.from_quat(quaternion)), time[rows], field[rows]


def _direction(rotation: Array, field: Array) -> tuple[float, Array]:
    """Return the largest share of the calibrated field that is constant in the world, and its direction."""
    scaled = field / np.sqrt(np.mean(field**2))
    lever = np.concatenate([scaled, -np.ones((len(field), 1))], axis=1)  # (n, 4): G = lever ⊗ R
    mean = np.einsum("na,nij->iaj", lever, rotation).reshape(3, 12) / len(field)
    square = np.kron(lever.T @ lever / len(field), np.eye(3))  # GᵀG = lever leverᵀ ⊗ RᵀR
    value, vector = np.linalg.eigh(mean @ np.linalg.solve(square, mean.T))
    return float(value[-1]), vector[:, -1]
