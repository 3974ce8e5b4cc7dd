"""Sums and means over the magnetometer samples of each window, of the motion and of the field."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array, Spinor, cross, matrices

ROWS = 27  # rows per sample: R 9, K 9, dRᵀ/dτ 9


def window_sums(starts: np.ndarray, rotation: Spinor, lever: Array, rate: Array) -> Array:
    """Return the sums (27, n) over the samples from each start to the next: of R, K and dRᵀ/dτ, row by row."""
    result = np.empty((ROWS, len(starts)))
    if compiled.loops:
        samples = map(compiled.given, (*rotation, lever, rate))
        compiled.loops.sum_windows(len(rate), starts.astype(np.int64, copy=False), *samples, result)
        return result
    x, y, z = rate.T
    turned = matrices(rotation)
    r = turned.reshape(3, 3, -1).swapaxes(0, 1)  # rows of Rᵀ
    # d/dτ R(t − τ)ᵀ = [ω]× Rᵀ, row by row.
    change = np.empty((3, 3, len(rate)))
    np.subtract(y * r[2], z * r[1], out=change[0])
    np.subtract(z * r[0], x * r[2], out=change[1])
    np.subtract(x * r[1], y * r[0], out=change[2])
    for part, rows in zip(np.split(result, 3), (turned, lever, change.reshape(9, -1)), strict=True):
        np.add.reduceat(rows, starts, axis=1, out=part)
    return result


def of_samples(starts: np.ndarray, mean: Array, time: Array, field: Array) -> tuple[Array, Array]:
    """Return the mean field (3, n) of each window, and the variance (n,) of its stamps.

    Args:
        starts, mean: (n,) the first sample of each window, and the mean of its stamps.
        time, field: (m,), (m, 3) of all samples.
    """
    if compiled.loops:
        result = np.empty((3, len(starts))), np.empty(len(starts))
        samples = map(compiled.given, (mean, time, field))
        compiled.loops.average_samples(len(time), starts.astype(np.int64, copy=False), *samples, *result)
        return result
    count = np.diff(np.append(starts, len(time)))
    since = time - np.repeat(mean, count)
    of_field = np.ascontiguousarray(np.add.reduceat(field, starts, axis=0).T / count)
    return of_field, np.add.reduceat(since * since, starts) / count


class MotionInWindows(NamedTuple):
    """The motion in n windows: rotation, rotation_bias, rotation_rate and lever of `FieldWindows`."""

    rotation: Array
    rotation_bias: Array
    rotation_rate: Array
    lever: Array


def of_windows(sums: Array, count: Array, spread: Array) -> MotionInWindows:
    """Return the motion by the sums (27, n), the numbers of samples (n,), and the variance (n,) s² of their stamps."""
    n = len(count)
    if compiled.loops:
        shapes = ((3, 3, n), (3, 3, 3, n), (3, 3, n), (3, 3, n - 1))
        result = MotionInWindows(*map(np.empty, shapes))
        compiled.loops.window_motion(n, *map(compiled.given, (sums, count, spread)), *result)
        return result
    means = sums / count
    world, change = means[:9].reshape(3, 3, -1), means[18:].reshape(3, 3, -1).copy()  # a view would keep all means
    swung = change * spread
    return MotionInWindows(
        world.swapaxes(0, 1).copy(),
        cross(world[:, None], swung.swapaxes(0, 1)[:, :, None]).swapaxes(0, 1).copy(),
        change,
        np.diff(means[9:18]).reshape(3, 3, -1),
    )
