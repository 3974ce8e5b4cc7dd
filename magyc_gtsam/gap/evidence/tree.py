"""A tree over sets of effects: each set fitted jointly and weighed, the likeliest followed.

The evidence of a set is that of its linear model at its joint minimum (Laplace): parameters without a prior, and
amplitudes with theirs, each scale averaged over, beside white noise or beside a field of the place that varies
(`field_variation`).
What stands beside a set (further names, families) is weighed there without a fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates, at_settings
from magyc_gtsam.gap.evidence.laplace import Terms, marginal
from magyc_gtsam.gap.evidence.one_way import one_way
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed, best_of, weigh
from magyc_gtsam.gap.model.field_variation import COMBINATIONS, FieldVariation, field_variation
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import Refit, possible, refit, with_term, without_term
from magyc_gtsam.gap.model.variants import Projector
from magyc_gtsam.gap.scores.neighbours import neighbours

FIELD_VARIATION = "field-variation"
_VARIES = float(np.log(COMBINATIONS))  # of which the likeliest is taken
_FINER = 2  # rounds of refining a setting


@dataclass(frozen=True, eq=False)
class Node:
    """A set of effects at its joint minimum.

    Attributes:
        names: of the set, in the order of adding.
        fit: of the model with them.
        variation: of the field, where that is in the set.
        log: nats of the set with its prior odds, against nothing.
        search: nats, that the searches over settings cost, in `log`.
        misfit: mean square of what is left, of its noise.
        explained: power of all that the set explains.
        powers: (t, t) of each term of the model, beside the others, and of each as a form of another (`marginal`).
        beside: the set, beside which everything else is weighed.
        found: what else explains the data there.
        refined: names of which the likeliest setting was found on a finer grid.
        moving: nats of what varies as the field of a place does, but in the sensor's axes: of something unknown.
    """

    names: tuple[str, ...]
    fit: Refit
    variation: FieldVariation | None
    log: float
    search: float
    misfit: float
    explained: float
    powers: Array
    beside: Beside
    found: dict[str, Weighed] = field(default_factory=dict)
    moving: list[float] = field(default_factory=list)
    refined: set[str] = field(default_factory=set)

    @property
    def key(self) -> tuple[str, ...]:
        """The names in their own order."""
        return tuple(sorted(self.names))

    @cached_property
    def left(self) -> Array:
        """(3n,) innovations that the parameters and terms leave, whatever the field does."""
        twin = self.fit.twin
        result: Array = Projector(twin.base_columns, twin.base_pull)(twin.residual().reshape(1, -1))[0]
        return result

    @property
    def named(self) -> float:
        """Power of what its names explain."""
        return self.explained - self.of_field if self.names else 0.0

    @cached_property
    def of_field(self) -> float:
        """Power of what a field that varies explains beside the names of a set."""
        if self.variation is None:
            return 0.0
        without, rows = float(self.left @ self.left) / self.variation.noise**2, len(self.left)
        return max(without - self.misfit * rows, 0.0)


class Tree:
    """The sets of names of one recording that were fitted."""

    def __init__(self, root: Refit, names: Sequence[str], given: Sequence[Active] = ()) -> None:
        """Grow it from a model without effects; `given` are those of a calibration, tried whatever they explain."""
        self._problem, self._names = root.twin.problem, tuple(names)
        self.candidates = Candidates.of(root.twin, self._names)
        terms = Terms.of(root)
        plain = terms.beside(None)
        self.square, self.freedom = plain.square, len(terms.residual) - len(terms.base)
        self.nodes: dict[tuple[str, ...], Node] = {}
        self.refused: set[tuple[str, ...]] = set()  # sets with an impossible value, or without a fit
        first = self._node((), root, None, 0.0)
        self.nodes[first.key] = first
        self._grow([first, *self._given(root, given)])
        while self._exchanged() or self._deepened():
            pass

    @property
    def best(self) -> Node:
        """The likeliest set."""
        return max(self.nodes.values(), key=lambda node: node.log)

    def _given(self, root: Refit, given: Sequence[Active]) -> Iterator[Node]:
        model = root.model
        for term in given:
            model = with_term(model, term)
        if given:
            node = self._node(tuple(term.name for term in given), refit(self._problem, model, None), None, 0.0)
            self.nodes[node.key] = node
            yield node

    def _grow(self, frontier: list[Node]) -> None:
        while frontier and len(self.nodes) < PRIOR.nodes:
            node = max(frontier, key=lambda each: each.log)
            frontier.remove(node)
            if len(node.fit.model.terms) >= PRIOR.depth or node.log < self.best.log - PRIOR.close:
                continue
            for child in self._children(node):
                self.nodes[child.key] = child
                frontier.append(child)

    def _exchanged(self) -> bool:
        """Whether another set is likelier than the best with one of its names for a rival, or for two of them.

        The strongest single name may be one that holds some of each of two others: a drift of two jumps.
        """
        best = self.best
        for index, term in enumerate(best.fit.model.terms):
            node = self.less(best, index)
            rivals = [each for each in best_of(node.found, len(TERMS)) if related(each.name, term.name)]
            for option in rivals[: PRIOR.beam]:
                one = self._fitted(node, option)
                if one is None:
                    continue
                again = [each for each in best_of(one.found, len(TERMS)) if related(each.name, term.name)][:1]
                for more in again if len(one.names) < PRIOR.depth else []:
                    self._fitted(one, more)
        return self.best is not best

    def _deepened(self) -> bool:
        """Whether the best set is likelier with one more name."""
        best = self.best
        options = [each for each in best_of(best.found, len(TERMS)) if not self._full(best, each.name)][:1]
        for option in options if len(best.fit.model.terms) < PRIOR.depth else []:
            key = tuple(sorted((*best.names, option.name)))
            child = self._child(best, option) if key not in self.nodes and option.log + PRIOR.named > 0 else None
            if child is not None:
                self.nodes[key] = child
        return self.best is not best

    @staticmethod
    def _full(node: Node, name: str) -> bool:
        return node.names.count(name) >= TERMS[name].most

    def _fitted(self, node: Node, option: Weighed) -> Node | None:
        """A set with one more name, which is kept; None where it has no fit, or there are enough."""
        key = tuple(sorted((*node.names, option.name)))
        full = self._full(node, option.name)
        if key not in self.nodes and not full and len(self.nodes) < PRIOR.most and option.log + PRIOR.named > 0:
            child = self._child(node, option)
            if child is not None:
                self.nodes[key] = child
        return self.nodes.get(key)

    def less(self, node: Node, index: int) -> Node:
        """A set without the term `index` of its model, fitted where it was not."""
        names = list(node.names)
        names.remove(node.fit.model.terms[index].name)
        known = self.nodes.get(tuple(sorted(names)))
        rest = [term.setting for i, term in enumerate(node.fit.model.terms) if i != index]
        if known is not None and all(term.setting in rest for term in known.fit.model.terms):
            return known
        fit = refit(self._problem, without_term(node.fit.model, index), None)
        variation = None if node.variation is None else field_variation(fit.twin)
        return self._likelier(self._node(tuple(names), fit, variation, node.search))

    def _likelier(self, node: Node) -> Node:
        """Keep a set, if the same names at other settings are not likelier."""
        known = self.nodes.get(node.key)
        if known is None or known.log < node.log:
            self.nodes[node.key] = node
        return node

    def _children(self, node: Node) -> Iterator[Node]:
        if node.variation is None and node.misfit > 1 + PRIOR.misfit * np.sqrt(2 / self.freedom):
            key = tuple(sorted((*node.names, FIELD_VARIATION)))
            variation = field_variation(node.fit.twin)
            if len(variation.components):
                node.moving.append(field_variation(node.fit.twin, in_world=False).gain - _VARIES)
            if key not in self.nodes and len(variation.components):
                yield self._node((*node.names, FIELD_VARIATION), node.fit, variation, node.search)
        options = best_of(node.found, PRIOR.beam)
        for option in options:
            if option.log + PRIOR.named < -1.0 or option.log < options[0].log - PRIOR.close:
                continue
            key = tuple(sorted((*node.names, option.name)))
            if key in self.nodes or self._full(node, option.name):
                continue
            if len(self.nodes) < PRIOR.nodes:
                child = self._child(node, option)
                if child is not None:
                    yield child

    def _child(self, node: Node, option: Weighed) -> Node | None:
        term, setting = TERMS[option.name], dict(option.setting)
        key = tuple(sorted((*node.names, option.name)))
        if key in self.refused:
            return None
        if option.name not in node.refined:
            setting = dict(self._finer(node, option).setting)
        count = len(term.regressors(node.fit.twin, setting).window)
        try:
            model = with_term(node.fit.model, Active(option.name, setting, np.zeros(count)))
            fit = refit(self._problem, model, None, node.fit.twin)
        except MagycError:
            self.refused.add(key)
            return None
        if not all(possible(fit, index) for index in range(len(fit.model.terms))):
            self.refused.add(key)
            return None
        variation = None if node.variation is None else field_variation(fit.twin)
        return self._node((*node.names, option.name), fit, variation, node.search + option.search)

    def _node(self, names: tuple[str, ...], fit: Refit, variation: FieldVariation | None, search: float) -> Node:
        terms = Terms.of(fit)
        plain = terms.beside(variation)
        evidence, scales, powers, left = marginal(terms, plain, fit)
        log = 0.5 * (self.square - plain.square - plain.log_determinant) + evidence
        log -= self.freedom * np.log(plain.noise) + (_VARIES if variation is not None else 0.0)
        beside = terms.beside(variation, scales)
        node = Node(
            names,
            fit,
            variation,
            float(log + len(names) * PRIOR.named - search),
            search,
            left / self.freedom,
            self.square / plain.noise**2 - left,
            powers,
            beside,
        )
        node.found.update(self._found(node))
        return node

    def _finer(self, node: Node, option: Weighed) -> Weighed:
        """An option with the cell of its likeliest setting integrated on a finer grid, where there is one.

        A jump is known to a fraction of the grid's spacing: between two of its times most of it would be missed. Of
        something that was attached and taken off one end is refined beside the other.
        """
        twin = node.fit.twin
        for _ in range(_FINER):
            near = TERMS[option.name].refined(twin, dict(option.setting))
            if not near:
                break
            finer = Candidates.of_parts(twin, [at_settings(twin, option.name, near)])
            option, before = option.with_cell(weigh(finer, node.beside, node.named)[option.name]), option
            if option.setting == before.setting or "until" not in option.setting:
                break
        return option

    def _found(self, node: Node) -> dict[str, Weighed]:
        twin = node.fit.twin
        found = weigh(self.candidates, node.beside, node.named)
        for each in best_of(found, PRIOR.beam):
            found[each.name] = self._finer(node, each)
            node.refined.add(each.name)
        # A product with another signal may be there beside its name, and in place of one that is likely: at the
        # setting of that, for which it costs the same search.
        likely = [(each.name, each.setting, each.search) for each in best_of(found, PRIOR.beam) if each.log > 0]
        likely += [(term.name, term.setting, 0.0) for term in node.fit.model.terms]
        products = {f.name: (f, cost) for name, at, cost in likely for f in neighbours(twin, name, at)}
        if products:
            made = weigh(Candidates.of(twin, (), [f for f, _ in products.values()]), node.beside, node.named)
            found |= {name: each.less(products[name][1]) for name, each in made.items()}
        if "hard-iron-drift" not in node.names:
            found |= one_way(self.candidates, node.beside, node.named)
        return found


def related(one: str, other: str) -> bool:
    """Whether the catalogue says that one is confused with the other."""
    return one == other or other in TERMS[one].rivals or one in TERMS[other].rivals
