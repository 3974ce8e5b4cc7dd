"""Hard iron that changes: with a current, with temperature, in a step, or slowly with time."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, islice

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.gap.effects.term import NEARBY, EffectTerm, at_time, behind, course, vector
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_STEPS = 100  # times at which a step of the hard iron is tried
_FEWER = 40  # of other steps: with more values, or of more samples
_LAGS = (0.0, 20.0, 60.0, 180.0)  # s, lags of the sensor's temperature behind the thermometer
_CIRCUIT_LAGS = (1.0, 3.0)  # s, of a field behind the current: housings, a filtered current
_WARMING = (0.1, 0.3)  # of the recording, time constants of what warms up
_ENDS = 16  # times at which a magnetic object may be attached or removed
_IN_WINDOW = 6  # times inside a window
_MARGIN = 4  # windows at both ends where a step cannot be distinguished from noise


def _moving(twin: Twin, kind: str) -> dict[int, Array]:
    """Return {index: row} of the rows of a channel that change."""
    return {i: row for i, row in enumerate(twin.windows.channels.get(kind, ())) if row.std() > 0}


def references(twin: Twin, kind: str) -> dict[str, float]:
    """Return the means of the rows that change as references, so that the hard iron is the one at the mean."""
    return {f"reference_{i}": float(row.mean()) for i, row in _moving(twin, kind).items()}


def circuits(twin: Twin) -> list[dict[str, float]]:
    """Return the setting of all currents that change. A channel that is never near 0, such as raw counts, is taken
    relative to its mean."""
    moving = _moving(twin, "current")
    offset = {
        i: float(row.mean()) for i, row in moving.items() if abs(row.mean()) > RULES.far_from_zero * row.std()
    }
    if not offset and len(moving) == len(twin.windows.channels["current"]):
        return [{}]
    return [{f"reference_{i}": offset.get(i, 0.0) for i in moving}]


def lagging_circuits(twin: Twin) -> list[dict[str, float]]:
    """Return the setting of all currents that change, without and with a lag."""
    return [at | lag for at in circuits(twin) for lag in ({}, *({"lag": lag} for lag in _CIRCUIT_LAGS))]


def _circuits_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    """Return lags between those of `lagging_circuits`, and up to an octave beyond."""
    shortest, longest = NEARBY[0] * _CIRCUIT_LAGS[0], NEARBY[-1] * _CIRCUIT_LAGS[-1]
    lags = [setting["lag"] * share for share in (NEARBY if "lag" in setting else ())]
    return [dict(setting) | {"lag": lag} for lag in lags if shortest <= lag <= longest]


def lagged(twin: Twin) -> list[dict[str, float]]:
    """Return the settings without and with a lag behind the thermometer."""
    return [references(twin, "temperature") | {"lag": lag} for lag in _LAGS if lag < 0.5 * twin.duration]


def lagged_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    """Return lags between and beyond those of `lagged`, up to the length of the recording."""
    lags = (max(setting["lag"], 10.0) * share for share in (0.0, *NEARBY))
    return [dict(setting) | {"lag": lag} for lag in lags if lag < twin.duration]


def edges_of(twin: Twin, count: int, margin: int = _MARGIN) -> Array:
    """Return up to `count` times between windows, none within `margin` windows of either end."""
    edges = 0.5 * (twin.time[1:] + twin.time[:-1])[margin : len(twin.time) - 1 - margin]
    return edges[np.unique(np.linspace(0, len(edges) - 1, min(count, len(edges))).astype(int))]


def step_times(twin: Twin, count: int = _FEWER) -> list[dict[str, float]]:
    """Return single steps at up to `count` times."""
    return [{"time": float(t)} for t in edges_of(twin, count)]


def _jumps(twin: Twin) -> list[dict[str, float]]:
    """Return single steps, and pairs of opposite steps of an object that is attached and removed again."""
    single = step_times(twin, _STEPS)
    coarse = edges_of(twin, _ENDS)
    shortest = 1.5 * (coarse[-1] - coarse[0]) / _ENDS  # an object that stays for less was passed, not attached
    return single + [{"time": float(a), "until": float(b)} for a, b in combinations(coarse, 2) if b - a > shortest]


def _jumps_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    """Return jumps near the found one; of two, each alone as well: its time may lie between those of single jumps."""
    if "until" not in setting:
        return step_nearby(twin, setting, _STEPS)
    alone = [{"time": setting[end]} for end in ("time", "until")]
    return [*step_nearby(twin, setting, _ENDS), *alone]


def step_nearby(
    twin: Twin, setting: Setting, count: int = _FEWER, margin: int = _MARGIN
) -> list[dict[str, float]]:
    """Return steps at every time near the found one, of `step_times`, and inside the windows beside it."""
    edges = edges_of(twin, twin.n, margin)
    width = 1.1 * (edges[-1] - edges[0]) / min(count, len(edges))
    inside = np.linspace(-1.0, 1.0, 2 * _IN_WINDOW + 1) * float(np.median(np.diff(edges)))
    result = [dict(setting)]
    for end in ("time", "until"):
        if end in setting:
            near = [*edges[np.abs(edges - setting[end]) <= width], *(setting[end] + inside)]
            result += [dict(setting) | {end: float(t)} for t in near]
    outside = _ends_first(setting)
    return [s for s in result if _ends_first(s) == outside]


def _ends_first(setting: Setting) -> bool:
    return setting.get("until", np.inf) <= setting.get("time", -np.inf)


def whole(twin: Twin) -> dict[str, float]:
    """Return the setting of what changes over the whole recording, s."""
    return {"start": float(twin.time[0]), "end": float(twin.time[-1])}


def irregular_drifts(twin: Twin) -> Iterator[dict[str, float]]:
    """Yield the settings of the slow part of a random walk, from few modes to as many as its shortest period allows."""
    order = RULES.drift_modes
    while order * RULES.drift_period <= 2 * twin.duration:
        yield {"order": float(order)} | whole(twin)
        order *= RULES.drift_finer


def drifts(twin: Twin) -> list[dict[str, float]]:
    """Return a straight line, courses of what warms up, and the slow part of a random walk in a few modes or more."""
    line = {"order": 0.0} | whole(twin)
    constants = (share * twin.duration for share in _WARMING)
    warming = [line | {"constant": each} for each in constants if 2 * each >= RULES.drift_period]
    return [line, *warming, *islice(irregular_drifts(twin), 2)]


def warming_nearby(twin: Twin, setting: Setting) -> list[dict[str, float]]:
    """Return time constants between and beyond those of `drifts`, and the longest of them beside a straight line.

    What is over at once is a change and no drift.
    """
    if "constant" in setting:
        constants = [setting["constant"] * share for share in NEARBY]
    elif setting["order"] == 0:
        constants = [_WARMING[-1] * (setting["end"] - setting["start"])]
    else:
        return []
    warming = [dict(setting) | {"constant": each} for each in constants if 2 * each >= RULES.drift_period]
    return warming if "constant" in setting or not warming else [dict(setting), *warming]


def _say_current(value: Array, sigma: Array, setting: Setting) -> str:
    strength, late = np.linalg.norm(value), behind(setting, "it", 1)
    return (
        f"a current adds {strength:.3g} µT per unit of the current channel, along {vector(value, sigma)} µT{late}"
    )


def _say_squared(value: Array, sigma: Array, setting: Setting) -> str:
    late = behind(setting, "it", 1)
    return f"the square of a current adds {vector(value, sigma)} µT per unit of the channel squared{late}"


def _say_temperature(value: Array, sigma: Array, setting: Setting) -> str:
    late = behind(setting, "the thermometer")
    return f"the hard iron depends on temperature, by {vector(value, sigma)} µT per unit of it{late}"


def _say_step(value: Array, sigma: Array, setting: Setting) -> str:
    by, when = vector(value, sigma), at_time(setting)
    return f"the hard iron jumped by {by} µT {when}: a magnetic object was moved or switched"


def _say_drift(value: Array, sigma: Array, setting: Setting) -> str:
    irregularly = " irregularly" if setting["order"] else ""
    return course(f"the hard iron drifted{irregularly}", "µT", value, sigma, setting)


MOTOR_CURRENT = EffectTerm(
    name="motor-current",
    label="magnetic field of a current",
    physics=(
        "A conductor is surrounded by a field in proportion to its current, by 2 µT at 10 cm from a single "
        "wire with 1 A. The field is fixed to the vehicle, so that it adds to the hard iron with the measured "
        "current. A load that is switched once looks like a jump."
    ),
    unit="µT per unit",
    matters=0.3e-6,
    prior=1e-3,
    rivals=("hard-iron-step", "hard-iron-drift", "current-squared", "load-soft-iron"),
    say=_say_current,
    motion="switch the load on and off several times at rest and under way, not in step with the turns",
    settings=lagging_circuits,
    refined=_circuits_nearby,
    products=("reading", "gain"),
)
SQUARED = EffectTerm(
    name="current-squared",
    label="magnetic field of a current's square",
    physics=(
        "A converter or a motor bridge chops the current: the channel shows its mean, while part of the field "
        "follows its power. The warmth of a winding and the bend of an iron core do so as well. A load at one "
        "power only does not show the difference to the current's own field."
    ),
    unit="µT per unit²",
    matters=0.3e-6,
    prior=1e-3,
    rivals=("motor-current", "load-soft-iron", "hard-iron-step"),
    say=_say_squared,
    motion="run the load at several powers, not in step with the turns",
    settings=lagging_circuits,
    refined=_circuits_nearby,
    power=2,
)
TEMPERATURE = EffectTerm(
    name="temperature-hard-iron",
    label="hard iron that depends on temperature",
    physics=(
        "Magnets lose 0.02 to 0.2 % of their field per kelvin, and the zero of a sensor depends on its "
        "temperature. The hard iron then follows the thermometer, late by minutes where the warm part is "
        "another one. A temperature that only rises looks like a drift."
    ),
    unit="µT per unit",
    matters=0.3e-6,
    prior=1e-3,
    rivals=("hard-iron-drift", "hard-iron-step", "temperature-gain"),
    say=_say_temperature,
    motion="let the temperature rise and fall during the recording, so that it does not merely follow time",
    settings=lagged,
    refined=lagged_nearby,
    products=("gain", "field"),
)
STEP = EffectTerm(
    name="hard-iron-step",
    label="jump of the hard iron",
    physics=(
        "A magnetic object near the sensor is moved, attached or taken off, or a load is switched. The hard "
        "iron is constant before and after. Where the vehicle turns little on both sides, a drift or a passed "
        "object explains as much."
    ),
    unit="µT",
    matters=0.3e-6,
    prior=1e-3,
    rivals=("hard-iron-drift", "temperature-hard-iron", "motor-current", "local-anomaly", "soft-iron-step"),
    say=_say_step,
    motion="turn a full circle before and after the moment in question, at the same place",
    settings=_jumps,
    refined=_jumps_nearby,
    most=4,
    products=("reading", "gain"),
)
DRIFT = EffectTerm(
    name="hard-iron-drift",
    label="slow drift of the hard iron",
    physics=(
        "Steel is magnetised slowly by the field of the Earth and by shocks, and batteries change their field "
        "as they are discharged. The hard iron moves along a line, or wanders over minutes. Without a "
        "thermometer it includes what follows the temperature."
    ),
    unit="µT",
    matters=0.3e-6,
    prior=1e-3,
    rivals=("temperature-hard-iron", "hard-iron-step"),
    say=_say_drift,
    motion="record longer, and log the temperature",
    settings=drifts,
    refined=warming_nearby,
    products=("reading", "gain"),
)
