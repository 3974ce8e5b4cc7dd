"""Detect a bit of a sensor's converter that is wrong in some of the readings.

Such a reading is off its neighbours by what the bit is worth, B: upwards where the bit should be 0, downwards where it
should be 1. Which of the two it should be alternates every B along the axis. Spikes, bursts of noise and readings of
another sensor stand out as well, but not upwards in one stretch of B and downwards in the next; the peaks of a quick
turn do so, but among neighbours that are off as far. The means of the readings are off by up to the share of wrong
readings times B, alternating likewise, and so is what is fitted to them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter, rank_filter

from magyc_gtsam.recording import Array


@dataclass(frozen=True)
class FailingRules:
    """Limits between readings with a wrong bit and others.

    Attributes:
        noises: least multiple of the readings' scatter that a bit is worth; with 3, a log of lost samples has one.
        spreads: multiple of the distances around it by which a reading stands out; in a turn those are as large.
        off: distances from what is expected that count, as multiples of what the bit is worth.
        nearly: distance beyond which a reading is off at all, as a multiple of what the bit is worth.
        as_far: least share of those that are off at all that are off by a distance that counts; pulses whose height
            changes have less.
        middle: median of the distances that count, as multiples of what the bit is worth: 0.95 to 1.16 of 1,700 failing
            bits, more than 1 where the motion is quick; 0.76 to 0.84 and 1.21 of other faults.
        parts: parts into which two stretches are divided, to find where one begins.
        both: least share of the readings in either kind of stretch.
        often: least share of the readings that is wrong.
        alike: least share of the readings off by as much that are so on the side which the bit explains, less that of
            the others; 0.46 to 1 with a failing bit. Of noise that is not white in long logs it is 0.1.
        significant: standard deviations by which the kinds differ; ten minutes at 10 Hz with 15 % wrong readings reach
            9 to 19.
        outliers, beyond: share of the readings that exceed a multiple of the scatter, below which none is wrong;
            0.3 % of normal noise do.
        least: fewest readings.
    """

    noises: float = 4.0
    spreads: float = 3.0
    off: tuple[float, float] = (0.6, 1.4)
    nearly: float = 0.4
    as_far: float = 0.7
    middle: tuple[float, float] = (0.95, 1.17)
    parts: int = 32
    both: float = 0.05
    often: float = 0.006
    alike: float = 0.4
    significant: float = 6.0
    outliers: float = 0.005
    beyond: float = 3.0
    least: int = 200


RULES = FailingRules()
_BESIDE = 2  # neighbours on either side whose median a reading is compared with
_RUN = 7  # readings whose median distance from it is what the motion bends by
_AROUND = 13  # readings around one, itself among them
_RANK = 9  # place of the distance among theirs that three of them exceed
_NORMAL = 0.6745  # median of the absolute values of a normal deviate
_ROUNDING = 0.5  # steps, least scatter of readings in whole steps


def failing_bit(steps: Array, rules: FailingRules = RULES) -> int:
    """Return how many steps the bit is worth that is wrong in some of the readings (n,), whole steps; 0 for none."""
    if len(steps) < rules.least or not _has_outliers(steps, rules):
        return 0
    expected = _expected(steps)
    off = steps[_BESIDE:-_BESIDE] - expected
    size = np.abs(off)
    least = rules.noises * max(float(np.median(size)) / _NORMAL, _ROUNDING)
    off[size <= rules.spreads * rank_filter(size, _RANK, _AROUND)] = 0.0
    every = [1 << k for k in range(1, int(np.ptp(steps)).bit_length())]
    worths = [worth for worth in every if worth >= least and _many_stand(np.abs(off), worth, rules)]
    found = [_significance(off, expected, worth, rules) for worth in worths]
    if not found or max(found) <= rules.significant:
        return 0
    return worths[int(np.argmax(found))]


def _has_outliers(steps: Array, rules: FailingRules) -> bool:
    """Return whether more readings stand out than by noise: a test at a few operations per reading."""
    away = np.abs(steps[1:-1] - 0.5 * (steps[:-2] + steps[2:]))
    scatter = max(float(np.median(away)) / _NORMAL, _ROUNDING)
    return bool(np.count_nonzero(away > rules.beyond * scatter) > rules.outliers * len(away))


def _expected(steps: Array) -> Array:
    """Return what the neighbours of each reading (n,) but the first and the last two let expect, (n − 4,).

    It is the median of four neighbours, and of what the readings around are off from theirs by the motion's curvature.
    """
    beside = np.stack([steps[:-4], steps[1:-3], steps[3:-1], steps[4:]])
    median = 0.5 * (beside.sum(axis=0) - beside.min(axis=0) - beside.max(axis=0))
    result: Array = median + median_filter(steps[_BESIDE:-_BESIDE] - median, _RUN)
    return result


def _many_stand(size: Array, worth: int, rules: FailingRules) -> bool:
    """Return whether enough readings of a distance (n,) are off by what a bit is worth, and few others are."""
    own = size[_stands(size, worth, rules)]
    enough = 2 * rules.often * rules.both * len(size)  # in the rarer kind of stretch, at least
    if len(own) < max(enough, rules.as_far * np.count_nonzero(size > rules.nearly * worth)):
        return False
    least, most = (share * worth for share in rules.middle)
    return bool(least < np.median(own) < most)


def _significance(off: Array, level: Array, worth: int, rules: FailingRules) -> float:
    """Return by how many sigmas more readings are off upwards in every second stretch, and downwards in the others.

    Args:
        off, level: (n,) steps, each reading's distance from what is expected, 0 where it does not stand out, and that.
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
    """Return (n,) whether readings of a distance (n,) are off by about what a bit is worth."""
    nearest, farthest = (share * worth for share in rules.off)
    return (size > nearest) & (size < farthest)


def _in_halves(counts: np.ndarray) -> Array:
    """Return the sums (2, n) of counts (n,) over the half of a circle that begins at each place, and over the other."""
    half = len(counts) // 2
    total = np.concatenate([[0.0], np.cumsum(np.concatenate([counts, counts]))])
    one = total[half : half + len(counts)] - total[: len(counts)]
    return np.stack([one, counts.sum() - one])
