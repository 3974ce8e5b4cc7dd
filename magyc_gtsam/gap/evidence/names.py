"""The names of a set: its terms that exceed what another one may explain by a deviation from its form."""

from __future__ import annotations

from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.candidates import COLOUR
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION, Node
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.rules import RULES


def kept(tree: Tree, node: Node) -> list[int]:
    """Return the terms of a set that exceed the deviation from its form of another one or of the field variation.

    If each of two terms may be the deviation of the other, the one with more evidence remains. The terms are left out
    one by one, the least evident first, since another one explains more without them.
    """
    terms = node.fit.model.terms
    alone = node.of_terms.powers(range(len(terms)))
    result = sorted(range(len(terms)), key=lambda one: -_evidence_of(tree, node, one, alone[one, one]))
    while True:
        powers = node.of_terms.powers(result)
        for place in reversed(range(len(result))):
            index, stronger = result[place], result[:place]
            deviations = [PRIOR.form_of_field * node.of_field, *(PRIOR.form * powers[index, j] for j in stronger)]
            passed = any(_one_passing(terms[index], terms[other]) for other in stronger)
            if passed or powers[index, index] <= max(deviations):
                del result[place]
                break
        else:
            return sorted(result)


def _evidence_of(tree: Tree, node: Node, index: int, power: float) -> float:
    """Return the nats of a term relative to the same set without it, if that was fitted; else half its power."""
    less = list(node.names)
    less.remove(node.fit.model.terms[index].name)
    without = tree.nodes.get(tuple(sorted(less)))
    return 0.5 * power if without is None else node.log - without.log


def _one_passing(one: Active, other: Active) -> bool:
    """Return whether two bumps belong to one passed object, whose field rotates meanwhile."""
    if one.name != "local-anomaly" or other.name != one.name:
        return False
    widths = one.setting["width"] + other.setting["width"]
    return abs(one.setting["time"] - other.setting["time"]) < RULES.span * widths


def key_of(tree: Tree, node: Node) -> tuple[str, ...]:
    """Return the names of the remaining terms, sorted, with the field variation if it is evident."""
    names = {node.fit.model.terms[index].name for index in kept(tree, node)}
    if node.variation is not None:  # the effects may explain all of it
        names |= {FIELD_VARIATION} if node.variation.evident else set()
        colour, contained = node.of_colour
        names |= {COLOUR} if colour > PRIOR.form * contained else set()
    return tuple(sorted(names))


def names_of(tree: Tree, node: Node) -> frozenset[str]:
    """Return the effects of the catalogue in a set."""
    return frozenset(key_of(tree, node)).intersection(TERMS)


def powers_of(tree: Tree, node: Node) -> dict[str, float]:
    """Return the power that each name of a set explains."""
    result, there = dict.fromkeys(key_of(tree, node), 0.0), kept(tree, node)
    powers = node.of_terms.powers(there)
    for index in there:
        result[node.fit.model.terms[index].name] += powers[index, index]
    if FIELD_VARIATION in result:
        result[FIELD_VARIATION] = node.of_field
    return result
