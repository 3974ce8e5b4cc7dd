"""From a tree of sets to probabilities: of each set, of what is unknown beside it, of each name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.special import logsumexp

from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import FIELD_VARIATION, Node, Tree, related
from magyc_gtsam.gap.problem import Active
from magyc_gtsam.gap.rules import RULES

Set = tuple[tuple[str, ...], bool]  # names, and whether something unknown is beside them
_FORM = float(
    np.log(0.5)
)  # odds that a form is visibly not quite the catalogue's, while it is by less than `form`


def weights(tree: Tree) -> dict[Set, float]:
    """{set: log weight}: each by itself, with its form a little wrong, or beside something unknown."""
    result: dict[Set, float] = {}
    tried = tree.nodes.keys() | tree.refused

    def add(key: tuple[str, ...], unknown: bool, log: float) -> None:
        result[key, unknown] = float(np.logaddexp(result.get((key, unknown), -np.inf), log))

    for node in tree.nodes.values():
        key = key_of(node)
        form, foreign = _families(tree, node)
        add(key, False, np.logaddexp(node.log, node.log + _FORM + form) if np.isfinite(form) else node.log)
        if np.isfinite(foreign):
            add(key, True, node.log + PRIOR.unknown + foreign)
        for log in node.moving:
            add(key, True, node.log + PRIOR.unknown - np.log(max(len(node.found), 1)) + log)
        for each in node.found.values():  # what was not worth a fit still has its share, as linearised
            more = tuple(sorted((*node.names, each.name)))
            if each.name in TERMS and each.name not in node.names and more not in tried:
                seen = each.power > PRIOR.form * of_field(node)
                if seen.any():
                    log = node.log + PRIOR.named + logsumexp(each.by_scale[seen])
                    add(tuple(sorted({*key, each.name})), False, log)
    return result


def _families(tree: Tree, node: Node) -> tuple[float, float]:
    """Nats of families without a name that are no more than the form of the set, and of those that are more."""
    families = [each for each in node.found.values() if each.name not in TERMS]
    form, foreign = [], []
    for each in families:
        small = each.power < PRIOR.form * node.explained
        if small.any():
            form.append(logsumexp(each.by_scale[small]))
        if (~small).any():
            foreign.append(logsumexp(each.by_scale[~small]) + _beyond(tree, node, each.name))
    share = np.log(max(len(families), 1))
    return (
        float(logsumexp(form) - share) if form else -np.inf,
        float(logsumexp(foreign) - share) if foreign else -np.inf,
    )


def _beyond(tree: Tree, node: Node, family: str) -> float:
    """Log probability that what a family says is more than the form of one more name."""
    result = 1.0
    for child in tree.nodes.values():
        if len(child.names) == len(node.names) + 1 and child.names[:-1] == node.names and family in child.found:
            found = child.found[family]
            more = found.power > PRIOR.form * (child.explained - node.explained)
            logs = np.concatenate([[0.0], found.by_scale])
            result = min(result, float(np.exp(logs - logsumexp(logs))[1:][more].sum()))
    return float(np.log(max(result, 1e-12)))


def of_field(node: Node) -> float:
    """Power of what a field that varies explains beside the names of a set."""
    if node.variation is None:
        return 0.0
    without, rows = float(node.left @ node.left) / node.variation.noise**2, len(node.left)
    return max(without - node.misfit * rows, 0.0)


def kept(node: Node) -> list[int]:
    """Its terms, without those that are no more than the form of a related one, or of a field that varies."""
    result: list[int] = []
    terms = node.fit.model.terms
    names = [term.name for term in terms]
    least = PRIOR.form * of_field(node)
    for index in sorted(range(len(names)), key=lambda i: -node.powers[i]):
        strong = [node.powers[i] for i in result if related(names[index], names[i])]
        passed = any(_one_passing(terms[index], terms[i]) for i in result)
        if not passed and node.powers[index] > max([least, *(PRIOR.form * power for power in strong)]):
            result.append(index)
    return sorted(result)


def _one_passing(one: Active, other: Active) -> bool:
    """Whether two bumps belong to one object that was passed, whose field turns meanwhile."""
    if one.name != "local-anomaly" or other.name != one.name:
        return False
    widths = one.setting["width"] + other.setting["width"]
    return abs(one.setting["time"] - other.setting["time"]) < RULES.span * widths


def key_of(node: Node) -> tuple[str, ...]:
    """The names of what is kept, in their own order."""
    names = {node.fit.model.terms[index].name for index in kept(node)}
    return tuple(sorted(names | ({FIELD_VARIATION} if node.variation is not None else set())))


def normalised(logs: Mapping[Set, float]) -> dict[Set, float]:
    """Probabilities."""
    total = logsumexp(list(logs.values()))
    return {key: float(np.exp(log - total)) for key, log in logs.items()}
