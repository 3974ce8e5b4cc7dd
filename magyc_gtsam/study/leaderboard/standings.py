"""The table of the leaderboard: the result for a user of each method, with losses and wins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.engine import Row
from magyc_gtsam.study.leaderboard.running import DELIVERED, OPTICS
from magyc_gtsam.study.outcome import OutcomeStatus

MARGIN = (
    0.02  # share of the heading error below which results count as equal; BROAD's 3.3° vary by 0.01 between blocks
)


@dataclass(frozen=True)
class MethodStanding:
    """One method over the pairs (calibrated on one recording, judged on another of the unit) of one collection.

    Attributes:
        method: its name.
        calibrations, trusted: number of recordings, and of those on which the method trusts its result.
        heading, direction: deg, medians over the pairs of the errors for a user: those of the calibrated reading where
            it is trusted, otherwise those of the reading as delivered.
        worst: deg, largest heading error over the trusted pairs; None for none.
        best: number of pairs in which no other method has a heading better by more than `MARGIN`.
        better, worse: number of trusted pairs whose heading is better, or worse, than as delivered by more than
            `MARGIN`.
        pairs: number of all pairs.
        covered: share of the stated hard iron's components within 1.96 sigmas; None where none is stated.
        nees: median of the squared error per degree of freedom; None where none is stated.
        seconds: median run time of a calibration.
    """

    method: str
    calibrations: int
    trusted: int
    heading: float
    direction: float
    worst: float | None
    best: int
    better: int
    worse: int
    pairs: int
    covered: float | None
    nees: float | None
    seconds: float | None


@dataclass(frozen=True)
class Pair:
    """The errors, deg, of a method calibrated on one recording and judged on another."""

    method: str
    calibrated_on: str
    judged_on: str
    trusted: bool
    heading: float
    direction: float


def pairs_of(rows: Iterable[Row]) -> list[Pair]:
    """Return all pairs; a method without a result counts as the untrusted reading as delivered."""
    listed = list(rows)
    delivered = {row["recording"]: row for row in listed if row["method"] == DELIVERED}
    pairs = []
    for row in listed:
        before = delivered[row["recording"]]
        trusted = row["status"] == OutcomeStatus.TRUSTED.value
        used = row if trusted else before
        for judge, heading, direction in zip(before["judges"], used["heading"], used["direction"], strict=True):
            pairs.append(Pair(row["method"], row["recording"], judge, trusted, heading, direction))
    return pairs


def standings(rows: Sequence[Row]) -> list[MethodStanding]:
    """Return the standings of one collection: the optics' floor, as delivered, then the methods by heading."""
    pairs = pairs_of(rows)
    before = {(p.calibrated_on, p.judged_on): p.heading for p in pairs if p.method == DELIVERED}
    least = _least(pair for pair in pairs if pair.method != OPTICS)
    names = list(dict.fromkeys(row["method"] for row in rows))
    found = [_standing(name, rows, pairs, before, least) for name in names]
    return sorted(found, key=lambda s: (s.method not in (DELIVERED, OPTICS), s.heading, s.direction))


def _standing(
    name: str,
    rows: Sequence[Row],
    pairs: Sequence[Pair],
    before: Mapping[tuple[str, str], float],
    least: Mapping[tuple[str, str], float],
) -> MethodStanding:
    own = [row for row in rows if row["method"] == name]
    mine = [pair for pair in pairs if pair.method == name]
    counted = [pair for pair in mine if pair.trusted]
    stated = [row for row in own if row["status"] == OutcomeStatus.TRUSTED.value and row["components"]]
    took = [row["seconds"] for row in own if row["seconds"] is not None]

    def ratio(pair: Pair, to: Mapping[tuple[str, str], float]) -> float:
        return pair.heading / to[pair.calibrated_on, pair.judged_on]

    return MethodStanding(
        name,
        len(own),
        sum(row["status"] == OutcomeStatus.TRUSTED.value for row in own),
        float(np.median([pair.heading for pair in mine])),
        float(np.median([pair.direction for pair in mine])),
        max((pair.heading for pair in counted), default=None),
        sum(ratio(pair, least) <= 1 + MARGIN for pair in mine),
        sum(ratio(pair, before) < 1 - MARGIN for pair in counted),
        sum(ratio(pair, before) > 1 + MARGIN for pair in counted),
        len(mine),
        sum(row["covered"] for row in stated) / sum(row["components"] for row in stated) if stated else None,
        float(np.median([row["nees"] for row in stated])) if stated else None,
        float(np.median(took)) if took else None,
    )


def losses(rows: Sequence[Row], method: str) -> list[tuple[Pair, float]]:
    """Return the pairs in which a user of the method has a worse heading than with another method or as delivered.

    Each pair comes with the factor of its heading error over the best one, the largest factor first.
    """
    pairs = [pair for pair in pairs_of(rows) if pair.method != OPTICS]
    least = _least(pairs)
    ratios = [(p, p.heading / least[p.calibrated_on, p.judged_on]) for p in pairs if p.method == method]
    return sorted(((p, ratio) for p, ratio in ratios if ratio > 1 + MARGIN), key=lambda each: -each[1])


def _least(pairs: Iterable[Pair]) -> dict[tuple[str, str], float]:
    least: dict[tuple[str, str], float] = {}
    for pair in pairs:
        key = pair.calibrated_on, pair.judged_on
        least[key] = min(least.get(key, np.inf), pair.heading)
    return least
