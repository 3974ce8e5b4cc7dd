"""Errors of the gyroscope's time stamps, found from the stamps alone, and what they add to the variance of its turn.

A driver that reads its samples in batches stamps them by the time at which it got the batch, spread evenly or not. The
stamps of a batch are then late by a delay δ that differs from batch to batch. Integrated over such stamps the attitude
is off by −∫ δ dω: nothing at a constant rate, but at each change of the rate an error that stays. Its variance per
batch is σ_δ² |Δω|², with Δω the change of the rate from one batch to the next.

A sensor samples evenly, so that a batch that lasts longer than its samples do is one whose delay grew. Of independent
delays E[max(δ' − δ, 0)²] = σ_δ². Only what is too long counts: of what is too short a part is lost, where stamps would
run backwards. Batches that are too long alone are pauses or lost samples, whose stamps are right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.rotations import Array


@dataclass(frozen=True)
class StampRules:
    """Limits between stamps that wander from batch to batch, and those of a sensor with pauses or of an uneven one.

    Measured on eight simulated vehicles and four drivers whose delays vary by 5 to 80 ms, on logs that lose 60 % of
    their samples in bursts, on uneven samples, and on 30 real recordings, none of which passes for batches.

    Attributes:
        even: share of the mean interval by which two intervals of one batch may differ. Those that a driver
            computes are even but for rounding, up to 1 % in recordings of phones.
        alike: least mean number of steps of a batch, below which each stamp is measured by itself. Drivers have 4 to
            31; uneven samples 1.0 to 1.5, and a recording of a polled sensor with pauses 1.3.
        together: share of the mean interval below which the samples of a batch are stamped together, at its arrival
            (0.002 to 0.01; else 0.6 and more).
        off: share of an interval by which a batch is too long or too short. Stamps in ticks change one by less, if
            the ticks are at most a quarter of it.
        returned: least share of too short ones among these: 0.39 to 0.95, and none where samples are lost.
        whole, lost: most of the batches that are too long are so by a whole number of intervals, within `whole`, where
            samples were lost: all of them, and at most 0.19 by drivers. Rounding may make others too short there, as in
            a real recording that is stamped in ticks of a quarter of its interval.
        batches: fewest of these from which a spread can be estimated, to a fifth.
        longest: multiples of the median excess up to which one counts, because pauses occur as well. One in 1,000
            exponential delays exceeds it.
    """

    even: float = 0.02
    alike: float = 3.0
    together: float = 0.1
    off: float = 0.25
    returned: float = 0.2
    whole: float = 0.1
    lost: float = 0.5
    batches: int = 20
    longest: float = 10.0


RULES = StampRules()


@dataclass(frozen=True, eq=False)
class StampErrors:
    """The delays of a gyroscope's stamps.

    Attributes:
        spread: s, standard deviation of the delay from batch to batch.
        first, count: (k,) the first step between stamps of each batch, and the number of its steps.
    """

    spread: float
    first: np.ndarray
    count: np.ndarray

    def variance(self, rate: Array, noise: float) -> Array:
        """Return what they add to the variance of the turn in each step, (G − 1,) rad².

        Args:
            rate: (G, 3) rad/s.
            noise: rad/s, standard deviation of a sample per axis.
        """
        result = np.zeros(len(rate) - 1)
        result[self.first] = self.spread**2 * _squared_changes(rate, self.first, self.count, noise)
        return result


def stamp_errors(time: Array, rules: StampRules = RULES) -> StampErrors | None:
    """Return the errors of a gyroscope's ascending stamps (G,) s; None if samples are stamped as they are taken."""
    step = np.diff(time)
    if len(step) <= rules.batches:
        return None
    if float(step.min()) > (1 - rules.even) * float(step.max()):
        return None
    typical, mean = median(step), float(step.mean())
    first = _batches(step, rules.even * mean)
    if not rules.batches <= len(first) <= len(step) / rules.alike:
        return None
    count = np.diff(np.append(first, len(step)))
    lasted = np.add.reduceat(step, first)
    # Stamped together, all samples but one of a batch seem to take no time.
    interval = typical if typical > rules.together * mean else median(np.repeat(lasted / count, count))
    excess = lasted - count * interval
    limit = rules.off * interval
    long, short = (int(np.count_nonzero(sign * excess > limit)) for sign in (1, -1))
    if long + short < rules.batches or short < rules.returned * (long + short) or not long:
        return None
    missing = excess[excess > limit] / interval
    if float((np.abs(missing - np.rint(missing)) < rules.whole).mean()) > rules.lost:
        return None
    late = np.maximum(excess, 0.0)
    late = np.minimum(late, rules.longest * median(late[late > limit]))
    return StampErrors(float(np.sqrt(np.square(late).mean())), first, count)


def _batches(step: Array, even: float) -> np.ndarray:
    """Return the index of the first interval of each batch: intervals (n,) that are alike, and the one before them."""
    changed = np.flatnonzero(np.abs(np.diff(step)) > even) + 1
    first = np.concatenate([[0], changed])
    count = np.diff(np.append(first, len(step)))
    inside = np.zeros(len(first), dtype=bool)  # a batch that begins with the single interval before it
    inside[1:] = (count[:-1] == 1) & (count[1:] > 1)
    result: np.ndarray = first[~inside]
    return result


def _squared_changes(rate: Array, first: np.ndarray, count: np.ndarray, noise: float) -> Array:
    """Return |Δω|² (k,) in rad²/s² from each batch to the next, between their mean rates, less that of noise."""
    mean = np.add.reduceat(rate[1:], first, axis=0) / count[:, None]
    change = np.diff(mean, axis=0, append=mean[-1:])
    by_noise = rate.shape[1] * noise**2 * (1 / count + 1 / np.append(count[1:], count[-1]))
    return np.maximum(np.einsum("ki,ki->k", change, change) - by_noise, 0.0)
