"""What an autopilot multiplies its motor parameters by, and which channel of the log that is."""

from __future__ import annotations

import re
from typing import NamedTuple

from magyc_gtsam.factors.effects.changes import referenced
from magyc_gtsam.factors.effects.signals import stands_in
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.recording.autopilot import Autopilot

THROTTLE, CURRENT = 1, 2  # of COMPASS_MOTCT and CAL_MAG_COMP_TYP; PX4 has 3 for its second battery
_UNITS = (  # in names of channels, and their number in an ampere or in full throttle
    (CURRENT, 1e3, re.compile(r"(?<![a-z])(ma|milliamp\w*)(?![a-z])", re.IGNORECASE)),
    (THROTTLE, 1e2, re.compile(r"%|(?<![a-z])(percent|pct)(?![a-z])", re.IGNORECASE)),
)


class Power(NamedTuple):
    """What the motor parameters are multiplied by.

    Attributes:
        type: value of COMPASS_MOTCT or CAL_MAG_COMP_TYP.
        channel: of the log in which the effect was found; "" if it is not known.
        unit: value of the channel at 1 A or full throttle.
    """

    type: int = CURRENT
    channel: str = ""
    unit: float = 1.0


def unit_of(channel: str, kind: int) -> float:
    """Return the value of a channel at 1 A or full throttle, by its name: 1 if that names no unit."""
    return next((size for of, size, word in _UNITS if of == kind and word.search(channel)), 1.0)


def power_of(term: Term, autopilot: Autopilot | None) -> Power | str:
    """Return what a target multiplies the motor parameters by to correct an effect of one channel, or why it cannot.

    Args:
        term: of a current, or a throttle in its place.
        autopilot: of its log, whose firmware is the target; None for a log that says nothing of it, of which the names
            of the channels decide.
    """
    if not term.channels:
        return Power()
    channel = term.channels[referenced(term.channels, term.setting)[0]]
    if autopilot is None:
        kind = THROTTLE if stands_in(channel, "current") else CURRENT
        return Power(kind, shortened(channel), unit_of(channel, kind))
    if channel not in autopilot.powers:
        return f"{shortened(channel)} is not what the autopilot corrects a compass by"
    kind, unit = autopilot.powers[channel]
    return Power(kind, shortened(channel), unit)
