"""Covariances and priors of variables that a constraint of the graph holds exactly; to GTSAM their variance is 1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.factors.variables import Array

HELD = 1e-6  # standard deviation, relative to the field, of a calibration that a constraint holds
_ROUNDING = 1e-9  # of a variance that is 1, through a QR decomposition


def exact_covariance(
    joint: gtsam.JointMarginal, keys: Sequence[int], graph: Callable[[], gtsam.NonlinearFactorGraph]
) -> Array:
    """Return a joint covariance in the order of its keys, given what constraints hold; 0 for what they hold.

    GTSAM drops the information of a constraint and keeps its unit pivot: a component that `Constrained` noise or a
    `NonlinearEquality` holds has the variance 1, and spreads it to the others in some orders of elimination. A prior of
    one unit that nothing else has changed looks the same, so that the factors decide.

    Args:
        joint: the marginal.
        keys: its keys.
        graph: returns the factors of the solver; only called where a component looks held.
    """
    covariance: Array = joint.fullMatrix()
    held = np.abs(np.diag(covariance) - 1.0) < _ROUNDING
    if held.any():
        sizes = [joint.at(key, key).shape[0] for key in keys]
        constrained = _constrained_keys(graph())
        held &= np.repeat([key in constrained for key in keys], sizes)
        crossed = covariance[:, held]
        covariance = covariance - crossed @ np.linalg.solve(covariance[np.ix_(held, held)], crossed.T)
        covariance[held] = covariance[:, held] = 0.0
    return covariance


def _constrained_keys(graph: gtsam.NonlinearFactorGraph) -> set[int]:
    """Return the keys of all factors that must hold exactly."""
    found: set[int] = set()
    for i in range(graph.size()):
        factor = graph.at(i)
        if isinstance(factor, gtsam.NoiseModelFactor):
            model = factor.noiseModel()
            constrained = model is not None and model.isConstrained()
        else:  # what a fixed-lag smoother leaves of a constraint
            constrained = (
                isinstance(factor, gtsam.LinearContainerFactor)
                and factor.isJacobian()
                and factor.toJacobian().isConstrained()
            )
        if constrained:
            found.update(factor.keys())
    return found


def without_constraints(
    linear: gtsam.GaussianFactorGraph, keys: Sequence[int], unit: Array
) -> gtsam.GaussianFactorGraph:
    """Return a graph in which rows that must hold exactly, which have no information, have a very large one.

    Args:
        linear: factors on soft and hard iron.
        keys: those of soft and hard iron.
        unit: (9,) factor of each component of both that makes it relative to the field.
    """
    result = gtsam.GaussianFactorGraph()
    parts = dict(zip(keys, (slice(0, 6), slice(6, 9)), strict=True))
    for i in range(linear.size()):
        factor = linear.at(i)
        if isinstance(factor, gtsam.JacobianFactor) and factor.isConstrained():
            rows, right = factor.jacobianUnweighted()
            own = list(map(parts.__getitem__, factor.keys()))
            scale = np.linalg.norm(rows / np.concatenate([unit[part] for part in own]), axis=1)
            sigmas = np.maximum(factor.get_model().sigmas(), HELD * scale)
            blocks = np.split(rows, np.cumsum([part.stop - part.start for part in own])[:-1], axis=1)
            terms = [each for pair in zip(factor.keys(), blocks, strict=True) for each in pair]
            made: Any = gtsam.JacobianFactor  # of one term or of two
            factor = made(*terms, right, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
        result.push_back(factor)
    return result
