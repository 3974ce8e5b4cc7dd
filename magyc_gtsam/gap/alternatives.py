"""Names that are as good as each other: where each leads, and which is exchanged once more is known.

The strongest name is not always the right one while something else is missing too: a drift explains as much as a step
does, until what hid the step is in the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.gap.naming import TIE, Look, choices, related, term_places
from magyc_gtsam.gap.refined import nearer, sharpened
from magyc_gtsam.gap.refit import determined, without_term
from magyc_gtsam.gap.score import Score
from magyc_gtsam.gap.steps import State, with_effect

_CERTAIN = 2.0  # limits that the significance of what the motion does not determine must pass


@dataclass(frozen=True, eq=False)
class Way:
    """Where it leads to add an effect: a state, or None and what is said instead (nothing: it cannot be fitted)."""

    sharp: Score
    state: State | None
    instead: tuple[str, ...] = ()


def tried(state: State, now: Look, choice: Score) -> Way:
    """Add an effect as it is sharpest."""
    sharp = sharpened(choice, now.refit, now.innovation, now.projector)
    instead = nearer(sharp, now)
    if instead:
        return Way(sharp, None, instead)
    ahead = with_effect(state, now, choice, sharp)
    if ahead is not None and choice.significance < _CERTAIN * choice.limit and not determined(ahead.current, -1):
        return Way(sharp, None, (choice.name,))  # too little of too much that the motion leaves open
    return Way(sharp, ahead)


def rest(now: Look) -> float:
    """Nats of what explains most of what is still significant."""
    left = (s.evidence for s in now.scores if s.significant and now.gains.get(s.name, 0.0) > 0)
    return max(left, default=0.0)


def with_exchange(state: State, seen: Callable[[State], Look], done: set[str]) -> State | None:
    """With a name exchanged for a rival that explains more beside all that was found after it; None: there is none.

    Args:
        state: at its end.
        seen: gives a look at a state.
        done: names that were exchanged before, which are not again; the one exchanged is added.
    """
    for place, index in list(term_places(state.found, state.current.model).items())[:-1]:
        one = state.found[place]
        current = None if one.name in done else state.refitted(without_term(state.current.model, index))
        if current is None:
            continue
        without = replace(state, current=current, found=tuple(f for i, f in enumerate(state.found) if i != place))
        now = seen(without)
        rivals = [option for option in choices(now, without.found, set()) if related(one.name, option.name)]
        own = next(score for score in now.scores if score.name == one.name)
        sharp = [sharpened(s, now.refit, now.innovation, now.projector) for s in (own, *rivals)]
        best = int(np.argmax([s.evidence for s in sharp]))
        wider = len(sharp[best].expected) > len(own.expected)  # and so explains more, whatever it is
        if best == 0 or wider or sharp[best].evidence < sharp[0].evidence + TIE[0]:
            continue
        ahead = tried(without, now, rivals[best - 1]).state
        if ahead is None or not ahead.found or ahead.found[-1].name != sharp[best].name:
            continue
        done.add(one.name)
        # It explains what the other did, and more.
        statistic = one.statistic + sharp[best].statistic - sharp[0].statistic
        evidence = one.evidence + sharp[best].evidence - sharp[0].evidence
        stronger = replace(ahead.found[-1], statistic=statistic, evidence=evidence)
        return replace(ahead, found=(*ahead.found[:-1], stronger))
    return None
