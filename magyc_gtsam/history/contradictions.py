"""Detection of the logs that are not used, as those that contradict the others of their instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.history.coordinates import SHAPE
from magyc_gtsam.history.forward import WRONG
from magyc_gtsam.history.instrument import Instrument
from magyc_gtsam.history.log_factor import HARD_IRON, LogFactor
from magyc_gtsam.recording import Array

_UNITS = (
    ("soft iron", slice(0, SHAPE), 100.0, "%"),
    ("hard iron", HARD_IRON, 1.0, "µT"),
)


@dataclass(frozen=True)
class Contradiction:
    """One log that is not used.

    Attributes:
        index: index of the log.
        name: name of the log.
        sentence: why: the parameter that differs, by how much and by how many sigmas, or why it has no calibration.
    """

    index: int
    name: str
    sentence: str


def contradictions_of(
    factors: Sequence[LogFactor], groups: Sequence[Sequence[int]], instruments: Sequence[Instrument]
) -> tuple[Contradiction, ...]:
    """Return the logs without a calibration, those labelled wrong, and those alone in a group."""
    contradictions = [Contradiction(i, f.name, f.problem) for i, f in enumerate(factors) if f.mean is None]
    main = instruments[0]
    for instrument in instruments:
        for k in np.flatnonzero(instrument.label == WRONG):
            i = instrument.order[k]
            if factors[i].mean is not None:
                off = _largest(factors[i], instrument, int(k))
                contradictions.append(
                    Contradiction(i, factors[i].name, f"{off}: left out, as if recorded beside foreign iron")
                )
    for group in groups[1:]:
        if len(group) == 1:
            near = min(range(len(main.order)), key=lambda k: abs(main.order[k] - group[0]))
            off = _largest(factors[group[0]], main, near)
            sentence = f"{off}: another instrument, or a field that its surroundings disturb"
            contradictions.append(Contradiction(group[0], factors[group[0]].name, sentence))
    return tuple(sorted(contradictions, key=lambda each: each.index))


def _largest(factor: LogFactor, instrument: Instrument, k: int) -> str:
    """Return the parameter in which a log differs most from its instrument, as text."""
    assert factor.mean is not None
    assert factor.covariance is not None
    posterior, place = instrument.at(k)
    off: list[tuple[float, str]] = []
    for name, part, unit, word in _UNITS:
        expected, spread = (
            (posterior.shared[part], posterior.shared_covariance[part, part])
            if name == "soft iron"
            else (posterior.hard_iron[place], posterior.covariance[place])
        )
        difference: Array = factor.mean[part] - expected
        total = factor.covariance[part, part] + spread
        sigmas = float(np.sqrt(difference @ np.linalg.solve(total, difference)))
        off.append((sigmas, f"{name} off by {np.linalg.norm(difference) * unit:.2g} {word} ({sigmas:.1f} sigma)"))
    return max(off)[1]
