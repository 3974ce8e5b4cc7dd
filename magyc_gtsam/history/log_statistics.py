"""Statistics by which logs are compared: of each log, and summed over the logs of a group.

An instrument keeps its soft iron, gyroscope scale, gyroscope bias and misalignment from log to log up to a scatter;
these are the kept parameters, `KEPT_SIZE` in number. A log has no information on those that it does not estimate. Its
hard iron is kept in a share `STAYED` of the logs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.gaussian import log_density
from magyc_gtsam.history.log_factor import HARD_IRON, MILLIRADIAN, SIZE, LogFactor
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

KEPT_SIZE = SHAPE + 9  # soft iron, gyroscope scale, gyroscope bias, misalignment
STAYED = 0.8  # share of an instrument's logs whose hard iron equals that of another of its logs


@dataclass(frozen=True, eq=False)
class LogStatistics:
    """Statistics of logs, one row each.

    Attributes:
        information, weighted: information on the kept parameters, and information times mean.
        hard_iron, hard_iron_covariance: (k, 3) µT and (k, 3, 3).
        anywhere: (k,) log density of the hard iron among all instruments.
        most_hard_iron: (k,) nats, the largest gain that a comparison of hard irons can give.
        log_volume: (k,) log determinant of the covariance; smaller means more certain.
    """

    information: Array
    weighted: Array
    hard_iron: Array
    hard_iron_covariance: Array
    anywhere: Array
    most_hard_iron: Array
    log_volume: Array

    @classmethod
    def of(cls, factors: Sequence[LogFactor], model: HistoryModel) -> LogStatistics:
        """Return the statistics of logs that have a calibration."""
        size = next((len(factor.mean) for factor in factors if factor.mean is not None), SIZE)
        mean = np.array([factor.mean for factor in factors]).reshape(-1, size)
        covariance = np.array([factor.covariance for factor in factors]).reshape(-1, size, size)
        held = np.r_[: size - 6, size - 3 : size]  # the kept parameters that a `LogFactor.mean` holds
        kept = np.r_[: size - 6, SHAPE + 3 : SHAPE + 6]  # their indices among all kept parameters
        scale_scatter = np.full(size - 6 - SHAPE, model.gyroscope_scale_scatter)
        scatter = np.diag(np.r_[np.full(SHAPE, model.scatter), scale_scatter, np.full(3, model.bias_scatter)] ** 2)
        misalignment, misalignment_information = _misalignments(factors, model)
        information = np.zeros((len(factors), KEPT_SIZE, KEPT_SIZE))
        information[:, kept[:, None], kept] = np.linalg.inv(covariance[:, held[:, None], held] + scatter)
        information[:, -3:, -3:] = misalignment_information
        every = np.zeros((len(factors), KEPT_SIZE))
        every[:, kept], every[:, -3:] = mean[:, held], misalignment
        iron, iron_covariance = mean[:, HARD_IRON], covariance[:, HARD_IRON, HARD_IRON]
        wide = [log_density(iron, iron_covariance + np.eye(3) * h**2) for _, h in (model.raw, model.calibrated)]
        anywhere = np.logaddexp(*wide) + np.log(0.5)
        peak = log_density(np.zeros(3), iron_covariance + np.eye(3) * model.hard_iron_scatter**2)
        return cls(
            information,
            np.einsum("kij,kj->ki", information, every),
            iron,
            iron_covariance,
            anywhere,
            np.logaddexp(np.log(1 - STAYED), np.log(STAYED) + peak - anywhere),
            np.linalg.slogdet(covariance)[1],
        )

    def with_more(self, others: LogStatistics) -> LogStatistics:
        """Return these statistics followed by `others`."""
        return LogStatistics(
            *(np.concatenate([getattr(self, field.name), getattr(others, field.name)]) for field in fields(self))
        )


class Group:
    """Logs of one instrument, and the sums of their information on the kept parameters."""

    def __init__(
        self, logs: Sequence[int] = (), information: Array | None = None, weighted: Array | None = None
    ) -> None:
        self.logs = list(logs)
        self.information = np.zeros((KEPT_SIZE, KEPT_SIZE)) if information is None else information
        self.weighted = np.zeros(KEPT_SIZE) if weighted is None else weighted

    def change(self, i: int, information: Array, weighted: Array, sign: int) -> None:
        """Add log `i` (sign 1) or remove it (−1)."""
        self.information = self.information + sign * information
        self.weighted = self.weighted + sign * weighted
        if sign > 0:
            self.logs.append(i)
        else:
            self.logs.remove(i)


def _misalignments(factors: Sequence[LogFactor], model: HistoryModel) -> tuple[Array, Array]:
    """Return misalignments (k, 3) mrad and their information (k, 3, 3), zero for a log that showed none."""
    misalignment, information = np.zeros((len(factors), 3)), np.zeros((len(factors), 3, 3))
    for k, factor in enumerate(factors):
        if factor.misalignment is not None and factor.misalignment_covariance is not None:
            misalignment[k] = factor.misalignment / MILLIRADIAN
            covariance = factor.misalignment_covariance / MILLIRADIAN**2 + np.eye(3) * model.skew_scatter**2
            information[k] = np.linalg.inv(covariance)
    return misalignment, information
