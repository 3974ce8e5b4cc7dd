"""The scenarios of the blind test, determined only by set, motion, number and edition.

Strengths are in `simulation.effects.strengths`, seeds come from a hash, and nothing is drawn at run time, so that an
edition always gives the same recordings. Rules and thresholds are developed on edition 0 and judged on another.
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

# Groups of effects that are confused with each other by the table of effects; pairs of them do not test naming.
RIVALS = (
    {"hard-iron-step", "hard-iron-drift", "temperature-hard-iron", "local-anomaly", "motor-current"},
    {"temperature-hard-iron", "temperature-gain", "field-gradient", "gain-drift"},
    {"gain-drift", "hard-iron-drift", "local-anomaly"},
    {"motor-current", "current-squared", "load-soft-iron"},
    {"hard-iron-step", "soft-iron-step", "local-anomaly"},
    {"misalignment", "gyro-scale", "gyro-quadratic", "cubic", "saturation"},
    {
        "timing",
        "axis-delays",
        "clock-drift",
        "eddy-plane",
        "hysteresis",
        "sample-hold",
        "g-sensitivity",
        "field-gradient",
    },
    {"coloured-noise", "spikes", "tone", "quantisation", "sample-hold"},
    {"hard-iron-drift", "coloured-noise"},
    {"temperature-gyro", "g-sensitivity"},
    {"temperature-gyro", "gyro-bias-step", "gyro-bias-drift"},
)
# Effects that a motion cannot show at the published strength, by the table of one-sigma sizes.
INVISIBLE = {"moderate": ("g-sensitivity",)}
# Channels that are contained in others.
_ALSO_IN = {"depth": ("position",)}
# Discrete mounting errors: they have no fraction, and mask a second effect.
_WHOLE = ("axis-order",)
# Effects that can be injected into real recordings: they need no attitude and are not present already.
_INJECTED = tuple(n for n in NAMED if not EFFECTS[n].attitude and n != "sample-hold")
# Number of diagnoses of an unchanged real recording, all but the first on a cut of it, because a second more or less
# changes which of its small effects are significant.
_LOOKS = 5


@dataclass(frozen=True)
class Scenario:
    """One recording with its hidden effects.

    Attributes:
        id: unique within an edition.
        set: one of `SETS`.
        motion: motion of the simulator, or name of a real recording.
        seed: seed of motion, sensors, noise, surroundings and effects.
        effects: (name, factor on the published strength).
        withheld: channels that are left out.
        duration: duration of a simulated recording, s.
        cut: whether a real recording is cut a little at both ends.
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
        """The factor of the effects; 1 without effects."""
        return self.effects[0][1] if self.effects else 1.0

    @property
    def label(self) -> str:
        """The names of the hidden effects as text."""
        return " + ".join(self.names) or "nothing"

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the hidden effects."""
        return tuple(name for name, _ in self.effects)


def scenarios(
    motion: str,
    runs: int = 300,
    edition: int = 0,
    sets: Sequence[str] = SETS[:5],
    duration: float = 600.0,
) -> list[Scenario]:
    """Return all scenarios of a simulated motion.

    Args:
        motion: a motion of the simulator, such as those of `MOTIONS`.
        runs: number of recordings without effects; the other sets are in proportion (a thirtieth per effect and
            strength, a fifth of pairs, a third with withheld channels).
        edition: edition of the seeds.
        sets: the sets to include.
        duration: duration of a recording, s.
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
    """Return `each` scenarios per injected effect and real recording, and the recordings as they are, whole and cut."""
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
    """Return a seed from a hash of the name, so that it cannot be chosen."""
    return int.from_bytes(hashlib.sha256(f"{edition}/{name}".encode()).digest()[:6], "big")


def fingerprint(scenario_list: Sequence[Scenario]) -> str:
    """Return the sha256 of the list and the published strengths, which identifies a test in a report."""
    sizes = {name: strength.size for name, strength in STRENGTHS.items()}
    text = json.dumps([sizes, *(asdict(s) for s in scenario_list)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def rivals(first: str, second: str) -> bool:
    """Return whether one effect is confused with the other by the table of effects."""
    return any(first in group and second in group for group in RIVALS)


def _pairs(motion: str, edition: int) -> Iterator[tuple[str, str]]:
    """Yield the pairs of effects that are not rivals, in a hashed order."""
    names = [n for n in NAMED if n not in (*_WHOLE, *INVISIBLE.get(motion, ()))]
    pairs = [(a, b) for a, b in combinations(names, 2) if not rivals(a, b)]
    yield from sorted(pairs, key=lambda pair: seed_of("+".join(pair), edition))
