"""What the data say of a skew between the chips."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array

_CERTAIN = 0.95  # probability of a skew from which it is said to be there


@dataclass(frozen=True, eq=False)
class Skew:
    """A skew, as a fit reports it.

    Attributes:
        value: (3,) rad, ε as reported; 0 where it was not decided.
        covariance: (3, 3) of ε about `value`.
        evidence: nats for a skew of the most likely deviation against none, in the directions that are resolved.
        probability: that there is one, in those, as a decision believes it.
        gain: (13, 3) dθ/dε of the other parameters.
        shift: (13,) what the other parameters are to be moved by from the fit's, for `value`.
        doubt: why a skew that the data ask for is not believed; "" where there is none.
    """

    value: Array
    covariance: Array
    evidence: float
    probability: float
    gain: Array
    shift: Array
    doubt: str = ""

    @property
    def decided(self) -> bool:
        """Whether it is taken out of the readings."""
        return bool(self.value.any())

    @property
    def sentence(self) -> str:
        """What was taken out."""
        size = float(np.degrees(np.linalg.norm(self.value)))
        sigma = float(np.degrees(np.sqrt(self.value @ self.covariance @ self.value) / np.linalg.norm(self.value)))
        if self.probability < _CERTAIN:
            return (
                f"the two chips may be askew (probability {self.probability:.0%}): the mean of what they may be, "
                f"{size:.2f} ± {sigma:.2f}°, is taken out (misalignment)"
            )
        return f"the two chips are {size:.2f} ± {sigma:.2f}° askew, which is taken out (misalignment)"

    def undecided(self) -> Skew:
        """The same where it is not taken out."""
        second = self.covariance + np.outer(self.value, self.value)
        return replace(self, value=np.zeros(3), covariance=second, shift=self.shift - self.gain @ self.value)
