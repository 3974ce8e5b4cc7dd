"""The two stages of `autocal` on plain samples, equation numbers of the paper (Hong, Kang and Kim 2020).

    m_j = K x̂_j + b + ε_j,  ‖x̂_j‖ = 1                                                                         (1)
    minimise Σ ρ(‖K x̂_j + b − m_j‖²) over K (upper triangular), b and all x̂_j                                  (8)

The minimisation starts from the L1 ellipsoid (and from an L1 sphere if that fails), with the kernels ρ of (9) to (12)
in `factors.kernels`. The directions are eliminated: given K and b the best x̂_j is the closest point of the ellipsoid,
and the Schur complement (33) with its 2×2 blocks reduces each sample to the residual along the ellipsoid's normal n_j,

    n_jᵀ r_j = −distance_j,   n_jᵀ ∂r_j/∂(k, b)   (1×9)

because the Jacobian of r_j with respect to x̂_j spans the tangent plane there. A step costs some forty passes over the
data and one 9×9 solve, linear in the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from magyc_gtsam.closest_point import ClosestPoints, closest_points
from magyc_gtsam.estimators.ellipsoid.ellipsoid import Standardised, standardise
from magyc_gtsam.estimators.ellipsoid.l1_ellipsoid import l1_sphere, l1_start
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import UNKNOWNS
from magyc_gtsam.factors.chain.vech import UPPER
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.kernels import KERNELS, Kernel, kernel
from magyc_gtsam.recording import Array

WIDTH = float(np.sqrt(3))  # τ in units of the noise per axis: "up to 1 unit error per sensor axis" (section III-A)
ITERATIONS = 300  # as in section III-A
_MAD = 1.4826  # ratio of σ to the median absolute deviation of a normal distribution
_TRIMMED = 0.95456  # standard deviation of a unit normal distribution within ±2.5
_TRIMS = 3
_FIRST_DAMPING, _LARGEST_DAMPING = 0.1, 1e6
_SETTLED = 1e-6  # predicted gain in cost: a step of a thousandth of the parameters' standard deviations
_ENDLESS = 20.0  # ratio of radius to spread of the samples above which they do not determine the ellipsoid's size
_NOISE_UNCHANGED = 1e-2  # predicted gain of a step that is too small to change the estimated noise
_LEAST_NOISE = 1e-9  # share of the samples' spread, so that noise-free samples are solvable
_SCALE_SETTLED = 0.02  # relative change of the estimated noise
_SCALES = 10  # most updates of the estimated noise
_LONGEST = 4.0  # ratio of longest to shortest axis above which a second start is tried


@dataclass(frozen=True, eq=False)
class AutocalFit:
    """A minimum of (8), in the unit of the samples.

    Attributes:
        matrix: (3, 3) K, upper triangular with a positive diagonal.
        offset: (3,) b.
        distance: (n,) of the samples from the ellipsoid, positive outside; normal: (3, n) unit normals along it.
        direction: (3, n) x̂.
        sigma: noise per axis, given or estimated; `width` (τ) is √3 times that unless given.
        width: τ.
        cost: Σ ρ of e_j = distance_j/σ, in the convention of `factors.kernels`.
        iterations: number over all noise scales.
        converged: whether the stopping rule was met.
        message: why it stopped.
    """

    matrix: Array
    offset: Array
    distance: Array
    normal: Array
    direction: Array
    sigma: float
    width: float
    cost: float
    iterations: int
    converged: bool
    message: str


class _Step(NamedTuple):
    parameters: Array  # k 6, b 3
    points: ClosestPoints
    predicted: float  # gain predicted by the quadratic model, in units of the cost
    damping: float


def autocal(
    samples: Array, kernel_name: str = "cauchy", *, sigma: float | None = None, width: float | None = None
) -> AutocalFit:
    """Run both stages on samples (n, 3) of any unit.

    Args:
        samples: of the sensor, more than nine.
        kernel_name: "cauchy", "huber", "l1" or "geman-mcclure".
        sigma: noise per axis; None estimates it from the median distance.
        width: τ of (10) to (12), in the unit of the samples; None takes √3 σ.

    Raises:
        MagycError: unknown kernel, or samples that do not lie on an ellipsoid.
    """
    kernel(kernel_name)
    data = standardise(samples)
    start = l1_start(data)
    fit = None if start is None else _refine(data, *start, kernel_name, sigma, width)
    if fit is None or not fit.converged or np.linalg.cond(fit.matrix) > _LONGEST:
        # With half of the samples outliers on one side, the L1 ellipsoid is hundreds of radii long.
        sphere = l1_sphere(data)
        if sphere is not None:
            other = _refine(data, *sphere, kernel_name, sigma, width)
            fit = other if fit is None or _rank(other) < _rank(fit) else fit
    if fit is None:
        raise MagycError(
            "the samples do not lie on an ellipsoid: turn the sensor about more axes, or leave disturbed stretches out"
        )
    return fit


def _rank(fit: AutocalFit) -> tuple[bool, float]:
    return not fit.converged, float(np.median(np.abs(fit.distance)))


def _refine(
    data: Standardised, matrix: Array, offset: Array, kernel_name: str, sigma: float | None, width: float | None
) -> AutocalFit:
    """Run the second stage, section II-D and Algorithm 2, from K (upper triangular) and b.

    If σ is not given, it (and with it τ) is re-estimated from the distances until it converges.
    """
    parameters = np.concatenate([matrix[UPPER], offset - data.centre])
    parameters /= data.unit
    given = None if sigma is None else sigma / data.unit
    points = _closest(parameters, data.value)
    noise = max(noise_of(points.distance), _LEAST_NOISE) if given is None else given
    damping, scales, failure = _FIRST_DAMPING, 0, "no convergence"
    for iteration in range(1, ITERATIONS + 1):  # noqa: B007
        tuning = relative_width(kernel_name, None if width is None else width / data.unit / noise)
        step = _step(data.value, parameters, points, KERNELS[kernel_name], noise, tuning, damping)
        if step is None:
            failure = "no step lowers the cost"
            break
        parameters, points, predicted, damping = step
        if np.abs(parameters[:6]).max() > _ENDLESS:
            failure = f"the ellipsoid grew to over {_ENDLESS:.0f} times the spread of the samples"
            break
        follows = given is None and scales < _SCALES and predicted > _NOISE_UNCHANGED
        scale = max(noise_of(points.distance), _LEAST_NOISE) if follows else noise
        if abs(scale / noise - 1) > _SCALE_SETTLED:
            noise = scale
            scales += 1
        elif predicted < _SETTLED:
            failure = ""
            break
    return fitted(data, parameters, points, kernel_name, noise, tuning, iteration, failure)


def relative_width(kernel_name: str, width: float | None) -> float:
    """Return τ/σ; that of l1 is the rounding of its tip, as the kernel has no other width."""
    if kernel_name == "l1":
        return KERNELS["l1"].tuning[1]
    return WIDTH if width is None else width


def noise_of(distance: Array) -> float:
    """Return σ of the samples from distances: a trimmed estimate within 2.5 σ, started from the median."""
    square = distance * distance
    middle = len(square) // 2
    sigma = _MAD * float(np.sqrt(np.partition(square, middle)[middle]))
    for _ in range(_TRIMS):
        within = square < (2.5 * sigma) ** 2
        sigma = float(np.sqrt(square @ within / max(int(within.sum()), 1))) / _TRIMMED
    return sigma


def _closest(parameters: Array, value: Array, start: Array | None = None) -> ClosestPoints:
    return closest_points(triangle(parameters), parameters[6:], value, start)


def triangle(parameters: Array) -> Array:
    """Return K (3, 3) of (9,) parameters."""
    matrix = np.zeros((3, 3))
    matrix[UPPER] = parameters[:6]
    return matrix


def _jacobian(points: ClosestPoints) -> Array:
    """Return n_jᵀ ∂r_j/∂(k, b) (9, n) by (18) and (19), with k the upper triangle of K row by row."""
    normal, direction = points.normal, points.direction
    result = np.empty((UNKNOWNS, normal.shape[1]))
    np.multiply(normal[0], direction, out=result[:3])
    np.multiply(normal[1], direction[1:], out=result[3:5])
    np.multiply(normal[2], direction[2], out=result[5])
    result[6:] = normal
    return result


def _step(
    value: Array,
    parameters: Array,
    points: ClosestPoints,
    rho: Kernel,
    sigma: float,
    tuning: float,
    damping: float,
) -> _Step | None:
    """Return a step that lowers (8), with σ and τ/σ fixed; None if there is none.

    It solves (Σ c_j a_j a_jᵀ) Δ = Σ w_j distance_j a_j, a_j the columns of `_jacobian`. With c = ρ'' this is the
    paper's (21), close to a Newton step; with c = w = ρ'/e it is iteratively reweighted least squares, slower and more
    robust. c = ρ'' + λ (w − ρ'') interpolates between the two, in place of the paper's λ I.
    """
    jacobian = _jacobian(points)
    e = np.abs(points.distance) / sigma
    cost = float(rho.loss(e, tuning).sum())
    weight, curvature = rho.weight(e, tuning), rho.curvature(e, tuning)
    gradient = jacobian @ (weight * points.distance)
    while damping < _LARGEST_DAMPING:
        information = (jacobian * (curvature + damping * (weight - curvature))) @ jacobian.T
        _, step, not_positive = dposv(information, gradient)
        if not not_positive:
            predicted = float(step @ gradient) / sigma**2
            trial = _closest(parameters + step, value, points.multiplier)
            lowered = cost - float(rho.loss(np.abs(trial.distance) / sigma, tuning).sum())
            if lowered > 0 or predicted < _SETTLED:
                return _Step(parameters + step, trial, predicted, 0.1 * damping)
        damping = max(10 * damping, 1.0)
    return None


def fitted(
    data: Standardised,
    parameters: Array,
    points: ClosestPoints,
    kernel_name: str,
    sigma: float,
    tuning: float,
    iterations: int,
    failure: str,
) -> AutocalFit:
    """Convert `parameters` (k 6, b 3) of the standardised samples to a fit in the unit of the samples.

    `failure` is why the method failed, "" if it converged.
    """
    unit, matrix = data.unit, triangle(parameters)
    signs = np.sign(np.diag(matrix))  # applied to the columns of K and to x̂
    e = np.abs(points.distance) / sigma
    return AutocalFit(
        matrix=unit * matrix * signs,
        offset=data.centre + unit * parameters[6:],
        distance=unit * points.distance,
        normal=points.normal,
        direction=signs[:, None] * points.direction,
        sigma=unit * sigma,
        width=unit * sigma * (WIDTH if kernel_name == "l1" else tuning),
        cost=float(KERNELS[kernel_name].loss(e, tuning).sum()),
        iterations=iterations,
        converged=not failure,
        message=f"{failure or 'converged'} in {iterations} iterations",
    )
