"""Posterior probabilities from the evidence of a tree: of sets, with and without an unknown effect, and of names."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.candidates import COLOUR
from magyc_gtsam.gap.evidence.neighbours import product_of
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION, Node
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.evidence.weighing import Weighed

Set = tuple[tuple[str, ...], bool]  # names, and True if an unknown effect is present
NOTHING, UNKNOWN = "nothing", "unknown"


class SetWeight(NamedTuple):
    """The log weight of a set.

    Attributes:
        names: of the set.
        log: nats.
        seen: power that an unknown effect explains beside the names; None without one.
        powers: that each name explains.
    """

    names: tuple[str, ...]
    log: float
    seen: float | None = None
    powers: Mapping[str, float] = MappingProxyType({})


def weights(tree: Tree) -> Iterator[SetWeight]:
    """Yield the weights: each set as it is, with a small deviation from its form, or with an unknown effect."""
    for node in tree.nodes.values():
        yield from _weights_of(tree, node)


def _weights_of(tree: Tree, node: Node) -> Iterator[SetWeight]:
    tried = tree.nodes.keys() | tree.refused
    key, powers = node.present, node.powers
    form, (foreign, seen) = _families(tree, node, powers)
    known = float(np.logaddexp(node.log, node.log + form))
    if node.disturbed:
        strong = (name for name, power in powers.items() if name in TERMS and power > node.formless)
        yield SetWeight(tuple(sorted((*strong, FIELD_VARIATION))), known, 0.0)
        return
    yield SetWeight(key, known, None, powers)
    if np.isfinite(foreign):
        yield SetWeight(key, node.log + PRIOR.unknown + foreign, seen, powers)
    for log, seen in _products(node, powers):
        yield SetWeight(key, node.log + log, seen, powers)
    if node.variation is not None and not powers.keys() - {FIELD_VARIATION, COLOUR}:  # whatever the field absorbs
        yield _with_sensor(node, known)
    for each in node.found.values():  # sets that were not fitted, in linearised form
        if each.name in TERMS and each.name not in node.names and node.key_with(each.name) not in tried:
            with_it = {**powers, each.name: powers.get(each.name, 0.0) + _above([each], [0.0])[1]}
            yield SetWeight(tuple(sorted({*key, each.name})), node.log + PRIOR.named + each.log, None, with_it)


def _with_sensor(node: Node, known: float) -> SetWeight:
    """Return the weight of a variation that moves with the sensor, in place of the field's in a set.

    A fast one is correlated noise, any other one of the families of unknown effects.

    Args:
        node: the set.
        known: its log weight with families that may be deviations of the field from its form. What the variation in
            the sensor's axes explains beyond the field may be the same: it does not count twice.
    """
    ahead = node.in_sensor
    log = max(node.log + ahead, known + min(ahead, 0.0)) - PRIOR.named
    others = {name: power for name, power in node.powers.items() if name != FIELD_VARIATION}
    if node.with_sensor.fast:
        return SetWeight(tuple(sorted({*others, COLOUR})), log + PRIOR.named, None, others)
    return SetWeight(tuple(sorted(others)), log + PRIOR.unknown - PRIOR.one_of_families, node.of_field)


def _above(families: Sequence[Weighed], least: Sequence[float]) -> tuple[float, float]:
    """Return the nats of families at the scales whose power is above the least of each, and the mean power there."""
    large = [(each, each.power > limit) for each, limit in zip(families, least, strict=True)]
    logs = np.concatenate([[-np.inf], *(each.by_scale[seen] for each, seen in large)])
    total = float(np.logaddexp.reduce(logs))
    if not np.isfinite(total):
        return -np.inf, 0.0
    return total, float(
        np.exp(logs - total) @ np.concatenate([[0.0], *(each.power[seen] for each, seen in large)])
    )


def _deviation(node: Node, powers: Mapping[str, float], family: Weighed) -> float:
    """Return the power that a family may explain as a deviation of the set from its form.

    A product may be a deviation of its own effect, any other family of the part of the set's signal that it could
    explain, and each of the varying field, which has no form.
    """
    of_names = powers.get(product_of(family.name) or "", family.contained)
    return PRIOR.form * (node.of_field + of_names)


def _families(tree: Tree, node: Node, powers: Mapping[str, float]) -> tuple[float, tuple[float, float]]:
    """Return the nats of families no larger than the set's deviation from its form, and of larger ones with power."""
    families = _generic(node)
    form, foreign, alone = [], [], []
    for each in families:
        small = each.power < _deviation(node, powers, each)
        if small.any():
            form.append(np.logaddexp.reduce(each.by_scale[small]))
        if product_of(each.name) is None:
            alone.append(each)
            if not small.all():
                foreign.append(np.logaddexp.reduce(each.by_scale[~small]) + _log_exceeds_form(tree, node, each))
    share = np.log(max(len(families), 1))
    _, seen = _above(alone, [_deviation(node, powers, each) for each in alone])
    return (
        float(np.logaddexp.reduce(form) - share) if form else -np.inf,
        (float(np.logaddexp.reduce(foreign) - share) if foreign else -np.inf, seen),
    )


