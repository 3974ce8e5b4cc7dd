"""What a comparison over many logs found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.storage.json_types import json_types

Verdict = Literal["none", "closed", "unknown", "not enough information"]


@dataclass(frozen=True, eq=False)
class InLog:
    """An effect in one log.

    Attributes:
        log: its name.
        present: probability that it has it; of an effect of the instrument 1.
        value, sigma: (k,) by this log alone, in the effect's unit.
        setting: of what was searched over, here.
    """

    log: str
    present: float
    value: Array
    sigma: Array
    setting: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class SharedEffect:
    """An effect that was found in many logs.

    Attributes:
        name, label: of the catalogue.
        of: "instrument" (one value everywhere) or "place" (of the place or the day: a value of its own in each log).
        instrument: probability of the former.
        value, sigma: (k,) of all logs together, in `unit`; of the place, empty.
        parameters, unit, setting: as of `Effect`.
        evidence: nats over all logs.
        scatter: of the instrument: χ² of the logs' values about the one, per freedom; NaN for one log.
        ambiguous_with: names that explain all logs as well.
        logs: those that have it.
        sentence: for a navigator.
    """

    name: str
    label: str
    of: Literal["instrument", "place"]
    instrument: float
    value: Array
    sigma: Array
    parameters: tuple[str, ...]
    unit: str
    setting: Mapping[str, float]
    evidence: float
    scatter: float
    ambiguous_with: tuple[str, ...]
    logs: tuple[InLog, ...]
    sentence: str


@dataclass(frozen=True)
class Own:
    """What one log has on its own, and does not share: it was left out of the comparison."""

    log: str
    sentence: str


@dataclass(frozen=True)
class Weight:
    """A hypothesis in the last look: nats of one value everywhere, and of a value each."""

    name: str
    shared: float
    apart: float


@dataclass(frozen=True, eq=False)
class GapOfMany:
    """The result of `find_gap` of several recordings of one instrument.

    Attributes:
        verdict: "none" (nothing is missing), "closed" (named, and nothing significant left), "unknown" (something is
            missing that is not in the catalogue), "not enough information" (fewer than two logs can be used).
        sentence: the verdict, for a navigator.
        effects: in the order of adding.
        own: logs that were left out, and why.
        weights: every hypothesis against the last model, strongest first.
        calibrations: {log: with the effects as terms, and a verdict by what the log shows beside them}.
    """

    verdict: Verdict
    sentence: str
    effects: tuple[SharedEffect, ...]
    own: tuple[Own, ...]
    weights: tuple[Weight, ...]
    calibrations: Mapping[str, Calibration]

    def __repr__(self) -> str:
        names = ", ".join(f"{effect.name} ({effect.of})" for effect in self.effects)
        return f"GapOfMany({self.verdict!r}, {len(self.calibrations)} logs{', ' + names if names else ''})"

    def to_dict(self) -> dict[str, Any]:
        """As JSON types, without the calibrations."""
        names = ("verdict", "sentence", "effects", "own", "weights")
        result: dict[str, Any] = json_types({name: getattr(self, name) for name in names})
        return result
