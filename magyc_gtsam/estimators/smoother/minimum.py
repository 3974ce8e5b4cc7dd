"""A field chain at its minimum."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magyc_gtsam.estimators.smoother.columns import EstimatedTerms
from magyc_gtsam.factors.chain.chain_values import ChainState, Reduced, Residuals, Weights
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.rotations import Array


@dataclass(frozen=True, eq=False)
class Minimum:
    """A chain at its minimum.

    Attributes:
        chain, state, weights, reduced: the minimum and its linearisation.
        free: (p,) bool, parameters that were estimated.
        terms: parameters beyond θ, estimated jointly with it; None if there are none.
    """

    chain: FieldChain
    state: ChainState
    weights: Weights
    reduced: Reduced
    free: np.ndarray
    terms: EstimatedTerms | None = None

    @cached_property
    def residuals(self) -> Residuals:
        """The residuals of windows and links."""
        return self.chain.residuals(self.state)

    @cached_property
    def whitened(self) -> tuple[Array, Array]:
        """The whitened residuals of the windows, (3, n) in the sensor's axes and (3, n) in the world's axes."""
        whitened = self.residuals.window * np.sqrt(self.weights.window) / self.chain.window_sigma
        return whitened, np.einsum("ijn,in->jn", self.chain.windows.rotation, whitened)