def _products(node: Node, powers: Mapping[str, float]) -> Iterator[tuple[float, float]]:
    """Yield nats and power of products of an effect with another signal in its place; all are equally probable."""
    for name in dict.fromkeys(product_of(each) for each in node.found):  # in one order, since sums are rounded
        if name is None or name in node.names:
            continue
        found = [each for each in node.found.values() if product_of(each.name) == name]
        log, power = _above(found, [_deviation(node, powers, each) for each in found])
        yield PRIOR.named + PRIOR.product + log - float(np.log(len(found))), power


def _generic(node: Node) -> list[Weighed]:
    """Return the families, and the products of the set's effects; beside a varying field without coloured noise."""
    named = {*TERMS, COLOUR} if node.variation is not None else TERMS
    return [e for e in node.found.values() if e.name not in named and product_of(e.name) in (None, *node.names)]


def _log_exceeds_form(tree: Tree, node: Node, family: Weighed) -> float:
    """Return the log probability that a family is more than the deviation from its form of each effect beside it."""
    least = 1.0
    children = (child for child in tree.nodes.values() if child.has_one_more_than(node))
    for child in children if node.log + family.log > tree.best.log - PRIOR.certain else ():
        found = child.found.get(family.name)
        if found is not None:
            more = found.power > PRIOR.form * (child.explained - node.explained)
            logs = np.concatenate([[0.0], found.by_scale])
            least = min(least, float(np.exp(logs - np.logaddexp.reduce(logs))[1:][more].sum()))
    return float(np.log(max(least, 1e-12)))


def summed(each: Iterable[SetWeight]) -> dict[Set, float]:
    """Return {set: log weight}, with the sets in which one cause outside the catalogue resembles some of the names.

    A part of such a cause is also detected as an unknown effect, larger than a deviation from the form of all names.
    The names are any of the catalogue and the varying field, but no effects on single samples. Correlated noise beside
    it is a part of it as probably as not.
    """
    logs: dict[Set, list[float]] = {}
    for one in each:
        logs.setdefault((one.names, one.seen is not None), []).append(one.log)
        if one.seen is None or one.seen <= PRIOR.form * sum(one.powers.values()):
            continue
        replaced = [name for name in one.names if name in TERMS or name == FIELD_VARIATION]
        for count in range(1, len(replaced) + 1):
            for alike in combinations(replaced, count):
                others = tuple(name for name in one.names if name not in alike)
                logs.setdefault((others, True), []).append(one.log)
    result = {key: float(np.logaddexp.reduce(values)) for key, values in logs.items()}
    for (names, unknown), log in list(result.items()):
        if unknown and COLOUR in names:
            less = tuple(name for name in names if name != COLOUR), True
            result[less] = float(np.logaddexp(result.get(less, -np.inf), log))
    return result


def normalised(logs: Mapping[Set, float]) -> dict[Set, float]:
    """Return probabilities, with a share for what this comparison does not contain.

    It is an unknown effect alone and, beside a varying field, one in the place of all names.
    """
    total = np.logaddexp.reduce(list(logs.values()))
    result: dict[Set, float] = {}
    in_room = 0.0
    for (names, unknown), log in logs.items():
        share = (1 - PRIOR.unforeseen) * float(np.exp(log - total))
        other = PRIOR.unforeseen_in_room * share if FIELD_VARIATION in names else 0.0
        result[names, unknown] = share - other
        in_room += other
    for key, more in ((((FIELD_VARIATION,), True), in_room), (((), True), PRIOR.unforeseen)):
        if more:
            result[key] = result.get(key, 0.0) + more
    return result


def marginals(posterior: Mapping[Set, float]) -> dict[str, float]:
    """Return {name, `UNKNOWN` or `NOTHING`: probability}, the most probable first."""
    result = {NOTHING: 0.0, UNKNOWN: 0.0}
    for (names, unknown), probability in posterior.items():
        for name in dict.fromkeys(names):
            result[name] = result.get(name, 0.0) + probability
        if unknown:
            result[UNKNOWN] += probability
        elif not names:
            result[NOTHING] += probability
    stated = {what: min(probability, 1.0) for what, probability in result.items()}  # sums are rounded
    return dict(sorted(stated.items(), key=lambda one: -one[1]))
