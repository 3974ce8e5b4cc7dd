"""Which logs are wrong and where the hard iron jumped: a bank of Kalman filters, the likeliest labellings kept.

Each log has one of three labels. Its likelihood under each is Gaussian given the labels before it, so that a
labelling is one Kalman filter on the hard iron; the bank keeps the `_KEPT` likeliest ones (a Gaussian sum filter with
pruning, Alspach and Sorenson 1972). The soft iron's shape is taken as given: all logs together know it far better
than one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.history.chain import Observations
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

WALKED, JUMPED, WRONG = 0, 1, 2
_KEPT = 16
_ANYWHERE = 1000.0  # µT, deviation of the hard iron before the first log; phones have 400


@dataclass(frozen=True, eq=False)
class Labels:
    """The likeliest labelling.

    Attributes:
        label: (k,) WALKED, JUMPED (before this log) or WRONG.
        probability: (k,) of that label over all labellings kept.
    """

    label: np.ndarray
    probability: Array


def label_logs(
    observed: Observations, shape: Array, shape_covariance: Array, walk_variance: float, model: HistoryModel
) -> Labels:
    """Label all logs at a given shape and walk.

    Args:
        observed: in the order of time; a log of no information is passed over.
        shape, shape_covariance: of the instrument.
        walk_variance: µT² per unit of `observed.elapsed`.
        model: shares and sizes of jumps and wrong logs.
    """
    k = len(observed)
    covariance, says = _covariances(observed)
    prior = np.log([1 - model.jump_share - model.wrong_share, model.jump_share, model.wrong_share])
    of_shape, of_iron = (
        covariance[:, :SHAPE, :SHAPE] + ~says[:, None, None] * np.eye(SHAPE),
        covariance[:, SHAPE:, SHAPE:],
    )
    off = observed.mean[:, :SHAPE] - shape
    gain = np.linalg.solve(of_shape, covariance[:, :SHAPE, SHAPE:]).transpose(0, 2, 1)
    readings = observed.mean[:, SHAPE:] - np.einsum("kij,kj->ki", gain, off)  # of the hard iron, at the shape
    noises = of_iron - gain @ covariance[:, :SHAPE, SHAPE:]
    all_fit = _log_density(off, of_shape + shape_covariance)
    all_spoilt = _log_density(off, of_shape + np.eye(SHAPE) * model.wrong_shape**2)
    wide = of_iron + np.eye(3) * model.wrong_hard_iron**2
    mean, spread = np.zeros((1, 3)), np.eye(3)[None] * _ANYWHERE**2
    weight, labels = np.zeros(1), np.zeros((1, k), dtype=np.int8)
    first = True
    for i in range(k):
        if i:
            spread = spread + np.eye(3) * walk_variance * observed.elapsed[i - 1]
        if not says[i]:
            continue
        reading, noise, fits, spoilt = readings[i], noises[i], all_fit[i], all_spoilt[i]
        widened = spread + np.eye(3) * model.jump**2
        walked = _updated(mean, spread, reading, noise)
        jumped = _updated(mean, widened, reading, noise)
        wrong = _log_density(observed.mean[i, SHAPE:] - mean, spread + wide[i])
        if first:
            spoilt_weight = np.full_like(wrong, -np.inf) if says.sum() == 1 else wrong + spoilt
            candidates = [walked[2] + fits + prior[0], np.full_like(wrong, -np.inf), spoilt_weight + prior[2]]
            first = False
        else:
            candidates = [walked[2] + fits + prior[0], jumped[2] + fits + prior[1], wrong + spoilt + prior[2]]
        weight = np.concatenate([weight + each for each in candidates])
        mean = np.concatenate([walked[0], jumped[0], mean])
        spread = np.concatenate([walked[1], jumped[1], spread])
        labels = np.tile(labels, (3, 1))
        labels[:, i] = np.repeat([WALKED, JUMPED, WRONG], len(labels) // 3)
        best = np.argsort(-weight)[:_KEPT]
        weight, mean, spread, labels = weight[best], mean[best], spread[best], labels[best]
    share = np.exp(weight - weight.max())
    share /= share.sum()
    chosen = labels[0]
    return Labels(chosen, np.einsum("n,nk->k", share, labels == chosen))


def _covariances(observed: Observations) -> tuple[Array, np.ndarray]:
    """(k, 8, 8) inverse informations, and which logs say anything."""
    says = observed.information[:, 0, 0] > 0
    covariance = np.zeros_like(observed.information)
    covariance[says] = np.linalg.inv(observed.information[says])
    return covariance, says


def _updated(mean: Array, spread: Array, reading: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Kalman update of n filters (n, 3), (n, 3, 3) by one reading (3,): means, covariances, log-likelihoods."""
    innovation, total = reading - mean, spread + noise
    gain = np.linalg.solve(total, spread).transpose(0, 2, 1)
    after = mean + np.einsum("nij,nj->ni", gain, innovation)
    kept = np.eye(3) - gain
    covariance = kept @ spread @ kept.transpose(0, 2, 1) + gain @ noise @ gain.transpose(0, 2, 1)
    return after, covariance, _log_density(innovation, total)


def _log_density(off: Array, covariance: Array) -> Array:
    """Of N(0, covariance) at `off`, stacked."""
    squared = np.einsum("...i,...i->...", off, np.linalg.solve(covariance, off[..., None])[..., 0])
    result: Array = -0.5 * (squared + np.linalg.slogdet(2 * np.pi * covariance)[1])
    return result
