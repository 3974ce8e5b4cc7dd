"""A look at all hypotheses over many logs: one value in all logs, or a separate value in each log that has the effect.

An effect has the same prior as in one log (`evidence.weighing`), with one scale in all logs. For one value in all logs,
the logs' information matrices and scores are summed first. For a value in each log, a share π of the logs has it,
Σ ln(1 − π + π B_l). Both are averaged over the scales, π and the settings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import expit, logsumexp, softmax

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.dated import DATED
from magyc_gtsam.gap.effects import MOMENTS, TERMS
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.many.model import MODEL, OF_THE_INSTRUMENT, OF_THE_PLACE
from magyc_gtsam.gap.many.one_log import OneLog, Test, strongest

Tests = Mapping[str, tuple[Test, ...]]
_FAR = 300.0  # nats beyond which the share no longer matters


@dataclass(frozen=True, eq=False)
class WeighedOverLogs:
    """One effect or generic family over all logs.

    Attributes:
        name: of the effect or family.
        apart: evidence of a separate value in each log that has it, nats.
        present: (logs,) probability that a log has it, if each log has a separate value.
        best: for each log the test that explains most; None if it cannot be tested.
        shared: evidence of one value in all logs, nats; −∞ if it has none.
        setting, value: of the shared value at its best setting, SI.
    """

    name: str
    apart: float
    present: Array
    best: tuple[Test | None, ...]
    shared: float = -np.inf
    setting: Mapping[str, float] = field(default_factory=dict)
    value: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def named(self) -> bool:
        """Return whether it has a name, in the catalogue or as the field of the place that varies."""
        return self.name in TERMS or self.name == FIELD_VARIATION

    @property
    def nats(self) -> float:
        """Return the evidence of both cases together; for a generic family less its required lead."""
        nats = float(np.logaddexp(self.shared, self.apart) - np.log(2))
        return nats if self.named else nats - MODEL.sure - MODEL.generic * max(nats, 0.0)

    @property
    def instrument(self) -> float:
        """Return the probability that it is the instrument's: from the data, unless only one case is possible."""
        if self.name in OF_THE_PLACE or not np.isfinite(self.shared):
            return 0.0
        return 1.0 if self.name in OF_THE_INSTRUMENT else float(expit(self.shared - self.apart))

    @property
    def one_value(self) -> bool:
        """Return whether all logs have one value, and not each its own, or a level relative to its readings."""
        return self.instrument >= 0.5 and self.name not in OF_THE_INSTRUMENT


def look_over(logs: Sequence[OneLog], names: Sequence[str]) -> tuple[WeighedOverLogs, ...]:
    """Return all hypotheses, strongest first."""
    tests = [log.tests(names) for log in logs]
    for name in names:
        pooled = _pooled([log.get(name, ()) for log in tests])
        for log, found in zip(logs, tests, strict=True):
            if pooled and found.get(name):
                found[name] = (*found[name], *log.tests_at(name, pooled))
    every = dict.fromkeys(name for found in tests for name in found)
    weighed = [weigh(name, tests) for name in every]
    if all(log.variation is None for log in logs):
        apart, present, _ = mixture(np.array([log.varying[0] for log in logs])[None, None])
        weighed.append(WeighedOverLogs(FIELD_VARIATION, apart, present, (None,) * len(logs)))
    return tuple(sorted((w for w in weighed if _possible(w, logs)), key=lambda each: -each.nats))


def _pooled(of_log: Sequence[Sequence[Test]]) -> list[dict[str, float]]:
    """Return the best setting of each log, to be tested in all logs, if the logs have no setting in common."""
    keys = [{test.key for test in tests} for tests in of_log if tests]
    if len(keys) < 2 or set.intersection(*keys):
        return []
    best = [test for test in map(strongest, of_log) if test is not None]
    if any("time" in test.setting or "start" in test.setting for test in best):
        return []
    return list({test.key: dict(test.setting) for test in best}.values())


