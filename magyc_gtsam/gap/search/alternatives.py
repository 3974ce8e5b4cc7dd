"""Equal alternatives: the result of adding each, and the exchange of an effect for a rival once more is known.

The strongest effect is not always the right one while another effect is missing: a drift explains as much as a step,
until the effect that hid the step is in the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.refit import possible, without_term
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.scores.score import Score
from magyc_gtsam.gap.search.found import Found, less, term_places
from magyc_gtsam.gap.search.naming import Look, choices, related
from magyc_gtsam.gap.search.refined import nearer, sharpened
from magyc_gtsam.gap.search.steps import State, terms_of, with_effect


@dataclass(frozen=True, eq=False)
class Way:
    """The result of adding an effect: a state, or None and the names that remain instead (none: it has no fit)."""

    sharp: Score
    state: State | None
    instead: tuple[str, ...] = ()


def at_sharpest(score: Score, now: Look) -> Score:
    """Return a score of a look at the refined setting that explains most."""
    return sharpened(score, now.refit, now.innovation, now.projector)


def tried(state: State, now: Look, choice: Score, sharp: Score) -> Way:
    """Add an effect at its refined setting."""
    instead = nearer(sharp, now)
    if instead:
        return Way(sharp, None, instead)
    try:
        ahead = with_effect(state, now, choice, sharp)
    except MagycError:
        ahead = None
    if ahead is None or not _newcomers(ahead, state):
        return Way(sharp, None)
    if not possible(ahead.current, -1):
        return Way(sharp, None)  # another effect resembles it
    return Way(sharp, ahead)


def rest(now: Look) -> float:
    """Return the evidence, nats, of the strongest candidate with a held-out gain, significant or not."""
    return max((s.evidence for s in now.scores if now.gains.get(s.name, 0.0) > 0), default=0.0)


def with_exchange(state: State, seen: Callable[[State], Look], done: set[str]) -> State | None:
    """Exchange an effect for a rival that explains more beside all others, or a matrix for the delay that it contains.

    Args:
        state: at the end of the search.
        seen: function that returns a look at a state.
        done: names that were exchanged before, which are skipped; the exchanged name is added.

    Returns:
        None if there is no such effect.
    """
    for place, index in list(term_places(state.found, state.current.model).items())[:-1]:
        name = state.found[place].name
        if name in done or not any(related(name, other) for other in TERMS):
            continue
        try:
            ahead = _exchanged(state, seen, place, index)
        except MagycError:
            continue  # the model does not fit without it
        if ahead is not None:
            done.add(name)
            return ahead
    return None


def _exchanged(state: State, seen: Callable[[State], Look], place: int, index: int) -> State | None:
    one, term = state.found[place], state.current.model.terms[index]
    current = state.refitted(without_term(state.current.model, index))
    if current is None:
        return None
    without = replace(state, current=current, found=less(state.found, {place}))
    now = seen(without)
    own = at_sharpest(next(score for score in now.scores if score.name == one.name), now)
    if own.variant.setting.get("order", 0) < term.setting.get("order", 0):
        return None  # the model has more modes than a first test tries
    options = choices(now, without.found, set())
    # A matrix of eddy currents that is no longer significant may be only the delay.
    matrix = bool(term.setting.get("full")) and all(option.name != one.name for option in options)
    rivals = [(at_sharpest(option, now), option) for option in options if related(one.name, option.name)]
    for sharp, rival in sorted(rivals, key=lambda pair: -pair[0].evidence):
        delay = matrix and rival.name == "timing"
        if not delay and sharp.evidence < own.evidence + RULES.tie[0]:
            continue
        added = terms_of(rival.name, current, sharp.variant.setting)
        if len(added) > 1 or len(added[0].value) > len(term.value):
            continue  # it has more values, and explains more for that reason alone
        ahead = tried(without, now, rival, sharp).state
        if ahead is None or (delay and _wanted(one.name, seen(ahead), ahead)):
            continue  # it cannot be fitted, or plates remain significant beside the delay
        (newcomer,) = _newcomers(ahead, without)
        # It explains what the other effect did, and more; the remainder of a matrix beside a delay is not real.
        statistic = one.statistic + max(newcomer.statistic - own.statistic, 0.0)
        evidence = one.evidence + max(newcomer.evidence - own.evidence, 0.0)
        stronger = replace(newcomer, statistic=statistic, evidence=evidence)
        return replace(ahead, found=tuple(stronger if f is newcomer else f for f in ahead.found))
    return None


def _wanted(name: str, now: Look, state: State) -> bool:
    return any(option.name == name for option in choices(now, state.found, set()))


def _newcomers(ahead: State, before: State) -> list[Found]:
    return [found for found in ahead.found if all(found.of is not other.of for other in before.found)]
