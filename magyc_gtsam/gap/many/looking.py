"""A look at all hypotheses over many logs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.many.model import MODEL, OF_THE_INSTRUMENT
from magyc_gtsam.gap.many.one_log import OneLog, Test
from magyc_gtsam.gap.many.weighing import WeighedOverLogs, weigh, weigh_variation


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
        weighed.append(weigh_variation([log.varying[0] for log in logs]))
    return tuple(sorted((w for w in weighed if _possible(w, logs)), key=lambda each: -each.nats))


def _possible(weighed: WeighedOverLogs, logs: Sequence[OneLog]) -> bool:
    """Return whether a significant effect has possible values in most of the logs that contain it."""
    if not weighed.named or weighed.nats < MODEL.sure:
        return True
    shared = weighed.instrument >= 0.5 and weighed.name not in OF_THE_INSTRUMENT
    said = []
    for log, best, present in zip(logs, weighed.best, weighed.present, strict=True):
        if best is None or not (shared or present > 0.5):
            continue
        value, setting = (weighed.value, weighed.setting) if shared else (best.value, best.setting)
        said.append(TERMS[weighed.name].possible(log.refitted.twin, value, setting))
    return not said or float(np.mean(said)) >= 0.5


def _pooled(of_log: Sequence[Sequence[Test]]) -> list[dict[str, float]]:
    """Return the best setting of each log, to be tested in all logs, if the logs have no setting in common."""
    keys = [{test.key for test in tests} for tests in of_log if tests]
    if len(keys) < 2 or set.intersection(*keys):
        return []
    best = [max(tests, key=lambda test: float(test.nats.max())) for tests in of_log if tests]
    if any("time" in test.setting or "start" in test.setting for test in best):
        return []
    return list({test.key: dict(test.setting) for test in best}.values())
