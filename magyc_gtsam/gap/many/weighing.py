"""The evidence over many logs: one value everywhere against a value of its own in each log that has the effect.

With the values' prior variance γ in units of what one log tells of them (Zellner's g-prior), a score of squared
length T and rank r weighs ½ γ/(1+γ) T − ½ r ln(1+γ) nats against nothing. One value for all: the logs' information
and scores are summed before that, with γ times the number of logs. A value each: a share π of the logs has it,
Σ ln(1 − π + π B_l). Both are averaged over γ, π and the settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.many.model import MODEL, MOMENTS, OF_THE_INSTRUMENT, OF_THE_PLACE
from magyc_gtsam.gap.many.one_log import Test

Tests = Mapping[str, tuple[Test, ...]]
_SIZES = np.array(MODEL.sizes)
_WALK = 6  # modes of a drift: a random walk, whose k-th has the variance 1/k²
_FAR = 300.0  # nats beyond which the share no longer counts
_CORRELATED = 2.0  # knots over which a field that wanders in the world is alike


@dataclass(frozen=True, eq=False)
class WeighedOverLogs:
    """One effect, or family without a name, over all logs.

    Attributes:
        name: of it.
        shared: nats of one value everywhere; −∞ where there can be none.
        apart: nats of a value of its own in each log that has it.
        setting, value: of the shared value at its best setting, SI.
        present: (logs,) probability that a log has it, if each has its own.
        best: per log the test that explains most; None where it cannot be tested.
    """

    name: str
    shared: float
    apart: float
    setting: Mapping[str, float]
    value: Array
    present: Array
    best: tuple[Test | None, ...]

    @property
    def named(self) -> bool:
        """Whether it is of the catalogue."""
        return self.name in TERMS

    @property
    def nats(self) -> float:
        """Of either; a family without a name less what it must be ahead by."""
        nats = float(np.logaddexp(self.shared, self.apart) - np.log(2))
        return nats if self.named else nats - MODEL.generic[0] - MODEL.generic[1] * max(nats, 0.0)

    @property
    def instrument(self) -> float:
        """Probability that it is the instrument's: what the data say, but where it can only be one of the two."""
        if self.name in OF_THE_PLACE or not np.isfinite(self.shared):
            return 0.0
        return 1.0 if self.name in OF_THE_INSTRUMENT else float(expit(self.shared - self.apart))


def weigh(name: str, logs: Sequence[Tests]) -> WeighedOverLogs:
    """All hypotheses of one effect."""
    of_log = [log.get(name, ()) for log in logs]
    best = tuple(max(tests, key=_surprise, default=None) for tests in of_log)
    apart, present = _apart(name, of_log)
    if name in MOMENTS or name.startswith("time:"):
        return WeighedOverLogs(name, -np.inf, apart, {}, np.zeros(0), present, best)
    shared, setting, value = _shared(of_log)
    return WeighedOverLogs(name, shared, apart, setting, value, present, best)


def _surprise(test: Test) -> float:
    return float(np.max(nats_of(test.statistic, test.rank, _SIZES)))


def nats_of(statistic: Array | float, rank: Array | int, size: Array) -> Array:
    """Of a score of squared length `statistic` in its sigmas, at prior variances `size`."""
    result: Array = 0.5 * size / (1 + size) * statistic - 0.5 * rank * np.log1p(size)
    return result


def _shared(of_log: Sequence[Sequence[Test]]) -> tuple[float, Mapping[str, float], Array]:
    """Nats of one value, and setting and value that explain most."""
    keyed: dict[tuple, list[Test]] = {}
    for tests in of_log:
        for key, test in {test.key: test for test in tests}.items():
            keyed.setdefault((key, len(test.score)), []).append(test)
    most = max(map(len, keyed.values()), default=0)
    nats, found = [], []
    for tests in keyed.values():
        if len(tests) < most:  # a setting that only some logs allow
            continue
        information = np.sum([test.information for test in tests], axis=0)
        score = np.sum([test.score for test in tests], axis=0)
        value, rank = _solved(information, score)
        nats.append(nats_of(float(score @ value), rank, len(tests) * _SIZES))
        found.append((tests[0].setting, value))
    if not nats:
        return -np.inf, {}, np.zeros(0)
    table = np.array(nats)
    return float(logsumexp(table) - np.log(table.size)), *found[int(table.max(axis=1).argmax())]


