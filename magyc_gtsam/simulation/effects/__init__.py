"""The simulated effects, by the part of the signal path at which they act, and their published strengths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from magyc_gtsam.factors.errors import MagycError
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
        raise MagycError(f"effects: a list of names is needed, got {effects!r}; give [{effects!r}]")
    result: list[RequestedEffect] = []
    for item in effects:
        name, factor = (item, 1.0) if isinstance(item, str) else (item[0], float(item[1]))
        if name not in EFFECTS:
            raise MagycError(f"effects: {name!r} is not one of {', '.join(EFFECTS)}")
        if name in (c.name for c in result):
            raise MagycError(f"effects: {name!r} is given twice; give it once with its factor")
        if not 0 < factor < float("inf"):
            raise MagycError(f"effects: factor of {name!r} must be finite and above 0, got factor {factor:g}")
        strength = STRENGTHS[name]
        result.append(RequestedEffect(name, EFFECTS[name], factor, factor * strength.size, strength.unit, seed))
    return result
