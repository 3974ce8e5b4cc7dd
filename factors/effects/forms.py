"""The extra effects of the gap workflow: the contribution of each to a sensor's reading.

A form is linear in its value, reading = base model + Σ value_k · column_k, except for a rotation of axes, delays of
single axes and a delay that grows. The columns are a function of the available signals (time, field, rate, other
channels) and of a setting that was searched over (the time of a step, the frequency of a tone). The same forms serve
the evidence, the joint refit, the GTSAM factor (`effect_chain_factor`) and `Calibration.apply`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array, cross, exponential_matrices
from magyc_gtsam.factors.effects import changes
from magyc_gtsam.factors.effects.changes import Setting, per_axis
from magyc_gtsam.factors.effects.signals import STANDARD_GRAVITY, Signals
from magyc_gtsam.factors.effects.turning import Grows, line
from magyc_gtsam.factors.errors import MagycError

_COERCIVE = (np.arange(8) + 0.5) / 8  # coercive fields of the pieces of a hysteresis, relative to the largest
RATE_MATRIX = ("x", "y", "z", "xy", "xz", "yz")  # elements of a symmetric matrix that multiplies the rate


class Form(NamedTuple):
    """An effect on a reading: the sensor, the signals that it needs, and its columns (k, 3, n) per unit of the
    value.
    """

    side: str  # "magnetometer" or "gyroscope"
    needs: tuple[str, ...]
    columns: Callable[[Signals, Setting], Array]
    rotates: bool = False  # the value is a rotation vector that is applied to the rate exactly, not to first order
    # The contribution (3, n) of a value and its derivatives (k, 3, n), of a form that is not linear in its value.
    exact: Callable[[Signals, Array, Setting], tuple[Array, Array]] | None = None
    remembers: bool = False  # its columns at one sample depend on other samples, too

    def evaluate(self, signals: Signals, value: Array, setting: Setting) -> Array:
        """Return the effect's contribution (3, n) to the reading, in T or rad/s."""
        if self.rotates:
            turn = exponential_matrices(np.asarray(value, dtype=float)[:, None])[:, :, 0]
            return (turn - np.eye(3)) @ signals.need("rate")
        columns = self.columns(signals, setting)
        if len(columns) != len(value):
            raise MagycError(
                f"{' and '.join(self.needs)}: an effect of {len(value)} values meets data for {len(columns)}; the "
                "recording must have the same channels as the one that was calibrated"
            )
        if self.exact is not None:
            return self.exact(signals, np.asarray(value, dtype=float), setting)[0]
        result: Array = np.tensordot(np.asarray(value, dtype=float), columns, axes=1)
        return result

    def derivatives(self, signals: Signals, value: Array, setting: Setting) -> Array:
        """Return the derivatives (k, 3, n) of the contribution with respect to the value."""
        return self.columns(signals, setting) if self.exact is None else self.exact(signals, value, setting)[1]


def _misalignment(s: Signals, setting: Setting) -> Array:
    rate = s.need("rate")
    return np.stack([cross(axis[:, None], rate) for axis in np.eye(3)])


def _timing(s: Signals, setting: Setting) -> Array:
    return -s.need("field_rate")[None]


def _axis_delays(s: Signals, setting: Setting) -> Array:
    return -np.eye(3)[:, :, None] * s.need("field_rate")


def _earlier_axes(s: Signals, delay: Array, setting: Setting) -> tuple[Array, Array]:
    """Return what delays (3,) of the axes add to the reading (3, n), and its derivatives (3, 3, n)."""
    field = s.need("field")
    added, slope = np.zeros_like(field), np.zeros((3, *field.shape))
    for axis, late in enumerate(delay):
        reading, change = _earlier(s, float(late))
        added[axis], slope[axis, axis] = reading[axis] - field[axis], change[axis]
    return added, slope


def _earlier(s: Signals, delay: float, grows: Grows = None) -> tuple[Array, Array]:
    """Return the field (3, n) as read at the attitude of `delay` s ago, and its derivative (3, n) by the delay."""
    soft = s.need("soft_iron")
    turn, rate = s.turns.within(delay, grows)
    then = np.einsum("ijn,jn->in", exponential_matrices(turn), np.linalg.solve(soft, s.need("field")))
    return soft @ then, soft @ cross(rate, then)


def _clock_drift(s: Signals, setting: Setting) -> Array:
    return -(s.need("field_rate") * line(s.need("time"), setting["start"], setting["end"]))[None]


def _by_another_clock(s: Signals, delay: Array, setting: Setting) -> tuple[Array, Array]:
    """Return what a delay that grows by a value (1,) adds to the reading (3, n), and its derivative (1, 3, n)."""
    ends = setting["start"], setting["end"]
    reading, change = _earlier(s, float(delay[0]), ends)
    return reading - s.need("field"), (change * line(s.need("time"), *ends))[None]


