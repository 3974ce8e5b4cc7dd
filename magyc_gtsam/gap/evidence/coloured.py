"""Sets of effects beside coloured noise: a tree whose innovations are whitened for the noise that the best set leaves.

By white noise an effect is far more evident than beside coloured noise, and what the noise does by chance is, too: the
sets of the tree are then those that follow the noise, and the one with the effect that is there is not among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from magyc_gtsam.gap.evidence.candidates import COLOUR
from magyc_gtsam.gap.evidence.colour import Colour, colour_of
from magyc_gtsam.gap.evidence.node import Node
from magyc_gtsam.gap.evidence.posterior import Set, SetWeight, summed, weights
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.model.base import root
from magyc_gtsam.gap.model.colour import ColouredNoise
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import Refit

_ROUNDS = 3  # of estimating the noise from what the best set leaves


def noise_left_by(node: Node) -> ColouredNoise:
    """Return the likeliest noise of what a set leaves."""
    twin = node.fit.twin
    return ColouredNoise.of(twin.innovations(), twin.along_field)


def coloured(noise: ColouredNoise, bare: Refit, names: Sequence[str], given: Sequence[Active]) -> Tree:
    """Grow the tree beside coloured noise, and again beside that which its best set leaves.

    Args:
        noise: left by the most probable set with coloured noise, of a tree by white noise.
        bare: the model without effects of that tree.
        names, given: candidates, and terms of a calibration.
    """
    others, last = tuple(name for name in names if name != COLOUR), None
    for _ in range(_ROUNDS):
        problem = replace(bare.twin.problem, colour=noise)
        tree = Tree(root(problem, bare.model), others, given)
        tree.complete()
        if tree.best.key == last:
            break
        last, noise = tree.best.key, noise_left_by(tree.best)
    return tree


def beside_colour(tree: Tree) -> dict[Set, float]:
    """Return {set: log weight} of such a tree: with coloured noise, or with an unknown effect in its place."""
    noise, best = tree.fits.problem.colour, tree.best
    assert noise is not None
    there = PRIOR.named + noise.nats(tree.nodes[()].fit.twin.innovations())
    result = {
        (tuple(sorted((*names, COLOUR))), unknown): log + there
        for (names, unknown), log in summed(weights(tree)).items()
    }
    colour = colour_of(best.fit.twin.innovations().ravel())
    _, unknown = in_place_of_noise(best, colour)
    # That effect is weighed against the noise by one autoregression for each, of what the same set leaves.
    ahead = there - (PRIOR.named + colour.alike)
    return result | summed([unknown._replace(log=unknown.log + ahead, powers=best.powers)])


def in_place_of_noise(node: Node, colour: Colour) -> tuple[SetWeight, SetWeight]:
    """Return the weights of a set with coloured noise, and with an unknown effect along one direction in its place."""
    left = node.fit.twin.innovations()
    log = node.log + PRIOR.unknown - PRIOR.one_of_families + colour.one_way
    with_colour = SetWeight(tuple(sorted((*node.present, COLOUR))), node.log + PRIOR.named + colour.alike)
    return with_colour, SetWeight(node.present, log, float((left**2).sum()) - left.size)
