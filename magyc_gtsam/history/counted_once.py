"""Logs whose samples a history has already; counted twice they would make its sigmas too small."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from magyc_gtsam.history.log_factor import LogFactor


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
    """Return the first of other logs that counts the samples of a log; None if none does."""
    keys = _keys(factor)
    return next((other for other in others if keys & _keys(other)), None)


def _keys(factor: LogFactor) -> set[str | bytes]:
    """Return what identifies the samples that a log counts.

    That is their fingerprint, and the numbers fitted to them, since histories of earlier versions have no other. A log
    without a calibration counts none.
    """
    if factor.mean is None:
        return set()
    fitted: set[str | bytes] = {factor.mean.tobytes()}
    return fitted | {factor.samples} if factor.samples else fitted
