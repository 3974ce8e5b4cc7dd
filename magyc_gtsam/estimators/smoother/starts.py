"""Starting values of the smoother: the user supplies none, and h = 0 can lead to a local minimum."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.rotations import Array, cross
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech, vech

_LAG = 3.0  # s between the windows compared by the linear start
_PAIRS = 200  # pairs of windows that suffice for a start
_PASSES = 3
# Prior standard deviation of the soft iron's entries. Of 48 clean logs the first Gauss–Newton step ends 0.3 to 6 sigmas
# from the minimum; 30 to 100 from a spherical start, and up to 15 with a deviation of 0.2.
_SOFT_IRON = 0.1
_MOST_SOFT_IRON = 0.5  # norm above which the estimate is not a soft iron
_TRACELESS = np.concatenate([SYMMETRIC_UNITS[[1, 2, 4]], SYMMETRIC_UNITS[[0, 3]] - SYMMETRIC_UNITS[[3, 5]]])


def parameters(soft_iron: Array, hard_iron: Array, bias: Array, delay: float) -> Array:
    """Return θ (13,) of soft iron times field strength (3, 3) T, hard iron T, bias rad/s and delay s."""
    result = np.empty(PARAMETERS)
    result[:6], result[6:9], result[9:12], result[12] = vech(soft_iron), hard_iron, bias, delay
    return result


def from_prior(windows: FieldWindows, soft_iron: Array, hard_iron: Array, bias: Array) -> Array:
    """Return θ of an earlier calibration, vech(soft_iron) (6,), with the median strength of the field."""
    straight = np.linalg.solve(unvech(soft_iron), windows.field - hard_iron[:, None])
    strength = median(np.sqrt(np.einsum("in,in->n", straight, straight)))
    return parameters(unvech(soft_iron) * strength, hard_iron, bias, windows.delay)


def spherical(windows: FieldWindows, hard_iron: Array, bias: Array) -> Array:
    """Return θ with a spherical soft iron of the median radius around `hard_iron`."""
    away = windows.field - hard_iron[:, None]
    radius = median(np.sqrt(np.einsum("in,in->n", away, away)))
    return parameters(np.eye(3) * radius, hard_iron, bias, windows.delay)


def from_gyroscope(windows: FieldWindows) -> Array:
    """Return θ with soft iron, hard iron and gyroscope bias by robust linear least squares.

    With A = I the field rotated back by the gyroscope, y = Mᵀ(m − h), changes only by the bias: y' − y = [y]× ΔK b.
    Noise is additive in this form, so a large hard iron or noisy data do not bias the solution. No tilt is needed: the
    solution is right even if an ellipsoid fit sees only an arc. The last pass adds A⁻¹ ∝ I − D. Noise in the columns
    Mᵀ E_j (m − h) of D biases it, so D has a prior, and no trace, which would shrink the field to nothing.
    """
    spacing = max(median(np.diff(windows.time)), 1e-9)
    lag = min(max(round(_LAG / spacing), 1), (len(windows) - 1) // 2)
    turned_back = np.einsum("ijn,in->jn", windows.rotation, windows.field)
    total = np.zeros((3, 3, len(windows)))
    np.cumsum(windows.lever, axis=2, out=total[:, :, 1:])
    stride = -(-(len(windows) - lag) // _PAIRS)
    first, last = slice(0, len(windows) - lag, stride), slice(lag, None, stride)
    lever = total[:, :, last] - total[:, :, first]
    holes = np.concatenate([[0], np.cumsum(~windows.linked)])
    weight = (holes[last] == holes[first]).astype(float)
    if not weight.any():
        weight[:] = 1.0

    constant = turned_back[:, last] - turned_back[:, first]
    before, after = windows.rotation[:, :, first], windows.rotation[:, :, last]
    every = np.empty((11, *constant.shape))  # columns of hard iron, bias and D
    np.subtract(after, before, out=every[:3])
    hard_iron, bias, scale = windows.field.mean(axis=1), np.zeros(3), 0.0
    for left in reversed(range(_PASSES)):
        still = turned_back[:, first] - np.einsum("ijn,i->jn", before, hard_iron)
        every[3:6] = cross(still[:, None], lever).swapaxes(0, 1)
        if not left:
            away = windows.field - hard_iron[:, None]
            np.subtract(_stretched(after, away[:, last]), _stretched(before, away[:, first]), out=every[6:])
        design = every[:6] if left else every
        flat = design.reshape(len(design), -1)
        weighted = (design * weight).reshape(len(design), -1)
        normal = weighted @ flat.T
        normal.flat[:: len(design) + 1] *= 1 + 1e-9
        normal[6:, 6:] += scale / 3 / _SOFT_IRON**2 * np.eye(len(design) - 6)
        solution = _solved(normal, weighted @ constant.ravel())
        before_it, hard_iron, bias, stretch = hard_iron, solution[:3], solution[3:6], solution[6:]
        misfit = constant - (solution @ flat).reshape(3, -1)
        square = np.einsum("in,in->n", misfit, misfit)
        counts = weight > 0
        scale = median(square if counts.all() else square[counts]) or 1.0
        weight = counts / (1 + square / (2 * scale))  # Cauchy
    if not np.linalg.norm(stretch) < _MOST_SOFT_IRON:
        return spherical(windows, hard_iron, bias)
    soft_iron = np.linalg.inv(np.eye(3) - (stretch @ _TRACELESS.reshape(5, 9)).reshape(3, 3))
    hard_iron = before_it + soft_iron @ (hard_iron - before_it)
    return from_prior(windows, vech(soft_iron), hard_iron, bias)


def _stretched(rotation: Array, field: Array) -> Array:
    """Return (5, 3, n) Mᵀ E_j m of a basis of D, for M (3, 3, n) and m (3, n)."""
    stretched = (_TRACELESS.reshape(15, 3) @ field).reshape(5, 3, -1)
    return np.asarray(np.einsum("ijn,kin->kjn", rotation, stretched))


def _solved(normal: Array, right: Array) -> Array:
    """Return the solution of normal equations, that of least norm if they are singular."""
    try:
        solution = np.linalg.solve(normal, right)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(normal, right, rcond=None)[0]
    return solution.astype(np.float64, copy=False)
