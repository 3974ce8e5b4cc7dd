"""`kok-schon`: the L2 ellipsoid fit that is constrained to ellipsoids (Kok and Schön 2016, section V).

    minimise Σ g_j(C, d, e)²   subject to   trace C = 1,  C ⪰ 0

with g_j of (5) of the Autocal paper. All samples enter through the 10×10 matrix of their monomials'
products, so the semidefinite program has ten unknowns for any number of samples.
"""

from __future__ import annotations

import clarabel
import numpy as np
from scipy import sparse

from magyc_gtsam.estimators.ellipsoid.ellipsoid import algebraic, monomials, quadric, sensor_model, standardise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array

UNKNOWNS = 10  # C11, C22, C33, C12, C13, C23, d, e
_PACKED = [0, 3, 1, 4, 5, 2]  # indices of C's upper triangle column by column, the order of Clarabel


def trace_and_cone() -> tuple[sparse.csc_matrix, Array, list[object]]:
    """Return trace C = 1 and C ⪰ 0 on the ten unknowns, in Clarabel's form A x + s = b, s in the cones."""
    matrix = np.zeros((7, UNKNOWNS))
    matrix[0, :3] = 1.0
    matrix[1 + np.arange(6), _PACKED] = -np.where(np.array(_PACKED) < 3, 1.0, np.sqrt(2))
    bound = np.zeros(7)
    bound[0] = 1.0
    return sparse.csc_matrix(matrix), bound, [clarabel.ZeroConeT(1), clarabel.PSDTriangleConeT(3)]


def solve(
    quadratic: sparse.csc_matrix, linear: Array, matrix: sparse.csc_matrix, bound: Array, cones: list[object]
) -> Array:
    """Return the x that minimises ½ xᵀ P x + qᵀ x subject to A x + s = b, s in the cones.

    Raises:
        MagycError: the solver did not reach the minimum.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(quadratic, linear, matrix, bound, cones, settings).solve()
    if solution.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        raise MagycError(
            f"the semidefinite program was not solved ({solution.status}): turn the sensor about more axes, "
            "or choose another method"
        )
    return np.array(solution.x)


def fit_kok_schon(samples: Array) -> tuple[Array, Array] | None:
    """Return K and b of the fit to samples (n, 3) of any unit; None if the best ellipsoid is flat or infinite."""
    data = standardise(samples)
    phi = monomials(data.value)
    gram = sparse.csc_matrix(np.triu(phi @ phi.T) / len(samples))
    return sensor_model(quadric(solve(gram, np.zeros(UNKNOWNS), *trace_and_cone())), data)


calibrate_kok_schon = algebraic("kok-schon", fit_kok_schon)
