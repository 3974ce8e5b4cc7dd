"""Effects on the noise or the rows over many logs: attributed to the instrument if most logs have them.

The evidence of each log is its gain in log-likelihood beyond chance. A tone is the largest of many lines: its p-value p
has the evidence ∫ κ p^(κ−1) dκ = (1 − p + p ln p) / (p ln² p) relative to no effect (Sellke, Bayarri and Berger 2001).
Exchanged axes, held values and coarse steps are detected with certainty or not at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.many.model import MODEL
from magyc_gtsam.gap.many.one_log import OneLog
from magyc_gtsam.gap.many.result import InLog, SharedEffect
from magyc_gtsam.gap.many.weighing import mixture
from magyc_gtsam.gap.samples.noise_effects import NoiseScore

_FITTED = ("coloured-noise", "spikes")
_LEAST = 1e-3  # nats of evidence below which a p-value counts as 1


def noise_effects(logs: Sequence[OneLog], names: Sequence[str]) -> tuple[SharedEffect, ...]:
    """Return the effects on the noise, strongest first, without weak ones that a stronger one may cause."""
    scores = [log.noise() for log in logs]
    found = [_effect(name, logs, scores) for name in reversed(names) if name not in TERMS]
    kept: list[SharedEffect] = []
    for each in sorted((one for one in found if one is not None), key=lambda one: -one.evidence):
        if each.evidence > MODEL.sure + MODEL.remain * sum(before.evidence for before in kept):
            kept.append(each)
    return tuple(kept)


def _effect(name: str, logs: Sequence[OneLog], scores: Sequence[Mapping[str, NoiseScore]]) -> SharedEffect | None:
    own = [each.get(name) for each in scores]
    untested = 0.0 if name in _FITTED else -MODEL.settled
    nats = [untested if one is None else _nats(one) for one in own]
    evidence, present, everywhere = mixture(np.array(nats)[None, None])
    here = [
        (log, one, float(p)) for log, one, p in zip(logs, own, present, strict=True) if one is not None and p > 0.5
    ]
    if not here:
        return None
    unit, scale = here[0][1].shown
    each = np.array([np.linalg.norm(one.value) * scale for _, one, _ in here])
    instrument = everywhere >= 0.5
    value, sigma = np.zeros(0), np.zeros(0)
    if instrument and unit:
        value, sigma = np.array([np.median(each)]), np.array([each.std() / np.sqrt(len(each))])
    inside = tuple(
        InLog(log.name, p, size[None], np.full(1, np.nan), dict(one.setting))
        for (log, one, p), size in zip(here, each, strict=True)
    )
    truncated = ", truncated towards zero" if all("truncated" in one.setting for _, one, _ in here) else ""
    whose = "in the instrument, in" if instrument else "from the place or the day, in"
    return SharedEffect(
        name=name,
        label=LABELS[name],
        of="instrument" if instrument else "place",
        instrument=everywhere,
        value=value,
        sigma=sigma,
        parameters=("size",) if unit else (),
        unit=unit,
        evidence=evidence,
        logs=inside,
        sentence=f"{whose} {len(here)} of {len(logs)} logs: {LABELS[name]}{truncated}",
    )


def _nats(score: NoiseScore) -> float:
    """Return the evidence of one log, nats."""
    if score.evidence > MODEL.alone and not score.significant:
        return -MODEL.settled  # strong, but not of the effect's form
    if score.name in _FITTED:
        return score.evidence
    if score.name == "tone":
        surprise = max(score.evidence, _LEAST)
        p = np.exp(-min(surprise, 600.0))
        return float(np.log(1 - p - p * surprise) + surprise - 2 * np.log(surprise))
    return MODEL.settled if score.significant else -MODEL.settled
