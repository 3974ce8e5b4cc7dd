"""The delay of the magnetometer, which the calibration estimates although the posterior does not name it.

At a constant spin a delay is a rotation about its axis, as a misalignment is. Fixed at 0, it would be taken for one of
the named effects with sigmas that do not hold. `calibrate` estimates it in any case, too.
"""

from __future__ import annotations

from dataclasses import replace

from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.problem import Model

_DELAY = "timing"


def with_free_delay(model: Model) -> Model:
    """Return a model with named effects with a free delay, unless one of them contains the delay.

    A model without any effect remains without a delay: the misalignment that is then estimated beside it includes the
    rotation by a delay.
    """
    if not model.terms or any(_contains_delay(term.name) for term in model.terms):
        return model
    free = model.free.copy()
    free[DELAY] = True
    return replace(model, free=free)


def _contains_delay(name: str) -> bool:
    return name == _DELAY or any(_contains_delay(special) for special in TERMS[name].contains)
