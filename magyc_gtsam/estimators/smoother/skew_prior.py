"""The misalignment (skew) between the chips: its prior, for covariance and decision, and its estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


@dataclass(frozen=True)
class SkewPrior:
    """A scale mixture of normal distributions as the prior of the misalignment angles.

    Attributes:
        deviations: rad, standard deviations of each angle; the measured boards are misaligned by 0.7 to 1.3° in total,
            0.4 to 0.75° per angle.
        weights: prior probability of each deviation. Over 160 recordings on each of five motions, with misalignments
            of 0 to 1.5°, these weights have a mean log density no worse than the others that were tried and a NEES of
            8.7 to 12.1, except 13.6 at 1.5° in a level turn. If the motion does not observe the misalignment, no
            weights give a NEES of 11 at all sizes: the variance is too large for aligned chips and too small for 1.5°.
        aligned: prior probability of aligned chips in the decision to correct; the other deviations (octaves) share the
            rest equally. It is larger because a correction of aligned chips adds to their error, whereas an uncorrected
            misalignment is covered by the sigma. In the linear model of five motions (`benchmarks/skew_rules.py`) the
            heading error stays within 1.24 times the better of twelve and fifteen parameters at 0 to 1.5° (no rule is
            below 1.21), and the hard-iron error of aligned chips within 3 % of that with twelve.
        probable: posterior probability, with that prior, from which it is corrected. Without a threshold the factor
            would be 1.22, and every calibration would have a correction; with it one in eight calibrations of aligned
            chips, on motions that hardly observe the misalignment, has a slight one.
        resolved: rad, standard deviation of a direction of ε by the data above which it is not corrected: a correction
            less certain than the difference between boards would add noise to the heading (a level motion determines
            yaw to 1.4°).
        most: rad, largest misalignment that is believed. A field that varies with the place mimics larger ones (BROAD's
            trials with translation: 3.9°).
        apart: squared Mahalanobis distance between the estimates of the two halves from which the misalignment is
            rejected; the 99.99 % point of χ² with three degrees of freedom.
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
        """rad, the largest deviation, which bounds ε if the motion does not observe it."""
        return max(self.deviations)

    @cached_property
    def typical(self) -> float:
        """rad, prior root mean square of an angle."""
        return float(np.sqrt(np.average(np.square(self.deviations), weights=self.weights)))

    @cached_property
    def cautious(self) -> Array:
        """(k,) weights for the decision to correct; equal to `weights` if no deviation is 0."""
        none = np.array(self.deviations) == 0
        if not none.any():
            return np.array(self.weights)
        return np.where(none, self.aligned, (1 - self.aligned) / (~none).sum())


AUTOMATIC = SkewPrior(tuple(np.radians((0.0, 0.125, 0.25, 0.5, 1.0, 2.0))), (0.1, 0.02, 0.1, 0.3, 0.38, 0.1))


def given(deviation: float) -> SkewPrior:
    """Return the prior of a misalignment that is always estimated, with this standard deviation in rad."""
    never = np.inf
    return SkewPrior((deviation,), (1.0,), resolved=never, most=never, apart=never)


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
