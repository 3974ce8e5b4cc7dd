"""Non-linear responses of the magnetometer: saturation, a cubic non-linearity, and hysteresis."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import Setting
from magyc_gtsam.gap.effects.alignment import directions, directions_nearby
from magyc_gtsam.gap.effects.term import AXES, EffectTerm, vector
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_KNEES = (0.05, 0.15)  # shares of the largest reading over which a core saturates
_NEAR = np.linspace(0.9, 1.1, 41)  # levels relative to the likeliest one, tried with each fine knee
_FINE_KNEES = (0.0, 0.025, 0.05, 0.075, 0.1, 0.125, 0.15)  # shares of the largest reading
_FOOT = 2.0  # knees below the level, where the loss is an eighth of the final one
_WIDTHS = (0.1, 0.33, 1.0)  # loop widths that are tried, relative to the widest


def _reading(twin: Twin) -> Array:
    signals = twin.windows
    return np.abs(signals.need("field") + signals.need("hard_iron")[:, None])


def _levels(twin: Twin) -> list[dict[str, float]]:
    largest = float(_reading(twin).max())
    shares = (0.6, 0.7, 0.78, 0.84, 0.89, 0.93, 0.96, 0.98)
    tried = [{"level": largest * share, "knee": largest * knee} for knee in (0.0, *_KNEES) for share in shares]
    return _read_beyond(tried, largest)


def _levels_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    largest = float(_reading(twin).max())
    tried = [{"level": setting["level"] * near, "knee": largest * knee} for near in _NEAR for knee in _FINE_KNEES]
    return _read_beyond(tried, largest)


def _read_beyond(tried: list[dict[str, float]], largest: float) -> list[dict[str, float]]:
    """Return the settings whose knee lies within the readings: the loss beyond them would be a guess."""
    return [each for each in tried if each["level"] + each["knee"] <= largest]


def _loops(twin: Twin) -> list[dict[str, float]]:
    """Return loops on each axis and along thirteen directions, with several widths."""
    widths = [_widest(twin) * share for share in _WIDTHS]
    return [where | {"width": width} for width in widths for where in ({}, *directions())]


def _widest(twin: Twin) -> float:
    """Return the largest width of a loop that closes, T: a wider one acts as a non-linear gain."""
    return RULES.widest_loop * float(np.ptp(twin.windows.need("field"), axis=1).max())


def _loops_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    widths = [min(setting["width"] * share, _widest(twin)) for share in (0.5, 0.7, 1.0, 1.4, 2.0)]
    where = [{}] if "x" not in setting else directions_nearby(setting)
    return [place | {"width": width} for width in widths for place in where]


def _least_loss(setting: Setting) -> float:
    """Return the smallest share of the reading beyond the level that saturation removes."""
    return RULES.bent_loss if setting.get("knee") else RULES.clipped_loss


def _say_saturation(value: Array, sigma: Array, setting: Setting) -> str:
    level, knee = setting["level"], setting.get("knee", 0.0)
    soft = knee >= _KNEES[0] * level  # a smaller knee is what noise makes of a sharp level
    how = "saturates softly from" if soft else "clips at"
    level -= _FOOT * knee if soft else 0.0
    return f"the magnetometer {how} about {level * 1e6:.0f} µT: raise its range, or move the magnet away"


def _say_cubic(value: Array, sigma: Array, setting: Setting) -> str:
    return f"the magnetometer is not linear: {vector(value, sigma)} µT off at a reading of 50 µT on x, y, z"


def _say_hysteresis(value: Array, sigma: Array, setting: Setting) -> str:
    by = vector(value, sigma)
    return f"iron near the magnetometer shows hysteresis of {by} µT on x, y, z"


SATURATION = EffectTerm(
    name="saturation",
    label="magnetometer saturation",
    unit="of what is beyond the level",
    scale=1.0,
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
    unit="µT at 50 µT",
    scale=1e6,
    matters=0.5e-6,
    prior=30e-6,
    rivals=("saturation", "misalignment", "gyro-scale"),
    parameters=AXES,
    say=_say_cubic,
    motion="turn over about two axes, so that each axis sees the whole field",
)
HYSTERESIS = EffectTerm(
    name="hysteresis",
    label="magnetic hysteresis of nearby iron",
    unit="µT",
    scale=1e6,
    matters=0.3e-6,
    prior=1e-3,
    rivals=("timing", "eddy-plane"),
    parameters=AXES,
    say=_say_hysteresis,
    motion="turn through the same headings slowly and fast, both ways",
    settings=_loops,
    refined=_loops_nearby,
    possible=lambda twin, value, setting: setting["width"] < RULES.no_loop * _widest(twin),
)
