"""`dorveaux`: Dorveaux, Vissière, Martin and Petit, "Iterative calibration method for inertial and magnetic
sensors", 2009.

Equation numbers are those of section 5 of the review (Papafotis, Nikitas, Sotiriadis, Sensors 2021, 21, 5288).
"""

from __future__ import annotations

from typing import cast

import numpy as np

from magyc_gtsam.estimators.ellipsoid.entry_point import entry_point
from magyc_gtsam.estimators.ellipsoid.magnetometer_only import (
    Ellipsoid,
    check_positive,
    ended,
)
from magyc_gtsam.recording import Array


def dorveaux(y: Array, *, tolerance: float = 1e-9, max_iterations: int = 2000) -> Ellipsoid:
    """Fit the ellipsoid to samples (n, 3) without units.

    Iterated linear least squares map the samples onto the unit sphere, until J_stop (29), the size of the last step, is
    at most `tolerance`.
    """
    check_positive(tolerance=tolerance, max_iterations=max_iterations)
    m = y  # (24)
    A_total, B_total = np.eye(3), np.zeros(3)
    j_stop, iterations = np.inf, 0
    while j_stop > tolerance and iterations < max_iterations:
        design = np.hstack([m, np.ones((len(m), 1))])
        sphere = m / np.linalg.norm(m, axis=1, keepdims=True)
        # (25), least squares, for the difference to the identity, which keeps its relative precision as it shrinks
        step = np.linalg.solve(design.T @ design, design.T @ (sphere - m)).T
        A, B = np.eye(3) + step[:, :3], step[:, 3]
        m = m + design @ step.T  # (26)
        A_total, B_total = A @ A_total, A @ B_total + B  # (28)
        j_stop = float(np.linalg.norm(B) + np.linalg.norm(step[:, :3]))  # (29)
        iterations += 1
    converged = j_stop <= tolerance
    T = cast(Array, np.linalg.inv(A_total))  # (31)
    return Ellipsoid(
        T,
        -T @ B_total,
        converged,
        ended(converged, iterations),
        diagnostics={"iterations": iterations, "last_step": j_stop},
    )


calibrate_dorveaux = entry_point("dorveaux", dorveaux)
