"""Chains of rotations without a Python loop over samples: unit quaternions as pairs of complex numbers.

A rotation is the SU(2) element (p, q) = (w + i x, y + i z); the product is (p₁p₂ − q₁ q̄₂, p₁q₂ + q₁ p̄₂), eight
numpy calls for any number of rotations.
"""

from __future__ import annotations

from math import sin, sqrt

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.chain import compiled

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Spinor = tuple[Complex, Complex]

_BLOCK = 16  # rotations chained sequentially before the blocks themselves are chained
_SHORT = 3000  # number of rotations below which doubling is faster than blocks
_HOLE = 10  # ratio of two neighbouring steps from which the longer one is a hole
# Samples among which the third of a parabola is looked for. With samples at random times, one a second, the nearest is
# often too close, and steps without their correction lose 5 % of an oscillation of 20 s; with three to choose from 1 %.
_REACH = 3


def exponential(rotation_vector: Array) -> Spinor:
    """Return Exp of rotation vectors (n, 3) in rad."""
    x, y, z = rotation_vector.T
    square = x * x + y * y + z * z
    p = np.empty(len(square), complex)
    q = np.empty(len(square), complex)
    if square.max(initial=0.0) < 0.05:  # series of cos(φ/2) and sin(φ/2)/φ, exact to rounding
        p.real = 1 - square * (1 / 8 - square * (1 / 384 - square * (1 / 46080 - square / 10321920)))
        half = 0.5 - square * (1 / 48 - square * (1 / 3840 - square * (1 / 645120 - square / 185794560)))
    else:
        angle = np.sqrt(square)
        half = np.sin(0.5 * angle) / np.where(angle > 0, angle, 1.0)
        half[angle == 0] = 0.5
        p.real = np.cos(0.5 * angle)
    p.imag = x * half
    q.real = y * half
    q.imag = z * half
    return p, q


def increments(time: Array, rate: Array, bias: Array | None = None) -> Array:
    """Return the rotation vectors (n − 1, 3) in rad from each sample to the next, of rates (n, 3) rad/s AT their
    stamps.

    The method is the trapezoid rule with its end correction, h/2 (ω₀ + ω₁) − h²/12 (ω̇₁ − ω̇₀), and the first term of
    the Magnus series, h²/12 ω₀ × ω₁ (coning). It is of fourth order, where plain trapezoids lose (ωh)²/12 of every
    oscillation, 1 % of a 0.5 Hz swell at 10 Hz. Derivatives are those of the parabola through three samples, for any
    ratio of their steps (samples get lost), but not across a hole.
    """
    if compiled.loops and len(time) > 3:
        result = np.empty((3, len(time) - 1))
        start = np.zeros(3) if bias is None else bias
        if not compiled.loops.increments(len(time), *map(compiled.given, (time, rate, start)), result):
            return result.T
    step = np.diff(time)
    rate = np.array(rate.T, order="C")  # one axis per row
    if bias is not None:
        rate -= bias[:, None]
    result = (0.5 * step) * (rate[:, 1:] + rate[:, :-1])
    square = step * step / 12
    if len(time) > 3:
        before, after = step[:-1], step[1:]
        near = np.maximum(before, after) < _HOLE * np.minimum(before, after)
        near = near[1:] & near[:-1]
        change = (rate[:, 1:] - rate[:, :-1]) / step
        slope = change[:, :-1] + (before / (before + after)) * (change[:, 1:] - change[:, :-1])
        result[:, 1:-1] -= (square[1:-1] * near) * (slope[:, 1:] - slope[:, :-1])
        uneven = 1 + np.flatnonzero(~near)
        if len(uneven):
            result[:, uneven] -= square[uneven] * _slope_changes(time, rate, uneven)
    (x0, y0, z0), (x1, y1, z1) = rate[:, :-1], rate[:, 1:]
    result[0] += square * (y0 * z1 - z0 * y1)
    result[1] += square * (z0 * x1 - x0 * z1)
    result[2] += square * (x0 * y1 - y0 * x1)
    return result.T


