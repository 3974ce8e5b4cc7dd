"""The simulated effects, by the part of the signal path at which they act, and their published strengths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_positive
from magyc_gtsam.simulation.effects import electronics, field, foreign, gyroscope, iron, reading
from magyc_gtsam.simulation.effects.strengths import FOREIGN_STRENGTHS, NAMED_STRENGTHS, STRENGTHS, Strength
from magyc_gtsam.simulation.scene import RequestedEffect, SimulatedEffect

NAMED: tuple[str, ...] = tuple(NAMED_STRENGTHS)
FOREIGN: tuple[str, ...] = tuple(FOREIGN_STRENGTHS)
EFFECTS: dict[str, SimulatedEffect] = {
    **iron.EFFECTS,
    **field.EFFECTS,
    **electronics.EFFECTS,
    **reading.EFFECTS,
    **gyroscope.EFFECTS,
    **foreign.EFFECTS,
}

__all__ = ["EFFECTS", "FOREIGN", "NAMED", "STRENGTHS", "Strength", "chosen"]


def chosen(effects: Sequence[str | tuple[str, float]], seed: int) -> list[RequestedEffect]:
    """Return the requested effects with their sizes.

    Raises:
        MagycError: an unknown name, a name given twice, or a factor that is not positive.
    """
    if isinstance(effects, str) or not isinstance(effects, Iterable):
        better = f"give [{effects!r}]" if isinstance(effects, str) else "leave it out for none"
        raise MagycError(f"effects: a list of names is needed, got {effects!r:.60}; {better}")
    result: list[RequestedEffect] = []
    for item in effects:
        pair = isinstance(item, tuple | list) and len(item) == 2 and isinstance(item[0], str)
        if not isinstance(item, str) and not pair:
            raise MagycError(f"effects: must be names or pairs (name, factor), got {item!r:.60}")
        name, factor = (item, 1.0) if isinstance(item, str) else item
        if name not in EFFECTS:
            raise MagycError(f"effects: {name!r} is not one of {', '.join(EFFECTS)}")
        if name in (c.name for c in result):
            raise MagycError(f"effects: {name!r} is given twice; give it once with its factor")
        if not is_positive(factor):
            raise MagycError(
                f"effects: factor of {name!r} must be a number, finite and above 0, got factor {factor!r:.40}"
            )
        strength = STRENGTHS[name]
        result.append(
            RequestedEffect(name, EFFECTS[name], float(factor), factor * strength.size, strength.unit, seed)
        )
    return result
