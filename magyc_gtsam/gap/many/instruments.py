"""Whether many logs are of one instrument, by the grouping of a history: only then has an effect one value in all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.history.doubt import several_instruments
from magyc_gtsam.history.grouping import Grouping
from magyc_gtsam.history.log_factor import LogFactor, compress
from magyc_gtsam.history.model import HistoryModel

ANOTHER = (
    "it is of another instrument than the other logs, or its surroundings disturb the field; the log was left out"
)


def instruments_of(calibrations: Mapping[str, Calibration]) -> tuple[tuple[str, ...], ...]:
    """Return the names of the logs that can be of one instrument, the largest group first; untrusted ones are in none.

    Args:
        calibrations: {log: its calibration}, with the effects that were found as terms.
    """
    factors = [_compressed(name, calibration) for name, calibration in calibrations.items()]
    groups = Grouping(factors, HistoryModel()).groups
    return tuple(tuple(factors[i].name for i in group) for group in groups)


def strangers(groups: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    """Return the logs that are alone, where others are of one instrument."""
    return tuple(group[0] for group in groups[1:] if len(group) == 1 < len(groups[0]))


def not_of_one(groups: tuple[tuple[str, ...], ...]) -> str:
    """Return that the logs are of several instruments, with the remedy; "" if they are of one."""
    doubt = several_instruments(groups)
    return "" if doubt is None else doubt.sentence


def _compressed(name: str, calibration: Calibration) -> LogFactor:
    """Return what a calibration says about its instrument, without a scale of the gyroscope: not all logs have one."""
    terms = tuple(term for term in calibration.terms if term.name != "gyro-scale")
    return compress(replace(calibration, terms=terms), name, None)
