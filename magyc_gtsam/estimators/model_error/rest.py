"""Windows in which an instrument is put down."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array

_RESTING = 0.02  # times the log's rate of turn (rms), below which it is at rest; a straight run has more


def moving(time: Array, rotation: Array) -> np.ndarray:
    """Return (n,) bool, the windows, with rotations (3, 3, n), in which an instrument is not put down.

    The field is often another one there, which says nothing of its iron.
    """
    if len(time) < 3:
        return np.ones(len(time), dtype=bool)
    rate = _angles(rotation) / np.maximum(np.diff(time), 1e-9)
    least = _RESTING * float(np.sqrt(np.mean(rate**2)))
    turned = rate > least
    result = np.zeros(len(time), dtype=bool)
    result[:-1] = turned
    result[1:] |= turned
    return result


def _angles(rotation: Array) -> Array:
    """Return the angles (n − 1,) rad between neighbours of rotations (3, 3, n)."""
    if compiled.loops:
        result = np.empty(rotation.shape[2] - 1)
        compiled.loops.angles(rotation.shape[2], compiled.given(rotation), result)
        return result
    cosine = 0.5 * (np.einsum("ijn,ijn->n", rotation[..., 1:], rotation[..., :-1]) - 1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
