"""Gyroscope errors beyond a constant bias."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.factors.effects.forms import RATE_MATRIX
from magyc_gtsam.gap.effects.iron import drifts, lagged, lagged_nearby, step_nearby, step_times, warming_nearby
from magyc_gtsam.gap.effects.term import (
    AXES,
    NEARBY,
    EffectTerm,
    at_time,
    behind,
    course,
    vector,
)
from magyc_gtsam.gap.model.twin import Twin

# rad/s, prior deviation of a change of the bias: that of data sheets' 0.03 to 0.16 °/s per kelvin over 20 K, 3 °/s.
# Without a limit a jump in the second in which BROAD 01 is picked up from a table was one of 0.6 rad/s.
_CHANGE = 0.05
_LEVELS = (1.0, 3.0, 10.0)  # rad/s, rates beyond which the growth of the scale may level off


def _levels(twin: Twin) -> list[dict[str, float]]:
    """Return no level, and the levels below the fastest turn of the recording."""
    fastest = float(np.abs(twin.gyroscope.need("rate")).max())
    return [{}, *({"level": level} for level in _LEVELS if level < fastest)]


def _levels_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    if not setting:
        return []
    near = (setting["level"] * share for share in NEARBY)
    return [{"level": level} for level in near if level >= _LEVELS[0]]  # a lower level is a constant scale error


def _say_scale(value: Array, sigma: Array, setting: Setting) -> str:
    return f"the gyroscope's scale is off by {vector(value[:3] / 10, sigma[:3] / 10)} % along x, y, z"


def _say_quadratic(value: Array, sigma: Array, setting: Setting) -> str:
    less = f", ever less beyond {setting['level']:.1f} rad/s" if setting else ""
    by = vector(value / 10, sigma / 10)
    return f"the gyroscope's scale grows with the rate, by {by} % per rad/s along x, y, z{less}"


def _say_temperature(value: Array, sigma: Array, setting: Setting) -> str:
    by, late = vector(value, sigma), behind(setting, "the thermometer")
    return f"the gyroscope's bias depends on temperature, by {by} mrad/s per unit of the channel{late}"


def _say_step(value: Array, sigma: Array, setting: Setting) -> str:
    return f"the gyroscope's bias jumped by {vector(value, sigma)} mrad/s {at_time(setting)}"


def _say_drift(value: Array, sigma: Array, setting: Setting) -> str:
    return course("the gyroscope's bias drifted", "mrad/s", value, sigma, setting)


def _say_g(value: Array, sigma: Array, setting: Setting) -> str:
    return f"the gyroscope's bias depends on acceleration: up to {np.abs(value).max():.2g} mrad/s per g"


SCALE = EffectTerm(
    name="gyro-scale",
    label="gyroscope scale and non-orthogonality",
    physics=(
        "The scale factor of a low-cost gyroscope is off by 1 to 3 %, and its axes are not orthogonal by up "
        "to 1°. The stated turn is too large or too small in proportion. A misalignment and a scale that "
        "depends on the rate resemble it where the vehicle turns about few axes."
    ),
    unit="‰",
    matters=4e-3,
    prior=0.02,
    # A wrong range or conversion is off by more than data sheets allow. At 0.08, five of twelve scales of 7 to 16 % put
    # into real logs (editions 390 to 392) were called a scale that depends on the rate.
    largest=0.4,
    rivals=("misalignment", "gyro-quadratic"),
    parameters=RATE_MATRIX,
    say=_say_scale,
    motion="turn about all three axes, by several full turns each, slowly and fast",
    settings=lambda twin: [dict.fromkeys(AXES, 1.0), {}],
)
QUADRATIC = EffectTerm(
    name="gyro-quadratic",
    label="gyroscope scale that depends on the rate",
    physics=(
        "The drive or the amplifier of a gyroscope is not linear: its scale grows or shrinks with the rate. "
        "Fast turns are then off by a larger share than slow ones. At one rate it cannot be distinguished "
        "from a scale error."
    ),
    unit="ms/rad",
    matters=0.02,
    prior=0.2,  # s/rad; a bad part has 0.15
    rivals=("gyro-scale",),
    say=_say_quadratic,
    motion="turn slowly and fast about each axis: the same turn at several rates",
    settings=_levels,
    refined=_levels_nearby,
)
TEMPERATURE = EffectTerm(
    name="temperature-gyro",
    label="gyroscope bias that depends on temperature",
    physics=(
        "The zero of a gyroscope depends on its temperature, by 0.005 to 0.05 °/s per kelvin. The bias "
        "follows the thermometer, late by minutes where the thermometer is elsewhere. A temperature that only "
        "rises looks like a drift of the bias."
    ),
    unit="mrad/s per unit",
    matters=1e-3,
    prior=_CHANGE,
    rivals=("temperature-hard-iron", "gyro-bias-step", "gyro-bias-drift"),
    say=_say_temperature,
    motion="let the temperature rise and fall during the recording",
    settings=lagged,
    refined=lagged_nearby,
    products=("rate",),
)
BIAS_STEP = EffectTerm(
    name="gyro-bias-step",
    label="jump of the gyroscope's bias",
    physics=(
        "A shock, a change of the supply or of the range, or a filter that starts anew moves the zero of a "
        "gyroscope. The bias is constant before and after. A bias that warms resembles it where the "
        "temperature jumps, too."
    ),
    unit="mrad/s",
    matters=1e-3,
    prior=_CHANGE,
    rivals=("temperature-gyro", "gyro-bias-drift"),
    say=_say_step,
    motion="rest for some seconds before and after the moment in question",
    settings=step_times,
    refined=step_nearby,
    products=("rate",),
)
BIAS_DRIFT = EffectTerm(
    name="gyro-bias-drift",
    label="slow drift of the gyroscope's bias",
    physics=(
        "The zero of a gyroscope wanders with its supply, its age and its warmth, over minutes. The bias of a "
        "whole recording is then a mean that holds nowhere exactly. Without a thermometer it includes what "
        "follows the temperature."
    ),
    unit="mrad/s",
    matters=1e-3,
    prior=_CHANGE,
    rivals=("temperature-gyro", "gyro-bias-step"),
    say=_say_drift,
    motion="rest for some seconds now and then, and log the temperature",
    settings=drifts,
    refined=warming_nearby,
    products=("rate",),
)
G_SENSITIVITY = EffectTerm(
    name="g-sensitivity",
    label="g-sensitivity of the gyroscope",
    physics=(
        "The moving mass of a gyroscope is deflected by acceleration, too, which the sensor takes for a turn, "
        "by 0.01 to 0.4 °/s per g. The bias then depends on the attitude. In swells and on motions that pitch "
        "in step with the turn it resembles a delay."
    ),
    unit="mrad/s/g",
    matters=5e-3,
    rivals=("timing", "gyro-scale"),
    parameters=tuple(f"{a}{b}" for b in AXES for a in AXES),
    say=_say_g,
    motion="hold the vehicle in several attitudes, rolled and pitched by 45° or more, and turn in each",
)
