"""The log evidence of every candidate beside a model: amplitudes marginalised, scales and settings averaged.

With G and b the information and score of a candidate's columns beside the model (`beside`), in units of the smallest
effect that matters, and G = U diag(λ) Uᵀ, a scale s has ½ Σ [ (Uᵀb)² s² / (1 + s² λ) − ln(1 + s² λ) ] nats relative to
no effect. The average over settings and scales accounts for the grid search.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import LEAST, Beside
from magyc_gtsam.gap.evidence.candidates import Batch, Candidates
from magyc_gtsam.gap.evidence.prior import PRIOR

_JUMP = "hard-iron-step"
_ROUNDING = 1e-9  # of the squared columns: what is left of them beside a model is rounding if it is smaller


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
        cell: log prior of the most probable setting.
        information, score: (k, k) and (k,) of its values there, in units of what matters.
        everywhere: log prior of each setting, and the information (k, k) of the values there.
    """

    name: str
    log: float
    by_scale: Array
    power: Array
    setting: Setting
    search: float
    contained: float
    cell: float
    information: Array
    score: Array
    everywhere: tuple[tuple[float, Array], ...]

    @property
    def estimate(self) -> tuple[Array, Array]:
        """Return the estimate (k,) of the values at that setting, and its covariance, in units of what matters.

        Both are 0 in a direction without information, whose eigenvalue rounding may make negative.
        """
        value, vector = np.linalg.eigh(self.information)
        known = value > LEAST * max(float(value[-1]), 0.0)
        covariance: Array = (vector[:, known] / value[known]) @ vector[:, known].T
        return -covariance @ self.score, covariance

    @property
    def statistic(self) -> float:
        """Return twice the gain in log-likelihood at that setting."""
        return float(-self.estimate[0] @ self.score)

    @property
    def prior(self) -> float | None:
        """Return the prior deviation of its values, SI, that the data ask for beyond the catalogue's; else None."""
        term = TERMS[self.name]
        likely = float(PRIOR.scales[np.argmax(self.by_scale)] * term.matters)
        return likely if likely > term.prior else None

    def less(self, search: float) -> Weighed:
        """Subtract the nats of a search that determined its columns."""
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
            cell=self.cell + finer.cell,
            everywhere=self.everywhere,
        )


class _Part(NamedTuple):
    """A candidate at s settings with equally many values.

    Attributes:
        log, power: (s, S) nats with the log prior, and powers.
        contained: (s,) see `Weighed`.
        settings: the settings.
        prior: (s,) their log priors.
        information, score: (s, k, k) and (s, k) of the values.
    """

    log: Array
    power: Array
    contained: Array
    settings: Sequence[Setting]
    prior: Array
    information: Array
    score: Array


def weigh(candidates: Candidates, beside: Beside) -> dict[str, Weighed]:
    """Return the evidence of every candidate by name, beside a model."""
    if not candidates.batches:
        return {}
    seen = beside.see(candidates.columns, candidates.score_bias)
    # Products of the columns with the signal of the model's effects, beside the rest of the model.
    across = seen.on_signal - seen.reach[:, : beside.before] @ beside.reach_of_signal
    parts: dict[str, list[_Part]] = {}
    for batch in candidates.batches:
        reach, score = seen.reach[batch.rows], seen.score[batch.rows]
        rest, effects = reach[..., : beside.before], reach[..., beside.before :]
        gram = batch.gram / beside.noise**2
        beside_rest = gram - rest @ rest.swapaxes(1, 2)
        contained = _contained(beside_rest, gram, across[batch.rows])
        information = beside_rest - effects @ effects.swapaxes(1, 2)
        log, power = _by_scale(batch, information, score)
        log += batch.prior[:, None]
        for name, at in batch.places.items():
            settings = [batch.settings[i] for i in at]
            own = _Part(log[at], power[at], contained[at], settings, batch.prior[at], information[at], score[at])
            parts.setdefault(name, []).append(own)
    return {name: _averaged(name, many) for name, many in parts.items()}


def _contained(information: Array, gram: Array, across: Array) -> Array:
    """Return the power (B,) of the part of a signal that each candidate could explain.

    Args:
        information: (B, k, k) of the candidates.
        gram: (B, k, k) the same without a model.
        across: (B, k) products of their columns with the signal.
    """
    rounding = _ROUNDING * np.trace(gram, axis1=1, axis2=2) + np.finfo(float).tiny
    regular = information + rounding[:, None, None] * np.eye(across.shape[1])
    result: Array = (across * np.linalg.solve(regular, across[..., None])[..., 0]).sum(axis=1)
    return result


