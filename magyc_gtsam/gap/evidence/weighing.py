"""The evidence of every candidate beside a model, with amplitudes marginalised and scales and settings averaged.

With G and b the information and the score of a candidate's columns beside the model (`beside`), in units of what
matters, and G = U diag(λ) Uᵀ, a scale s is worth ½ Σ [ (Uᵀb)² s² / (1 + s² λ) − ln(1 + s² λ) ] nats against nothing.
The average over settings and scales pays for the search over them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import Setting
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Batch, Candidates
from magyc_gtsam.gap.evidence.prior import PRIOR


@dataclass(frozen=True, eq=False)
class Weighed:
    """A candidate beside a model.

    Attributes:
        name: of the catalogue or of a family.
        log: nats against nothing, scales and settings averaged.
        by_scale: (S,) the part of it of each scale, settings averaged: `log` is their logsumexp.
        power: (S,) squared length of what it would explain, at each scale.
        setting: the likeliest.
        search: nats, that the average over settings costs against the likeliest.
        tied: nats of a power that is expected to be a share of what is named, shares averaged: of a family that has
            what is named as a part.
        cell: log prior of the likeliest setting.
    """

    name: str
    log: float
    by_scale: Array
    power: Array
    setting: Setting
    search: float
    tied: float
    cell: float

    def less(self, search: float) -> Weighed:
        """With a search paid for, by which its columns were chosen."""
        return replace(self, log=self.log - search, by_scale=self.by_scale - search)

    def with_cell(self, finer: Weighed) -> Weighed:
        """With the share of the prior of its likeliest setting spread over finer settings around it."""
        by_scale = np.logaddexp(self.by_scale, finer.by_scale + self.cell)
        log = float(np.logaddexp(self.log, finer.log + self.cell))
        share = np.exp(finer.by_scale + self.cell - np.where(np.isfinite(by_scale), by_scale, 0.0))
        return replace(
            finer,
            log=log,
            by_scale=by_scale,
            power=self.power + share * (finer.power - self.power),
            search=finer.search + finer.log - log,
            tied=float(np.logaddexp(self.tied, finer.tied + self.cell)),
            cell=self.cell + finer.cell,
        )


class _Part(NamedTuple):
    """A candidate at one setting: (S,) nats and powers, nats of shares, its setting and that one's log prior."""

    log: Array
    power: Array
    tied: float
    setting: Setting
    prior: float


def weigh(candidates: Candidates, beside: Beside, power: float = 0.0) -> dict[str, Weighed]:
    """Every candidate by its name, beside a model whose names explain a power."""
    if not candidates.batches:
        return {}
    seen = beside.see(candidates.columns, candidates.pull)
    parts: dict[str, list[_Part]] = {}
    for batch in candidates.batches:
        log, powers, tied = _by_scale(batch, beside.noise, seen.reach, seen.score, power)
        for i, name in enumerate(batch.names):
            prior = float(batch.prior[i])
            parts.setdefault(name, []).append(
                _Part(log[i] + prior, powers[i], tied[i] + prior, batch.settings[i], prior)
            )
    return {name: _averaged(name, many) for name, many in parts.items()}


def _by_scale(
    batch: Batch, noise: float, reach: Array, score: Array, explained: float
) -> tuple[Array, Array, Array]:
    """(B, S) nats and powers, and (B,) nats of shares of what is explained."""
    own = reach[batch.rows]
    value, vector = np.linalg.eigh(batch.gram / noise**2 - own @ own.swapaxes(1, 2))
    value = np.maximum(value, 0.0)[:, None]
    pull = np.einsum("bki,bk->bi", vector, score[batch.rows])[:, None]
    variance = PRIOR.scales[:, None] ** 2
    spread = 1 + variance * value
    log = 0.5 * (pull**2 * variance / spread - np.log(spread)).sum(axis=2)
    share = variance / spread
    power = ((share * pull) ** 2 * value + share * value).sum(axis=2)
    for i, name in enumerate(batch.names):
        likely = scales_of(name)
        log[i, ~likely] = -np.inf
        log[i] += np.log(len(likely) / likely.sum())
    whole = np.trace(batch.gram, axis1=1, axis2=2)[:, None, None] / noise**2
    variance = PRIOR.shares[:, None] * explained / np.maximum(whole, 1e-12)
    spread = 1 + variance * value
    tied = 0.5 * (pull**2 * variance / spread - np.log(spread)).sum(axis=2)
    return log, power, np.logaddexp.reduce(tied, axis=1) - np.log(len(PRIOR.shares))


def scales_of(name: str) -> np.ndarray:
    """(S,) which scales a name may have, by its data sheets; a family any."""
    if name not in TERMS:
        return np.ones(len(PRIOR.scales), dtype=bool)
    return PRIOR.scales <= max(PRIOR.beyond * TERMS[name].prior / TERMS[name].matters, PRIOR.scales[0])


def _averaged(name: str, many: list[_Part]) -> Weighed:
    log = np.array([each.log for each in many])
    by_scale = np.logaddexp.reduce(log, axis=0)
    weight = np.exp(log - np.where(np.isfinite(by_scale), by_scale, 0.0))
    power = (weight * np.array([each.power for each in many])).sum(axis=0)
    of_setting = np.logaddexp.reduce(log, axis=1)
    # Of a name each setting is as likely as the other, and the likeliest is fitted.
    best = int(np.argmax(of_setting))
    scales = float(np.log(len(PRIOR.scales)))
    total = float(np.logaddexp.reduce(by_scale)) - scales
    search = float(of_setting[best]) - many[best].prior - scales - total
    tied = float(np.logaddexp.reduce([each.tied for each in many]))
    return Weighed(name, total, by_scale - scales, power, many[best].setting, search, tied, many[best].prior)


def best_of(weighed: Mapping[str, Weighed], count: int) -> list[Weighed]:
    """The likeliest names."""
    names = [each for each in weighed.values() if each.name in TERMS]
    return sorted(names, key=lambda each: -each.log)[:count]
