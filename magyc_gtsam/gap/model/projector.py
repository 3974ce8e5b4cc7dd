"""The projection on the complement of the columns of a model's parameters and terms."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class Projector:
    """The projection on the complement of the base model's columns (q, 3n)."""

    def __init__(self, base: Array) -> None:
        scale = np.linalg.norm(base, axis=1)
        scale = np.where(scale > 0, scale, 1.0)
        q, r = np.linalg.qr((base / scale[:, None]).T)
        self._q = q[:, np.abs(np.diag(r)) > 1e-9]

    def __call__(self, rows: Array) -> Array:
        result: Array = rows - self.within(rows) @ self._q.T
        return result

    def within(self, rows: Array) -> Array:
        """Return what rows (k, 3n) have in the span of the columns: coordinates (k, r) in an orthonormal basis."""
        result: Array = rows @ self._q
        return result
