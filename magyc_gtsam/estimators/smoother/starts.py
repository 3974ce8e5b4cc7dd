"""Starting values of the smoother: the user supplies none, and h = 0 can lead to a local minimum."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.smoother.linear_start import TRACELESS, Pairs
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.small import inverse, solved
from magyc_gtsam.factors.chain.vech import unvech, vech
from magyc_gtsam.factors.errors import SingularError

_LAG = 3.0  # s between the windows compared by the linear start
_PAIRS = 200  # pairs of windows that suffice for a start
_PASSES = 3
# Prior standard deviation of the soft iron's entries. Of 48 clean logs the first Gauss–Newton step ends 0.3 to 6 sigmas
# from the minimum; 30 to 100 from a spherical start, and up to 15 with a deviation of 0.2.
_SOFT_IRON = 0.1
_MOST_SOFT_IRON = 0.5  # norm above which the estimate is not a soft iron


def parameters(soft_iron: Array, hard_iron: Array, bias: Array, delay: float) -> Array:
    """Return θ (13,) of soft iron times field strength (3, 3) T, hard iron T, bias rad/s and delay s."""
    result = np.empty(PARAMETERS)
    result[:6], result[6:9], result[9:12], result[12] = vech(soft_iron), hard_iron, bias, delay
    return result


def from_prior(windows: FieldWindows, soft_iron: Array, hard_iron: Array, bias: Array) -> Array:
    """Return θ of an earlier calibration, vech(soft_iron) (6,), with the median strength of the field."""
    straight = inverse(unvech(soft_iron)) @ (windows.field - hard_iron[:, None])
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
    weight = np.ones(lever.shape[2])
    if not windows.linked.all():
        holes = np.concatenate([[0], np.cumsum(~windows.linked)])
        same = holes[last] == holes[first]
        weight = same.astype(float) if same.any() else weight

    parts = (windows.rotation[:, :, first], windows.rotation[:, :, last], lever, turned_back[:, first])
    fields = (windows.field[:, first], windows.field[:, last])
    pairs = Pairs(*map(np.ascontiguousarray, (*parts, *fields, turned_back[:, last] - turned_back[:, first])))
    hard_iron, bias, scale = windows.field.mean(axis=1), np.zeros(3), 0.0
    for left in reversed(range(_PASSES)):
        columns, normal, right = pairs.equations(hard_iron, weight, stretched=not left)
        normal.flat[:: len(normal) + 1] *= 1 + 1e-9
        if not left:
            normal[6:, 6:] += scale / 3 / _SOFT_IRON**2 * np.eye(5)
        solution = _solved(normal, right)
        before_it, hard_iron, bias, stretch = hard_iron, solution[:3], solution[3:6], solution[6:]
        square = pairs.squares(columns, solution)
        counts = weight > 0
        scale = median(square if counts.all() else square[counts]) or 1.0
        weight = counts / (1 + square / (2 * scale))  # Cauchy
    if not np.linalg.norm(stretch) < _MOST_SOFT_IRON:
        return spherical(windows, hard_iron, bias)
    soft_iron = inverse(np.eye(3) - (stretch @ TRACELESS.reshape(5, 9)).reshape(3, 3))
    hard_iron = before_it + soft_iron @ (hard_iron - before_it)
    return from_prior(windows, vech(soft_iron), hard_iron, bias)


def _solved(normal: Array, right: Array) -> Array:
    """Return the solution of normal equations, that of least norm if they are singular."""
    try:
        return solved(normal, right)
    except SingularError:
        return np.linalg.lstsq(normal, right, rcond=None)[0].astype(np.float64, copy=False)
