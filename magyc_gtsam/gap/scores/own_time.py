"""Circular-shift test: whether a channel explains the data better than any signal with the same spectrum.

Slow signals are correlated by chance: a room's field that changes while the vehicle moves is explained by any depth
that changes, too, far beyond what independent samples would allow. The same channel, shifted circularly in time, has
the same spectrum and no relation to the data; an effect caused by the channel is explained best without a shift.
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

_SHIFTS = 32  # equal parts of the recording's length


def in_its_own_time(score: Score, twin: Twin, innovation: Array, projector: Projector) -> bool:
    """Return whether an effect explains more with its channels unshifted than with nearly all circular shifts.

    Effects without a channel pass; the acceleration does not count as one, because it follows from the motion. A shift
    shorter than the correlation time of a slow channel is left out.
    """
    term = TERMS[score.name]
    if not set(term.channels) - {"acceleration"}:
        return True
    own = score.variant.unit.T @ score.variant.score(innovation)
    others = as_good = 0
    for shift in np.arange(1, _SHIFTS) / _SHIFTS:
        columns = term.regressors(_shifted(twin, float(shift)), score.variant.setting)
        other = variant(score.variant.setting, twin.whiten(columns), projector, columns.score_bias)
        held, shifted = other.unit @ own, other.score(innovation)
        if held @ held > RULES.too_slow * (own @ own):
            continue
        others += 1
        as_good += float(shifted @ shifted) >= score.statistic
    return as_good < RULES.as_good * others


def _shifted(twin: Twin, share: float) -> Twin:
    """Return a twin whose channels are shifted circularly by a share of the recording, towards later times."""

    def late(signals: Signals) -> Signals:
        rolled = {k: np.roll(v, round(share * v.shape[1]), axis=1) for k, v in signals.channels.items()}
        return replace(signals, channels=rolled)

    return replace(twin, windows=late(twin.windows), gyroscope=late(twin.gyroscope))