def _slope_changes(time: Array, rate: Array, start: np.ndarray) -> Array:
    """Return ω̇₁ − ω̇₀ (3, k) over the steps from the samples `start` (k,), beside shorter or longer ones.

    The third sample of a parabola is the nearest that is not too close: the slope between close samples is noise, which
    a long step multiplies by its square. Across a hole the result is zero.
    """
    step = time[start + 1] - time[start]
    third, beyond = start - 1, start + 2
    for _ in range(_REACH - 1):
        third -= (_HOLE * (time[start] - time[third]) <= step) & (third > 0)
        beyond += (_HOLE * (time[beyond] - time[start + 1]) <= step) & (beyond < len(time) - 1)
    before, after = time[start] - time[third], time[beyond] - time[start + 1]
    within = (rate[:, start + 1] - rate[:, start]) / step
    first = (within - (rate[:, start] - rate[:, third]) / before) * (step / (before + step))
    last = ((rate[:, beyond] - rate[:, start + 1]) / after - within) * (step / (step + after))
    near = (np.maximum(before, after) < _HOLE * step) & (step < _HOLE * np.minimum(before, after))
    result: Array = (first + last) * near
    return result


def multiply(first: Spinor, second: Spinor) -> Spinor:
    """Return R₁ R₂, elementwise."""
    p1, q1 = first
    p2, q2 = second
    return p1 * p2 - q1 * q2.conj(), p1 * q2 + q1 * p2.conj()


def chain(steps: Spinor) -> Spinor:
    """Return all products R_k = R_{k−1} S_{k−1} from R_0 = I: n + 1 rotations from n steps.

    Each product has few factors, by blocks of blocks: the norm is 1 to 1e-14 after ten minutes at 10 Hz and to some
    1e-13 after ten hours at 100 Hz.
    """
    p, q = steps
    n = len(p)
    if n == 0:
        return np.ones(1, complex), np.zeros(1, complex)
    if n < _SHORT:
        p, q = np.concatenate([[1.0], p]), np.concatenate([[0.0], q])
        reach = 1
        while reach <= n:  # doubling needs fewer calls
            p[reach:], q[reach:] = multiply((p[:-reach], q[:-reach]), (p[reach:], q[reach:]))
            reach *= 2
        return p, q
    blocks = n // _BLOCK + 1
    padded = np.zeros((2, blocks * _BLOCK), complex)
    padded[0] = 1.0
    padded[0, :n], padded[1, :n] = p, q
    # The product is p₁ (p₂, q₂) + q₁ (−q̄₂, p̄₂).
    step = np.ascontiguousarray(padded.reshape(2, blocks, _BLOCK).transpose(2, 0, 1))
    crossed = step[:, ::-1].conj()
    np.negative(crossed[:, 0], out=crossed[:, 0])
    inside = np.empty((_BLOCK + 1, 2, blocks), complex)
    inside[0] = [[1.0], [0.0]]
    for k in range(_BLOCK):
        np.multiply(inside[k, 0], step[k], out=inside[k + 1])
        inside[k + 1] += inside[k, 1] * crossed[k]
    start = chain((inside[-1, 0, :-1], inside[-1, 1, :-1]))
    p, q = multiply(start, (inside[:-1, 0], inside[:-1, 1]))
    return p.T.ravel()[: n + 1], q.T.ravel()[: n + 1]


def chained(rotation_vector: Array) -> Spinor:
    """Return `chain` of `exponential` of rotation vectors (n, 3) in rad."""
    if not compiled.loops:
        return chain(exponential(rotation_vector))
    n = len(rotation_vector)
    result = np.empty(n + 1, complex), np.empty(n + 1, complex)
    compiled.loops.chain(n, compiled.given(rotation_vector.T), *result)
    return result


def matrices(rotation: Spinor) -> Array:
    """Return rotation matrices (9, n), row by row along the first axis, so that every entry is contiguous."""
    p, q = rotation
    w, x, y, z = p.real, p.imag, q.real, q.imag
    x2, y2, z2 = x + x, y + y, z + z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    result = np.empty((9, len(w)))
    result[0] = 1 - yy - zz
    result[1] = xy - wz
    result[2] = xz + wy
    result[3] = xy + wz
    result[4] = 1 - xx - zz
    result[5] = yz - wx
    result[6] = xz - wy
    result[7] = yz + wx
    result[8] = 1 - xx - yy
    return result


