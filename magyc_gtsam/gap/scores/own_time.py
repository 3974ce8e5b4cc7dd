"""Whether a channel explains the data by what it shows, or as any signal of its kind would.

Slow signals agree by chance: a room's field that changes while the vehicle wanders is explained by any depth that
wanders too, far beyond what independent samples would allow. The same channel, shifted in time round the recording,
has its spectrum and nothing to do with the data; what is caused by the channel is explained by it at its own time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.model.variants import Projector, variant
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.scores.score import Score

_SHIFTS = 32  # of the recording's length


def in_its_own_time(score: Score, twin: Twin, innovation: Array, projector: Projector) -> bool:
    """Whether an effect explains more with its channels at their own time than at nearly all others.

    Effects without a channel do; the acceleration is no channel, it comes of the motion. A shift by less than what a
    slow channel hangs together over is no other time.
    """
    term = TERMS[score.name]
    if not set(term.channels) - {"acceleration"}:
        return True
    own = score.variant.unit.T @ score.variant.score(innovation)
    others = as_good = 0
    for shift in np.arange(1, _SHIFTS) / _SHIFTS:
        columns = term.regressors(_shifted(twin, float(shift)), score.variant.setting)
        other = variant(score.variant.setting, twin.whiten(columns), projector, columns.pull)
        held, pull = other.unit @ own, other.score(innovation)
        if held @ held > RULES.too_slow * (own @ own):
            continue
        others += 1
        as_good += float(pull @ pull) >= score.statistic
    return as_good < RULES.as_good * others


def _shifted(twin: Twin, share: float) -> Twin:
    """A twin whose channels are late by a share of the recording, and begin with what would be beyond its end."""

    def late(signals: Signals) -> Signals:
        rolled = {k: np.roll(v, round(share * v.shape[1]), axis=1) for k, v in signals.channels.items()}
        return replace(signals, channels=rolled)

    return replace(twin, windows=late(twin.windows), gyroscope=late(twin.gyroscope))
