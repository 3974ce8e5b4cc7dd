"""What a history pools beside its filter: the delay, the misalignment and the scale of the soft iron of its logs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.recording import Array

_SHOWN = 0.5  # share of the logs that have to show a misalignment
_UNSTATED = 0.01  # relative sigma of a scale in a history of an earlier version


def pooled(values: Array, sigmas: Array) -> tuple[float, float]:
    """Return the weighted mean of values (n,), and the sigma of it for another log.

    Where they scatter beyond their sigmas, as by a delay that changes, so may the next log.
    """
    weight = 1 / sigmas**2
    mean = float(weight @ values / weight.sum())
    if len(values) < 2:
        return mean, float(sigmas[0])
    beyond = float(((values - mean) ** 2).sum()) / (len(values) - 1) - float((sigmas**2).mean())
    return mean, float(np.sqrt(1 / weight.sum() + max(beyond, 0.0)))


def delay_of(logs: Sequence[LogFactor]) -> tuple[float, float | None]:
    """Return the delay of another log, s, and its sigma; None if no log estimated it."""
    used = [log for log in logs if log.mean is not None]
    rows = np.array([(log.delay, log.delay_sigma) for log in used if log.delay_sigma])
    if not len(rows):
        return (used[-1].delay if used else 0.0), None
    return pooled(*rows.T)


def scale_of(logs: Sequence[LogFactor]) -> tuple[float, float]:
    """Return the logarithm of the scale of another log's soft iron and its sigma; 0 and 0 without a known strength.

    The strength's own error is common to the logs, and their mean has it, too.
    """
    rows = [
        (log.log_scale, _UNSTATED if log.log_scale_sigma is None else log.log_scale_sigma)
        for log in logs
        if log.mean is not None and log.log_scale is not None
    ]
    if not rows:
        return 0.0, 0.0
    values, sigmas = np.array(rows).T
    mean, sigma = pooled(values, sigmas)
    return mean, max(sigma, float(np.mean(sigmas**-2.0) ** -0.5))


def misalignment_of(logs: Sequence[LogFactor]) -> tuple[Term, ...]:
    """Return the weighted mean misalignment, if more than half of the logs show one.

    Its covariance is widened where they scatter beyond their sigmas (Birge's ratio).
    """
    used = [log for log in logs if log.mean is not None]
    shown = [log for log in used if log.misalignment is not None]
    if len(shown) <= _SHOWN * len(used):
        return ()
    rows = np.array([log.misalignment for log in shown])
    each = [np.linalg.inv(log.misalignment_covariance) for log in shown if log.misalignment_covariance is not None]
    covariance = np.linalg.inv(np.sum(each, axis=0))
    mean = covariance @ np.einsum("kij,kj->i", each, rows)
    off = rows - mean
    squares = float(np.einsum("ki,kij,kj->", off, each, off))
    widened = max(1.0, squares / max(3 * len(rows) - 3, 1))
    return (Term("misalignment", mean, covariance * widened),)
