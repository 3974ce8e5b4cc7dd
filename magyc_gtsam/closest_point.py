"""The point of an ellipsoid closest to each sample: the exact minimiser x̂ of (7) of the Autocal paper."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.recording import Array

_LARGEST_STEPS = 50
_CONVERGED = 1e-6  # |N − 1| at which the search stops: the following step squares it


class ClosestPoints(NamedTuple):
    """The closest points of an ellipsoid to n samples.

    Attributes:
        distance: (n,) of the sample from the ellipsoid, positive outside.
        normal: (3, n) outward unit normal at the closest point K x̂ + h.
        direction: (3, n) unit vector x̂.
        multiplier: (n,) root t of the search, a start for the next call.
    """

    distance: Array
    normal: Array
    direction: Array
    multiplier: Array


def closest_points(matrix: Array, offset: Array, samples: Array, start: Array | None = None) -> ClosestPoints:
    """Minimise ‖K x̂ + h − m‖ over ‖x̂‖ = 1 for every sample m.

    In the principal axes of the ellipsoid (K = U diag(a) Vᵀ, z = Uᵀ(m − h)) the closest point is a² z/(a² + t), where
    t solves N(t) = ‖a z/(a² + t)‖ = 1. As 1/N is concave and nearly linear in t, Newton steps on it converge from any
    start, in two or three steps from a good one (Moré and Sorensen 1983).

    Args:
        matrix: (3, 3) K, including any rotation of x̂.
        offset: (3,) h.
        samples: (3, n) m, in the unit of K and h.
        start: (n,) `multiplier` of an earlier call with nearly the same ellipsoid; None for 0.
    """
    u, a, v = np.linalg.svd(matrix)
    z = u.T @ (samples - offset[:, None])
    floor = 1e-8 * a[:, None]  # at the centre both sides are equally near; this picks one
    if (np.abs(z) < floor).any():
        z = np.where(np.abs(z) < floor, floor, z)
    axes = (a * a)[:, None]
    reach = a[:, None] * np.abs(z)
    square = reach * reach
    lowest = (reach - axes).max(axis=0)  # N ≥ 1 here: a lower bound of the root
    t = np.zeros(samples.shape[1]) if start is None else start
    for _ in range(_LARGEST_STEPS):
        t = np.maximum(t, lowest)
        inverse = 1 / (axes + t)
        part = square * inverse * inverse
        norm2 = part[0] + part[1] + part[2]
        norm = np.sqrt(norm2)
        part *= inverse
        t = t + (norm - 1) * norm2 / (part[0] + part[1] + part[2])
        if np.abs(norm - 1).max() < _CONVERGED:
            break
    inverse = 1 / (axes + np.maximum(t, lowest))
    normal = z * inverse
    length = np.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
    length = np.maximum(length, np.finfo(float).tiny)
    return ClosestPoints(t * length, u @ (normal / length), v.T @ (a[:, None] * z * inverse), t)
