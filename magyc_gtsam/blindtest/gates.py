"""The gates: limits that the workflow must meet, fixed before they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from magyc_gtsam.blindtest.scenarios import FACTORS, INVISIBLE
from magyc_gtsam.blindtest.scoring import CRASHED, IN_SET, RIGHT, UNKNOWN, WRONG, Outcome

_VISIBLE = 0.1  # ratio of the excess open-loop variance to the floor's from which a gap is visible
_WORSE = 1.05  # ratio of heading errors from which the heading counts as worse
_NEGLIGIBLE = 0.05  # deg, heading error below which the ratio is ignored


@dataclass(frozen=True)
class Gate:
    """One gate and its measurement.

    Attributes:
        name: the requirement.
        share: measured share.
        interval: its 95 % interval (low, high), by Clopper and Pearson, or by order statistics for a median.
        count, total: number of hits, and of cases.
        limit: limit of the share.
        at_least: whether the share must be at least the limit, instead of at most.
    """

    name: str
    share: float
    interval: tuple[float, float]
    count: int
    total: int
    limit: float
    at_least: bool

    @property
    def passed(self) -> bool:
        """Whether the share keeps its limit."""
        return self.share >= self.limit if self.at_least else self.share <= self.limit


def gates(outcomes: Sequence[Outcome]) -> list[Gate]:
    """Return all gates for which there are outcomes."""
    result: list[Gate] = []

    def ask(name: str, hits: Sequence[bool], limit: float, at_least: bool = False) -> None:
        if len(hits):
            count, total = int(np.sum(hits)), len(hits)
            result.append(Gate(name, count / total, interval(count, total), count, total, limit, at_least))

    def of(kind: str, factor: float | None = None) -> list[Outcome]:
        return [o for o in outcomes if o.scenario.set == kind and factor in (None, o.scenario.factor)]

    ask("nothing hidden: a name", [bool(o.named) and o.kind == WRONG for o in of("none")], 0.02)
    ask("nothing hidden: UNKNOWN", [o.kind == UNKNOWN for o in of("none")], 0.02)
    ask("crashed", [o.kind == CRASHED for o in outcomes], 0.0)
    for factor in FACTORS:
        ask(f"one effect ×{factor:g}: wrong name", [o.kind == WRONG for o in of("single", factor)], 0.03)
    seen = [o for o in of("single", 1.0) if o.scenario.names[0] not in INVISIBLE.get(o.scenario.motion, ())]
    ask("one effect ×1: named", [o.kind in (RIGHT, IN_SET) for o in seen], 0.90, True)
    ask("foreign ×1: UNKNOWN", [o.kind == UNKNOWN for o in of("foreign", 1.0)], 0.85, True)
    for factor in FACTORS:
        ask(f"foreign ×{factor:g}: wrong name", [o.kind == WRONG for o in of("foreign", factor)], 0.05)
    ask("pairs: exact", [o.kind in (RIGHT, IN_SET) for o in of("pair")], 0.85, True)
    ask("channel withheld: wrong name", [o.kind == WRONG for o in of("withheld")], 0.03)
    real = [o for o in of("real") if o.scenario.effects]
    ask("real recordings, one effect: wrong name", [o.kind == WRONG for o in real], 0.03)
    ask("real recordings, one effect: named", [o.kind in (RIGHT, IN_SET) for o in real], 0.90, True)
    cuts = [
        1 - o.excess[1] / o.excess[0]
        for o in (*of("single"), *of("pair"))
        if o.excess and o.excess[0] > _VISIBLE and o.kind in (RIGHT, IN_SET)
    ]
    if cuts:
        result.append(_median("excess open-loop variance cut, median", np.array(cuts), 0.80))
    judged = [o.heading for o in outcomes if o.heading is not None]
    worse = [after > max(_WORSE * before, _NEGLIGIBLE) for before, after in judged]
    ask("accepted additions: heading worse by 5 %", worse, 0.05)
    return result


def missing(outcomes: Sequence[Outcome], limit: float = 0.9) -> dict[str, tuple[int, int]]:
    """Return {effect: (named, runs)} of effects named in less than `limit` of their runs at published strength."""
    result = {}
    full = [o for o in outcomes if o.scenario.set == "single" and o.scenario.factor == 1.0]
    for name in dict.fromkeys(o.scenario.names[0] for o in full):
        kinds = [o.kind for o in full if o.scenario.names[0] == name]
        named = sum(k in (RIGHT, IN_SET) for k in kinds)
        if named < limit * len(kinds):
            result[name] = (named, len(kinds))
    return result


def interval(count: int, total: int) -> tuple[float, float]:
    """Return Clopper and Pearson's 95 % interval of a share."""
    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, total - count + 1))
    high = 1.0 if count == total else float(beta.ppf(0.975, count + 1, total - count))
    return low, high


def _median(name: str, values: np.ndarray, limit: float) -> Gate:
    ordered, n = np.sort(values), len(values)
    half = 0.98 * np.sqrt(n)
    low, high = int(max(np.floor(n / 2 - half), 0)), int(min(np.ceil(n / 2 + half), n - 1))
    within = (float(ordered[low]), float(ordered[high]))
    return Gate(name, float(np.median(ordered)), within, int((values >= limit).sum()), n, limit, True)
