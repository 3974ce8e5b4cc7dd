"""The scenarios: what is hidden where, fixed by nothing but set, motion, number and edition.

Strengths are in `simulation.effects.strengths`, seeds come from a hash, and nothing here is drawn at run time:
the same edition gives the same recordings for ever. Rules and thresholds are developed on edition 0 and judged
on another.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations

from magyc_gtsam.simulation.effects import EFFECTS, FOREIGN, NAMED, STRENGTHS

FACTORS = (1.0, 0.5, 0.25, 2.0)
SETS = ("none", "single", "pair", "withheld", "foreign", "real")
MOTIONS = ("wide", "moderate", "multi")

# What the table of effects says is confused with what; such pairs are no test of naming.
RIVALS = (
    {"hard-iron-step", "hard-iron-drift", "temperature-hard-iron", "local-anomaly", "motor-current"},
    {"misalignment", "gyro-scale", "gyro-quadratic", "cubic", "saturation"},
    {"timing", "eddy-plane", "hysteresis", "sample-hold", "g-sensitivity", "field-gradient"},
    {"coloured-noise", "spikes", "tone", "quantisation", "sample-hold"},
    {"hard-iron-drift", "coloured-noise"},
    {"temperature-gyro", "g-sensitivity"},
)
# Effects that the level motion cannot show at the published strength, by the table of one-sigma sizes.
INVISIBLE = {"moderate": ("g-sensitivity",)}
# Channels that hold another as well.
_ALSO_IN = {"depth": ("position",)}
# Of these there is no half, or no pair: a discrete mounting error comes before everything else.
_WHOLE = ("axis-order",)
# What real recordings take: effects that need no attitude and are not there already.
_INJECTED = tuple(n for n in NAMED if not EFFECTS[n].attitude and n != "sample-hold")
# Looks at a real recording as it is, all but the first at a cut of it: which of its small effects are significant
# changes with a second more or less.
_LOOKS = 5


@dataclass(frozen=True)
class Scenario:
    """One recording with what is hidden in it.

    Attributes:
        id: unique within an edition.
        set: one of `SETS`.
        motion: of the simulator, or the name of a real recording.
        seed: of motion, sensors, noise, surroundings and effects.
        effects: (name, factor on the published strength).
        withheld: channels that are left out.
        duration: s, of a simulated recording.
        cut: whether a real recording lacks a little of its start and its end.
    """

    id: str
    set: str
    motion: str
    seed: int
    effects: tuple[tuple[str, float], ...]
    withheld: tuple[str, ...] = ()
    duration: float = 600.0
    cut: bool = False

    @property
    def factor(self) -> float:
        """Of the effects; 1 where there are none."""
        return self.effects[0][1] if self.effects else 1.0

    @property
    def label(self) -> str:
        """What is hidden, in one word or two."""
        return " + ".join(self.names) or "nothing"

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects."""
        return tuple(name for name, _ in self.effects)


def scenarios(
    motion: str,
    runs: int = 300,
    edition: int = 0,
    sets: Sequence[str] = SETS[:5],
    duration: float = 600.0,
) -> list[Scenario]:
    """All scenarios of a simulated motion.

    Args:
        motion: of `MOTIONS`, or any other that the simulator has.
        runs: recordings without any effect; the other sets are in proportion (per effect and strength a
            thirtieth of them, pairs a fifth, withheld channels a third).
        edition: of the seeds.
        sets: which.
        duration: s.
    """
    each = max(1, round(runs / 30))
    result: list[Scenario] = []

    def add(kind: str, label: str, effects: tuple[tuple[str, float], ...], withheld: tuple[str, ...] = ()) -> None:
        name = f"{kind}-{motion}-{label}"
        result.append(Scenario(name, kind, motion, seed_of(name, edition), effects, withheld, duration))

    if "none" in sets:
        for k in range(runs):
            add("none", f"{k:03d}", ())
    for kind, names in (("single", NAMED), ("foreign", FOREIGN)):
        for name in names if kind in sets else ():
            for factor in FACTORS[:1] if name in _WHOLE else FACTORS:
                for k in range(each):
                    add(kind, f"{name}-x{factor:g}-{k:02d}", ((name, factor),))
    if "pair" in sets:
        pairs = list(_pairs(motion, edition))
        for k in range(max(1, round(runs / 5))):
            first, second = pairs[k % len(pairs)]
            add("pair", f"{first}+{second}-{k:03d}", ((first, 1.0), (second, 1.0)))
    if "withheld" in sets:
        hidden = [n for n in NAMED if set(EFFECTS[n].needs) - {"acceleration"}]
        for k in range(max(1, round(runs / 3))):
            name = hidden[k % len(hidden)]
            channels = tuple(c for need in EFFECTS[name].needs for c in (need, *_ALSO_IN.get(need, ())))
            add("withheld", f"{name}-{k:03d}", ((name, 1.0),), channels)
    return result


def real_scenarios(recordings: Sequence[str], each: int = 2, edition: int = 0) -> list[Scenario]:
    """Every effect that a real recording can take, `each` times, and the recordings as they are, whole and in cuts."""
    result = []
    for recording in recordings:
        for name in ("", *_INJECTED):
            for k in range(each if name else _LOOKS):
                label = f"real-{recording}-{name or 'as-it-is'}-{k:02d}"
                effects = ((name, 1.0),) if name else ()
                cut = not name and k > 0
                result.append(Scenario(label, "real", recording, seed_of(label, edition), effects, cut=cut))
    return result


def seed_of(name: str, edition: int) -> int:
    """A seed that nobody chose."""
    return int.from_bytes(hashlib.sha256(f"{edition}/{name}".encode()).digest()[:6], "big")


def fingerprint(scenario_list: Sequence[Scenario]) -> str:
    """sha256 of the list and of the published strengths, to say in a report which test it was."""
    sizes = {name: strength.size for name, strength in STRENGTHS.items()}
    text = json.dumps([sizes, *(asdict(s) for s in scenario_list)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def rivals(first: str, second: str) -> bool:
    """Whether the table of effects says that one is confused with the other."""
    return any(first in group and second in group for group in RIVALS)


def _pairs(motion: str, edition: int) -> Iterator[tuple[str, str]]:
    """Pairs that are no rivals, in an order of their own."""
    names = [n for n in NAMED if n not in (*_WHOLE, *INVISIBLE.get(motion, ()))]
    pairs = [(a, b) for a, b in combinations(names, 2) if not rivals(a, b)]
    yield from sorted(pairs, key=lambda pair: seed_of("+".join(pair), edition))