def _eddy_plane(s: Signals, setting: Setting) -> Array:
    """Return the columns of eddy currents E = value normalᵀ.

    A change of the field across a plate drives currents, whose own field may point in another direction. They decay
    within `lag` s, where the setting has one; without, they follow the change at once. The setting `uneven`, for
    several plates or a bent one, admits any E of trace zero, which contains no delay (8 values, column by column,
    without the last of the diagonal).
    """
    change = s.need("field_rate")
    if setting.get("lag"):
        change = changes.lagged(s.need("time"), change, setting["lag"])
    if setting.get("uneven"):
        columns = -per_axis(change)
        columns[[0, 4]] -= columns[8]
        return columns[:8]
    normal = np.array([setting["x"], setting["y"], setting["z"]])
    return -np.eye(3)[:, :, None] * (normal @ change)


def _gyro_scale(s: Signals, setting: Setting) -> Array:
    """Return the columns of the six symmetric matrices, or of those elements of `RATE_MATRIX` that the setting
    names.
    """
    x, y, z = s.need("rate")
    zero = np.zeros_like(x)
    columns = np.array(
        [(x, zero, zero), (zero, y, zero), (zero, zero, z), (y, x, zero), (z, zero, x), (zero, z, y)]
    )
    named = [element in setting for element in RATE_MATRIX]
    return columns[named] if any(named) else columns


def _gyro_quadratic(s: Signals, setting: Setting) -> Array:
    """Return the columns per axis; above `level` rad/s, where the setting has one, the scale saturates as in a real
    sensor.
    """
    rate = s.need("rate")
    grown = np.abs(rate)
    if "level" in setting:
        grown = -setting["level"] * np.expm1(-grown / setting["level"])
    return np.eye(3)[:, :, None] * (rate * grown)


def _g_sensitivity(s: Signals, setting: Setting) -> Array:
    return per_axis(s.need("acceleration") / STANDARD_GRAVITY)


def _field_gradient(s: Signals, setting: Setting) -> Array:
    """Return the columns of those rows of the channel that have references in the setting; without any, of all rows."""
    columns: Array = changes.beyond_reference(s.need("position"), setting)[:, None] * s.need("field")
    return columns


def _local_anomaly(s: Signals, setting: Setting) -> Array:
    """Return the columns of an anomaly fixed in the world: from `time` to `until` (`changes.during`), or with a
    Gaussian profile of `width` s around `time`.

    The setting `passing` adds the derivative of the profile, as for a dipole that is passed.
    """
    axes = s.world_axes
    if "width" not in setting:
        return axes * changes.during(s, setting)
    since = (s.need("time") - setting["time"]) / setting["width"]
    bump = np.exp(-0.5 * since**2)
    if setting.get("passing"):
        return np.concatenate([axes * bump, axes * (bump * since)])
    return axes * bump


def _saturation(s: Signals, setting: Setting) -> Array:
    """Return the column of the excess over `level` T, from which on the slope falls linearly over `fall` T, if set.

    Cores saturate within a finite field: hyperbolic tangent, Langevin's function and others from a level on differ
    from this by 0.004 % to 0.06 % of the lost power, most of them two to five times less than from a logistic slope.
    """
    reading = s.path + s.need("hard_iron")[:, None, None]
    level, knee = setting["level"], setting.get("fall", 0.0)

    def beyond(value: Array) -> Array:
        over = np.maximum(value - level, 0.0)
        result: Array = np.where(over < knee, 0.5 * over**2 / knee, over - 0.5 * knee) if knee > 0 else over
        return result

    return (beyond(-reading) - beyond(reading)).mean(axis=-1)[None]


def _cubic(s: Signals, setting: Setting) -> Array:
    """Return the columns per axis, of the reading in units of 50 µT, so that the value is the effect in T at 50 µT."""
    reading = (s.path + s.need("hard_iron")[:, None, None]) / 50e-6
    return np.eye(3)[:, :, None] * (reading**3).mean(axis=-1)


def _hysteresis(s: Signals, setting: Setting) -> Array:
    """Return the columns of loops by Rayleigh's law for weak fields, in units of the largest coercive field, T.

    A piece of iron with a coercive field r adds the change of the field along it until that is ±r, and then ±r (the
    stop operator of Prandtl and Ishlinskii). Equally many pieces of each r up to the largest have loops of two
    parabolas, the smaller ones inside the larger ones. The field acts along (x, y, z), while the loop's own field may
    have another direction; without a direction, each axis has its own loop.
    """
    path = s.path
    along = np.eye(3) if "x" not in setting else np.array([[setting["x"], setting["y"], setting["z"]]])
    y = along @ path.reshape(3, -1) / setting["coercive"]
    loop = _stopped(y, _COERCIVE)
    return np.eye(3)[:, :, None] * loop.reshape(len(loop), *path.shape[1:]).mean(axis=-1)


