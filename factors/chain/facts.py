"""Prior knowledge of θ: Gaussian facts, each a whitened residual and its Jacobian.

Examples are an earlier calibration, the prior of the skew between the chips, a delay measured on the bench and the
strength of the field at the site. They enter the normal equations after the elimination.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.small import inverse
from magyc_gtsam.factors.chain.vech import MULTIPLICITY, unvech, vech


class Fact(Protocol):
    """A single prior constraint on θ."""

    def residual(self, parameters: Array) -> tuple[Array, Array]:
        """Return the whitened residual (k,) at θ (p,), and its Jacobian (k, p)."""
        ...


@dataclass(frozen=True, eq=False)
class LinearFact:
    """root · (θ[rows] − mean) ~ N(0, I).

    Args:
        rows: (m,) indices of θ.
        mean: (m,).
        root: (k, m), rootᵀ root is the information.
    """

    rows: np.ndarray
    mean: Array
    root: Array

    def residual(self, parameters: Array) -> tuple[Array, Array]:
        """See `Fact`."""
        jacobian = np.zeros((len(self.root), len(parameters)))
        jacobian[:, self.rows] = self.root
        return self.root @ (parameters[self.rows] - self.mean), jacobian


@dataclass(frozen=True)
class StrengthFact:
    """The field strength ∛det B in T: mean and sigma. It is useful only where the shape of B is known too."""

    mean: float
    sigma: float

    def residual(self, parameters: Array) -> tuple[Array, Array]:
        """See `Fact`."""
        strength, slope = field_strength(parameters[:6])
        jacobian = np.zeros((1, len(parameters)))
        jacobian[0, :6] = slope / self.sigma
        return np.array([(strength - self.mean) / self.sigma]), jacobian


@dataclass(frozen=True, eq=False)
class IronFact:
    """root · (vech(S)/F − shape, h − hard_iron) ~ N(0, I), F = ∛det S: soft iron up to its scale, and hard iron.

    Args:
        shape: (6,) vech of a soft iron with determinant 1.
        hard_iron: (3,) T.
        root: (k, 9), rootᵀ root is the information.
    """

    shape: Array
    hard_iron: Array
    root: Array

    def residual(self, parameters: Array) -> tuple[Array, Array]:
        """See `Fact`."""
        away, slope = self.away(parameters)
        jacobian = np.zeros((len(self.root), len(parameters)))
        jacobian[:, :9] = self.root @ slope
        return self.root @ away, jacobian

    def away(self, parameters: Array) -> tuple[Array, Array]:
        """Return the deviation (9,) of θ from the prior values, and its derivative (9, 9) on the first nine
        parameters.
        """
        strength, slope = field_strength(parameters[:6])
        scaled = parameters[:6] / strength
        derivative = np.eye(9)
        derivative[:6, :6] = (np.eye(6) - np.outer(scaled, slope)) / strength
        return np.concatenate([scaled - self.shape, parameters[6:9] - self.hard_iron]), derivative


def field_strength(soft_iron: Array) -> tuple[float, Array]:
    """Return ∛|det S| of vech(S) (6,), and its derivative (6,): d∛det S = ∛det S / 3 · tr(S⁻¹ dS)."""
    matrix = unvech(soft_iron)
    strength = strength_of(matrix)
    return strength, strength / 3 * vech(inverse(matrix)) * MULTIPLICITY


def strength_of(iron: Array) -> float:
    """Return the field strength ∛|det B| of an iron matrix B (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = iron.tolist()
    return float(np.cbrt(abs(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))))


def quadratic(facts: Sequence[Fact], parameters: Array) -> tuple[float, Array, Array]:
    """Return half the sum of squares of all facts at θ (p,), its gradient (p,) and its information (p, p)."""
    size = len(parameters)
    cost, gradient, information = 0.0, np.zeros(size), np.zeros((size, size))
    for fact in facts:
        residual, jacobian = fact.residual(parameters)
        cost += 0.5 * float(residual @ residual)
        gradient += jacobian.T @ residual
        information += jacobian.T @ jacobian
    return cost, gradient, information