def skew(vector: Array) -> Array:
    """Return [v]×, matrices (..., 3, 3), for vectors (..., 3)."""
    result = np.zeros((*vector.shape, 3))
    result[..., 0, 1] = -vector[..., 2]
    result[..., 0, 2] = vector[..., 1]
    result[..., 1, 0] = vector[..., 2]
    result[..., 1, 2] = -vector[..., 0]
    result[..., 2, 0] = -vector[..., 1]
    result[..., 2, 1] = vector[..., 0]
    return result


def cross(first: Array, second: Array, out: Array | None = None) -> Array:
    """Return the cross product along the first axis."""
    result = np.empty(np.broadcast(first, second).shape) if out is None else out
    (a, b, c), (x, y, z) = first, second
    np.subtract(b * z, c * y, out=result[0, ...])
    np.subtract(c * x, a * z, out=result[1, ...])
    np.subtract(a * y, b * x, out=result[2, ...])
    return result


def by_axes(vector: Array) -> Array:
    """Return the cross products e_k × v (3, 3, n) of each axis k with vectors (3, n)."""
    x, y, z = vector
    result = np.zeros((3, *vector.shape))
    np.negative(z, out=result[0, 1])
    np.negative(x, out=result[1, 2])
    np.negative(y, out=result[2, 0])
    result[0, 2], result[1, 0], result[2, 1] = y, z, x
    return result


def along(vector: Array, columns: Array) -> Array:
    """Return the products (p, n) of vectors (3, n) with columns (p, 3, n)."""
    result: Array = np.einsum("in,pin->pn", vector, columns)
    return result


def exponential_matrices(rotation_vector: Array) -> Array:
    """Return the rotation matrices (3, 3, n) of rotation vectors (3, n)."""
    square = np.einsum("in,in->n", rotation_vector, rotation_vector)
    if square.max(initial=0.0) < 1e-3:  # series, exact to rounding
        a = 1 - square * (1 / 6 - square * (1 / 120 - square / 5040))
        b = 0.5 - square * (1 / 24 - square * (1 / 720 - square / 40320))
    else:
        angle = np.maximum(np.sqrt(square), 1e-8)
        a, b = np.sin(angle) / angle, 0.5 * (np.sin(0.5 * angle) / (0.5 * angle)) ** 2
    # (1 − b v²) I + a [v]× + b v vᵀ
    result: Array = (b * rotation_vector)[:, None] * rotation_vector
    result.reshape(9, -1)[::4] += 1 - b * square
    x, y, z = a * rotation_vector
    result[0, 1] -= z
    result[1, 0] += z
    result[0, 2] += y
    result[2, 0] -= y
    result[1, 2] -= x
    result[2, 1] += x
    return result


def exponential_matrix(rotation_vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of one rotation vector (3,)."""
    x, y, z = rotation_vector.tolist()
    square = x * x + y * y + z * z
    angle, a, b = sqrt(square), 1.0, 0.5
    if angle > 0:
        a, b = sin(angle) / angle, 0.5 * (sin(0.5 * angle) / (0.5 * angle)) ** 2
    c = 1 - b * square
    return np.array(
        [
            [b * x * x + c, b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, b * y * y + c, b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, b * z * z + c],
        ]
    )


def right_jacobian(rotation_vector: Array) -> Array:
    """Return J (3, 3) with Exp(v + δ) = Exp(v) Exp(J δ) to first order in δ, for v (3,)."""
    angle = float(np.linalg.norm(rotation_vector))
    across = skew(rotation_vector)
    if angle < 1e-3:
        first, second = 0.5 - angle**2 / 24, 1 / 6 - angle**2 / 120
    else:
        first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.eye(3) - first * across + second * across @ across


def tangent_frame(direction: Array) -> Array:
    """Return unit vectors (3, n) and their orthonormal tangent bases: (3, 3, n) (Duff et al. 2017, without
    branches).
    """
    x, y, z = direction
    sign = np.copysign(1.0, z)
    frame = np.empty((3, 3, len(x)))
    frame[:, 0] = direction
    a = -1 / (sign + z)
    xa = x * a
    b = y * xa
    np.multiply(sign, x, out=frame[2, 1])
    np.multiply(frame[2, 1], xa, out=frame[0, 1])
    frame[0, 1] += 1
    np.negative(frame[2, 1], out=frame[2, 1])
    np.multiply(sign, b, out=frame[1, 1])
    frame[0, 2] = b
    np.multiply(y * y, a, out=frame[1, 2])
    frame[1, 2] += sign
    np.negative(y, out=frame[2, 2])
    return frame