def _solved(information: Array, score: Array) -> tuple[Array, int]:
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    weight, vector = np.linalg.eigh(information * scale * scale[:, None])
    kept = weight > 1e-9 * weight[-1]
    value = scale * ((vector[:, kept] / weight[kept]) @ (vector[:, kept].T @ (scale * score)))
    return value, int(kept.sum())


def _apart(name: str, of_log: Sequence[Sequence[Test]]) -> tuple[float, Array]:
    """Nats of a value each, and the probability of each log to have it.

    What is searched over is either of one kind in all logs, as a jump or something attached and taken off, or not.
    """
    total, present, _ = mixture(_by_kind(name, of_log))
    return total, present


def mixture(tables: Array) -> tuple[float, Array, float]:
    """Over tables (kinds, sizes, logs) of each log's nats: those of all logs, the probability of each log to have the
    effect, and that of the largest share of the logs."""
    share = np.array(MODEL.shares)[:, None, None, None]
    mixed = np.log1p(share * np.expm1(np.minimum(tables, _FAR))) + np.maximum(tables - _FAR, 0.0)
    nats = mixed.sum(axis=-1)  # (shares, kinds, sizes)
    weight = np.exp(nats - logsumexp(nats))
    odds = tables + np.log(share) - np.log1p(-share)
    present = (weight[..., None] * expit(odds)).sum(axis=(0, 1, 2))
    return float(logsumexp(nats) - np.log(nats.size)), present, float(weight[-1].sum())


def _by_kind(name: str, of_log: Sequence[Sequence[Test]]) -> Array:
    """(kinds, sizes, logs) nats of each log by itself, averaged over the settings of a kind."""
    smooth = _walk if name == "hard-iron-drift" else _wandering if name.startswith("time:world") else None
    if smooth is not None:
        return np.array([[smooth(tests) for tests in of_log]]).transpose(0, 2, 1)
    kinds = sorted({_kind(name, test) for tests in of_log for test in tests}) or [()]
    result = np.zeros((len(kinds), len(_SIZES), len(of_log)))
    for i, kind in enumerate(kinds):
        for k, tests in enumerate(of_log):
            own = [test for test in tests if _kind(name, test) == kind]
            if own:
                statistic = np.array([test.statistic for test in own])[:, None]
                rank = np.array([test.rank for test in own])[:, None]
                result[i, :, k] = logsumexp(nats_of(statistic, rank, _SIZES), axis=0) - np.log(len(own))
    return result


def _kind(name: str, test: Test) -> tuple:
    """Of a moment: what it has beside its time; other effects are of one kind."""
    if name not in MOMENTS:
        return ()
    return tuple(sorted((k, v if k == "width" else 0.0) for k, v in test.setting.items()))


def _walk(tests: Sequence[Test]) -> Array:
    """(sizes,) nats of a random walk, by the modes that there are."""
    test = next((test for test in tests if test.setting.get("order") == _WALK), None)
    if test is None:
        return np.zeros(len(_SIZES))
    variance = np.repeat(1.0 / np.arange(1, _WALK + 1) ** 2, 3)
    return _likelihood(test, np.diag(variance), 3 * _SIZES / np.trace(test.information[:3, :3]))


def _wandering(tests: Sequence[Test]) -> Array:
    """(sizes,) nats of a field that wanders in the world, knot by knot, along the vehicle's way."""
    whole = [test for test in tests if not test.setting]
    if not whole:
        return np.zeros(len(_SIZES))
    test = whole[0]
    knots = len(test.score) // 3
    apart = np.abs(np.arange(knots)[:, None] - np.arange(knots))
    kernel = np.kron(np.exp(-apart / _CORRELATED), np.eye(3))
    return _likelihood(test, kernel, len(test.score) * _SIZES / np.trace(test.information))


def _likelihood(test: Test, kernel: Array, variances: Array) -> Array:
    """(sizes,) nats of values whose prior covariance is each of the variances times the kernel."""
    root = np.linalg.cholesky(kernel)
    weight, vector = np.linalg.eigh(root.T @ test.information @ root)
    weight, pull = np.maximum(weight, 0.0), vector.T @ (root.T @ test.score)
    widened = 1 + variances[:, None] * weight
    result: Array = 0.5 * (variances[:, None] * pull**2 / widened - np.log(widened)).sum(axis=1)
    return result
