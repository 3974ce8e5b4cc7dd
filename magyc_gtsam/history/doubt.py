"""Why the calibration that a history predicts for the next log must not be used."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime, timezone
from itertools import pairwise
from typing import NamedTuple

from magyc_gtsam.foreign_text import listed
from magyc_gtsam.history.forward import WRONG
from magyc_gtsam.history.instrument import Instrument
from magyc_gtsam.history.log_factor import LogFactor
from magyc_gtsam.history.model import DAY
from magyc_gtsam.history.pooled import scale_of

_MOST_GROUPS = 3  # that are named
_OTHER_PLACES = 0.05  # relative scatter of the scales, above which a given strength is not that of all logs
_FAR_APART = 1000.0  # days between two logs, from which a clock is suspected that was never set


class HistoryDoubt(NamedTuple):
    """A reason with its remedy, at most 30 words together, and a title."""

    cause: str
    action: str
    called: str

    @property
    def sentence(self) -> str:
        """Both in one sentence."""
        return f"{self.cause}: {self.action}"


def date_of(seconds: float) -> str:
    """Return the date of a time in s since 1970, UTC."""
    return datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%d")


def doubt_of(
    factors: Sequence[LogFactor], groups: Sequence[Sequence[int]], instruments: Sequence[Instrument]
) -> HistoryDoubt | None:
    """Return why the next log is not predicted: logs of several instruments or places, an order in time that is not
    known, or a last log that is left out.
    """
    several = several_instruments([[factors[i].name for i in group] for group in groups])
    if several is not None:
        return several
    apart = None if any(log.time is None and log.mean is not None for log in factors) else _far_apart(factors)
    if apart is not None:
        return apart
    main = instruments[0]
    used = [k for k, i in enumerate(main.order) if factors[i].mean is not None]
    last = factors[main.order[used[-1]]]
    newest = _newest(instruments)
    if newest not in main.order:
        return HistoryDoubt(
            f"{factors[newest].name}, the last log, is of another instrument than those before it, or its iron changed",
            "leave it out, or add another log of that instrument",
            "The next log is not predicted",
        )
    if _is_ahead(last):
        assert last.time is not None
        return HistoryDoubt(
            f"{last.name} is dated {date_of(last.time)}, in the future",
            "correct the date of this log, or leave it out",
            "The order of the logs is not known",
        )
    if main.label[used[-1]] == WRONG:
        return HistoryDoubt(
            f"{last.name}, the last log, contradicts those before it: iron was near, or its own changed for good",
            "add another log; if it agrees, the iron changed",
            "The next log is not predicted",
        )
    _, sigma = scale_of([factors[i] for k, i in enumerate(main.order) if main.label[k] != WRONG])
    if sigma > _OTHER_PLACES:
        return HistoryDoubt(
            f"the scales of the soft irons differ by {sigma:.0%} (1σ), so that the given field is not that of all logs",
            "give the logs of each place alone, with its field, or all without a field",
            "The logs are not of one place",
        )
    return None


def several_instruments(groups: Sequence[Sequence[str]]) -> HistoryDoubt | None:
    """Return that logs are of several instruments; None if they are not.

    Args:
        groups: the names of logs that can be of one instrument, the largest group first; a log that is alone beside a
            larger group may only be disturbed.
    """
    several = [group for group in groups if len(group) > 1 or len(group) == len(groups[0])]
    if len(several) < 2:
        return None
    members = "; ".join(listed(group) for group in several[:_MOST_GROUPS])
    more = "; and more" if len(several) > _MOST_GROUPS else ""
    return HistoryDoubt(
        f"the logs are of {len(several)} instruments ({members}{more})",
        "give the logs of one instrument alone",
        "The logs do not belong together",
    )


def _newest(instruments: Sequence[Instrument]) -> int:
    """Return the index of the last log with a calibration, of whatever instrument."""
    dated = [
        (log.time, index)
        for instrument in instruments
        for log, index in zip(instrument.logs, instrument.order, strict=True)
        if log.mean is not None
    ]
    return max(dated)[1]


def _far_apart(factors: Sequence[LogFactor]) -> HistoryDoubt | None:
    """Return that a log is dated years before the next one, as by a clock that was never set; None if none is."""
    known = sorted((each.time, each.name) for each in factors if each.time is not None and each.mean is not None)
    for (at, name), (later, after) in pairwise(known):
        if later - at > _FAR_APART * DAY and later <= time.time() + DAY:
            return HistoryDoubt(
                f"{name} is dated {date_of(at)}, {(later - at) / DAY:.0f} days before {after}, as by a clock that was "
                "not set",
                f"leave out the logs before {after}, or correct their dates",
                "The order of the logs is not known",
            )
    return None


def last_unused(factors: Sequence[LogFactor], times: Sequence[float] | None) -> LogFactor | None:
    """Return the last log if it could be read and has no calibration to trust; None otherwise.

    Args:
        factors: of the history.
        times: of each; None for their order.
    """
    when = range(len(factors)) if times is None else times
    counted = [(at, k) for k, (at, factor) in enumerate(zip(when, factors, strict=True)) if factor.counts]
    last = factors[max(counted)[1]]
    return last if last.mean is None else None


def _is_ahead(factor: LogFactor) -> bool:
    """Return whether a log is dated in the future."""
    return factor.time is not None and factor.time > time.time() + DAY