def information_of(batch: Batch, noise: float, reach: Array) -> Array:
    """Return the information (B, k, k) of candidates with a reach (N, m) beside a model."""
    own = reach[batch.rows]
    result: Array = batch.gram / noise**2 - own @ own.swapaxes(1, 2)
    return result


def _by_scale(batch: Batch, information: Array, score: Array) -> tuple[Array, Array]:
    """Return nats and powers (B, S)."""
    value, vector = np.linalg.eigh(information)
    value = np.maximum(value, 0.0)
    rotated = np.einsum("bki,bk->bi", vector, score)
    log = nats_by_scale(batch.names, value, rotated)
    variance = PRIOR.scales[:, None] ** 2
    share = variance / (1 + variance * value[:, None])
    power = ((share * rotated[:, None]) ** 2 * value[:, None] + share * value[:, None]).sum(axis=2)
    return log, power


def nats_by_scale(names: Sequence[str], value: Array, rotated: Array) -> Array:
    """Return the nats (B, S, …) of candidates at each scale that their data sheets allow, as shares of the average.

    Args:
        names: (B,) of the candidates.
        value: (B, k) eigenvalues of their information.
        rotated: (B, k, …) scores along the eigenvectors.
    """
    variance = PRIOR.scales[:, None] ** 2
    spread = 1 + variance * value[:, None]
    gain = np.einsum("bsk,bk...->bs...", variance / spread, rotated**2)
    log: Array = 0.5 * (gain - np.log(spread).sum(axis=2).reshape(gain.shape[:2] + (1,) * (gain.ndim - 2)))
    likely = np.array([scales_of(name) for name in names])
    log[~likely] = -np.inf
    log += np.log(likely.shape[1] / likely.sum(axis=1)).reshape((-1,) + (1,) * (log.ndim - 1))
    return log


@cache
def scales_of(name: str) -> np.ndarray:
    """Return (S,) whether an effect may have a scale, by its data sheets; a family may have any."""
    if name not in TERMS:
        return np.ones(len(PRIOR.scales), dtype=bool)
    return PRIOR.scales <= max(PRIOR.beyond * TERMS[name].limit / TERMS[name].matters, PRIOR.scales[0])


def _averaged(name: str, many: Sequence[_Part]) -> Weighed:
    log, power, contained, prior = (
        np.concatenate([getattr(part, what) for part in many]) for what in ("log", "power", "contained", "prior")
    )
    settings, information, score = (
        [one for part in many for one in getattr(part, what)] for what in ("settings", "information", "score")
    )
    by_scale = np.logaddexp.reduce(log, axis=0)
    weight = np.exp(log - np.where(np.isfinite(by_scale), by_scale, 0.0))
    of_setting = np.logaddexp.reduce(log, axis=1)
    # The settings are equally probable; the most probable one given the data is fitted.
    best = int(np.argmax(of_setting - _second_jump(name, settings)))
    scales = float(np.log(len(PRIOR.scales)))
    total = float(np.logaddexp.reduce(by_scale)) - scales
    return Weighed(
        name,
        total,
        by_scale - scales,
        (weight * power).sum(axis=0),
        settings[best],
        float(of_setting[best] - prior[best]) - scales - total,
        float(contained[best]),
        float(prior[best]),
        information[best],
        score[best],
        tuple(zip(prior.tolist(), information, strict=True)),
    )


def _second_jump(name: str, settings: Sequence[Setting]) -> Array:
    """Return the nats (s,) that the second jump of each setting of a jump has to explain, 0 for one with one jump.

    Two jumps are named as two, so that the second one has to be as probable as a name, and its time was searched: the
    best of many explains some noise.
    """
    two = np.array([name == _JUMP and {"time", "until"} <= setting.keys() for setting in settings])
    ends = len({setting["until"] for setting, pair in zip(settings, two, strict=True) if pair})
    result: Array = two * np.log(max(ends, 1) * PRIOR.named_from / (1 - PRIOR.named_from))
    return result


def best_of(weighed: Mapping[str, Weighed], count: int) -> list[Weighed]:
    """Return the most probable effects of the catalogue."""
    names = [each for each in weighed.values() if each.name in TERMS]
    return sorted(names, key=lambda each: -each.log)[:count]
