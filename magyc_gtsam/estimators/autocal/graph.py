"""Stage two of `autocal` as a GTSAM graph: one sphere factor with robust noise, and one `Unit3`, per sample.

It has the same minimum as the array code of `autocal`, and serves for checks and as an example. Python factors receive
a copy of all values at every call, so the time grows with the square of the number of samples: a second for some
hundred of them.
"""

from __future__ import annotations

import gtsam
import numpy as np

from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.autocal import fit as autocal_fit
from magyc_gtsam.estimators.ellipsoid.ellipsoid import standardise
from magyc_gtsam.factors.chain.vech import UPPER
from magyc_gtsam.factors.robust import robust_noise
from magyc_gtsam.factors.sphere import sphere_factor
from magyc_gtsam.recording import Array
from magyc_gtsam.runners.batch import optimize
from magyc_gtsam.runners.status import Status

_K, _B = gtsam.symbol("k", 0), gtsam.symbol("b", 0)
_TOLERANCE = 1e-13
_ROUNDS = 20


def autocal_graph(
    value: Array, matrix: Array, offset: Array, kernel: str, sigma: float, tuning: float
) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the graph of (8), and initial values.

    Args:
        value: (3, n), samples.
        matrix, offset: K (3, 3) upper triangular and b (3,) of the start.
        kernel: its name in `factors.KERNELS`.
        sigma: noise per axis, in the unit of the samples.
        tuning: τ/σ.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(_K, matrix[UPPER])
    values.insert(_B, offset)
    noise = robust_noise(kernel, sigma, 3, tuning)
    directions = closest_points(matrix, offset, value).direction
    for j, (m, x) in enumerate(zip(value.T, directions.T, strict=True)):
        key = gtsam.symbol("x", j)
        graph.add(sphere_factor(key, _K, _B, m, noise, shape="triangular"))
        values.insert(key, gtsam.Unit3(x))
    return graph, values


def refine_graph(
    samples: Array, matrix: Array, offset: Array, kernel: str, *, sigma: float, width: float
) -> autocal_fit.AutocalFit:
    """Run the second stage of `autocal_fit.autocal` with GTSAM's Levenberg–Marquardt.

    It stalls if the directions of outliers, far from the surface, are badly approximated. All directions are then set
    to their closest points, and the optimisation continues.

    Args:
        samples: (n, 3), any unit.
        matrix, offset, sigma, width: K, b, noise per axis and τ in that unit; σ is not estimated here.
    """
    data = standardise(samples)
    noise = sigma / data.unit
    tuning = autocal_fit.relative_width(kernel, width / sigma)
    parameters = np.concatenate([matrix[UPPER] / data.unit, (offset - data.centre) / data.unit])
    iterations = 0
    for _ in range(_ROUNDS):
        graph, values = autocal_graph(
            data.value, autocal_fit.triangle(parameters), parameters[6:], kernel, noise, tuning
        )
        result = optimize(
            graph,
            values,
            relative_tolerance=_TOLERANCE,
            absolute_tolerance=_TOLERANCE,
            max_iterations=autocal_fit.ITERATIONS,
        )
        parameters = np.concatenate([result.values.atVector(_K), result.values.atPoint3(_B)])
        iterations += result.iterations
        if result.status is not Status.STALLED:
            break
    failure = "" if result.converged else f"GTSAM {result.status}"
    points = closest_points(autocal_fit.triangle(parameters), parameters[6:], data.value)
    return autocal_fit.fitted(data, parameters, points, kernel, noise, tuning, iterations, failure)