def _possible(weighed: WeighedOverLogs, logs: Sequence[OneLog]) -> bool:
    """Return whether a significant effect has possible values in most of the logs that contain it."""
    if not weighed.named or weighed.nats < MODEL.sure:
        return True
    said = []
    for log, best, present in zip(logs, weighed.best, weighed.present, strict=True):
        if best is not None and (weighed.one_value or present > 0.5):
            own = weighed if weighed.one_value else best
            said.append(TERMS[weighed.name].possible(log.refitted.twin, own.value, own.setting))
    return not said or float(np.mean(said)) >= 0.5


def weigh(name: str, logs: Sequence[Tests]) -> WeighedOverLogs:
    """Return the evidence, in both cases, of an effect that some of the logs can show."""
    of_log = [log.get(name, ()) for log in logs]
    apart, present, _ = mixture(_by_kind(name, of_log))
    alone = WeighedOverLogs(name, apart, present, tuple(map(strongest, of_log)))
    if name in DATED or name.startswith("time:"):
        return alone
    shared, best = _shared(name, of_log)
    return replace(alone, shared=shared, setting=best.setting, value=best.value)


def _shared(name: str, of_log: Sequence[Sequence[Test]]) -> tuple[float, Test]:
    """Return the evidence of one value in all logs, and the test of all logs at the setting that explains most."""
    keyed: dict[tuple, list[Test]] = {}
    for tests in of_log:
        for key, test in {test.key: test for test in tests}.items():
            keyed.setdefault((key, len(test.score)), []).append(test)
    most = max(map(len, keyed.values()))
    together = []
    for tests in keyed.values():
        if len(tests) < most:  # a setting that only some logs allow
            continue
        information = np.sum([test.information for test in tests], axis=0)
        score = np.sum([test.score for test in tests], axis=0)
        unit = np.exp(np.mean([np.log(test.unit) for test in tests], axis=0))
        together.append(Test.of(name, tests[0].setting, information, score, unit))
    table = np.array([test.nats for test in together])
    return float(logsumexp(table) - np.log(table.size)), together[int(table.max(axis=1).argmax())]


def mixture(tables: Array) -> tuple[float, Array, float]:
    """Return the evidence of all logs, the probability of each log to have the effect, and that of the largest share.

    Args:
        tables: (kinds, scales, logs) evidence of each log, nats.
    """
    share = np.array(MODEL.shares)[:, None, None, None]
    mixed = np.log1p(share * np.expm1(np.minimum(tables, _FAR))) + np.maximum(tables - _FAR, 0.0)
    nats = mixed.sum(axis=-1)  # (shares, kinds, scales)
    weight = softmax(nats)
    odds = tables + np.log(share) - np.log1p(-share)
    present = np.minimum((weight[..., None] * expit(odds)).sum(axis=(0, 1, 2)), 1.0)  # but for rounding
    return float(logsumexp(nats) - np.log(nats.size)), present, float(weight[-1].sum())


def _by_kind(name: str, of_log: Sequence[Sequence[Test]]) -> Array:
    """Return the evidence (kinds, scales, logs) of each log alone, nats, averaged over the settings of a kind.

    The grid points of a jump or a passed object are of several kinds (a lasting jump, for example, or something that is
    attached and taken off); all logs have the same kind.
    """
    kinds = sorted({_kind(name, test) for tests in of_log for test in tests})
    scales = next(len(test.nats) for tests in of_log for test in tests)
    result = np.zeros((len(kinds), scales, len(of_log)))
    for i, kind in enumerate(kinds):
        for k, tests in enumerate(of_log):
            own = [test.nats for test in tests if _kind(name, test) == kind]
            if own:
                result[i, :, k] = logsumexp(own, axis=0) - np.log(len(own))
    return result


def _kind(name: str, test: Test) -> tuple:
    """Return the kind of a setting of a jump, a drift or a passed object; other effects have one kind."""
    if name not in MOMENTS:
        return ()
    return tuple(sorted((k, v if k == "width" else 0.0) for k, v in test.setting.items()))
