"""Assessment of stated probabilities by the share of true statements at each probability, and by scoring rules.

Each name, "unknown" and "nothing" is a statement about a recording. The log score is the mean of −ln P of the true
statements; the Brier score is the mean square of P minus the truth (0 or 1), summed over the statements of a recording
(Gneiting and Raftery, Strictly proper scoring rules, 2007).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from magyc_gtsam.blindtest.gates import interval
from magyc_gtsam.blindtest.scoring import Outcome

RELIABILITY_HEADER = ("stated", "statements", "mean stated", "true", "95 %", "")
_EDGES = (
    0.5,
    0.8,
    0.95,
    0.98,
    1.0,
)  # the last two are near the largest probability that is stated of a name, 0.995
_LEAST = 1e-6  # smallest probability in the log score
# Sets with a definite truth; without a channel another name may be fair.
_SETS = ("none", "single", "pair", "foreign", "real")


class Scores(NamedTuple):
    """Mean log score (nats) and Brier score, and the number of recordings with probabilities."""

    log: float
    brier: float
    recordings: int


def statements(outcome: Outcome) -> Iterator[tuple[str, float, bool]]:
    """Yield (statement, its probability, whether it is true) for each statement about a recording."""
    hidden = outcome.scenario.names
    known = outcome.scenario.set != "foreign"
    for what, probability in outcome.probabilities.items():
        is_true = {"nothing": not hidden, "unknown": not known}.get(what, known and what in hidden)
        yield what, probability, is_true


def reliability_rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Return one row per range of probabilities: number of statements, mean probability, share that is true."""
    every = [(p, is_true) for o in _scored(outcomes) for _, p, is_true in statements(o)]
    rows = []
    for low, high in pairwise(_EDGES):
        own = [(p, is_true) for p, is_true in every if low <= p and (p < high or high == _EDGES[-1])]
        if own:
            stated, right = float(np.mean([p for p, _ in own])), sum(is_true for _, is_true in own)
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
    """Return the mean scores; None without stated probabilities."""
    logs, squares = [], []
    for outcome in _scored(outcomes):
        stated = list(statements(outcome))
        true = [p for _, p, is_true in stated if is_true]
        unstated = max(len(_true(outcome)) - len(true), 0)
        logs.append(-sum(np.log(max(p, _LEAST)) for p in [*true, *[0.0] * unstated]))
        squares.append(sum((p - is_true) ** 2 for _, p, is_true in stated) + unstated)
    return Scores(float(np.mean(logs)), float(np.mean(squares)), len(logs)) if logs else None


def _true(outcome: Outcome) -> tuple[str, ...]:
    """Return the true statements."""
    if outcome.scenario.set == "foreign":
        return ("unknown",)
    return outcome.scenario.names or ("nothing",)


def _scored(outcomes: Sequence[Outcome]) -> list[Outcome]:
    each = (o for o in outcomes if o.probabilities and o.scenario.set in _SETS)
    return [o for o in each if o.scenario.effects or o.scenario.set != "real"]  # what a real log has is not known
