"""`ali-pso`: Ali, Siddharth, Syed and El-Sheimy, "Swarm optimization-based magnetometer calibration for personal
handheld devices", 2012.

Equation numbers are those of section 7 of the review (Papafotis, Nikitas, Sotiriadis, Sensors 2021, 21, 5288).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from magyc_gtsam.estimators.ellipsoid.entry_point import entry_point
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import (
    Ellipsoid,
    check_positive,
)
from magyc_gtsam.factors.chain.vech import MULTIPLICITY, UPPER, vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import numbers
from magyc_gtsam.recording import Array

_WIDTH = (0.3, 0.15)  # standard deviations of the initial swarm about h = 0 and T = I
_BOUND = 5.0  # bound of an element, because (45) is zero for an infinite ellipsoid (a plane)
_REPORTS = 50  # calls of progress


def ali_pso(
    y: Array,
    *,
    seed: int = 0,
    particles: int = 40,
    inertia: float = 0.7298,
    acceleration: tuple[float, float] = (1.496, 1.496),
    tolerance: float = 1e-8,
    max_iterations: int = 2000,
    progress: Callable[[float], None] | None = None,
) -> Ellipsoid:
    """Fit the ellipsoid to samples (n, 3) without units; all particles are updated simultaneously.

    Args:
        y: samples (n, 3).
        seed: of the random numbers; the same seed gives the same result.
        particles: S of (47), 20 to 65 in the paper.
        inertia: w of (47), by Clerc and Kennedy (2002). With the review's w = 1, c1 = c2 = 2 the swarm's extent
            diverges (measured: 1e82 after 2000 iterations).
        acceleration: c1, c2 of (47), by Clerc and Kennedy.
        tolerance: extent of the swarm below which it has converged.
        max_iterations: largest number of iterations.
        progress: called with the share done.
    """
    check_positive(particles=particles, tolerance=tolerance, max_iterations=max_iterations, inertia=inertia)
    for name, value in (("particles", particles), ("seed", seed)):
        if not isinstance(value, int | np.integer) or value < 0:
            raise MagycError(f"{name}: must be a whole number of at least 0, got {value!r}")
    if numbers("acceleration", acceleration).shape != (2,):
        raise MagycError(f"acceleration: must be two numbers, c1 and c2, got {acceleration!r}")
    random = np.random.default_rng(seed)
    root = _moments(y)
    spread = np.repeat(_WIDTH, [3, 9])
    x = np.concatenate([np.zeros(3), np.eye(3).ravel()]) + spread * random.standard_normal((particles, 12))
    v = np.zeros_like(x)
    fitness = _fitness(x, root)
    p, p_fitness = x.copy(), fitness.copy()
    extent, iterations = np.inf, 0
    while extent > tolerance and iterations < max_iterations:
        p_g = p[np.argmin(p_fitness)]
        r1, r2 = random.random((2, *x.shape))
        v = inertia * v + acceleration[0] * r1 * (p - x) + acceleration[1] * r2 * (p_g - x)  # (47a)
        x = x + v  # (47b)
        fitness = _fitness(x, root)
        better = (fitness < p_fitness) & (np.abs(x) < _BOUND).all(axis=1)
        p[better], p_fitness[better] = x[better], fitness[better]
        extent = float(np.abs(x - p_g).max())
        iterations += 1
        if progress and iterations % (max_iterations // _REPORTS + 1) == 0:
            progress(iterations / max_iterations)
    best = p[np.argmin(p_fitness)]
    converged = extent <= tolerance
    return Ellipsoid(
        best[3:].reshape(3, 3),  # (48); the transpose of (46) makes it row by row
        best[:3],
        converged,
        f"gathered in {iterations} iterations"
        if converged
        else f"the swarm is still {extent:.2g} wide after {iterations} iterations",
        diagnostics={"iterations": iterations, "fitness": float(p_fitness.min())},
    )


calibrate_ali_pso = entry_point("ali-pso", ali_pso)


def _moments(y: Array) -> Array:
    """Return the triangular root (10, 10) of the samples' fourth moments, which determine (45).

    ‖T⁻¹(y − h)‖² − 1 is linear in the elements of y yᵀ, y and 1.
    """
    monomials = np.hstack([y[:, UPPER[0]] * y[:, UPPER[1]], y, np.ones((len(y), 1))])
    return np.asarray(np.linalg.qr(monomials, mode="r"))


def _fitness(x: Array, root: Array) -> Array:
    """Return (45) of particles x (S, 12) as (S,), with ‖T⁻¹(y − h)‖ in place of the review's ‖y‖."""
    h, T = x[:, :3], x[:, 3:].reshape(-1, 3, 3)
    inverse = np.linalg.inv(T)
    Q = np.swapaxes(inverse, 1, 2) @ inverse
    Qh = np.einsum("sij,sj->si", Q, h)
    quadric = np.hstack([vech(Q) * MULTIPLICITY, -2 * Qh, (np.einsum("si,si->s", h, Qh) - 1)[:, None]])
    fitness: Array = np.linalg.norm(quadric @ root.T, axis=1)
    return fitness
