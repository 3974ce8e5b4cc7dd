"""A jump of the iron after which the vehicle does not turn any more: the field of the place may have changed instead.

So end recordings that were not stopped before the vehicle was put down or moored. If it was the place, the hard iron is
what it was before.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.gap.effects.world import turned
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.rules import RULES


def doubt_of_last_jump(result: Refit) -> str:
    """Return why the iron after the last jump of a model is uncertain, with a remedy; "" if it is not."""
    jumps = [t for t in result.model.terms if t.name == "hard-iron-step" and "until" not in t.setting]
    if not jumps:
        return ""
    last = max(jumps, key=lambda term: term.setting["time"])
    time = last.setting["time"]
    changed = float(np.linalg.norm(np.sum([term.value for term in jumps], axis=0)))
    moved = float(turned(result.twin, np.array([time]), np.array([np.inf]))[0])
    if moved > RULES.stay_turns or changed < RULES.taken_off * float(np.linalg.norm(last.value)):
        return ""
    return (
        f"the hard iron jumped at {time:.0f} s, or the field of the place changed: turn a full circle after it, or "
        "choose an interval without it (start=, end=)"
    )
