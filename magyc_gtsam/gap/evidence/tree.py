"""A tree of sets of effects: each set is fitted jointly and has its log evidence, and the most probable are extended.

Further effects and families are tested beside a set without a fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.candidates import COLOUR, with_each_drift
from magyc_gtsam.gap.evidence.joined import joined
from magyc_gtsam.gap.evidence.joint_fits import JointFits
from magyc_gtsam.gap.evidence.look import finer
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION, Node, one_event, related
from magyc_gtsam.gap.evidence.outline import Outline
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.weighing import Weighed, best_of
from magyc_gtsam.gap.model.field_variation import field_variation
from magyc_gtsam.gap.model.problem import Active, Model
from magyc_gtsam.gap.model.refit import Refit, refit, with_term, without_term
from magyc_gtsam.gap.rules import RULES

_MORE_MODES = float(np.log(RULES.drift_finer))


class Tree:
    """The fitted sets of effects of one recording."""

    def __init__(
        self, root: Refit, names: Sequence[str], given: Sequence[Active] = (), before: Outline | None = None
    ) -> None:
        """Grow the tree from a model without effects.

        Args:
            root: the fit of that model.
            names: candidates.
            given: terms of a calibration, fitted in any case.
            before: outline of the tree of nearly the same readings: from its probable sets this one is grown, those
                that had no fit are refused.
        """
        self.fits = JointFits.of(root, names)
        self.nodes: dict[tuple[str, ...], Node] = {}
        # Without a possible fit.
        self.refused: set[tuple[str, ...]] = set() if before is None else set(before.refused)
        again = () if before is None else self._again(root, before.near)
        # Terms, name and setting, that are not exchanged again, and the sets without one that are not fitted therefore.
        self._unrivalled: set[tuple[object, ...]] = set() if before is None else set(before.unrivalled)
        self._spared: set[tuple[str, ...]] = set()
        first = [self.fits.node((), root, 0.0), *self._given(root, given), *again]
        self.nodes |= {node.key: node for node in first}
        self._grow(first)

    def complete(self) -> None:
        """Add the sets in which effects are exchanged for rivals, and one more to those that may become better.

        What is evident beside the best set is added first: exchanges beside a set that lacks it are of no use, and may
        be as many as there are sets to be fitted.
        """
        while self._deepened() or self._exchanged() or self._deepened() or self._joined() or self._left_out():
            pass

    @property
    def best(self) -> Node:
        """Return the most probable set."""
        return max(self.nodes.values(), key=lambda node: node.log)

    @property
    def bare(self) -> Node:
        """Return the set without effects, with the varying field of the place if there is one."""
        return self.nodes.get((FIELD_VARIATION,), self.nodes[()])

    @property
    def _full(self) -> bool:
        return len(self.nodes.keys() | self._spared) >= PRIOR.most

    @property
    def outline(self) -> Outline:
        """Return what is taken over: the sets of effects that are probable, alone or with a candidate more."""
        least = self.best.log - PRIOR.certain
        possible = [node for node in self.nodes.values() if node.names and node.log + node.most > least]
        likely = [node for node in possible if node.log + node.more > least]
        near = tuple((node.names, node.fit.model, node.search) for node in likely)
        return Outline(near, frozenset(self.refused), frozenset(self._unrivalled))

    def _given(self, root: Refit, given: Sequence[Active]) -> Iterator[Node]:
        model = root.model
        for term in given:
            model = with_term(model, term)
        if given:
            yield self.fits.node(tuple(term.name for term in given), refit(self.fits.problem, model, None), 0.0)

    def _again(self, root: Refit, before: Sequence[tuple[tuple[str, ...], Model, float]]) -> Iterator[Node]:
        """Fit sets of nearly the same readings."""
        for names, model, search in before:
            fit = self.fits.fit(replace(model, noise=root.model.noise), None)
            if fit is None:
                self.refused.add(tuple(sorted(names)))
            else:
                yield self.fits.node(names, fit, search)

    def _grow(self, frontier: list[Node]) -> None:
        while frontier and len(self.nodes) < PRIOR.nodes:
            node = max(frontier, key=lambda each: each.log)
            frontier.remove(node)
            if len(node.fit.model.terms) >= PRIOR.depth or node.log < self.best.log - PRIOR.certain:
                continue
            for child in self._children(node):
                self.nodes[child.key] = child
                frontier.append(child)

    def _exchanged(self) -> bool:
        """Exchange an effect of the best set for one or two of its rivals; return whether a better set was found.

        The strongest single effect may resemble the sum of two others, as a drift does that of two jumps. One of the
        two then explains at least half of what the effect does, in the linear model of the best set, too: only then is
        the set without the effect fitted. An effect of which no rival explains a third there keeps its place when the
        best set gets one more.
        """
        best = self.best
        for index, term in enumerate(best.fit.model.terms):
            place = term.name, tuple(term.setting.items())
            if not best.replaceable(index):
                continue
            if place in self._unrivalled:
                self._spared.add(best.key_without(term.name))
                continue
            node = self.less(best, index)
            if node is None:
                continue
            gap = best.log - node.log
            for option in islice(self._options(node, term.name), PRIOR.beam):
                if option.log + PRIOR.named < 0.5 * gap:
                    break
                one = self._fitted(node, option)
                if one is not None and len(one.names) < PRIOR.depth:
                    for more in islice(self._options(one, term.name), 1):
                        self._fitted(one, more)
            rival = next((each.log + PRIOR.named for each in self._options(node, term.name)), 0.0)
            # Where the linear model says less of the effect, it may lose its place beside another one.
            if rival < PRIOR.unrivalled * gap < best.of_terms.nats[index]:
                self._unrivalled.add(place)
        return self.best is not best

    def _deepened(self) -> bool:
        """Add one more effect to the best set, and to those that may become better; return whether one is.

        Candidates that are as probable in the linear model as one that was added are fitted, too, and what was added to
        a set is added to one that differs by one name and is as probable.
        """
        best = self.best
        parents = {name: self.nodes.get(best.key_without(name)) for name in best.names}
        for node in [each for each in self.nodes.values() if len(each.fit.model.terms) < PRIOR.depth]:
            others = {n: one for n, one in parents.items() if one is not None and node.differs_by_one_from(one)}
            beside = {name for name, one in others.items() if node.log > one.log - PRIOR.alike}
            if not beside and not best.has_one_more_than(node) and node.log + node.most < best.log:
                continue
            added = [each for each in node.found.values() if node.key_with(each.name) == best.key]
            for option in self._options(node):
                ahead = node is best or node.log + option.log + PRIOR.named > best.log
                alike = any(option.log > other.log - PRIOR.alike for other in added)
                if self._full:
                    break
                if not (option.name in beside or (alike if added else ahead)):
                    continue
                if self._fitted(node, option) is not None:
                    added.append(option)
                # A set that is far ahead is extended first, before the sets are too many.
                if self.best.log > best.log + PRIOR.certain:
                    return True
        return self.best is not best

    def _joined(self) -> bool:
        """Replace two changes of the best set, until one time and from another one on, by one.

        If both have the same value, one has half as many. Return whether a better set was found.
        """
        best = self.best
        for name, model in joined(best.fit.model, best.fit.twin.duration):
            fit = self.fits.fit(model, None)
            if fit is not None:
                self._keep(self.fits.settled(self.fits.node(best.names_without(name), fit, best.search)))
        return self.best is not best

    def _left_out(self) -> bool:
        """Leave out the effects of the best set that add less than they cost; return whether a better set was found.

        What was added first may explain nothing any more beside what was added later: a drift had stood for a scale
        that grows with the rate, and for a gradient beside a current.
        """
        best = self.best
        nats = best.of_terms.nats + PRIOR.named
        for index in sorted(range(len(nats)), key=lambda one: nats[one]):
            if nats[index] < 0:
                self.less(best, index)
        return self.best is not best

    def _options(self, node: Node, instead_of: str | None = None) -> Iterator[Weighed]:
        """Yield the candidates that may be added to a set, or those confused with an effect, the most probable first.

        Sets without a possible fit are skipped, those that were found to have none since the last candidate, too.
        """
        for each in best_of(node.found, len(TERMS)):
            fits = instead_of is None or (each.name != instead_of and related(each.name, instead_of))
            if fits and not node.full(each.name) and node.key_with(each.name) not in self.refused:
                yield each

    def _fitted(self, node: Node, option: Weighed) -> Node | None:
        """Return a set with one more effect, fitted if necessary; None if it has no fit, or the limit is reached."""
        key = node.key_with(option.name)
        if key not in self.nodes and not self._full and option.log + PRIOR.named > 0:
            child = self.child(node, option)
            if child is not None:
                self.nodes[key] = child
        return self.nodes.get(key)

    def less(self, node: Node, index: int) -> Node | None:
        """Return a set without the term `index` of its model, fitted if necessary; None if it has no minimum."""
        name = node.fit.model.terms[index].name
        known = self.nodes.get(node.key_without(name))
        rest = [term.setting for i, term in enumerate(node.fit.model.terms) if i != index]
        if known is not None and all(term.setting in rest for term in known.fit.model.terms):
            return known
        try:
            fit = refit(self.fits.problem, without_term(node.fit.model, index), None)
        except MagycError:
            return None
        names = node.names_without(name)
        less = self.fits.node(names, fit, node.search)
        self._keep(less)
        return less

    def _keep(self, node: Node) -> None:
        known = self.nodes.get(node.key)
        if known is None or known.log < node.log:  # otherwise the same names with other settings are more probable
            self.nodes[node.key] = node

    def _children(self, node: Node) -> Iterator[Node]:
        if node.variation is None and node.misfit > 1 + PRIOR.misfit * np.sqrt(2 / self.fits.freedom):
            key = node.key_with(FIELD_VARIATION)
            variation = field_variation(node.fit.twin)
            if key not in self.nodes and len(variation.components):
                yield self.fits.node((*node.names, FIELD_VARIATION), node.fit, node.search, variation)
        colour, names = node.found.get(COLOUR), (*node.names, COLOUR)
        beside = (
            node.variation is not None and COLOUR not in node.names and node.key_with(COLOUR) not in self.nodes
        )
        if beside and colour is not None and colour.log + PRIOR.named > 0:
            yield self.fits.node(names, node.fit, node.search)
        least, tried = -1.0 - PRIOR.named, list[Weighed]()
        for option in self._options(node):
            if option.log < least or len(tried) == PRIOR.beam or len(self.nodes) >= PRIOR.nodes:
                break
            if any(one_event(option, other) for other in tried):
                continue  # a rival, which is exchanged for it
            if node.key_with(option.name) not in self.nodes:
                child = self.child(node, option)
                if child is None:
                    continue
                yield child
            least = max(least, option.log - PRIOR.certain)
            tried.append(option)

    def child(self, node: Node, option: Weighed) -> Node | None:
        """Return a set with one more effect, fitted; None if it has no fit."""
        setting = dict(option.setting)
        if option.name not in node.refined:
            setting = dict(finer(option, node.fit.twin, node.beside).setting)
        count = len(node.fit.twin.columns(option.name, setting).window)
        term = Active(option.name, setting, np.zeros(count), option.prior)
        model = with_term(node.fit.model, term)
        names, search = (*node.names, option.name), node.search + option.search

        def fitted(model: Model) -> Node | None:
            fit = self.fits.fit(model, node.fit.twin)
            return None if fit is None else self.fits.node(names, fit, search)

        models, place = with_each_drift(model, node.fit.twin)
        best = fitted(models[place])
        if best is None:
            self.refused.add(node.key_with(option.name))
            return None
        first = best
        for way, others in ((-1, models[:place][::-1]), (1, models[place + 1 :])):
            for each in others if best is first else ():  # a number of modes has a prior of 1 / number
                child = fitted(each)
                if child is None or child.log < best.log + way * _MORE_MODES:
                    break
                best = child
        return best if best.log < self.best.log - PRIOR.certain else self.fits.settled(best)
