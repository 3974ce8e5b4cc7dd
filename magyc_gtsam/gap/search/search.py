"""The search: which effect is added next, its rivals, and the end of the search.

Forward selection by the penalised score (evidence: −ln p for white innovations), decided by the significance for
innovations with the colour of the data, and vetoed if there is no gain on held-out blocks. After each addition
everything is refitted jointly, and terms that became superfluous are removed. Equal alternatives are all tried
(`gap.search.alternatives`).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.problem import Problem
from magyc_gtsam.gap.model.refit import Refit, refit, small, without_term
from magyc_gtsam.gap.model.variants import Projector
from magyc_gtsam.gap.preparation.clocks import CLOCK_DRIFT, drift_apart
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.scores.own_time import in_its_own_time
from magyc_gtsam.gap.scores.score import Score, held_out_gain, interleaved, scan
from magyc_gtsam.gap.search.alternatives import at_sharpest, rest, tried, with_exchange
from magyc_gtsam.gap.search.found import Found, less, term_places
from magyc_gtsam.gap.search.naming import Look, choices, loudest, with_forms
from magyc_gtsam.gap.search.objections import leftover, stands, switched
from magyc_gtsam.gap.search.refined import sharpened
from magyc_gtsam.gap.search.steps import State, with_more_modes, with_noise
from magyc_gtsam.recording import Recording

_TURNS = RULES.most_terms + 8  # looks; 8 more for effects on the noise, failed fits and exchanges
_ON_AND_OFF = (
    "hard-iron-step",
    "local-anomaly",
)  # at a time of their own; hard to distinguish on the coarse grids


@dataclass(frozen=True, eq=False)
class Search:
    """The result of a search.

    Attributes:
        recording, problem: the data, without wrong samples and tones.
        first, last: looks at the base model and at the final one.
        found: effects in the order in which they were added; see `found.term_places`.
        leftover: names that remain significant in the last look and were not added; effects that are significant
            without a possible value; colour that may be part of a misfit; and drifting clocks.
        slight: names of effects that would explain the data, but are too small and too weak to be named.
    """

    recording: Recording
    problem: Problem
    first: Look
    last: Look
    found: tuple[Found, ...]
    leftover: tuple[str, ...] = ()
    slight: tuple[str, ...] = ()


def look(recording: Recording, refitted: Refit, names: tuple[str, ...], random: np.random.Generator) -> Look:
    """Test all candidates against a model."""
    scores, innovation, projector = scan(refitted.twin, names, random)
    if any(s.significant and "until" in s.variant.setting for s in scores):
        scores = [
            sharpened(s, refitted, innovation, projector) if s.significant and s.name in _ON_AND_OFF else s
            for s in scores
        ]
    scores.sort(key=lambda s: -s.evidence)
    confirm = _confirmation(refitted, innovation)
    gains = {s.name: confirm(s) for s in scores if s.evidence > RULES.worth_a_look}
    for s in scores:
        tried = s.significant and not s.generic and gains[s.name] > 0
        if tried and not in_its_own_time(s, refitted.twin, innovation, projector):
            gains[s.name] = 0.0
    return Look(recording, refitted, scores, innovation, projector, gains)


def _confirmation(refitted: Refit, innovation: Array) -> Callable[[Score], float]:
    """Return a function that gives the held-out gain of scores.

    Terms of the model at a time of their own are fitted to the whole recording: if an object was passed in one block,
    the other half contains nothing about it.
    """
    twin = refitted.twin
    names = [t.name for t in twin.model.estimated for _ in t.value]
    local = np.array([False] * int(twin.model.free.sum()) + [name in _ON_AND_OFF for name in names])
    beside = Projector(twin.base_columns[local])
    base = beside(twin.base_columns[~local])

    def gain(score: Score) -> float:
        length = RULES.block if score.generic else TERMS[score.name].block(score.variant.setting)
        length = min(length, (twin.time[-1] - twin.time[0]) / RULES.blocks)
        columns = beside(score.variant.columns)
        return held_out_gain(base, columns, innovation, interleaved(twin.time, length))

    return gain


def search(
    recording: Recording,
    base: Refit,
    short_term: SensorNoise,
    names: tuple[str, ...],
    progress: Callable[[float], None],
    seed: int = 0,
) -> Search:
    """Add effects until nothing is significant."""
    random = np.random.default_rng(seed)
    allowed = tuple(n for n in names if n in TERMS)

    def seen(state: State) -> Look:
        return look(state.recording, state.current, allowed, random)

    def widest(state: State) -> tuple[State, Look]:
        """Return a state with all significant modes of its drift, and a look at it."""
        now = seen(state)
        wider = with_more_modes(state, now)
        return (state, now) if wider is None else (wider, seen(wider))

    state = State(recording, base.twin.problem, base, (), short_term)
    first = now = seen(state)
    noted: set[str] = set()
    failed: set[str] = set()
    instead: tuple[str, ...] = ()
    exchanged: set[str] = set()
    for turn in range(_TURNS):
        progress(0.2 + 0.6 * turn / _TURNS)
        noise = loudest(now, names, noted)
        options = choices(now, state.found, failed)
        if noise is not None and (not options or noise.evidence >= options[0].evidence):
            noted.add(noise.name)
            if noise.name == "quantisation":
                noted.add("coloured-noise")  # the error of a coarse step is autocorrelated, as the reading is
            state, now = widest(with_noise(state, now, noise))
            continue
        if not options or len(state.current.model.terms) >= RULES.most_terms:
            better = with_exchange(state, seen, exchanged)
            if better is None:
                break
            state, now = widest(better)
            continue
        ways = [tried(state, now, option, at_sharpest(option, now)) for option in options]
        instead = ways[0].instead
        if instead:
            break
        failed |= {way.sharp.name for way in ways if way.state is None and not way.instead}
        ahead = []
        for way in ways:
            if way.state is not None:
                try:
                    ahead.append((way.sharp.evidence, *widest(way.state)))
                except MagycError:
                    failed.add(way.sharp.name)  # its model cannot be evaluated on the data
        if ahead:
            _, state, now = _best(ahead)
            failed = set()  # beside another effect they may fit
    # Coloured noise is in no model, so that it is still significant if it is real and not part of another effect.
    loud = {noise.name for noise in now.noise if noise.significant}
    state = replace(state, found=tuple(f for f in state.found if f.name != "coloured-noise" or f.name in loud))
    left = tuple(dict.fromkeys((*instead, *switched(state.found), *leftover(now, first, state.found, noted))))
    final = state
    if left:
        final = _supported(state, first, now, left)
        left = (*left, *(f.name for f in state.found if f.name == "coloured-noise"))
    places = term_places(final.found, final.current.model)
    weak = {p for p, i in places.items() if final.found[p].evidence < RULES.weak and small(final.current, i)}
    slight = tuple(final.found[p].name for p in sorted(weak))
    final = _without(final, weak)
    if final.current is not state.current:
        now = seen(final)
    if drift_apart(now.refit):
        left = (CLOCK_DRIFT, *left)
    return Search(final.recording, final.problem, first, now, with_forms(final.found, now), left, slight)


def _best(ahead: Sequence[tuple[float, State, Look]]) -> tuple[float, State, Look]:
    """Return the best of several alternatives, with their evidence: the one that leaves the smallest misfit.

    If the misfit of each exceeds the evidence of all, it has another cause and does not distinguish them.
    """
    left = [rest(now) for _, _, now in ahead]
    if min(left) > max(evidence for evidence, _, _ in ahead):
        left = [0.0] * len(ahead)
    return max(zip(ahead, left, strict=True), key=lambda one: one[0][0] - one[1])[0]


def _supported(state: State, first: Look, now: Look, left: tuple[str, ...]) -> State:
    """Return the state without the terms that depend on the remaining misfit."""
    current, found = state.current, state.found
    # A line at the frequencies of the motion that is stronger than a named effect is the cause of that effect.
    line = max((n.evidence for n in first.noise if n.name == "tone" and not n.significant), default=0.0)
    loose = {
        place
        for place, index in term_places(found, current.model).items()
        if found[place].evidence < line
        or _repeated(current, index, now, left)
        or not stands(current, index, found[place], now, left)
    }
    firm = _without(state, loose)
    # A remaining misfit would be taken for colour.
    return replace(firm, found=tuple(f for f in firm.found if f.name != "coloured-noise"))


def _without(state: State, places: Container[int]) -> State:
    """Return the state without the terms found at these places."""
    indices = [index for place, index in term_places(state.found, state.current.model).items() if place in places]
    if not indices:
        return state
    model = state.current.model
    for index in reversed(indices):
        model = without_term(model, index)
    kept = refit(state.problem, model, state.short_term)
    return replace(state, current=kept, found=less(state.found, places))


def _repeated(current: Refit, index: int, now: Look, left: tuple[str, ...]) -> bool:
    """Return whether a further term of this effect is nearly as significant: a sequence of steps is not a step."""
    name = current.model.terms[index].name
    more = max((s.statistic for s in now.scores if s.name == name), default=np.inf)
    return name in left and more > RULES.left * current.weight_of(index)
