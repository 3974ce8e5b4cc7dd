"""The history as a GTSAM graph that can be joined to other graphs; needs GTSAM.

Variables: the shared parameters `s` (5-vector, the soft iron's shape; 8-vector with the gyroscope's scale), and each
log's hard iron `h_k` (3-vector, µT). Factors: one per log, the result of eliminating its field chain, and a random
walk between neighbours.
"""

from __future__ import annotations

import gtsam
import numpy as np

from magyc_gtsam.history.chain import Observations
from magyc_gtsam.recording import Array

SHARED_KEY = gtsam.symbol("s", 0)


def history_graph(observed: Observations, step_variance: Array) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the graph that `chain.solve` solves, and initial values.

    Args:
        observed: the logs' observations.
        step_variance: (k − 1,) µT², variance of each step of the hard iron on each axis.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    p = observed.shared
    values.insert(SHARED_KEY, np.zeros(p))
    for k in range(len(observed)):
        values.insert(hard_iron_key(k), np.zeros(3))
    for k, (mean, information) in enumerate(zip(observed.mean, observed.information, strict=True)):
        if information[0, 0] > 0:
            root = np.linalg.cholesky(information).T
            linear = gtsam.JacobianFactor(
                SHARED_KEY, root[:, :p], hard_iron_key(k), root[:, p:], root @ mean, _unit(len(root))
            )
            graph.add(gtsam.LinearContainerFactor(linear, values))
    for k, variance in enumerate(step_variance):
        noise = gtsam.noiseModel.Isotropic.Sigma(3, float(np.sqrt(variance)))
        graph.add(gtsam.BetweenFactorVector(hard_iron_key(k), hard_iron_key(k + 1), np.zeros(3), noise))
    return graph, values


def hard_iron_key(k: int) -> int:
    """Return the key of the k-th log's hard iron."""
    return int(gtsam.symbol("h", k))


def _unit(size: int) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Unit.Create(size)
