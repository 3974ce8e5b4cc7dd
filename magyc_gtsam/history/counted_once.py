"""Logs whose samples a history has already; counted twice they would make its sigmas too small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.recording.fingerprint import first_shared, hashes_of


class CountedLogs:
    """Logs in the order in which they came, to find one with the same samples in time independent of their number."""

    def __init__(self) -> None:
        self._logs: list[LogFactor] = []
        self._with: dict[
            int | bytes, list[int]
        ] = {}  # by hash of samples, and by mean; earlier versions had no hashes

    def same_samples(self, factor: LogFactor) -> LogFactor | None:
        """Return the first log that counts samples of another one; None if none does."""
        near = sorted({i for key in _keys(factor) for i in self._with.get(key, ())})
        for log in (self._logs[i] for i in near):
            if log.mean is not None and factor.mean is not None:
                shared = first_shared(factor.samples, [log.samples]) is not None
                if shared or log.mean.tobytes() == factor.mean.tobytes():
                    return log
        return None

    def take(self, factors: Sequence[LogFactor]) -> list[LogFactor]:
        """Return the factors without the information of those whose samples an earlier one has, and keep the others."""
        result: list[LogFactor] = []
        for factor in factors:
            first = self.same_samples(factor)
            if first is not None:
                problem = f"the same samples as {first.name}, which count once"
                factor = replace(factor, mean=None, covariance=None, problem=problem, samples="")
            for key in _keys(factor):
                self._with.setdefault(key, []).append(len(self._logs))
            self._logs.append(factor)
            result.append(factor)
        return result


def _keys(factor: LogFactor) -> list[int | bytes]:
    """Return what a log shares with another one of the same samples; a log without a calibration counts none."""
    return [] if factor.mean is None else [factor.mean.tobytes(), *hashes_of(factor.samples).tolist()]


def of_one_kind(factors: Sequence[LogFactor]) -> tuple[LogFactor, ...]:
    """Return the factors, all with the gyroscope's scale or all without."""
    sizes = {len(factor.mean) for factor in factors if factor.mean is not None}
    if len(sizes) > 1:
        raise MagycError(
            "history: some logs were calibrated with the gyroscope's scale and some without; calibrate all of them "
            "with the same gyroscope_scale"
        )
    return tuple(factors)
