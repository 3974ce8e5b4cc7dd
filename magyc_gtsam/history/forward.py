"""Kalman filters over one instrument's logs in the order of time.

Each log is labelled: the hard iron walked or jumped before it, both irons changed, or the log is wrong. A labelling, a
walk and a scatter of the logs' errors define one Kalman filter on (s, h). The bank keeps the `KEPT` likeliest
labellings, each at every walk and scatter of a grid (a Gaussian sum filter with pruning, Alspach and Sorenson 1972,
over multiple models, Magill 1965). A step takes constant time, and earlier logs are never filtered again.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.gaussian import log_density
from magyc_gtsam.history.log_factor import OBSERVED, LogFactor
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

WALKED, JUMPED, WRONG, REFITTED = 0, 1, 2, 3
KEPT = 8  # number of labellings that are kept
WALKS = np.geomspace(
    0.02, 10.0, 16
)  # µT per √day; neighbours differ by half, while sixty logs determine the walk to a tenth
# What the logs have beside the sensors' noise: the share of their model errors that is the same in all of them, so that
# it neither makes them differ nor averages out, and the scatter of their soft irons beyond all that is stated.
SCATTERS = np.array([(1.0, 0.0), (0.5, 0.0), (0.0, 0.0), (0.5, 0.002), (0.5, 0.005), (0.5, 0.012), (0.5, 0.03)])
_CELLS = len(WALKS) * len(SCATTERS)
WALK_OF_CELL = np.repeat(WALKS, len(SCATTERS))
SHARED_OF_CELL, SCATTER_OF_CELL = np.tile(SCATTERS.T, len(WALKS))


@dataclass(frozen=True, eq=False)
class Bank:
    """The bank of filters after a number of logs.

    Attributes:
        order: indices of the logs in the history, in the order of time.
        dated: whether elapsed time is in days.
        label: (k, logs) WALKED, JUMPED or REFITTED (before this log) or WRONG, the likeliest labelling first.
        weight: (k, cells) logarithm of the posterior probability up to a constant.
        mean, covariance: (k, cells, p + 3), (k, cells, p + 3, p + 3) of the shared parameters and h, µT, after the last
            log.
    """

    order: tuple[int, ...]
    dated: bool
    label: np.ndarray
    weight: Array
    mean: Array
    covariance: Array

    @property
    def share(self) -> Array:
        """The posterior probabilities (k, cells)."""
        share = np.exp(self.weight - self.weight.max())
        result: Array = share / share.sum()
        return result

    def to_dict(self) -> dict[str, Any]:
        """Return the bank as JSON types, numbers bit for bit."""
        rows, columns = np.triu_indices(self.mean.shape[-1])
        return {
            "order": list(self.order),
            "size": self.mean.shape[-1],
            "dated": self.dated,
            "label": ["".join(map(str, each)) for each in self.label.tolist()],
            "weight": _packed(self.weight),
            "mean": _packed(self.mean),
            "covariance": _packed(self.covariance[..., rows, columns]),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], logs: int) -> Bank:
        """Return the bank that `to_dict` described, for a history of `logs` logs.

        Raises:
            MagycError: a value is missing or has a wrong shape.
        """
        try:
            order = tuple(int(each) for each in data["order"])
            label = np.array([[int(each) for each in row] for row in data["label"]], dtype=np.int8)
            count, size = len(label), int(data.get("size", SHAPE + 3))
            rows = np.triu_indices(size)
            covariance = np.empty((count, _CELLS, size, size))
            half = _unpacked(data["covariance"], (count, _CELLS, len(rows[0])))
            covariance[..., rows[0], rows[1]] = covariance[..., rows[1], rows[0]] = half
            bank = cls(
                order,
                bool(data["dated"]),
                label,
                _unpacked(data["weight"], (count, _CELLS)),
                _unpacked(data["mean"], (count, _CELLS, size)),
                covariance,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise MagycError(f"history: a damaged filter ({type(error).__name__}: {error})") from None
        fits = label.shape == (count, len(order)) and set(np.unique(label)) <= {WALKED, JUMPED, WRONG, REFITTED}
        if not count or not fits or len(set(order)) != len(order) or not set(order) <= set(range(logs)):
            raise MagycError("history: a damaged filter (its logs are not those of the history)")
        return bank


def empty_bank(dated: bool, shared: int, model: HistoryModel) -> Bank:
    """Return the bank before the first log; `shared` is the number of parameters that all logs share."""
    weight = -0.5 * (np.log(WALK_OF_CELL / model.walk) / model.walk_spread) ** 2
    partly = 0.5 * (1 - model.shared_error)
    stated = (1 - model.scattered) * np.where(SHARED_OF_CELL == 1, model.shared_error, partly)
    scattered = model.scattered / np.count_nonzero(SCATTERS[:, 1])
    weight = weight + np.log(np.where(SCATTER_OF_CELL == 0, stated, scattered))
    size = shared + 3
    scale = np.full(shared - SHAPE, model.gyroscope_scale)
    wide = np.diag(np.r_[np.full(SHAPE, model.before[0]), scale, np.full(3, model.before[1])] ** 2)
    return Bank(
        (),
        dated,
        np.zeros((1, 0), dtype=np.int8),
        weight[None],
        np.zeros((1, _CELLS, size)),
        np.broadcast_to(wide, (1, _CELLS, size, size)),
    )


def stepped(bank: Bank, index: int, factor: LogFactor, elapsed: float, model: HistoryModel) -> Bank:
    """Return the bank after one more log, `elapsed` days (1 without dates) after the last one."""
    order = (*bank.order, index)
    size = bank.mean.shape[-1]
    on_shape, on_iron = np.diag(np.arange(size) < SHAPE) * 1.0, np.diag(np.arange(size) >= size - 3) * 1.0
    walked = (
        bank.covariance + (WALK_OF_CELL**2 * elapsed)[:, None, None] * on_iron if bank.order else bank.covariance
    )
    if factor.mean is None or factor.covariance is None:
        label = np.hstack([bank.label, np.full((len(bank.label), 1), WALKED, dtype=np.int8)])
        return Bank(order, bank.dated, label, bank.weight, bank.mean, walked)
    noise = observed_covariance(factor, SHARED_OF_CELL, model) + (SCATTER_OF_CELL**2)[:, None, None] * on_shape
    innovation = factor.mean[OBSERVED] - bank.mean
    spoilt = model.wrong_shape**2 * on_shape + model.wrong_hard_iron**2 * on_iron
    shares = model.jump_share, model.wrong_share, model.refit_share
    prior = np.log([1 - sum(shares), *shares])
    branches = [
        (WALKED, *_updated(bank.mean, walked, innovation, noise)),
        (WRONG, bank.mean, walked, log_density(innovation, walked + noise + spoilt)),
    ]
    if bank.order:
        jumped = walked + model.jump**2 * on_iron
        refitted = jumped + model.refit_shape**2 * on_shape
        branches.insert(1, (JUMPED, *_updated(bank.mean, jumped, innovation, noise)))
        branches.append((REFITTED, *_updated(bank.mean, refitted, innovation, noise)))
    labels = [np.hstack([bank.label, np.full((len(bank.label), 1), each, dtype=np.int8)]) for each, *_ in branches]
    every = np.concatenate([bank.weight + density + prior[each] for each, _, _, density in branches])
    best = np.argsort(-np.logaddexp.reduce(every, axis=1), kind="stable")[:KEPT]
    return Bank(
        order,
        bank.dated,
        np.concatenate(labels)[best],
        every[best] - every[best].max(),
        np.concatenate([mean for _, mean, _, _ in branches])[best],
        np.concatenate([covariance for _, _, covariance, _ in branches])[best],
    )


def observed_covariance(factor: LogFactor, shared: ArrayLike, model: HistoryModel) -> Array:
    """Return the covariance (…, p + 3, p + 3) of a log's s, g and h, including the scatter of g between logs.

    Args:
        factor: of a log with a calibration.
        shared: (…) share of its model error that all logs have, which is left out.
        model: assumptions about the instrument between the logs.
    """
    assert factor.covariance is not None
    model_error = factor.model_error[OBSERVED, OBSERVED]
    observed = factor.covariance[OBSERVED, OBSERVED] - np.asarray(shared)[..., None, None] * model_error
    scale = np.arange(SHAPE, observed.shape[-1] - 3)
    observed[..., scale, scale] += model.gyroscope_scale_scatter**2
    return observed


def _updated(mean: Array, spread: Array, innovation: Array, noise: Array) -> tuple[Array, Array, Array]:
    """Update all filters by one reading of the whole state; return means, covariances and log-likelihoods."""
    total = spread + noise
    gain = np.linalg.solve(total, spread).swapaxes(-1, -2)  # P (P + R)⁻¹
    after = gain @ noise  # P (P + R)⁻¹ R, without cancellation
    density = log_density(innovation, total)
    return mean + np.einsum("...ij,...j->...i", gain, innovation), 0.5 * (after + after.swapaxes(-1, -2)), density


def _packed(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()


def _unpacked(text: str, shape: tuple[int, ...]) -> Array:
    values = np.frombuffer(base64.b64decode(text, validate=True), dtype="<f8").reshape(shape).astype(np.float64)
    if not np.isfinite(values).all():
        raise ValueError("not finite")
    return values
