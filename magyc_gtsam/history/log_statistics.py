"""Statistics by which logs are compared: of each log, and summed over the logs of a group.

An instrument keeps its soft iron, gyroscope scale, gyroscope bias and misalignment from log to log up to a scatter;
these are the kept parameters, `KEPT_SIZE` in number. A log has no information on those that it does not estimate. Its
hard iron is kept in a share `STAYED` of the logs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from magyc_gtsam.history.bias_scatter import BIAS_SCATTERS
from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.gaussian import log_density
from magyc_gtsam.history.log_factor import HARD_IRON, MILLIRADIAN, SIZE, LogFactor
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Array

KEPT_SIZE = SHAPE + 9  # soft iron, gyroscope scale, gyroscope bias, misalignment
STAYED = 0.8  # share of an instrument's logs whose hard iron equals that of another of its logs


class Evidence(NamedTuple):
    """What logs say about the kept parameters, at each scatter of the gyroscope bias.

    Attributes:
        information, weighted: (…, g, k, k), (…, g, k) information, and information times mean.
        constant: (…, g) nats, their log-likelihood at zero.
    """

    information: Array
    weighted: Array
    constant: Array

    @classmethod
    def nothing(cls) -> Evidence:
        """Return the evidence of no log."""
        count = len(BIAS_SCATTERS)
        return cls(np.zeros((count, KEPT_SIZE, KEPT_SIZE)), np.zeros((count, KEPT_SIZE)), np.zeros(count))

    def of(self, rows: int | Sequence[int]) -> Evidence:
        """Return the evidence of some of the logs."""
        return Evidence(*(each[rows] for each in self))

    def plus(self, other: Evidence, sign: int = 1) -> Evidence:
        """Return the sum with another evidence, or the difference (sign −1)."""
        return Evidence(*(one + sign * two for one, two in zip(self, other, strict=True)))


@dataclass(frozen=True, eq=False)
class LogStatistics:
    """Statistics of logs, one row each.

    Attributes:
        kept: what the logs say about the kept parameters.
        hard_iron, hard_iron_covariance: (k, 3) µT and (k, 3, 3).
        anywhere: (k,) log density of the hard iron among all instruments.
        most_hard_iron: (k,) nats, the largest gain that a comparison of hard irons can give.
        log_volume: (k,) log determinant of the covariance; smaller means more certain.
    """

    kept: Evidence
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
        steady = np.r_[np.full(SHAPE, model.scatter), np.full(size - 6 - SHAPE, model.gyroscope_scale_scatter)]
        scatter = np.array([np.r_[steady, np.full(3, each)] for each in BIAS_SCATTERS])
        total = covariance[:, None, held[:, None], held] + scatter[:, :, None] ** 2 * np.eye(len(held))
        misalignment, misalignment_information = _misalignments(factors, model)
        information = np.zeros((len(factors), len(BIAS_SCATTERS), KEPT_SIZE, KEPT_SIZE))
        information[..., kept[:, None], kept] = np.linalg.inv(total)
        information[..., -3:, -3:] = misalignment_information[:, None]
        every = np.zeros((len(factors), KEPT_SIZE))
        every[:, kept], every[:, -3:] = mean[:, held], misalignment
        weighted = np.einsum("kgij,kj->kgi", information, every)
        constant = -0.5 * (np.einsum("kgi,ki->kg", weighted, every) + np.linalg.slogdet(total)[1])
        iron, iron_covariance = mean[:, HARD_IRON], covariance[:, HARD_IRON, HARD_IRON]
        wide = [log_density(iron, iron_covariance + np.eye(3) * h**2) for _, h in (model.raw, model.calibrated)]
        anywhere = np.logaddexp(*wide) + np.log(0.5)
        peak = log_density(np.zeros(3), iron_covariance + np.eye(3) * model.hard_iron_scatter**2)
        return cls(
            Evidence(information, weighted, constant),
            iron,
            iron_covariance,
            anywhere,
            np.logaddexp(np.log(1 - STAYED), np.log(STAYED) + peak - anywhere),
            np.linalg.slogdet(covariance)[1],
        )

    def with_more(self, others: LogStatistics) -> LogStatistics:
        """Return these statistics followed by `others`."""
        names = [field.name for field in fields(self) if field.name != "kept"]
        joined = (np.concatenate([getattr(self, name), getattr(others, name)]) for name in names)
        return LogStatistics(Evidence(*map(np.concatenate, zip(self.kept, others.kept, strict=True))), *joined)


class Group:
    """Logs of one instrument, and the sum of their evidence on the kept parameters."""

    def __init__(self, logs: Sequence[int] = (), kept: Evidence | None = None) -> None:
        self.logs = list(logs)
        self.kept = Evidence.nothing() if kept is None else kept

    def change(self, i: int, kept: Evidence, sign: int) -> None:
        """Add log `i` (sign 1) or remove it (−1)."""
        self.kept = self.kept.plus(kept, sign)
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
