"""The extra effects of the gap workflow: what each adds to a sensor's reading.

A form is linear in its value but for a rotation of axes: reading = base model + Σ value_k · column_k, with the
columns a function of the signals at hand (time, field, rate, other channels) and of a setting that was searched
over (the time of a step, the frequency of a tone). The same forms serve the score tests, the joint refit, the
GTSAM factor (`effect_chain_factor`) and `Calibration.apply`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_banded

from magyc_gtsam.factors.chain.rotations import Array, cross, exponential_matrices
from magyc_gtsam.factors.effects.signals import STANDARD_GRAVITY, Signals
from magyc_gtsam.factors.errors import MagycError

Setting = Mapping[str, float]
RATE_MATRIX = ("x", "y", "z", "xy", "xz", "yz")  # elements of a symmetric matrix on the rate


class Form(NamedTuple):
    """What an effect adds to a reading: the sensor, the signals it needs, and its columns (k, 3, n) per unit."""

    side: str  # "magnetometer" or "gyroscope"
    needs: tuple[str, ...]
    columns: Callable[[Signals, Setting], Array]
    rotates: bool = False  # the value is a rotation vector that turns the rate, to all orders

    def evaluate(self, signals: Signals, value: Array, setting: Setting) -> Array:
        """(3, n) what it adds, in T or rad/s."""
        if self.rotates:
            turn = exponential_matrices(np.asarray(value, dtype=float)[:, None])[:, :, 0]
            return (turn - np.eye(3)) @ signals.need("rate")
        columns = self.columns(signals, setting)
        if len(columns) != len(value):
            raise MagycError(
                f"{' and '.join(self.needs)}: an effect of {len(value)} values meets data for {len(columns)}; the "
                "recording must have the same channels as the one that was calibrated"
            )
        result: Array = np.tensordot(np.asarray(value, dtype=float), columns, axes=1)
        return result


def per_axis(profile: Array) -> Array:
    """Columns e_i · profile_j for profiles (p, n): (3p, 3, n)."""
    p, n = profile.shape
    result = np.zeros((p, 3, 3, n))
    for i in range(3):
        result[:, i, i] = profile
    return result.reshape(3 * p, 3, n)


def referenced(channel: Array, setting: Setting) -> list[int]:
    """The rows of a channel (k, n) that have a reference, the settings `reference_0`, …; all, if none has."""
    known = [int(name.removeprefix("reference_")) for name in setting if name.startswith("reference_")]
    return sorted(known) or list(range(len(channel)))


def _beyond_reference(channel: Array, setting: Setting) -> Array:
    """The referenced rows of a channel (k, n), less their references."""
    rows = referenced(channel, setting)
    if rows[-1] >= len(channel):
        raise MagycError(
            f"an effect of channel {rows[-1] + 1} of its kind meets data with {len(channel)}; the recording must have "
            "the same channels as the one that was calibrated"
        )
    result: Array = channel[rows] - np.array([[setting.get(f"reference_{i}", 0.0)] for i in rows])
    return result


def _motor_current(s: Signals, setting: Setting) -> Array:
    return per_axis(_beyond_reference(s.need("current"), setting))


def _temperature(s: Signals, setting: Setting) -> Array:
    """Of what lies `lag` s behind the thermometer, as a battery does: a first-order response."""
    warm = _beyond_reference(s.need("temperature"), setting)
    return per_axis(_lagged(s.need("time"), warm, setting.get("lag", 0.0)))


def _lagged(time: Array, rows: Array, lag: float) -> Array:
    """(k, n) rows through a first-order filter, in balance at the start."""
    if lag <= 0:
        return rows
    decay = np.exp(-np.diff(time) / lag)
    return _remembered(decay, np.column_stack([rows[:, :1], (1 - decay) * rows[:, 1:]]))


def _remembered(decay: Array, driven: Array) -> Array:
    """(k, n) yₙ = decayₙ yₙ₋₁ + drivenₙ, y₀ = driven₀, as a bidiagonal system; decay (n − 1,)."""
    band = np.array([np.ones(driven.shape[1]), np.append(-decay, 0.0)])
    result: Array = solve_banded((1, 0), band, driven.T).T
    return result


def _step(s: Signals, setting: Setting) -> Array:
    """From `time` on; to `until`, where what was attached is taken off again."""
    time = s.need("time")
    on = (time > setting["time"]) & (time <= setting.get("until", np.inf))
    return per_axis(on.astype(float)[None])


def _drift(s: Signals, setting: Setting) -> Array:
    """Cosines of half periods over [start, end] (the modes of a random walk), `order` of them; 0 is linear."""
    share = (s.need("time") - setting["start"]) / (setting["end"] - setting["start"])
    order = int(setting["order"])
    if order == 0:
        return per_axis(share[None] - 0.5)
    return per_axis(np.cos(np.pi * np.arange(1, order + 1)[:, None] * np.clip(share, 0.0, 1.0)))


def _misalignment(s: Signals, setting: Setting) -> Array:
    rate = s.need("rate")
    return np.stack([cross(axis[:, None], rate) for axis in np.eye(3)])


def _timing(s: Signals, setting: Setting) -> Array:
    return -s.need("field_rate")[None]


def _eddy_plane(s: Signals, setting: Setting) -> Array:
    """E = value normalᵀ: the change of the field across a plate drives currents, whose field may lie otherwise.

    `full` takes any E (9 values, column by column): several plates, or a bent one; `uneven` any of trace zero, which
    holds no delay (8 values, without the last of the diagonal).
    """
    if setting.get("full") or setting.get("uneven"):
        columns = -per_axis(s.need("field_rate"))
        if setting.get("full"):
            return columns
        columns[[0, 4]] -= columns[8]
        return columns[:8]
    normal = np.array([setting["x"], setting["y"], setting["z"]])
    return -np.eye(3)[:, :, None] * (normal @ s.need("field_rate"))


def _gyro_scale(s: Signals, setting: Setting) -> Array:
    """The six symmetric matrices, or those of `RATE_MATRIX` that the setting names."""
    x, y, z = s.need("rate")
    zero = np.zeros_like(x)
    columns = np.array(
        [(x, zero, zero), (zero, y, zero), (zero, zero, z), (y, x, zero), (z, zero, x), (zero, z, y)]
    )
    named = [element in setting for element in RATE_MATRIX]
    return columns[named] if any(named) else columns


def _gyro_quadratic(s: Signals, setting: Setting) -> Array:
    """Axis by axis; the scale grows ever less beyond `level` rad/s, where there is one, as that of any sensor must."""
    rate = s.need("rate")
    grown = np.abs(rate)
    if "level" in setting:
        grown = -setting["level"] * np.expm1(-grown / setting["level"])
    return np.eye(3)[:, :, None] * (rate * grown)


def _g_sensitivity(s: Signals, setting: Setting) -> Array:
    return per_axis(s.need("acceleration") / STANDARD_GRAVITY)


def _field_gradient(s: Signals, setting: Setting) -> Array:
    """Along the rows of the channel that the setting has references for; without any, along all."""
    columns: Array = _beyond_reference(s.need("position"), setting)[:, None] * s.need("field")
    return columns


def _local_anomaly(s: Signals, setting: Setting) -> Array:
    """A bump fixed in the world, Gaussian in time; `passing` adds its derivative, as of a dipole passed by."""
    since = (s.need("time") - setting["time"]) / setting["width"]
    bump = np.exp(-0.5 * since**2)
    axes = np.swapaxes(s.need("to_sensor"), 0, 1)  # column j of the rotation: world axis j in the sensor
    if setting.get("passing"):
        return np.concatenate([axes * bump, axes * (bump * since)])
    return axes * bump


def _saturation(s: Signals, setting: Setting) -> Array:
    """What is beyond the level, which may be reached with a knee of some width, as cores do."""
    reading = s.need("field") + s.need("hard_iron")[:, None]
    level, knee = setting["level"], setting.get("knee", 0.0)

    def beyond(value: Array) -> Array:
        over = value - level
        result: Array = knee * np.logaddexp(0.0, over / knee) if knee > 0 else np.maximum(over, 0.0)
        return result

    return (beyond(-reading) - beyond(reading))[None]


def _cubic(s: Signals, setting: Setting) -> Array:
    """Per axis, of the reading in units of 50 µT, so that the value is T at 50 µT."""
    reading = (s.need("field") + s.need("hard_iron")[:, None]) / 50e-6
    return np.eye(3)[:, :, None] * reading**3


def _hysteresis(s: Signals, setting: Setting) -> Array:
    """Duhem (Dahl) loop of width `width` T: dz/dy = 1 − sgn(ẏ) z, y in units of the width.

    y is the field along (x, y, z), its loop's field may lie otherwise; without a direction, each axis by itself.
    """
    field = s.need("field")
    if field.shape[1] < 2:
        raise MagycError("hysteresis: it depends on what came before, so it needs the whole recording")
    along = np.eye(3) if "x" not in setting else np.array([[setting["x"], setting["y"], setting["z"]]])
    y = along @ field / setting["width"]
    step = np.diff(y)
    decay, sign = np.exp(-np.abs(step)), np.sign(step)
    gain = np.column_stack([np.zeros(len(y)), sign * (1 - decay)])
    z = np.concatenate([_remembered(each, driven[None]) for each, driven in zip(decay, gain, strict=True)])
    return np.eye(3)[:, :, None] * z


def _tone(s: Signals, setting: Setting) -> Array:
    phase = 2 * np.pi * setting["frequency"] * s.need("time")
    return per_axis(np.stack([np.cos(phase), np.sin(phase)]))


FORMS: Mapping[str, Form] = MappingProxyType(
    {
        "motor-current": Form("magnetometer", ("current",), _motor_current),
        "temperature-hard-iron": Form("magnetometer", ("time", "temperature"), _temperature),
        "hard-iron-step": Form("magnetometer", ("time",), _step),
        "hard-iron-drift": Form("magnetometer", ("time",), _drift),
        "misalignment": Form("gyroscope", ("rate",), _misalignment, rotates=True),
        "timing": Form("magnetometer", ("field_rate",), _timing),
        "eddy-plane": Form("magnetometer", ("field_rate",), _eddy_plane),
        "gyro-scale": Form("gyroscope", ("rate",), _gyro_scale),
        "gyro-quadratic": Form("gyroscope", ("rate",), _gyro_quadratic),
        "temperature-gyro": Form("gyroscope", ("time", "temperature"), _temperature),
        "g-sensitivity": Form("gyroscope", ("acceleration",), _g_sensitivity),
        "field-gradient": Form("magnetometer", ("position", "field"), _field_gradient),
        "local-anomaly": Form("magnetometer", ("time", "to_sensor"), _local_anomaly),
        "saturation": Form("magnetometer", ("field", "hard_iron"), _saturation),
        "cubic": Form("magnetometer", ("field", "hard_iron"), _cubic),
        "hysteresis": Form("magnetometer", ("field",), _hysteresis),
        "tone": Form("magnetometer", ("time",), _tone),
    }
)
