"""The estimate of a misalignment (skew) between the chips."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array

_CERTAIN = 0.95  # probability of a misalignment from which the message states it as certain


@dataclass(frozen=True, eq=False)
class Skew:
    """The misalignment estimate of a fit.

    Attributes:
        value: (3,) rad, ε that is corrected; 0 if undecided.
        covariance: (3, 3) second moment of ε about `value`.
        evidence: log Bayes factor (nats) of the likeliest deviation against none, in the resolved directions.
        probability: posterior probability of a misalignment in those directions, with the prior of a decision.
        gain: (13, 3) dθ/dε of the other parameters.
        shift: (13,) change of the other parameters from the fit's values to those that hold at `value`.
        doubt: why a probable misalignment is not believed; "" if it is.
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
        """Whether the misalignment is corrected."""
        return bool(self.value.any())

    @property
    def sentence(self) -> str:
        """The correction in words."""
        size = float(np.degrees(np.linalg.norm(self.value)))
        sigma = float(np.degrees(np.sqrt(self.value @ self.covariance @ self.value) / np.linalg.norm(self.value)))
        if self.probability < _CERTAIN:
            return (
                f"the two chips may be misaligned (probability {self.probability:.0%}): the mean of what they may be, "
                f"{size:.2f} ± {sigma:.2f}°, is taken out (misalignment)"
            )
        return f"the two chips are {size:.2f} ± {sigma:.2f}° misaligned, which is taken out (misalignment)"

    def undecided(self) -> Skew:
        """Return the estimate without a correction: `value` 0, and the second moment about it."""
        second = self.covariance + np.outer(self.value, self.value)
        return replace(self, value=np.zeros(3), covariance=second, shift=self.shift - self.gain @ self.value)
