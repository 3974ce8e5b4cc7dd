"""The projection on the complement of the columns of a model's parameters and terms."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class Projector:
    """The projection on the complement of the base model's columns (q, 3n), which have a score bias (q,)."""

    def __init__(self, base: Array, score_bias: Array | None = None) -> None:
        scale = np.linalg.norm(base, axis=1)
        scale = np.where(scale > 0, scale, 1.0)
        q, r = np.linalg.qr((base / scale[:, None]).T)
        self._q = q[:, np.abs(np.diag(r)) > 1e-9]
        scaled = np.zeros(len(base)) if score_bias is None else score_bias / scale
        self._score_bias = np.linalg.lstsq(r.T, scaled, rcond=1e-9)[0][np.abs(np.diag(r)) > 1e-9]

    def __call__(self, rows: Array) -> Array:
        result: Array = rows - (rows @ self._q) @ self._q.T
        return result

    def shared_score_bias(self, rows: Array) -> Array:
        """Return the part of the score bias of rows that the projection removes with the base model's columns."""
        result: Array = (rows @ self._q) @ self._score_bias
        return result
