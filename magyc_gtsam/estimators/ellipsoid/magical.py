"""`magical`: Papafotis and Sotiriadis, "MAG.I.C.AL. – a unified methodology for magnetic and inertial sensors
calibration and alignment", 2019.

Equation numbers are those of section 9 of the review (Papafotis, Nikitas, Sotiriadis, Sensors 2021, 21, 5288).
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


def magical(y: Array, *, tolerance: float = 1e-9, max_iterations: int = 5000) -> Ellipsoid:
    """Fit the ellipsoid to samples (n, 3) without units.

    It ends when T and h change by at most `tolerance` in an iteration. The paper stops at a small cost (65), but with
    noise the cost stays above any threshold that indicates convergence.
    """
    check_positive(tolerance=tolerance, max_iterations=max_iterations)
    Y = y.T
    m = _unit(Y)  # (59)
    L = np.eye(3, 4)
    change, iterations = np.inf, 0
    while change > tolerance and iterations < max_iterations:
        G = np.vstack([m, np.ones(m.shape[1])])  # (61c)
        previous, L = L, np.linalg.solve(G @ G.T, G @ Y.T).T  # (62)
        T, h = L[:, :3], L[:, 3]  # (61b)
        field = cast(Array, np.linalg.solve(T, Y - h[:, None]))  # (64)
        m = _unit(field)  # (63)
        change = float(np.linalg.norm(L - previous))
        iterations += 1
    cost = float(np.sum((np.sum(field**2, axis=0) - 1) ** 2))  # (65)
    converged = change <= tolerance
    return Ellipsoid(
        T,
        h,
        converged,
        ended(converged, iterations),
        diagnostics={"iterations": iterations, "cost": cost},
    )


calibrate_magical = entry_point("magical", magical)


def _unit(columns: Array) -> Array:
    unit: Array = columns / np.linalg.norm(columns, axis=0)
    return unit
