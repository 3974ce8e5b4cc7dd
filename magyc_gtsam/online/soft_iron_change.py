"""Whether the soft iron changed with the hard iron at a step, as by steel, and the error that this may cause.

After a step in hard iron the chain goes on from the marginal of the windows before it (`restart`), which knows the soft
iron, and the attitude of the chips to each other. Steel changes both: its soft iron need not be symmetric, and what is
not symmetric turns the field, which is a misalignment. A change of E (18, 9) δ, δ ~ N(0, s²), between the marginal and
the windows is a nuisance beside θ: it enters the marginal alone, as x − E δ. With S and g its information and gradient
after θ and all directions are eliminated, divided by the residuals' colour, and C the covariance of θ without it,

    ln p(data | s) / p(data | none) = ½ gᵀ D g − ½ ln |I + s² S|,   D = (S + 1/s²)⁻¹,
    θ − θ₀ ~ N(G δ̂, C + G D Gᵀ),   δ̂ = −D g,   G = dθ/dδ,

in closed form from one linearisation. With the posterior probability p of a change, p (G D Gᵀ + G δ̂ δ̂ᵀ Gᵀ) is added to
the covariance. From a probability of 0.9 on the marginal is widened by the change instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.smoother.fit import Fit, inverse_information
from magyc_gtsam.estimators.smoother.marginal import ContinuedChain, Marginal, continued
from magyc_gtsam.estimators.smoother.skew import widened
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC
from magyc_gtsam.factors.chain.banded import forward_solved
from magyc_gtsam.factors.chain.chain_values import SKEW, WITH_SKEW
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech

SOFT_IRON = slice(0, 6)
_CERTAIN = 50.0  # nats beyond which evidence does not count


@dataclass(frozen=True)
class _Belief:
    """What is believed of the soft iron at a step in hard iron before the windows after it are known.

    Attributes:
        odds: prior odds that it changed. With 0.3 and 3 in place of 1 the hard iron is beyond 3 sigmas in 20 and 15 of
            1,600 looks in place of 16 (136 while the past was certain), and the sigmas after steps of the hard iron
            alone are the same within 0.2 %.
        sizes: standard deviations of an element of a change, as a share of the field strength, equally probable.
            With 0.01 as well the hard iron is beyond 3 sigmas in 30 of 4,900 looks in place of 24.
        probable: posterior probability from which the marginal is widened. With 0.5 and 0.99 in place of 0.9 as many
            looks are wrong.
    """

    odds: float = 1.0
    sizes: tuple[float, ...] = (0.02, 0.04, 0.08)
    probable: float = 0.9


_BELIEF = _Belief()


class SoftIronChange(NamedTuple):
    """A possible change of the soft iron at the step before a chain.

    Attributes:
        component: the error that it may cause, (16, 16).
        past: the marginal before the step, widened by the change.
    """

    component: Component
    past: Marginal

    @property
    def probable(self) -> bool:
        """Whether a change is so probable that the marginal is to be widened."""
        return self.component.share > _BELIEF.probable


def soft_iron_change(fit: Fit, colour: float) -> SoftIronChange | None:
    """Return the change of the soft iron before a chain that continues a marginal; None if that knows no soft iron.

    Args:
        fit: at its minimum.
        colour: correlation factor of the residuals, by a fit that a change does not raise.
    """
    chain = continued(fit)
    if chain.past is None or not chain.past.information[SOFT_IRON].any():
        return None
    columns = _columns(fit)
    information, gradient, moves = _beside(fit, chain, columns)
    information, gradient = information / colour, gradient / colour
    sizes, evidence, moments = np.array(_BELIEF.sizes), [], []
    for size in sizes:
        spread = np.linalg.inv(information + np.eye(9) / size**2)
        change = -spread @ gradient
        volume = np.linalg.slogdet(np.eye(9) + size**2 * information)[1]
        evidence.append(0.5 * float(-gradient @ change - volume))
        moments.append(spread + np.outer(change, change))
    best = max(evidence)
    likely = np.exp(np.array(evidence) - best)
    odds = _BELIEF.odds * float(likely.mean()) * np.exp(min(best, _CERTAIN))
    likely /= likely.sum()
    share = float(odds / (1 + odds))
    size = float(np.sqrt(likely @ sizes**2))
    second = share * moves @ np.einsum("k,kij->ij", likely, moments) @ moves.T
    words = "the soft iron may have changed at the step in hard iron"
    name = "soft iron at a step"
    component = Component(name, words, size * columns[0, 0], best, second, share=share)
    return SoftIronChange(component, chain.past.changed(size / np.sqrt(colour) * columns))


def _columns(fit: Fit) -> Array:
    """Return E (18, 9): the soft iron, T, and the turn by what is not symmetric of it, rad, as shares of the field."""
    result = np.zeros((WITH_SKEW + 2, 9))
    result[SOFT_IRON, :6] = float(np.cbrt(abs(np.linalg.det(unvech(fit.state.parameters[:6]))))) * np.eye(6)
    result[SKEW, 6:] = np.sqrt(0.5) * np.eye(3)
    return result


def _beside(fit: Fit, chain: ContinuedChain, columns: Array) -> tuple[Array, Array, Array]:
    """Return S (9, 9) and g (9,) of the module's docstring without colour, and G (16, 9)."""
    wide = widened(replace(fit, chain=chain), AUTOMATIC)
    past, reduced, state = chain.past, wide.reduced, wide.state
    assert past is not None
    onto = past.information @ columns
    slope = past.gradient + past.information @ chain.away(state)
    border = np.zeros((9, 2, len(chain.windows)))
    border[:, :, 0] = -onto[WITH_SKEW:].T @ chain.origin[1].T @ reduced.basis[:, :, 0]
    absorbed = forward_solved(reduced.band_factor, border)
    cross = -onto[:WITH_SKEW].T - absorbed @ reduced.half[:, :-1]
    gradient = -columns.T @ slope - absorbed @ reduced.half[:, -1]
    covariance = inverse_information(reduced.information, wide.free)
    explained = cross @ covariance
    information = columns.T @ onto - absorbed @ absorbed.T - explained @ cross.T
    return 0.5 * (information + information.T), gradient - explained @ reduced.gradient, -explained.T
