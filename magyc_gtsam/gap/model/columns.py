"""Regressors of the gap's models before they are whitened."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class Columns(NamedTuple):
    """Unwhitened regressors.

    Attributes:
        window: (p, 3, n) of the windows, T per unit.
        link: (p, 3, n − 1) of the links, rad per unit; None for zero.
        score_bias: (p,) score bias (`Twin.rate_score_bias`); None for zero.
    """

    window: Array
    link: Array | None
    score_bias: Array | None = None

    @property
    def bias(self) -> Array:
        """Return the score bias (p,)."""
        return np.zeros(len(self.window)) if self.score_bias is None else self.score_bias


def together(parts: Sequence[Columns]) -> Columns:
    """Return the columns of several parts, all on the same sensor, without their score bias."""
    links = [part.link for part in parts if part.link is not None]
    return Columns(np.concatenate([part.window for part in parts]), np.concatenate(links) if links else None)