def _stopped(y: Array, limits: Array) -> Array:
    """Return the mean over limits r (l,) of sₙ = clip(sₙ₋₁ + yₙ − yₙ₋₁, −r, r), s₀ = 0, for signals y (k, n)."""
    if compiled.loops:
        result = np.empty(y.shape)
        compiled.loops.stop(y.shape[1], compiled.given(y), limits, result)
        return result
    return np.stack([_stopped_by_stretches(row, limits) for row in y])


def _stopped_by_stretches(y: Array, limits: Array) -> Array:
    """Return the same of one signal (n,).

    Where y turns back, s follows from where it turned back before. Each stretch is a function s → clip(s + a, low,
    high), and so is a sequence of stretches: those from the first sample are composed by doubling.
    """
    turns = np.append(0, np.flatnonzero(np.diff(np.sign(np.diff(y)))) + 1)
    change = np.diff(y[turns], prepend=y[0])
    high = np.repeat(limits[:, None], len(turns), axis=1)
    low, shift = -high, 1
    while shift < len(turns):
        later, least, most = change[shift:], low[:, shift:].copy(), high[:, shift:].copy()
        low[:, shift:] = np.minimum(np.maximum(low[:, :-shift] + later, least), most)
        high[:, shift:] = np.minimum(np.maximum(high[:, :-shift] + later, least), most)
        change[shift:] = later + change[:-shift]
        shift *= 2
    state = np.minimum(np.maximum(change, low), high)
    last = np.repeat(np.arange(len(turns)), np.diff(turns, append=len(y)))
    since, mean = y - y[turns][last], np.zeros(len(y))
    for each, limit in zip(state, limits, strict=True):
        mean += np.minimum(np.maximum(each[last] + since, -limit), limit)
    return mean / len(limits)


def _tone(s: Signals, setting: Setting) -> Array:
    phase = 2 * np.pi * setting["frequency"] * s.need("time")
    return per_axis(np.stack([np.cos(phase), np.sin(phase)]))


# Settings of earlier forms, in which the same values meant something else.
EARLIER = MappingProxyType({"saturation": "knee", "hysteresis": "width"})
FORMS: Mapping[str, Form] = MappingProxyType(
    {
        "motor-current": Form("magnetometer", ("current",), changes.motor_current),
        "temperature-hard-iron": Form("magnetometer", ("time", "temperature"), changes.temperature),
        "temperature-gain": Form(
            "magnetometer", ("time", "temperature", "field", "hard_iron"), changes.temperature_gain
        ),
        "gain-drift": Form("magnetometer", ("time", "field", "hard_iron"), changes.gain_drift),
        "current-squared": Form("magnetometer", ("time", "current"), changes.current_squared),
        "load-soft-iron": Form("magnetometer", ("current", "field"), changes.load_soft_iron),
        "soft-iron-step": Form("magnetometer", ("time", "field"), changes.soft_iron_step),
        "hard-iron-step": Form("magnetometer", ("time",), changes.step),
        "hard-iron-drift": Form("magnetometer", ("time",), changes.drift),
        "misalignment": Form("gyroscope", ("rate",), _misalignment, rotates=True),
        "timing": Form("magnetometer", ("field_rate",), _timing),
        "axis-delays": Form(
            "magnetometer", ("time", "rate", "field_rate"), _axis_delays, exact=_earlier_axes, remembers=True
        ),
        "clock-drift": Form(
            "magnetometer", ("time", "rate", "field_rate"), _clock_drift, exact=_by_another_clock, remembers=True
        ),
        "eddy-plane": Form("magnetometer", ("field_rate",), _eddy_plane),
        "gyro-scale": Form("gyroscope", ("rate",), _gyro_scale),
        "gyro-quadratic": Form("gyroscope", ("rate",), _gyro_quadratic),
        "temperature-gyro": Form("gyroscope", ("time", "temperature"), changes.temperature),
        "gyro-bias-step": Form("gyroscope", ("time",), changes.step),
        "gyro-bias-drift": Form("gyroscope", ("time",), changes.drift),
        "g-sensitivity": Form("gyroscope", ("acceleration",), _g_sensitivity),
        "field-gradient": Form("magnetometer", ("position", "field"), _field_gradient),
        "local-anomaly": Form("magnetometer", ("time", "to_sensor"), _local_anomaly, remembers=True),
        "saturation": Form("magnetometer", ("field", "hard_iron"), _saturation),
        "cubic": Form("magnetometer", ("field", "hard_iron"), _cubic),
        "hysteresis": Form("magnetometer", ("field",), _hysteresis, remembers=True),
        "tone": Form("magnetometer", ("time",), _tone),
    }
)
