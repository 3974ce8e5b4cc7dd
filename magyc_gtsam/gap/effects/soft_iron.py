"""Gain and soft iron that change: with temperature, with time, with a current, or in a step."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import ENTRIES
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.gap.effects.iron import (
    circuits,
    drifts,
    lagged,
    lagged_nearby,
    step_nearby,
    step_times,
    warming_nearby,
)
from magyc_gtsam.gap.effects.term import EffectTerm, at_time, behind, course, vector


def _say_gain(value: Array, sigma: Array, setting: Setting) -> str:
    late = behind(setting, "the thermometer")
    return f"the magnetometer's gain depends on temperature, by {vector(value, sigma)} % per unit of it{late}"


def _say_drift(value: Array, sigma: Array, setting: Setting) -> str:
    return course("the magnetometer's gain drifted", "%", value, sigma, setting)


def _say_load(value: Array, sigma: Array, setting: Setting) -> str:
    return f"a load changes the soft iron by up to {np.abs(value).max():.2g} % per unit of the current channel"


def _say_step(value: Array, sigma: Array, setting: Setting) -> str:
    by, when = np.abs(value).max(), at_time(setting)
    return f"the soft iron changed by up to {by:.2g} % {when}: steel was added, moved or removed"


TEMPERATURE_GAIN = EffectTerm(
    name="temperature-gain",
    label="magnetometer gain that depends on temperature",
    physics=(
        "The sensitivity of a coil, a core or a bridge depends on its temperature, by 0.02 to 0.3 % per "
        "kelvin without compensation. It multiplies all that the sensor reads, including the field of the "
        "hard iron. Where the hard iron is large, one that depends on temperature looks the same."
    ),
    unit="% per unit",
    matters=6e-3,
    rivals=("temperature-hard-iron", "gain-drift"),
    say=_say_gain,
    motion="let the temperature rise and fall during the recording, while turning over",
    settings=lagged,
    refined=lagged_nearby,
)
GAIN_DRIFT = EffectTerm(
    name="gain-drift",
    label="slow drift of the magnetometer's gain",
    physics=(
        "The sensitivity of a magnetometer changes while it warms up, and with its supply, by a percent in some "
        "minutes. It multiplies all that the sensor reads, including the field of the hard iron. Without a "
        "thermometer it includes what follows the temperature, and a field of the place that grows looks the same."
    ),
    unit="%",
    matters=6e-3,
    prior=0.05,
    rivals=("temperature-gain", "hard-iron-drift"),
    say=_say_drift,
    motion="let the instrument warm up before, or log its temperature, and turn over now and then",
    settings=drifts,
    refined=warming_nearby,
)
LOAD = EffectTerm(
    name="load-soft-iron",
    label="soft iron that depends on a current",
    physics=(
        "The current through a winding on an iron core moves the core along its magnetisation curve. The "
        "core's permeability changes, and with it the field that it concentrates near the sensor. On one "
        "heading this looks like the current's own field."
    ),
    unit="% per unit",
    matters=6e-3,
    rivals=("motor-current", "current-squared"),
    parameters=ENTRIES,
    say=_say_load,
    motion="run the load at several powers on every heading",
    settings=circuits,
)
STEP = EffectTerm(
    name="soft-iron-step",
    label="jump of the soft iron",
    physics=(
        "A piece of steel without remanence concentrates the field and adds what depends on heading. Where it "
        "is brought near, moved or taken off, the soft iron changes at once. On few headings this looks like "
        "a jump of the hard iron."
    ),
    unit="%",
    matters=6e-3,
    prior=0.05,  # a jump of 20 % and more is that of a field of the place
    rivals=("hard-iron-step",),
    parameters=ENTRIES,
    say=_say_step,
    motion="turn a full circle before and after the moment in question, at the same place",
    settings=step_times,
    refined=step_nearby,
)
