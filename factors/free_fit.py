"""The graph solved with what its blocks hold as two more variables: their mounting, and the field's heading.

Where the true mounting is ᵇRₛ Exp(θ) and the true field Rz(ψ) f, a block's Jacobian on ψ is that of a turn of its
attitude the other way about the world's vertical, so that it needs no factor of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.factors.constraints import exact_covariance
from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.heading_pull import heading_axis
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array

_FREE = gtsam.symbol("~", 2**56 - 2)  # of (θ, ψ), one since marginals of more keys take longer; no graph has it


@dataclass(frozen=True, eq=False)
class FreeFit:
    """The cost of θ (3,) and ψ with all other variables at their best, to second order.

    Attributes:
        information, score: (4, 4), (4,) of (θ, ψ) in rad, without their priors; 0 where no block holds one.
        shift: (p, 4) by which the keys of the last block are off per rad of θ and ψ.
        axis: (columns of the attitude,) tangent vector of the last block's attitude for a rotation about the vertical.
        time: s, of the last block.
    """

    information: Array
    score: Array
    shift: Array
    axis: Array
    time: float


def holds_field(details: BlockDetails) -> bool:
    """Whether a block holds the direction of the field in the world."""
    return details.field is not None and not details.on_direction


def free_fit(view: View, delivered: Sequence[Delivered], priors: tuple[float, float]) -> FreeFit | None:
    """Solve the graph with θ and ψ free; None where no block holds one or where the variables are not determined.

    Args:
        view: view of the solver.
        delivered: all factors that the solver holds as quadratics, oldest first.
        priors: rad, standard deviations of θ and ψ, with which the graph determines both.
    """
    blocks = [
        each
        for each in delivered
        if each.details is not None
        and (each.details.freed or holds_field(each.details))
        and all(map(view.exists, each.factor.keys()))  # others have left a fixed-lag smoother in this update
    ]
    if not blocks:
        return None
    graph, values, last = view.factors(), view.estimate(), blocks[-1]
    for each in blocks:
        graph.remove(each.slot)
    free = view.placed(graph).linearize(values)
    for each in blocks:
        free.push_back(_free_factor(each, values))
    prior = np.r_[np.full(3, priors[0]), priors[1]]
    free.add(_FREE, np.diag(1 / prior), np.zeros(4), gtsam.noiseModel.Unit.Create(4))
    keys = [*last.factor.keys(), _FREE]
    try:
        tree = free.eliminateMultifrontal()
        mean = tree.marginalFactor(_FREE).solve(gtsam.VectorValues()).at(_FREE)
        joint = exact_covariance(tree.jointMarginalCovariance(keys), keys, lambda: graph)
    except RuntimeError:  # the variables are not determined
        return None
    information = np.asarray(np.linalg.inv(joint[-4:, -4:]))
    assert last.details is not None
    return FreeFit(
        information - np.diag(prior**-2),
        information @ mean,
        -joint[:-4, -4:] @ information,
        heading_axis(values, last.details.attitude_key),
        last.details.block.time,
    )


def _free_factor(each: Delivered, point: gtsam.Values) -> gtsam.GaussianFactor:
    """Return the block's linearisation at what it holds, with (θ, ψ) as an additional variable."""
    details = each.details
    assert details is not None
    free = point.extract(list(each.factor.keys()))
    if details.freed is None:
        linear = each.native.linearize(free)
    else:
        free.insert(_FREE, gtsam.Rot3(details.block.body_R_sensor))
        linear = details.freed(_FREE).linearize(free)
    rows, right = linear.jacobian()
    keys, sizes, added = list(linear.keys()), free.dims(), np.zeros((len(right), 4))
    columns = dict(zip(keys, np.split(rows, np.cumsum([sizes[key] for key in keys])[:-1], axis=1), strict=True))
    if details.freed is not None:
        added[:, :3] = columns.pop(_FREE)
    if holds_field(details):
        added[:, 3] = -columns[details.attitude_key] @ heading_axis(free, details.attitude_key)
    columns[_FREE] = added
    widths = [part.shape[1] for part in columns.values()]
    split: Any = gtsam.VerticalBlockMatrix(widths, np.column_stack([*columns.values(), right]), True)
    return gtsam.GaussianConditional(list(columns), 0, split)
