"""The calibration that a graph holds before any block: from the solver, or from priors."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np

from magyc_gtsam.factors.constraints import HELD, without_constraints
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array, choose, vector

_WEAK_PRIOR = np.diag(
    np.r_[np.full(6, 1 / 0.5**2), np.full(3, 1.0)]
)  # information on soft iron and on hard iron, the latter relative to the field
_NO_IRON = np.r_[1.0, 0, 0, 1, 0, 1, 0, 0, 0]


def calibration_before(
    view: View, graph: gtsam.NonlinearFactorGraph, details: BlockDetails
) -> tuple[Array, Array]:
    """Return mean (9,) and information (9, 9) of soft and hard iron before any block, from the solver or from priors,
    new ones or those of the solver; a weak prior for what has none.
    """
    keys = [details.soft_iron_key, details.hard_iron_key]
    strength = 50e-6 if details.field is None else float(np.linalg.norm(details.field))
    unit = np.r_[np.ones(6), np.full(3, details.field_unit / strength)]
    weak = _WEAK_PRIOR * unit * unit[:, None]
    point = view.values(keys)
    start = np.concatenate(
        [
            choose("coarse alignment", vector(size), point, key)(point, key)[0]
            for key, size in zip(keys, (6, 3), strict=True)
        ]
    )
    covariance = None if any(map(view.new.exists, keys)) else view.covariance(keys)
    if covariance is not None:
        covariance += np.diag(np.where(np.diag(covariance) > 0, 0.0, (HELD / unit) ** 2))
        known, gradient, seen = np.linalg.inv(covariance), np.zeros(9), np.full(9, True)
    else:
        priors = _priors(view, graph, keys)
        held = set(priors.keyVector())
        seen = np.repeat([key in held for key in keys], (6, 3))
        known, gradient = np.zeros((9, 9)), np.zeros(9)
        if held:
            ordering = gtsam.Ordering()
            for key in (each for each in keys if each in held):
                ordering.push_back(key)
            square, right = without_constraints(priors.linearize(point), keys, unit).hessian(ordering)
            known[np.ix_(seen, seen)], gradient[seen] = square, right
    information = weak * np.where(seen, 1e-3, 1.0)  # makes it regular beside priors
    right = information @ _NO_IRON + gradient + known @ start
    return np.linalg.solve(information + known, right), information + known


def _priors(view: View, graph: gtsam.NonlinearFactorGraph, keys: Sequence[int]) -> gtsam.NonlinearFactorGraph:
    """Return the factors on nothing but these keys, among new ones and those of the solver."""
    priors = gtsam.NonlinearFactorGraph()
    for factors in [graph] if isinstance(view.solver, gtsam.Values) else [graph, view.factors()]:
        for i in range(factors.size()):
            if factors.exists(i) and set(factors.at(i).keys()) <= set(keys):
                priors.push_back(factors.at(i))
    return view.placed(priors)
