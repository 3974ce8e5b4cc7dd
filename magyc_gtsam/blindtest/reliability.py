"""Whether stated probabilities are true: how often what was said with a probability was so, and the scores of all.

Each name, "unknown" and "nothing" is a statement about a recording. The log score is the mean of −ln P of what is
hidden; the Brier score the mean square of P less what is so, over all statements of a recording (Gneiting and Raftery,
Strictly proper scoring rules, 2007).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from magyc_gtsam.blindtest.gates import interval
from magyc_gtsam.blindtest.scoring import Outcome

RELIABILITY_HEADER = ("stated", "statements", "mean stated", "so", "95 %", "")
_EDGES = (0.5, 0.8, 0.95, 0.99, 1.0)
_LEAST = 1e-6  # probability: what is less counts as this in the log score
_SETS = ("none", "single", "pair", "foreign")  # of which what is so is known: without a channel a name may be fair


class Scores(NamedTuple):
    """Of the recordings with probabilities: nats, mean square, and how many."""

    log: float
    brier: float
    recordings: int


def statements(outcome: Outcome) -> Iterator[tuple[str, float, bool]]:
    """What is said of a recording: (what, its probability, whether it is so)."""
    hidden = outcome.scenario.names
    known = outcome.scenario.set != "foreign"
    for what, probability in outcome.probabilities.items():
        so = {"nothing": not hidden, "unknown": not known}.get(what, known and what in hidden)
        yield what, probability, so


def reliability_rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """One row per range of probabilities: how many statements, what was stated in the mean, how many are so."""
    every = [(p, so) for o in _scored(outcomes) for _, p, so in statements(o)]
    rows = []
    for low, high in pairwise(_EDGES):
        own = [(p, so) for p, so in every if low <= p and (p < high or high == _EDGES[-1])]
        if own:
            stated, right = float(np.mean([p for p, _ in own])), sum(so for _, so in own)
            least, most = interval(right, len(own))
            rows.append(
                [
                    f"{low:g} to {high:g}",
                    f"{len(own)}",
                    f"{stated:.3f}",
                    f"{right / len(own):.3f}",
                    f"{least:.3f} to {most:.3f}",
                    "" if least <= stated <= most else "not true",
                ]
            )
    return rows


def scores(outcomes: Sequence[Outcome]) -> Scores | None:
    """The mean scores; None where nothing was stated."""
    logs, squares = [], []
    for outcome in _scored(outcomes):
        said = list(statements(outcome))
        true = [p for _, p, so in said if so]
        unsaid = max(len(_true(outcome)) - len(true), 0)
        logs.append(-sum(np.log(max(p, _LEAST)) for p in [*true, *[0.0] * unsaid]))
        squares.append(sum((p - so) ** 2 for _, p, so in said) + unsaid)
    return Scores(float(np.mean(logs)), float(np.mean(squares)), len(logs)) if logs else None


def _true(outcome: Outcome) -> tuple[str, ...]:
    """What is so."""
    if outcome.scenario.set == "foreign":
        return ("unknown",)
    return outcome.scenario.names or ("nothing",)


def _scored(outcomes: Sequence[Outcome]) -> list[Outcome]:
    return [o for o in outcomes if o.probabilities and o.scenario.set in _SETS]
