"""Non-linear responses of the magnetometer: saturation, a cubic non-linearity, and hysteresis."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.gap.effects.alignment import directions, directions_nearby
from magyc_gtsam.gap.effects.term import NEARBY, EffectTerm, vector
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_KNEES = (0.0, 0.5, 1.0)  # widths over which a core saturates, relative to what is read beyond the level
_NEAR = np.linspace(0.9, 1.1, 41)  # levels relative to the likeliest one, tried with each fine knee
_FINE_KNEES = (0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
_SOFT = 0.1  # knee relative to the level; a smaller one is what noise makes of a sharp level
_COERCIVE = (0.05, 0.15, 0.5)  # largest coercive fields that are tried, relative to the span of the field


def _reading(twin: Twin) -> Array:
    signals = twin.windows
    return np.abs(signals.need("field") + signals.need("hard_iron")[:, None])


def _levels(twin: Twin) -> list[dict[str, float]]:
    shares = (0.6, 0.7, 0.78, 0.84, 0.89, 0.93, 0.96, 0.98)
    largest = float(_reading(twin).max())
    return _with_knees([largest * share for share in shares], _KNEES, largest)


def _levels_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    return _with_knees(setting["level"] * _NEAR, _FINE_KNEES, float(_reading(twin).max()))


def _with_knees(levels: Iterable[float], knees: Iterable[float], largest: float) -> list[dict[str, float]]:
    """Return the settings. A knee ends within the readings: the loss beyond them would be a guess."""
    return [
        {"level": float(level), "fall": float((largest - level) * knee)}
        for level, knee in product(levels, knees)
        if level < largest
    ]


def _loops(twin: Twin) -> list[dict[str, float]]:
    """Return loops on each axis and along thirteen directions, with several coercive fields."""
    widths = [_span(twin) * share for share in _COERCIVE]
    return [where | {"coercive": width} for width in widths for where in ({}, *directions())]


def _span(twin: Twin) -> float:
    return float(np.ptp(twin.windows.need("field"), axis=1).max())


def _loops_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    largest = _COERCIVE[-1] * _span(twin)  # no iron with a larger one changes its direction
    widths = sorted({min(setting["coercive"] * share, largest) for share in NEARBY})
    where = [{}] if "x" not in setting else directions_nearby(setting)
    return [place | {"coercive": width} for width in widths for place in where]


def _least_loss(setting: Setting) -> float:
    """Return the smallest share of the reading beyond the level that saturation removes."""
    return RULES.bent_loss if setting.get("fall") else RULES.clipped_loss


def _say_saturation(value: Array, sigma: Array, setting: Setting) -> str:
    level, knee = setting["level"], setting.get("fall", 0.0)
    how = "saturates softly from" if knee >= _SOFT * level else "clips at"
    return f"the magnetometer {how} about {level * 1e6:.0f} µT: raise its range, or move the magnet away"


def _say_cubic(value: Array, sigma: Array, setting: Setting) -> str:
    return f"the magnetometer is not linear: {vector(value, sigma)} µT off at a reading of 50 µT on x, y, z"


def _say_hysteresis(value: Array, sigma: Array, setting: Setting) -> str:
    return f"iron near the magnetometer shows hysteresis of {vector(value, sigma)} µT on x, y, z"


SATURATION = EffectTerm(
    name="saturation",
    label="magnetometer saturation",
    physics=(
        "Beyond its full scale a sensor reads a constant, and a core saturates gradually before that. The "
        "largest readings of an axis, often with a large hard iron, are then too small. A cubic non-linearity "
        "also bends the largest readings, but the others as well."
    ),
    unit="of what is beyond the level",
    matters=0.3,
    prior=1.0,  # all of what is beyond the level
    rivals=("cubic",),
    parameters=("share",),
    say=_say_saturation,
    motion="turn over, so that each axis sees its largest field in both directions",
    settings=_levels,
    refined=_levels_nearby,
    possible=lambda twin, value, setting: bool(value[0] > _least_loss(setting)),
)
CUBIC = EffectTerm(
    name="cubic",
    label="non-linear magnetometer",
    physics=(
        "A core, a bridge or an amplifier is not quite linear, by 0.1 to 1 % of the full scale. Each axis "
        "reads too little or too much by the cube of what it measures. Where the axes see few values, errors "
        "of scale and angle resemble it."
    ),
    unit="µT at 50 µT",
    matters=0.5e-6,
    prior=30e-6,
    rivals=("saturation", "misalignment", "gyro-scale"),
    say=_say_cubic,
    motion="turn over about two axes, so that each axis sees the whole field",
)
HYSTERESIS = EffectTerm(
    name="hysteresis",
    label="magnetic hysteresis of nearby iron",
    physics=(
        "Unhardened steel keeps part of the magnetisation that the Earth's field gave it on the last heading. "
        "The reading therefore depends on the direction from which a heading was reached. It lags as a delay "
        "does, but by the same amount in slow turns and in fast ones."
    ),
    unit="µT",
    matters=0.3e-6,
    prior=1e-3,
    rivals=("timing", "eddy-plane"),
    say=_say_hysteresis,
    motion="turn through the same headings slowly and fast, both ways",
    settings=_loops,
    refined=_loops_nearby,
)
