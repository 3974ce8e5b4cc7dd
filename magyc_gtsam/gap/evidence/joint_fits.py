"""The joint fit of a set of effects, and its log evidence.

The evidence of a set is that of its linear model at the joint minimum (Laplace): parameters have no prior; amplitudes
have one, and are averaged over its scales. The residual is white noise, or white noise with a varying field of the
place (`field_variation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.evidence.candidates import COLOUR, Candidates
from magyc_gtsam.gap.evidence.laplace import Terms, marginal
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION, Node
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.field_variation import COLOURS, COMBINATIONS, FieldVariation, field_variation
from magyc_gtsam.gap.model.problem import Model, Problem
from magyc_gtsam.gap.model.refit import Refit, possible, refit
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

VARIES = float(np.log(COMBINATIONS))  # nats for the choice of the most probable combination
_COLOURED = float(np.log(COLOURS))  # the same for that of coloured noise
_SETTLED = 4  # rounds of finding a setting again at the minimum
_BEYOND = 2.0  # times the largest possible value, from which a fit that has not converged will not be possible


@dataclass(frozen=True, eq=False)
class JointFits:
    """The fits of sets of effects to one recording.

    Attributes:
        problem: the data.
        candidates: further effects and families, which are tested beside a set.
        square, freedom: of the residual without effects, and the number of values that the parameters leave.
    """

    problem: Problem
    candidates: Candidates
    square: float
    freedom: int

    @classmethod
    def of(cls, root: Refit, names: Sequence[str]) -> JointFits:
        """Begin with the fit of a model without effects, and the names of candidates."""
        terms = Terms.of(root)
        freedom = len(terms.residual) - len(terms.base)
        return cls(root.twin.problem, Candidates.of(root.twin, names), terms.beside(None).square, freedom)

    def fit(self, model: Model, known: Twin | None) -> Refit | None:
        """Fit a model; None if there is no fit or a value is impossible."""
        try:
            fit = refit(self.problem, model, None, known, _BEYOND * RULES.farthest)
        except MagycError:
            return None
        return fit if all(possible(fit, index) for index in range(len(fit.model.terms))) else None

    def node(
        self, names: tuple[str, ...], fit: Refit, search: float, variation: FieldVariation | None = None
    ) -> Node:
        """Return the set of a fit; the variation of the field is estimated unless it is given."""
        if variation is None and FIELD_VARIATION in names:
            variation = field_variation(fit.twin, coloured=COLOUR in names)
        terms = Terms.of(fit)
        plain = terms.beside(variation)
        evidence, scales, of_terms, left = marginal(terms, plain, fit)
        log = 0.5 * (self.square - plain.square - plain.log_determinant) + evidence
        log -= self.freedom * np.log(plain.noise) + (VARIES if variation is not None else 0.0)
        log -= _COLOURED if COLOUR in names else 0.0
        return Node(
            names,
            fit,
            variation,
            float(log + len(names) * PRIOR.named - search),
            search,
            left / self.freedom,
            self.square / plain.noise**2 - left,
            of_terms,
            scales,
            terms.added_to(plain, scales),
            self.candidates,
        )

    def settled(self, node: Node) -> Node:
        """Return a set with the setting of each effect that is most probable at its minimum.

        A setting was found in the linear model of a set without the effect, far from that minimum if the effect is
        large or if others are missing.
        """
        for _ in range(_SETTLED):
            before = node
            for index in reversed(range(len(node.scales))):
                node = self._closer(node, index)
            if node is before:
                break
        return node

    def _closer(self, node: Node, index: int) -> Node:
        """Return a set with the more probable setting of a term nearby, if there is one."""
        setting = node.closer(index)
        if setting == node.fit.model.terms[index].setting:
            return node
        terms = list(node.fit.model.terms)
        terms[index] = replace(terms[index], setting=setting)
        fit = self.fit(replace(node.fit.model, terms=tuple(terms)), node.fit.twin)
        ahead = None if fit is None else self.node(node.names, fit, node.search)
        return node if ahead is None or ahead.log <= node.log else ahead
