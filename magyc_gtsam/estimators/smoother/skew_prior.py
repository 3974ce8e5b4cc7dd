"""What is believed of a skew between the chips before the data, for the covariance and for a decision."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


@dataclass(frozen=True)
class SkewPrior:
    """What is believed of a skew before the data.

    Attributes:
        deviations: rad, of each angle; the boards that were measured are 0.7 to 1.3° askew in all, 0.4 to 0.75° an
            angle.
        weights: how far each is believed. Of those that were tried these have, over 160 recordings on each of five
            motions and skews of 0 to 1.5°, a mean logarithm of the stated density no worse than others and a NEES of
            8.7 to 12.1, but 13.6 at 1.5° in a level turn. Where the motion does not show a skew no weights bring all
            sizes to 11: the room that is left for one is too much for aligned chips and too little for 1.5°.
        aligned: how far aligned chips are believed where a skew is to be taken out, all deviations (octaves) being
            believed alike: what is taken out of aligned chips adds to their error, what is left in others is in the
            sigma. In the linear model of five motions (`benchmarks/skew_rules.py`) this leaves the heading within 1.24
            times the better of twelve and fifteen parameters at 0 to 1.5°, where no rule is below 1.21, and the error
            of the hard iron of aligned chips within 3 % of that with twelve.
        probable: probability, with that belief, from which it is taken out. Without a threshold the heading would be
            within 1.22 times, and every calibration would have a skew; with this one in eight of aligned chips, on
            motions that show a skew badly, has a slight one.
        resolved: rad, standard deviation of a direction of ε by the data beyond which it is left open: what is known
            worse than boards differ would be noise in the heading (a level motion knows yaw to 1.4°).
        most: rad, of a skew that is believed. Rooms whose field varies with the place show larger ones (BROAD's
            trials with translation: 3.9°).
        apart: squared difference between the skews of the two halves, in their covariance, from which it is none;
            the 99.99 % point of χ² with three degrees of freedom.
    """

    deviations: tuple[float, ...]
    weights: tuple[float, ...]
    aligned: float = 0.65
    probable: float = 0.3
    resolved: float = np.radians(0.5)
    most: float = np.radians(2.0)
    apart: float = 21.1

    @property
    def widest(self) -> float:
        """rad, the largest deviation: what holds ε where the motion does not show it."""
        return max(self.deviations)

    @cached_property
    def typical(self) -> float:
        """rad, root mean square of an angle."""
        return float(np.sqrt(np.average(np.square(self.deviations), weights=self.weights)))

    @cached_property
    def cautious(self) -> Array:
        """(k,) the weights of a decision; those given where the chips cannot be aligned."""
        none = np.array(self.deviations) == 0
        if not none.any():
            return np.array(self.weights)
        return np.where(none, self.aligned, (1 - self.aligned) / (~none).sum())


AUTOMATIC = SkewPrior(tuple(np.radians((0.0, 0.125, 0.25, 0.5, 1.0, 2.0))), (0.1, 0.02, 0.1, 0.3, 0.38, 0.1))


def given(deviation: float) -> SkewPrior:
    """A skew that is estimated with a prior of this deviation in rad, whatever the evidence."""
    never = np.inf
    return SkewPrior((deviation,), (1.0,), resolved=never, most=never, apart=never)
