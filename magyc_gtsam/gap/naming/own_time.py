"""Circular-shift test: whether a channel explains the data better than any signal with the same spectrum.

Slow signals are correlated by chance: a bias or a field that changes while the vehicle moves is explained by any depth
or temperature that changes, too, far beyond what independent samples would allow. The same channel, shifted circularly
in time, has the same spectrum and no relation to the data; an effect caused by the channel is explained best without a
shift.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside, Seen, solved
from magyc_gtsam.gap.model.refit import Refit, without_term
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_SHIFTS = 32  # equal parts of the recording's length


def in_its_own_time(fitted: Refit, index: int) -> bool:
    """Return whether the model's term `index` explains more with its channels unshifted than with nearly all shifts.

    Effects without a channel pass; the acceleration does not count as one, because it follows from the motion. A shift
    shorter than the correlation time of a slow channel is left out.
    """
    twin, term = fitted.twin, fitted.model.terms[index]
    effect = TERMS[term.name]
    if not set(effect.channels) - {"acceleration"}:
        return True
    without = replace(twin, model=without_term(twin.model, index))
    own = twin.whiten(twin.columns(term.name, term.setting))
    value, _ = fitted.value_of(index)
    residual, rows = twin.residual().ravel() - value @ own, without.base_columns
    beside = Beside.of(residual, rows, rows[:0], np.zeros(0), without.base_score_bias)

    def seen(shift: float) -> tuple[Array, Seen]:
        columns = effect.regressors(_shifted(twin, shift), term.setting)
        none = np.zeros(len(columns.window))
        whitened = twin.whiten(columns)
        return whitened, beside.see(whitened, none if columns.score_bias is None else columns.score_bias)

    own, first = seen(0.0)
    value, _ = solved(own @ own.T - first.reach @ first.reach.T, first.score)
    explained = float(first.score @ value)
    others, as_good = 0, 0
    for shift in np.arange(1, _SHIFTS) / _SHIFTS:
        columns, other = seen(float(shift))
        information = columns @ columns.T - other.reach @ other.reach.T
        shared = (columns @ own.T - other.reach @ first.reach.T) @ value
        if shared @ solved(information, shared)[0] > RULES.too_slow * explained:
            continue
        others += 1
        as_good += bool(other.score @ solved(information, other.score)[0] >= explained)
    return as_good < RULES.as_good * others


def _shifted(twin: Twin, share: float) -> Twin:
    """Return a twin whose channels are shifted circularly by a share of the recording, towards later times."""

    def late(signals: Signals) -> Signals:
        rolled = {k: np.roll(v, round(share * v.shape[1]), axis=1) for k, v in signals.channels.items()}
        return replace(signals, channels=rolled)

    return replace(twin, windows=late(twin.windows), gyroscope=late(twin.gyroscope))
