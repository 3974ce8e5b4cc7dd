"""The evidence over many logs for one value in all logs, and for a separate value in each log that has the effect.

With the values' prior variance γ in units of their variance from one log (Zellner's g-prior), a score of squared length
T and rank r has the evidence ½ γ/(1+γ) T − ½ r ln(1+γ) nats relative to no effect. For one value in all logs, the logs'
information matrices and scores are summed first, and γ is multiplied by the number of logs. For a value in each log, a
share π of the logs has it, Σ ln(1 − π + π B_l). Both are averaged over γ, π and the settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import MOMENTS, TERMS
from magyc_gtsam.gap.evidence.beside import solved
from magyc_gtsam.gap.many.model import MODEL, OF_THE_INSTRUMENT, OF_THE_PLACE
from magyc_gtsam.gap.many.one_log import Test

Tests = Mapping[str, tuple[Test, ...]]
_SIZES = np.array(MODEL.sizes)
_FAR = 300.0  # nats beyond which the share no longer matters
_CORRELATED = 2.0  # knots, correlation length of a field that varies in the world frame


@dataclass(frozen=True, eq=False)
class WeighedOverLogs:
    """One effect or generic family over all logs.

    Attributes:
        name: of the effect or family.
        shared: evidence of one value in all logs, nats; −∞ if it has none.
        apart: evidence of a separate value in each log that has it, nats.
        setting, value: of the shared value at its best setting, SI.
        present: (logs,) probability that a log has it, if each log has a separate value.
        best: for each log the test that explains most; None if it cannot be tested.
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
        """Return whether it is an effect of the catalogue."""
        return self.name in TERMS

    @property
    def nats(self) -> float:
        """Return the evidence of both cases together; for a generic family less its required lead."""
        nats = float(np.logaddexp(self.shared, self.apart) - np.log(2))
        return nats if self.named else nats - MODEL.generic[0] - MODEL.generic[1] * max(nats, 0.0)

    @property
    def instrument(self) -> float:
        """Return the probability that it is the instrument's: from the data, unless only one case is possible."""
        if self.name in OF_THE_PLACE or not np.isfinite(self.shared):
            return 0.0
        return 1.0 if self.name in OF_THE_INSTRUMENT else float(expit(self.shared - self.apart))


def weigh(name: str, logs: Sequence[Tests]) -> WeighedOverLogs:
    """Return the evidence of an effect in both cases."""
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
    """Return the evidence of a score with squared length `statistic` in its sigmas, at prior variances `size`, nats."""
    result: Array = 0.5 * size / (1 + size) * statistic - 0.5 * rank * np.log1p(size)
    return result


def _shared(of_log: Sequence[Sequence[Test]]) -> tuple[float, Mapping[str, float], Array]:
    """Return the evidence of one value in all logs, and the setting and value that explain most."""
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
        value, rank = solved(information, score)
        nats.append(nats_of(float(score @ value), rank, len(tests) * _SIZES))
        found.append((tests[0].setting, value))
    if not nats:
        return -np.inf, {}, np.zeros(0)
    table = np.array(nats)
    return float(logsumexp(table) - np.log(table.size)), *found[int(table.max(axis=1).argmax())]


def _apart(name: str, of_log: Sequence[Sequence[Test]]) -> tuple[float, Array]:
    """Return the evidence of a value in each log, nats, and the probability of each log to have the effect.

    The grid points of a jump or a passed object are of several kinds (a lasting jump, for example, or something that is
    attached and taken off); all logs have the same kind.
    """
    total, present, _ = mixture(_by_kind(name, of_log))
    return total, present


def mixture(tables: Array) -> tuple[float, Array, float]:
    """Return the evidence of all logs, the probability of each log to have the effect, and that of the largest share.

    Args:
        tables: (kinds, sizes, logs) evidence of each log, nats.
    """
    share = np.array(MODEL.shares)[:, None, None, None]
    mixed = np.log1p(share * np.expm1(np.minimum(tables, _FAR))) + np.maximum(tables - _FAR, 0.0)
    nats = mixed.sum(axis=-1)  # (shares, kinds, sizes)
    weight = np.exp(nats - logsumexp(nats))
    odds = tables + np.log(share) - np.log1p(-share)
    present = (weight[..., None] * expit(odds)).sum(axis=(0, 1, 2))
    return float(logsumexp(nats) - np.log(nats.size)), present, float(weight[-1].sum())


def _by_kind(name: str, of_log: Sequence[Sequence[Test]]) -> Array:
    """Return the evidence (kinds, sizes, logs) of each log alone, nats, averaged over the settings of a kind."""
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
    """Return the kind of a setting of a jump, a drift or a passed object; other effects have one kind."""
    if name not in MOMENTS:
        return ()
    return tuple(sorted((k, v if k == "width" else 0.0) for k, v in test.setting.items()))


def _walk(tests: Sequence[Test]) -> Array:
    """Return the evidence (sizes,) of a random walk, represented by its first modes, nats."""
    test = next((test for test in tests if test.setting.get("order")), None)
    if test is None:
        return np.zeros(len(_SIZES))
    variance = np.repeat(1.0 / np.arange(1, len(test.score) // 3 + 1) ** 2, 3)
    return _likelihood(test, np.diag(variance), 3 * _SIZES / np.trace(test.information[:3, :3]))


def _wandering(tests: Sequence[Test]) -> Array:
    """Return the evidence (sizes,) of a field that varies in the world frame from knot to knot, nats."""
    whole = [test for test in tests if not test.setting]
    if not whole:
        return np.zeros(len(_SIZES))
    test = whole[0]
    knots = len(test.score) // 3
    apart = np.abs(np.arange(knots)[:, None] - np.arange(knots))
    kernel = np.kron(np.exp(-apart / _CORRELATED), np.eye(3))
    return _likelihood(test, kernel, len(test.score) * _SIZES / np.trace(test.information))


def _likelihood(test: Test, kernel: Array, variances: Array) -> Array:
    """Return the evidence (sizes,) of values whose prior covariance is each variance times the kernel, nats."""
    root = np.linalg.cholesky(kernel)
    weight, vector = np.linalg.eigh(root.T @ test.information @ root)
    weight, score = np.maximum(weight, 0.0), vector.T @ (root.T @ test.score)
    widened = 1 + variances[:, None] * weight
    result: Array = 0.5 * (variances[:, None] * score**2 / widened - np.log(widened)).sum(axis=1)
    return result
