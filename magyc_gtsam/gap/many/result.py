"""The result of a comparison over many logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.result import Verdict
from magyc_gtsam.storage.json_types import json_types


@dataclass(frozen=True, eq=False)
class InLog:
    """An effect in one log.

    Attributes:
        log: its name.
        present: probability that the log has the effect; 1 for an effect of the instrument.
        value, sigma: (k,) from this log alone, in the effect's unit; sigma is NaN for an effect on the noise.
        setting: of the grid search in this log.
    """

    log: str
    present: float
    value: Array
    sigma: Array
    setting: Mapping[str, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class SharedEffect:
    """An effect that was found in many logs.

    Attributes:
        name, label: of the catalogue.
        of: "instrument" (one value in all logs) or "place" (of the place or the day: a separate value in each log).
        instrument: probability that it is of the instrument.
        value, sigma: (k,) from all logs together, in `unit`; empty for an effect of the place.
        parameters, unit, setting: as in `Effect`.
        evidence: over all logs, nats.
        scatter: for an effect of the instrument, χ² of the logs' values about the common value per degree of freedom;
            NaN for one log.
        ambiguous_with: names of alternatives that explain all logs as well.
        logs: the logs that have the effect.
        sentence: for a navigator.
    """

    name: str
    label: str
    of: Literal["instrument", "place"]
    instrument: float
    value: Array = field(default_factory=lambda: np.zeros(0))
    sigma: Array = field(default_factory=lambda: np.zeros(0))
    parameters: tuple[str, ...]
    unit: str
    setting: Mapping[str, float] = field(default_factory=dict)
    evidence: float
    scatter: float = float("nan")
    ambiguous_with: tuple[str, ...] = ()
    logs: tuple[InLog, ...]
    sentence: str


@dataclass(frozen=True)
class LogLeftOut:
    """A log that was left out of the comparison, and the reason."""

    log: str
    sentence: str


@dataclass(frozen=True)
class Weight:
    """A hypothesis in the last look: its evidence (nats) with one value in all logs, and with a value in each log."""

    name: str
    shared: float
    apart: float


@dataclass(frozen=True, eq=False)
class GapOfMany:
    """The result of `find_gap` for several recordings of one instrument.

    Attributes:
        verdict: "none" (nothing is missing), "closed" (named, and nothing significant remains), "unknown" (an effect
            outside the catalogue is missing), "not enough information" (fewer than two logs can be used, or they are of
            several instruments; without effects and calibrations then).
        sentence: the verdict, for a navigator.
        effects: in the order in which they were added.
        own: logs that were left out, and the reasons.
        weights: every hypothesis against the last model, strongest first.
        calibrations: {log: calibration}, with the effects as terms; each verdict includes the log's remaining misfit.
    """

    verdict: Verdict
    sentence: str
    effects: tuple[SharedEffect, ...]
    own: tuple[LogLeftOut, ...]
    weights: tuple[Weight, ...]
    calibrations: Mapping[str, Calibration]

    def __repr__(self) -> str:
        names = ", ".join(f"{effect.name} ({effect.of})" for effect in self.effects)
        return f"GapOfMany({self.verdict!r}, {len(self.calibrations)} logs{', ' + names if names else ''})"

    def to_dict(self) -> dict[str, Any]:
        """Return the result as JSON types, without the calibrations."""
        names = ("verdict", "sentence", "effects", "own", "weights")
        result: dict[str, Any] = json_types({name: getattr(self, name) for name in names})
        return result
