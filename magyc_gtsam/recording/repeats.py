"""How many entries of a sensor's log make one sample, if entries repeat by a hold, by coarse steps, or by both.

A hold repeats all axes together, a coarse step each axis independently. The shares of steps at which single axes and
all of them repeat tell the two apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.recording.checks import Array, Mask

ALONE = 0.1  # share of the entries in which single axes repeat, above which the steps are coarse
# share of the repeated entries that chance must explain: at coarse steps it does for 0.9 to 1, beside a hold for 0.3
_BY_CHANCE = 0.5
_WHOLE = 0.05  # share of the entries to a sample by which they may differ from a whole number, and be that number
_SHORT = 10  # equal samples in a row that are believed whatever the share of equal samples
_UNLIKELY = 1e-6  # share of the samples with longer runs by chance, beyond which the sensor may be stuck
LONGEST_RUN = 40  # entries; longer runs are counted as this
LOCALLY = 3.0  # s in which the probability of a repeat hardly changes
ROWS = 100  # fewest rows from which a share is estimated


class Repetition(NamedTuple):
    """How a sensor's entries repeat.

    Attributes:
        rows: entries to a sample: 1 if entries repeat because of coarse steps only, more if samples that may equal each
            other are held as well, inf if the steps are not coarse, so that equal entries are one sample.
        longest: how often an entry repeats by chance, at most.
    """

    rows: float
    longest: float


def due(repeat: np.ndarray, rows: float | Array) -> Mask:
    """Return which entries are samples, given how often each has repeated so far and the entries to a sample."""
    result: Mask = (repeat == 0) | (np.floor(repeat / rows) > np.floor((repeat - 1) / rows))
    return result


def repeats_so_far(fresh: Mask) -> np.ndarray:
    """Return how many entries (n,) each one is behind the last that is fresh; the first is."""
    place = np.arange(len(fresh))
    return place - np.maximum.accumulate(np.where(fresh, place, 0))


def repetition(time: Array, repeats: Mask) -> Repetition:
    """Return how entries (n,) s repeat, given which axes do at each of the steps (n − 1, 3) between them."""
    return repetition_of(counted(time, repeats), histogram(np.diff(np.flatnonzero(~repeats.all(axis=1)))))


def repetition_of(counts: Array, runs: Array) -> Repetition:
    """Return how entries repeat, from the counts (k, 5) of stretches and the numbers (L,) of run lengths.

    The share that is held says roughly how many; runs up to that length are of one sample, and their mean is exact.
    """
    if repeat_alone(counts)[1] <= ALONE:
        return Repetition(np.inf, 0.0)
    held, stale = share_held(counts), float(counts[:, 4].sum() / counts[:, 0].sum())
    if held < _BY_CHANCE * stale:
        return Repetition(1.0, _longest(stale))
    of_one: np.ndarray = runs[: int(np.ceil(1 / max(1 - held, 1 / LONGEST_RUN)))]
    if not of_one.any() or held > 1 - 1 / LONGEST_RUN:  # too few entries, or hardly any that change
        return Repetition(np.inf, 0.0)
    rows = float(of_one @ np.arange(1, len(of_one) + 1) / of_one.sum())
    rows = float(round(rows)) if rows > 1.5 and abs(rows - round(rows)) < _WHOLE * rows else rows
    return Repetition(rows, rows * _longest((stale - held) / (1 - held)))


def _longest(equal: float) -> float:
    """Return the length of the longest run of equal samples by chance, given the share that equals the one before."""
    return max(_SHORT, float(np.log(_UNLIKELY) / np.log(np.clip(equal, 1e-3, 0.95))))


def histogram(runs: np.ndarray) -> Array:
    """Return the numbers (L,) of runs of each length from 1 on."""
    return np.bincount(np.minimum(runs, LONGEST_RUN), minlength=LONGEST_RUN + 1)[1:].astype(float)


def counted(time: Array, repeats: Mask) -> Array:
    """Return the counts (k, 5) in each stretch: steps (n, 3), and those at which each axis and all axes repeat."""
    length = max(LOCALLY, ROWS * float(np.median(np.diff(time))))
    stretch = np.floor((time[1:] - time[0]) / length).astype(int)
    _, starts, steps = np.unique(stretch, return_index=True, return_counts=True)
    each = np.add.reduceat(repeats, starts, axis=0, dtype=float)
    return np.column_stack([steps, each, np.add.reduceat(repeats.all(axis=1), starts, dtype=float)])


def repeat_alone(counts: Array) -> tuple[float, float]:
    """Return the share of the steps at which single axes repeat, of all steps and of those that are no hold."""
    steps, *each, together = counts.sum(axis=0)
    alone = sum(each) / 3 - together
    return float(alone / steps), float(alone / max(steps - together, 1.0))


def share_held(counts: Array) -> float:
    """Return the share h of the steps at which all axes are held, apart from repeats of single axes.

    With q_i the probability of a repeat of axis i without a hold, an axis repeats with p_i = h + (1 − h) q_i and all
    three with h + (1 − h) q_x q_y q_z. This is solved for h in each stretch of `counted` by bisection. The median
    over the stretches is returned: a hold is present all the time, a pause is not.
    """
    steps = counts[:, 0].astype(int)
    each, together = counts[:, 1:4] / steps[:, None], counts[:, 4] / steps
    low, high = np.zeros(len(counts)), each.min(axis=1)
    for _ in range(30):
        h = 0.5 * (low + high)
        free = np.maximum(1 - h, 1e-9)
        more = h + np.prod(np.maximum(each - h[:, None], 0.0) / free[:, None], axis=1) * free < together
        low, high = np.where(more, h, low), np.where(more, high, h)
    return float(np.median(np.repeat(0.5 * (low + high), steps)))
