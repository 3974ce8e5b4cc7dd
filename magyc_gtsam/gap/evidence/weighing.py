"""The log evidence of every candidate beside a model: amplitudes marginalised, scales and settings averaged.

With G and b the information and score of a candidate's columns beside the model (`beside`), in units of the smallest
effect that matters, and G = U diag(λ) Uᵀ, a scale s has ½ Σ [ (Uᵀb)² s² / (1 + s² λ) − ln(1 + s² λ) ] nats relative to
no effect. The average over settings and scales accounts for the grid search.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import Setting
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside, Seen
from magyc_gtsam.gap.evidence.candidates import Batch, Candidates
from magyc_gtsam.gap.evidence.prior import PRIOR

_LEAST = 1e-9  # of the squared columns: what is left of them beside a model is rounding if it is smaller


@dataclass(frozen=True, eq=False)
class Weighed:
    """The evidence of a candidate beside a model.

    Attributes:
        name: of the catalogue or of a family.
        log: log evidence relative to no effect, nats, averaged over scales and settings.
        by_scale: (S,) contribution of each scale to it, averaged over settings: `log` is their logsumexp.
        power: (S,) squared length of the explained part, at each scale.
        setting: the most probable one.
        search: nats by which the average over settings is below the most probable one.
        contained: power of the part of the set's signal that it could explain without the set.
        tied: nats of a family whose power is a share of that of the named effects, averaged over shares: of a cause
            of which the named effects are a part.
        cell: log prior of the most probable setting.
    """

    name: str
    log: float
    by_scale: Array
    power: Array
    setting: Setting
    search: float
    contained: float
    tied: float
    cell: float

    def less(self, search: float) -> Weighed:
        """Subtract the nats of a grid search that determined its columns."""
        return replace(self, log=self.log - search, by_scale=self.by_scale - search)

    def with_cell(self, finer: Weighed) -> Weighed:
        """Spread the prior share of its most probable setting over finer settings around it."""
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
    """A candidate at one setting.

    Attributes:
        log, power: (S,) nats and powers.
        contained: see `Weighed`.
        tied: nats averaged over shares.
        setting: the setting.
        prior: its log prior.
    """

    log: Array
    power: Array
    contained: float
    tied: float
    setting: Setting
    prior: float


def weigh(candidates: Candidates, beside: Beside, power: float = 0.0) -> dict[str, Weighed]:
    """Return the evidence of every candidate by name, beside a model whose named effects explain a power."""
    if not candidates.batches:
        return {}
    seen = beside.see(candidates.columns, candidates.score_bias)
    shared = _Shared.of(candidates, beside, seen)
    parts: dict[str, list[_Part]] = {}
    for batch in candidates.batches:
        log, powers, tied = _by_scale(batch, beside.noise, seen.reach, seen.score, power)
        contained = shared.contained(batch, beside.noise)
        for i, name in enumerate(batch.names):
            prior = float(batch.prior[i])
            parts.setdefault(name, []).append(
                _Part(log[i] + prior, powers[i], contained[i], tied[i] + prior, batch.settings[i], prior)
            )
    return {name: _averaged(name, many) for name, many in parts.items()}


class _Shared(NamedTuple):
    """What candidates have in common with the signal of a model's effects, beside the rest of the model.

    Attributes:
        reach: (N, m) of the candidates' columns into the rest of the model.
        across: (N,) their products with the signal.
    """

    reach: Array
    across: Array

    @classmethod
    def of(cls, candidates: Candidates, beside: Beside, seen: Seen) -> _Shared:
        signal, reach = beside.signal(), seen.reach[:, : beside.before]
        own = beside.see(signal[None] * beside.noise, np.zeros(1)).reach[0, : beside.before]
        return cls(reach, candidates.columns @ signal / beside.noise - reach @ own)

    def contained(self, batch: Batch, noise: float) -> Array:
        """Return the power (B,) of the part of the signal that each candidate could explain."""
        own, across = self.reach[batch.rows], self.across[batch.rows]
        gram = batch.gram / noise**2
        rounding = _LEAST * np.trace(gram, axis1=1, axis2=2) + np.finfo(float).tiny
        information = gram - own @ own.swapaxes(1, 2) + rounding[:, None, None] * np.eye(own.shape[1])
        result: Array = (across * np.linalg.solve(information, across[..., None])[..., 0]).sum(axis=1)
        return result


def _by_scale(
    batch: Batch, noise: float, reach: Array, score: Array, explained: float
) -> tuple[Array, Array, Array]:
    """Return nats and powers (B, S), and the nats (B,) averaged over shares of the explained power."""
    own = reach[batch.rows]
    value, vector = np.linalg.eigh(batch.gram / noise**2 - own @ own.swapaxes(1, 2))
    value = np.maximum(value, 0.0)[:, None]
    rotated = np.einsum("bki,bk->bi", vector, score[batch.rows])[:, None]
    variance = PRIOR.scales[:, None] ** 2
    spread = 1 + variance * value
    log = 0.5 * (rotated**2 * variance / spread - np.log(spread)).sum(axis=2)
    share = variance / spread
    power = ((share * rotated) ** 2 * value + share * value).sum(axis=2)
    for i, name in enumerate(batch.names):
        likely = scales_of(name)
        log[i, ~likely] = -np.inf
        log[i] += np.log(len(likely) / likely.sum())
    whole = np.trace(batch.gram, axis1=1, axis2=2)[:, None, None] / noise**2
    variance = PRIOR.shares[:, None] * explained / np.maximum(whole, 1e-12)
    spread = 1 + variance * value
    tied = 0.5 * (rotated**2 * variance / spread - np.log(spread)).sum(axis=2)
    return log, power, np.logaddexp.reduce(tied, axis=1) - np.log(len(PRIOR.shares))


def scales_of(name: str) -> np.ndarray:
    """Return (S,) whether an effect may have a scale, by its data sheets; a family may have any."""
    if name not in TERMS:
        return np.ones(len(PRIOR.scales), dtype=bool)
    return PRIOR.scales <= max(PRIOR.beyond * TERMS[name].prior / TERMS[name].matters, PRIOR.scales[0])


def _averaged(name: str, many: list[_Part]) -> Weighed:
    log = np.array([each.log for each in many])
    by_scale = np.logaddexp.reduce(log, axis=0)
    weight = np.exp(log - np.where(np.isfinite(by_scale), by_scale, 0.0))
    power = (weight * np.array([each.power for each in many])).sum(axis=0)
    of_setting = np.logaddexp.reduce(log, axis=1)
    # The settings are equally probable; the most probable one given the data is fitted.
    best = int(np.argmax(of_setting))
    scales = float(np.log(len(PRIOR.scales)))
    total = float(np.logaddexp.reduce(by_scale)) - scales
    search = float(of_setting[best]) - many[best].prior - scales - total
    tied = float(np.logaddexp.reduce([each.tied for each in many]))
    return Weighed(
        name,
        total,
        by_scale - scales,
        power,
        many[best].setting,
        search,
        many[best].contained,
        tied,
        many[best].prior,
    )


def best_of(weighed: Mapping[str, Weighed], count: int) -> list[Weighed]:
    """Return the most probable effects of the catalogue."""
    names = [each for each in weighed.values() if each.name in TERMS]
    return sorted(names, key=lambda each: -each.log)[:count]
