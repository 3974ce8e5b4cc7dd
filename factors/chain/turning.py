"""The rate of turn and the field at the windows of a fit, and the world in which the field has one direction."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.rotations import Array, Spinor, chained, cross, exponential_matrices, matrices

_LEAST = 1e-9  # lower bound of lengths of vectors


def turn_rates(rotation: Array, change: Array, direction: Array) -> tuple[Array, Array, Array]:
    """Return the field's direction in the sensor's axes, its derivative (1/s) and the rate of turn (rad/s), (3, n).

    Args:
        rotation: (3, 3, n) M, world → sensor; change: (3, 3, n) 1/s, its derivative with respect to the delay.
        direction: (3, n) of the field in the world.
    """
    if compiled.loops:
        result = np.empty((3, *direction.shape))
        inputs = map(compiled.given, (rotation, change, direction))
        compiled.loops.turn_rates(direction.shape[1], *inputs, *result)
        return result[0], result[1], result[2]
    turning = np.einsum("ijn,kjn->ikn", change, rotation)  # [ω]×
    rate = 0.5 * np.array(
        [turning[2, 1] - turning[1, 2], turning[0, 2] - turning[2, 0], turning[1, 0] - turning[0, 1]]
    )
    return np.einsum("ijn,jn->in", rotation, direction), np.einsum("ijn,jn->in", change, direction), rate


def world_of(windows: FieldWindows, bias: Array, direction: Array) -> Array:
    """Return rotations (3, 3, n) from the integrated world to the world by a bias, in which the field has one
    direction.

    Args:
        windows: integrated at a bias near this one.
        bias: (3,) rad/s.
        direction: (3, n) of the field in the integrated world.
    """
    drift = np.einsum("ijn,j->in", windows.lever, bias - windows.bias)  # of the world in each link
    return aligned(chained(drift.T), direction)


def aligned(rotation: Spinor, direction: Array) -> Array:
    """Return rotations (3, 3, n) of n spinors, followed by the least turn that gives the field (3, n) one direction.

    In a world that drifts against the field by the gyroscope's noise, columns of the iron's form would differ from
    it by this noise and be scored by it: one of 60 clean logs on tiny motion lost its trust.
    """
    if compiled.loops:
        result = np.empty((3, *direction.shape))
        compiled.loops.align(direction.shape[1], *map(compiled.given, (*rotation, direction)), result)
        return result
    world = matrices(rotation).reshape(3, 3, -1)
    there = np.einsum("ijn,jn->in", world, direction)
    mean = there.mean(axis=1)
    mean /= max(float(np.linalg.norm(mean)), _LEAST)
    across = cross(there, np.broadcast_to(mean[:, None], there.shape))
    size = np.linalg.norm(across, axis=0)
    angle = np.arctan2(size, mean @ there)
    turn = exponential_matrices(across * (angle / np.maximum(size, _LEAST)))
    return np.asarray(np.einsum("ijn,jkn->ikn", turn, world))
