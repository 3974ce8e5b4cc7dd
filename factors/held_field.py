"""Test of the heading of the field that blocks hold, against the heading that the rest of the graph knows.

Blocks turn the graph to their field: with a wrong declination nothing else disagrees with them by much at any one time,
and innovations show nothing. Only the graph solved with the field's turn ψ free (`free_fit.py`) has the heading of all
its other factors, e.g. of positions against accelerations or odometry. Without such factors ψ keeps its prior.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.free_fit import FreeFit
from magyc_gtsam.factors.held import Held, HeldLimits


@dataclass(frozen=True)
class FieldLimits(HeldLimits):
    """Limits of the test of a held field, whose prior is that of a declination left out.

    Positions with errors that last half a minute, of twice the stated size, turned ψ by 1.8°, less than `least`.
    """

    prior: float = math.radians(10.0)
    least: float = math.radians(2.0)


class HeldField(Held):
    """The evidence for a turned field, from the last solution with ψ free."""

    def __init__(self, limits: FieldLimits) -> None:
        super().__init__(limits, 1)
        self.limits = limits

    def solved(self, fit: FreeFit | None) -> None:
        """Take over a solution with ψ free; None where there is none."""
        self.tried()
        if fit is not None:
            self._information, self._score = np.maximum(fit.information[3:, 3:], 0.0), fit.score[3:]
