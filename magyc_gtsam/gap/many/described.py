"""The effects that were added to many logs, as values with sigmas, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.chain.rotations import Array
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
            np.array([np.hypot(log.variation.along, log.variation.attitude) * 1e6]),
            np.full(1, np.nan),
            {"period": log.variation.period},
        )
        for log, p in zip(logs, each.present, strict=True)
        if log.variation is not None
    )
    sentence = f"from the place, {_where(inside, len(logs))}: {FIELD_VARIES}"
    return SharedEffect(
        each.name,
        FIELD_VARIES,
        "place",
        0.0,
        np.zeros(0),
        np.zeros(0),
        ("size",),
        "µT",
        {},
        sum(log.of_field for log in logs),
        float("nan"),
        each.rivals,
        inside,
        sentence,
    )


def _effect(each: AddedEffect, logs: Sequence[OneLog], calibrations: Mapping[str, Calibration]) -> SharedEffect:
    term = TERMS[each.name]
    here = [
        (log, setting, p)
        for log, setting, p in zip(logs, each.settings, each.present, strict=True)
        if setting is not None
    ]
    found = [(log, setting, float(p), *_value(calibrations[log.name], each.name)) for log, setting, p in here]
    inside = tuple(
        InLog(log.name, p, value * term.scale, np.sqrt(np.diag(covariance)) * term.scale, setting)
        for log, setting, p, value, covariance in found
    )
    instrument = each.instrument >= 0.5
    sizes = {len(value) for _, _, _, value, _ in found}
    value, sigma, scatter = np.zeros(0), np.zeros(0), float("nan")
    if instrument and len(sizes) == 1:
        value, covariance, scatter = _combined([(v, c) for *_, v, c in found])
        value, sigma = value * term.scale, np.sqrt(np.diag(covariance)) * term.scale
    setting = dict(found[0][1]) if instrument and found else {}
    rows = term.rows(found[0][0].refitted.twin, found[0][1]) if found else ()
    count = len(value) or (len(found[0][3]) if found else 0)
    return SharedEffect(
        each.name,
        LABELS[each.name],
        "instrument" if instrument else "place",
        each.instrument,
        value,
        sigma,
        term.names(count, rows),
        term.unit,
        setting,
        each.evidence,
        scatter,
        each.rivals,
        inside,
        _sentence(each, inside, value, sigma, setting, rows, len(logs)),
    )


def _value(calibration: Calibration, name: str) -> tuple[Array, Array]:
    term = next(term for term in calibration.terms if term.name == name)
    return term.value, term.covariance


def _combined(values: Sequence[tuple[Array, Array]]) -> tuple[Array, Array, float]:
    """Return the mean weighted by information, its covariance, and χ² per degree of freedom of the values about it."""
    information = [np.linalg.pinv(covariance, hermitian=True) for _, covariance in values]
    covariance = np.linalg.pinv(np.sum(information, axis=0), hermitian=True)
    mean = covariance @ np.sum([w @ v for w, (v, _) in zip(information, values, strict=True)], axis=0)
    away = sum(float((v - mean) @ w @ (v - mean)) for w, (v, _) in zip(information, values, strict=True))
    freedoms = len(mean) * (len(values) - 1)
    return mean, covariance, away / freedoms if freedoms else float("nan")


def _sentence(
    each: AddedEffect,
    inside: Sequence[InLog],
    value: Array,
    sigma: Array,
    setting: Mapping[str, float],
    rows: Sequence[str],
    count: int,
) -> str:
    term = TERMS[each.name]
    rivals = ", ".join(LABELS.get(name, FIELD_VARIES) for name in each.rivals)
    also = f" (or {rivals}: these logs cannot distinguish them)" if rivals else ""
    if each.instrument >= 0.5:
        said = term.sentence(value, sigma, setting, rows) if len(value) else term.label
        return f"in the instrument, the same in all logs: {said}{also}"
    return f"from the place or the day, {_where(inside, count)}: {term.label}{also}"


def _where(inside: Sequence[InLog], count: int) -> str:
    """Return the logs in words."""
    names = ", ".join(log.log for log in inside[:_FIRST]) + (" and others" if len(inside) > _FIRST else "")
    return f"in {len(inside)} of {count} logs ({names})"
