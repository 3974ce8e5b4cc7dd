"""Logs whose samples a history has already; counted twice they would make its sigmas too small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.recording.fingerprint import first_shared


def counted_once(factors: Sequence[LogFactor], before: Sequence[LogFactor]) -> list[LogFactor]:
    """Return the factors without the information of those whose samples an earlier one has, under whatever name."""
    result: list[LogFactor] = []
    for factor in factors:
        first = same_samples(factor, [*before, *result])
        if first is not None:
            problem = f"the same samples as {first.name}, which count once"
            factor = replace(factor, mean=None, covariance=None, problem=problem)
        result.append(factor)
    return result


def same_samples(factor: LogFactor, others: Sequence[LogFactor]) -> LogFactor | None:
    """Return the first of other logs that counts samples of a log; None if none does."""
    if factor.mean is None:  # a log without a calibration counts none
        return None
    fitted = factor.mean.tobytes()  # histories of earlier versions have no fingerprints
    for other in others:
        if other.mean is not None:
            shared = first_shared(factor.samples, [other.samples]) is not None
            if shared or other.mean.tobytes() == fitted:
                return other
    return None
