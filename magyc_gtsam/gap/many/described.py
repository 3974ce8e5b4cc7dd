"""The effects that were added to many logs, as values with sigmas, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.many.one_log import OneLog
from magyc_gtsam.gap.many.result import InLog, SharedEffect
from magyc_gtsam.gap.outcome.described import FIELD_VARIES

_FIRST = 4  # logs that a sentence names


@dataclass(frozen=True, eq=False)
class AddedEffect:
    """An effect in the model: probabilities that it is the instrument's and that each log has it, and its settings."""

    name: str
    evidence: float
    instrument: float
    present: Array
    settings: tuple[Mapping[str, float] | None, ...]
    rivals: tuple[str, ...]

    def in_logs(self, kept: np.ndarray) -> AddedEffect:
        """Return the effect in those of the logs that are `kept` (logs,) bool."""
        settings = tuple(setting for setting, keep in zip(self.settings, kept, strict=True) if keep)
        return replace(self, present=self.present[kept], settings=settings)


def told(
    added: Sequence[AddedEffect], logs: Sequence[OneLog], calibrations: Mapping[str, Calibration]
) -> tuple[SharedEffect, ...]:
    """Return the effects of a search at its end, without those whose logs were all left out later.

    Args:
        added: the effects.
        logs: the logs with their models.
        calibrations: {log: calibration of its model}, whose terms state the values, with the model error.
    """
    return tuple(
        _variation(each, logs) if each.name == FIELD_VARIATION else _effect(each, logs, calibrations)
        for each in added
        if any(s is not None for s in each.settings)
    )


def _variation(each: AddedEffect, logs: Sequence[OneLog]) -> SharedEffect:
    """Return the field of the place that varies, with its size in each log."""
    inside = tuple(
        InLog(
            log.name,
            float(p),
            np.array([log.variation.size * 1e6]),
            np.full(1, np.nan),
            {"period": log.variation.period},
        )
        for log, p in zip(logs, each.present, strict=True)
        if log.variation is not None
    )
    sentence = f"from the place, {_where(inside, len(logs))}: {FIELD_VARIES}"
    return SharedEffect(
        name=each.name,
        label=FIELD_VARIES,
        of="place",
        instrument=0.0,
        parameters=("size",),
        unit="µT",
        evidence=sum(log.of_field for log in logs),
        ambiguous_with=each.rivals,
        logs=inside,
        sentence=sentence,
    )


def _effect(each: AddedEffect, logs: Sequence[OneLog], calibrations: Mapping[str, Calibration]) -> SharedEffect:
    term = TERMS[each.name]
    found = [
        (log, setting, float(p), next(t for t in calibrations[log.name].terms if t.name == each.name))
        for log, setting, p in zip(logs, each.settings, each.present, strict=True)
        if setting is not None
    ]
    inside = tuple(
        InLog(log.name, p, own.value * term.scale, own.sigma * term.scale, setting)
        for log, setting, p, own in found
    )
    instrument = each.instrument >= 0.5
    value, sigma, scatter = np.zeros(0), np.zeros(0), float("nan")
    if instrument and len({len(log.value) for log in inside}) == 1:
        value, covariance, scatter = _combined([own for *_, own in found])
        value, sigma = value * term.scale, np.sqrt(np.diag(covariance)) * term.scale
    first, setting = found[0][:2]
    rows = term.rows(first.refitted.twin, setting)
    rivals = ", ".join(LABELS.get(name, FIELD_VARIES) for name in each.rivals)
    also = f" (or {rivals}: these logs cannot distinguish them)" if rivals else ""
    if instrument:
        said = term.sentence(value, sigma, setting, rows) if len(value) else term.label
        sentence = f"in the instrument, the same in all logs: {said}{also}"
    else:
        sentence = f"from the place or the day, {_where(inside, len(logs))}: {term.label}{also}"
    return SharedEffect(
        name=each.name,
        label=LABELS[each.name],
        of="instrument" if instrument else "place",
        instrument=each.instrument,
        value=value,
        sigma=sigma,
        parameters=term.names(len(value) or len(inside[0].value), rows),
        unit=term.unit,
        setting=dict(setting) if instrument else {},
        evidence=each.evidence,
        scatter=scatter,
        ambiguous_with=each.rivals,
        logs=inside,
        sentence=sentence,
    )


def _combined(terms: Sequence[Term]) -> tuple[Array, Array, float]:
    """Return the mean weighted by information, its covariance, and χ² per degree of freedom of the values about it."""
    information = [np.linalg.pinv(term.covariance, hermitian=True) for term in terms]
    covariance = np.linalg.pinv(np.sum(information, axis=0), hermitian=True)
    mean = covariance @ np.sum([w @ term.value for w, term in zip(information, terms, strict=True)], axis=0)
    from_mean = [term.value - mean for term in terms]
    away = sum(float(v @ w @ v) for w, v in zip(information, from_mean, strict=True))
    freedoms = len(mean) * (len(terms) - 1)
    return mean, covariance, away / freedoms if freedoms else float("nan")


def _where(inside: Sequence[InLog], count: int) -> str:
    """Return the logs in words."""
    names = ", ".join(log.log for log in inside[:_FIRST]) + (" and others" if len(inside) > _FIRST else "")
    return f"in {len(inside)} of {count} logs ({names})"
