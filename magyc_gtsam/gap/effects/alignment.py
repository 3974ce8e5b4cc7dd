"""Angle and delay between the two sensors, and eddy currents in nearby metal."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.gap.effects.iron import whole
from magyc_gtsam.gap.effects.term import AXES, EffectTerm, measured, vector
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_DECAYS = (0.1, 0.2, 0.4, 0.8)  # s, in which a plate's currents decay: from centimetres of aluminium on


def directions() -> list[dict[str, float]]:
    """Return thirteen directions: the axes, and the face and space diagonals of a cube."""
    grid = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 3)[14:]
    unit = grid / np.linalg.norm(grid, axis=1)[:, None]
    return [dict(zip(AXES, map(float, normal), strict=True)) for normal in unit]


def directions_nearby(setting: Setting) -> list[dict[str, float]]:
    """Return the direction of a setting, and directions on rings of 9° and 17° about it."""
    centre = np.array([setting[a] for a in AXES])
    first = np.cross(centre, np.eye(3)[np.argmin(np.abs(centre))])
    first /= np.linalg.norm(first)
    second = np.cross(centre, first)
    tilts = [(0.0, 0.0)] + [(t * np.cos(a), t * np.sin(a)) for t in (0.15, 0.3) for a in np.arange(8) * np.pi / 4]
    near = np.array([centre + a * first + b * second for a, b in tilts])
    near /= np.linalg.norm(near, axis=1)[:, None]
    return [dict(zip(AXES, map(float, normal), strict=True)) for normal in near]


def _plates(twin: Twin) -> list[dict[str, float]]:
    """Return single plates, and any matrix of eddy currents without the part that is a delay."""
    return [*directions(), {"uneven": 1.0}]


def _plates_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    """Return directions near that of a setting, each with currents that follow at once and with those that decay."""
    where = directions_nearby(setting) if "x" in setting else [dict(setting)]
    return [place | decay for place in where for decay in ({}, *({"lag": lag} for lag in _DECAYS))]


def _holds_back(twin: Twin, value: Array, setting: Setting) -> bool:
    """Return whether the values can be those of a plate, which delays the field: a lead is not a plate."""
    return "x" not in setting or float(np.array([setting[a] for a in AXES]) @ value) > 0


def _unequal(twin: Twin, value: Array, setting: Setting) -> bool:
    """Return whether the delays of the axes differ by more than one delay of all may deviate from its form."""
    return float(np.square(value - value.mean()).sum()) > RULES.unequal * float(np.square(value).sum())


def _say_misalignment(value: Array, sigma: Array, setting: Setting) -> str:
    angle = np.rad2deg(np.linalg.norm(value) * 1e-3)
    return f"the magnetometer is mounted {angle:.2f}° out of line with the gyroscope, about {vector(value, sigma)} mrad"


def _say_timing(value: Array, sigma: Array, setting: Setting) -> str:
    late = "lags" if value[0] >= 0 else "runs ahead of"
    return f"the magnetometer {late} the gyroscope by {measured(abs(value[0]), sigma[0])} ms"


def _say_axis_delays(value: Array, sigma: Array, setting: Setting) -> str:
    return f"the magnetometer's axes lag the gyroscope by {vector(value, sigma)} ms on x, y, z"


def _say_clock_drift(value: Array, sigma: Array, setting: Setting) -> str:
    gains = "gains" if value[0] >= 0 else "loses"
    share = 0.1 / (setting["end"] - setting["start"])  # % for each ms
    return (
        f"the magnetometer's clock {gains} {measured(share * abs(value[0]), share * sigma[0])} % on the gyroscope's: "
        f"its delay changes by {vector(value, sigma)[1:-1]} ms over the recording"
    )


def _say_eddy(value: Array, sigma: Array, setting: Setting) -> str:
    if "x" not in setting:
        most = f"{float(np.abs(value).max()):.2g} ms"
        return f"eddy currents in metal near the magnetometer delay the field by up to {most}{_decaying(setting)}"
    normal = [setting[a] for a in AXES]
    size = float(np.linalg.norm(value))
    return (
        f"eddy currents in a plate across {vector(normal)} delay the field by "
        f"{measured(size, float(np.linalg.norm(sigma)) / 3**0.5)} ms{_decaying(setting)}"
    )


def _decaying(setting: Setting) -> str:
    return f" and decay in about {setting['lag']:g} s" if setting.get("lag") else ""


MISALIGNMENT = EffectTerm(
    name="misalignment",
    label="misaligned magnetometer and gyroscope axes",
    physics=(
        "The chips of the two sensors, or the boards that they are on, are mounted at an angle of 0.3 to 3° "
        "to each other. The gyroscope then states the turn in other axes than the magnetometer. A motion "
        "about one axis cannot distinguish it from errors of the gyroscope's scale, a constant spin not from a delay."
    ),
    unit="mrad",
    matters=5e-3,
    rivals=("gyro-scale", "cubic"),
    say=_say_misalignment,
    motion="turn about all three axes: pitch and roll by 45° or more",
)
TIMING = EffectTerm(
    name="timing",
    label="magnetometer delay",
    physics=(
        "The magnetometer's reading is older than its stamp, because it is converted, filtered, and waits for "
        "the bus. The field that is read is that of an earlier attitude. Eddy currents in metal around the "
        "sensor, and hysteresis, lag in a similar way."
    ),
    unit="ms",
    matters=5e-3,
    rivals=("hysteresis", "g-sensitivity", "eddy-plane", "axis-delays"),
    parameters=("delay",),
    say=_say_timing,
    motion="turn fast one way and the other, about more than one axis",
    products=("speed", "speed²"),
)
AXIS_DELAYS = EffectTerm(
    name="axis-delays",
    label="unequal delays of the magnetometer's axes",
    physics=(
        "A sensor that converts its axes one after the other, or filters them unequally, reads each at "
        "another time. Each axis then shows the field of its own earlier attitude. Eddy currents in a bent "
        "plate lag in the same way, and delays that hardly differ are one delay."
    ),
    unit="ms",
    matters=5e-3,
    rivals=("timing", "eddy-plane", "hysteresis"),
    say=_say_axis_delays,
    motion="turn fast about all three axes, not about the vertical only",
    possible=_unequal,
    contains=("timing",),
)
CLOCK_DRIFT = EffectTerm(
    name="clock-drift",
    label="clocks of the two sensors that drift apart",
    physics=(
        "Two recorders, or a sensor that stamps its own samples, have clocks that differ by some parts in ten "
        "thousand. The delay between the sensors then grows over the recording, beside its mean, which is an "
        "effect of its own. Where the vehicle turns fast for a part of the log only, the two resemble each other."
    ),
    unit="ms",
    matters=5e-3,
    rivals=("timing", "axis-delays", "gyro-bias-drift"),
    parameters=("growth of the delay",),
    say=_say_clock_drift,
    motion="turn fast at the beginning and at the end of a longer recording",
    settings=lambda twin: [whole(twin)],
)
EDDY_PLANE = EffectTerm(
    name="eddy-plane",
    label="eddy currents in a plate",
    physics=(
        "A change of the field across a metal plate drives currents in it, whose own field opposes the "
        "change and decays, the more slowly the thicker the plate. The reading lags for one direction of the "
        "field, by milliseconds near a phone's frame, by 60 ms near a thick deck. A delay, which is the same for "
        "all directions, resembles it on motions about one axis."
    ),
    unit="ms",
    matters=8e-3,
    rivals=("timing", "hysteresis", "axis-delays"),
    say=_say_eddy,
    motion="turn fast about all three axes, not about the vertical only",
    settings=_plates,
    possible=_holds_back,
    contains=("axis-delays",),
    refined=_plates_nearby,
    products=("speed", "speed²"),
)
