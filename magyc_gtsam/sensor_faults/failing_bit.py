"""Detect a bit of the magnetometer's converter that is wrong in some of the readings.

Such a reading is off its neighbours by what the bit is worth, B: upwards where the bit should be 0, downwards where it
should be 1. Which of the two it should be alternates every B along the axis. Spikes, bursts of noise and readings of
another sensor stand out as well, but not upwards in one stretch of B and downwards in the next. The means of the
readings are off by up to the share of wrong readings times B, alternating likewise, and so is what is fitted to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.recording import Array


@dataclass(frozen=True)
class FailingRules:
    """Limits between readings with a wrong bit and others.

    Attributes:
        noises: least multiple of the readings' scatter that a bit is worth; with 3, a log of lost samples has one.
        off: distances from the neighbours that count, as multiples of what the bit is worth.
        parts: parts into which two stretches are divided, to find where one begins.
        both: least share of the readings in either kind of stretch.
        often: least share of the readings that is wrong.
        alike: least share of the readings off by as much that are so on the side which the bit explains, less that of
            the others; 0.4 to 0.9 with a failing bit. Of noise that is not white in long logs it is 0.1.
        significant: standard deviations by which the kinds differ; ten minutes at 10 Hz with 15 % wrong readings reach
            9 to 19. Of 2,500 faulty logs without such a bit one exceeds it, whose readings wrap at the full scale.
        outliers, beyond: share of the readings that exceed a multiple of the scatter, below which none is wrong;
            0.3 % of normal noise do.
        least: fewest readings.
    """

    noises: float = 4.0
    off: tuple[float, float] = (0.6, 1.4)
    parts: int = 32
    both: float = 0.05
    often: float = 0.01
    alike: float = 0.3
    significant: float = 6.0
    outliers: float = 0.005
    beyond: float = 3.0
    least: int = 200


RULES = FailingRules()
_BESIDE = (-2, -1, 1, 2)  # neighbours whose median a reading is compared with
# Neighbours whose median tells the stretch. They are others, because noise in the former moves both.
_AROUND = (-5, -4, -3, 3, 4, 5)
_WIDEST = 5
_NORMAL = 0.6745  # median of the absolute values of a normal deviate
_ROUNDING = 0.5  # steps, least scatter of readings in whole steps


def failing_bit(steps: Array, rules: FailingRules = RULES) -> int:
    """Return how many steps the bit is worth that is wrong in some of the readings (n,), whole steps; 0 for none."""
    if len(steps) < rules.least or not _has_outliers(steps, rules):
        return 0
    off = steps[_WIDEST:-_WIDEST] - _median(steps, _BESIDE)
    scatter = max(float(np.median(np.abs(off))) / _NORMAL, _ROUNDING)
    # Readings that stand out in the rarer kind of stretch, at least.
    enough = 2 * rules.often * rules.both * len(off)
    worths, most, size = [], np.ptp(steps), np.abs(off)
    worth = 2
    while worth <= most:
        if worth >= rules.noises * scatter and np.count_nonzero(_stands(size, worth, rules)) >= enough:
            worths.append(worth)
        worth *= 2
    if not worths:
        return 0
    level = _median(steps, _AROUND)
    found = [_significance(off, level, worth, rules) for worth in worths]
    best = int(np.argmax(found))
    return worths[best] if found[best] > rules.significant else 0


def _has_outliers(steps: Array, rules: FailingRules) -> bool:
    """Return whether more readings stand out than by noise: a test at a few operations per reading."""
    away = np.abs(steps[1:-1] - 0.5 * (steps[:-2] + steps[2:]))
    scatter = max(float(np.median(away)) / _NORMAL, _ROUNDING)
    return bool(np.count_nonzero(away > rules.beyond * scatter) > rules.outliers * len(away))


def _median(steps: Array, neighbours: tuple[int, ...]) -> Array:
    """Return the medians (n − 10,) of an even number of neighbours of each reading (n,)."""
    last = len(steps) - _WIDEST
    beside = np.stack([steps[_WIDEST + k : last + k] for k in neighbours])
    half = len(neighbours) // 2
    beside.partition((half - 1, half), axis=0)
    result: Array = 0.5 * (beside[half - 1] + beside[half])
    return result


def _significance(off: Array, level: Array, worth: int, rules: FailingRules) -> float:
    """Return by how many sigmas more readings are off upwards in every second stretch, and downwards in the others.

    Args:
        off, level: (n,) steps, each reading's distance from its neighbours, and their level.
        worth: steps, length of a stretch.
        rules: the limits.
    """
    stands = np.flatnonzero(_stands(np.abs(off), worth, rules))
    parts = min(rules.parts, 2 * worth)
    part = (level % (2 * worth) * (parts / (2 * worth))).astype(np.int64)
    every = _in_halves(np.bincount(part, minlength=parts))
    standing = _in_halves(np.bincount(part[stands], minlength=parts))
    upwards = _in_halves(np.bincount(part[stands], np.sign(off[stands]), minlength=parts))
    share = upwards / np.maximum(every, 1)
    variance = (standing + 1) / np.maximum(every, 1) ** 2
    differs = share[0] - share[1]
    possible = (every.min(axis=0) >= rules.both * len(level)) & (differs >= 2 * rules.often)
    possible &= upwards[0] - upwards[1] >= rules.alike * len(stands)
    return float(np.where(possible, differs / np.sqrt(variance.sum(axis=0)), 0.0).max())


def _stands(size: Array, worth: int, rules: FailingRules) -> np.ndarray:
    """Return (n,) whether readings of a distance (n,) from their neighbours are off by about what a bit is worth."""
    nearest, farthest = (share * worth for share in rules.off)
    return (size > nearest) & (size < farthest)


def _in_halves(counts: np.ndarray) -> Array:
    """Return the sums (2, n) of counts (n,) over the half of a circle that begins at each place, and over the other."""
    half = len(counts) // 2
    total = np.concatenate([[0.0], np.cumsum(np.concatenate([counts, counts]))])
    one = total[half : half + len(counts)] - total[: len(counts)]
    return np.stack([one, counts.sum() - one])
