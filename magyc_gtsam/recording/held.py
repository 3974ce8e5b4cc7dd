"""Why a magnetometer's log repeats values: it is polled faster than it measures, or its steps are coarse.

A hold repeats all axes together and is no new sample; a coarse step repeats each axis independently, and each entry is
a sample. To leave these out would keep the first of each run, and so make the magnetometer seem early: by 8 ms on a
ship, by 3 ms on a car at steps of 0.6 µT and 20 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.recording.checks import Array, Mask
from magyc_gtsam.recording.recording import Recording

HELD = 0.08  # share of entries that exactly repeat the one before, above which they may be held
_ALONE = 0.1  # share of the entries in which single axes repeat, above which the steps are coarse
_LEFT = 0.7  # share of the repeated entries that chance must not explain: axes that pause together are not held
# share of the repeated entries that chance must explain: at coarse steps it does for 0.9 to 1, beside a hold for 0.3
_BY_CHANCE = 0.5
_RANDOM = 0.5  # position between the variances of run lengths by a clock (0) and by chance (1)
_LONGEST = 10  # entries in a row that repeat by chance; a sensor that is stuck has more
_LOCALLY = 3.0  # s in which the probability of a repeat hardly changes
_ROWS = 100  # fewest rows from which a share is estimated


@dataclass(frozen=True)
class RepeatedEntries:
    """The repeated entries of a magnetometer's log.

    Attributes:
        share: share of the entries in which all axes are held, apart from chance repeats of the single axes.
        held: whether the entries are those of a sensor that is polled faster than it measures.
        by_chance: whether the entries repeat because of coarse steps: each is a sample.
    """

    share: float
    held: bool
    by_chance: bool

    @classmethod
    def of(cls, recording: Recording) -> RepeatedEntries:
        """Count the repeats of a recording; at coarse steps those of a hold must also be regular."""
        own = recording.magnetic_field_stamped
        stale = ~recording.magnetic_field_fresh[own]
        repeats = np.diff(recording.magnetic_field[own], axis=0) == 0
        share = _share_held(recording.time[own], repeats)
        together = repeats.all(axis=1)
        coarse = float(repeats.mean() - together.mean()) > _ALONE
        unlikely = share > max(HELD, _LEFT * float(stale.mean()))
        held = bool(unlikely and (not coarse or _regular(together)))
        return cls(share, held, coarse and share < _BY_CHANCE * float(stale.mean()))


def with_chance_repeats(recording: Recording) -> Recording:
    """Return the recording with repeated entries as samples if they repeat because of coarse steps.

    Of a longer run, which may be that of a sensor that is stuck, only the first entries are.
    """
    fresh, stamped = recording.magnetic_field_fresh, recording.magnetic_field_stamped
    if np.array_equal(fresh, stamped) or not RepeatedEntries.of(recording).by_chance:
        return recording
    entry = np.cumsum(stamped)
    last: np.ndarray = np.maximum.accumulate(np.where(fresh, entry, 0))  # the last entry so far that was fresh
    return replace(recording, magnetic_field_fresh=stamped & (entry - last <= _LONGEST))


def _regular(repeats: Mask) -> bool:
    """Return whether repeated steps (n,) have the regular run lengths of a clock: one number of rows, or one more.

    Coarse steps repeat while the field hardly changes: their run lengths vary as by chance, or more.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], repeats.astype(int), [0]])))
    lengths = edges[1::2] - edges[::2]
    mean = float(lengths.mean())
    clock, chance = (mean % 1) * (1 - mean % 1), mean * (mean - 1)  # variances of the run length
    return bool(lengths.var() <= clock + _RANDOM * max(chance - clock, 0.0) + 1e-9)


def _share_held(time: Array, repeats: Mask) -> float:
    """Return the share h of the steps (n, 3) at which all axes are held, apart from repeats of single axes.

    With q_i the probability of a repeat of axis i without a hold, an axis repeats with p_i = h + (1 − h) q_i and all
    three with h + (1 − h) q_x q_y q_z. This is solved for h in each section of the recording by bisection. The median
    over the sections is returned: a hold is present all the time, a pause is not.
    """
    length = max(_LOCALLY, _ROWS * float(np.median(np.diff(time))))
    stretch = np.floor((time[1:] - time[0]) / length).astype(int)
    _, starts, count = np.unique(stretch, return_index=True, return_counts=True)
    each = np.add.reduceat(repeats, starts, axis=0, dtype=float) / count[:, None]
    together = np.add.reduceat(repeats.all(axis=1), starts, dtype=float) / count
    low, high = np.zeros(len(count)), each.min(axis=1)
    for _ in range(30):
        h = 0.5 * (low + high)
        free = np.maximum(1 - h, 1e-9)
        more = h + np.prod(np.maximum(each - h[:, None], 0.0) / free[:, None], axis=1) * free < together
        low, high = np.where(more, h, low), np.where(more, high, h)
    return float(np.median(np.repeat(0.5 * (low + high), count)))
