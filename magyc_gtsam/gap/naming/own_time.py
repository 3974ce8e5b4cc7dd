"""Circular-shift test: whether a channel explains the data better than any signal with the same spectrum.

Slow signals are correlated by chance: a bias or a field that changes while the vehicle moves is explained by any depth
or temperature that changes, too, far beyond what independent samples would allow. The same channel, shifted circularly
in time, has the same spectrum and no relation to the data; an effect caused by the channel is explained best without a
shift.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.refit import Refit, without_term
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.model.variants import Projector, Variant, variant
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
    project = Projector(without.base_columns, without.base_score_bias)
    value, _ = fitted.value_of(index)
    of_term = value @ twin.whiten(twin.columns(term.name, term.setting))
    target = project((twin.residual().ravel() - of_term)[None])[0]

    def at(shift: float) -> Variant:
        columns = effect.regressors(_shifted(twin, shift), term.setting)
        return variant(term.setting, twin.whiten(columns), project, columns.score_bias)

    own = at(0.0)
    score = own.score(target)
    explained = own.unit.T @ score
    others, as_good = 0, 0
    for shift in np.arange(1, _SHIFTS) / _SHIFTS:
        other = at(float(shift))
        held, shifted = other.unit @ explained, other.score(target)
        if held @ held > RULES.too_slow * (explained @ explained):
            continue
        others += 1
        as_good += bool(shifted @ shifted >= score @ score)
    return as_good < RULES.as_good * others


def _shifted(twin: Twin, share: float) -> Twin:
    """Return a twin whose channels are shifted circularly by a share of the recording, towards later times."""

    def late(signals: Signals) -> Signals:
        rolled = {k: np.roll(v, round(share * v.shape[1]), axis=1) for k, v in signals.channels.items()}
        return replace(signals, channels=rolled)

    return replace(twin, windows=late(twin.windows), gyroscope=late(twin.gyroscope))
