"""Generic families: effects without physical meaning that locate a misfit, and that a named effect must exceed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import per_axis
from magyc_gtsam.factors.effects.signals import STANDARD_GRAVITY, Signals
from magyc_gtsam.gap.model.columns import Columns
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

Profiles = Callable[[Signals], Array]
_KNOTS = (12, 40)  # numbers of knots of the linear splines in time


class Family(NamedTuple):
    """A generic family.

    Attributes:
        name: of the family.
        place: the variable that it depends on, in words.
        columns: function that returns its regressors.
        parts: numbers of columns to be tested separately. A few columns find an effect for which the whole family has
            too many parameters. A family that contains an effect of the catalogue has no parts, because these would be
            that effect under another name.
    """

    name: str
    place: str
    columns: Callable[[Twin], Columns]
    parts: tuple[int, ...] = ()


def families(twin: Twin) -> list[Family]:
    """Return all families that this recording allows."""
    result = []
    for knots in _KNOTS:
        if twin.duration < knots * RULES.knots_apart:
            continue
        hats = partial(_hats, knots=knots)
        result += [
            Family(f"time:sensor-{knots}", "time in the sensor's axes", _on_field(hats)),
            Family(f"time:world-{knots}", "time in the world's axes", partial(_in_world, knots=knots)),
            Family(f"time:gyroscope-{knots}", "time on the gyroscope", _on_rate(hats, False)),
        ]
    attitude = "the direction of the field (attitude)"
    result += [
        Family("field:quadratic", attitude, _on_field(lambda s: _powers(_unit(s), 2, 2)), (3, 1)),
        Family("field:cubic", attitude, _on_field(lambda s: _powers(_unit(s), 2, 3))),
        Family("rate:magnetometer", "the rate of turn on the magnetometer", _on_field(_rate_powers)),
        Family("rate:product", "the rate of turn on the magnetometer", _on_field(_rate_products), (3, 1)),
        Family("rate×field", "rate of turn times field", _on_field(_rate_times_field)),
        Family("lag", "a lag that depends on the rate of turn", _uneven_lag, (3, 1)),
        Family("rate:linear", "the rate of turn on the gyroscope", _on_rate(lambda s: s.need("rate"))),
        Family("rate:quadratic", "the rate of turn on the gyroscope", _on_rate(_bent_rate)),
        Family("rate:gyroscope", "products of rates of turn on the gyroscope", _on_rate(_rate_products), (3, 1)),
        Family(
            "field:gyroscope",
            "attitude on the gyroscope",
            _on_rate(lambda s: _powers(_unit(s), 1, 2), False),
            (3,),
        ),
    ]
    if twin.windows.acceleration is not None:
        result += [
            Family("tilt:magnetometer", "pitch and roll", _on_field(_tilts), (3, 1)),
            Family("tilt:gyroscope", "pitch and roll on the gyroscope", _on_rate(_tilts, False)),
            Family("tilt:products", "pitch and roll on the gyroscope", _on_rate(_tilt_products, False), (3, 1)),
        ]
    for kind in twin.windows.channels:
        where, channel = f"the channel {kind}", partial(_channel, kind=kind)
        result += [
            Family(f"{kind}:magnetometer", where, _on_field(channel)),
            Family(f"{kind}:gyroscope", f"{where} on the gyroscope", _on_rate(channel, False)),
        ]
        if kind != "position":  # position times field is the gradient of the field
            columns = partial(_channel_field, kind=kind)
            result.append(Family(f"{kind}×field", f"{where} times the field", columns, (1, 3)))
    return result


def _on_field(profiles: Profiles) -> Callable[[Twin], Columns]:
    return lambda twin: Columns(per_axis(profiles(twin.windows)), None)


def _on_rate(profiles: Profiles, reads_rate: bool = True) -> Callable[[Twin], Columns]:
    return lambda twin: twin.of_slow_profile(lambda signals: per_axis(profiles(signals)), reads_rate)


def _hats(signals: Signals, knots: int) -> Array:
    """Return linear splines in time (knots, n)."""
    time = signals.time
    place = (time - time[0]) / (time[-1] - time[0]) * (knots - 1)
    return np.maximum(1 - np.abs(place - np.arange(knots)[:, None]), 0.0)


def _in_world(twin: Twin, knots: int) -> Columns:
    """Return splines in the world frame without their mean, which is the field itself and only weakens the links."""
    hats = _hats(twin.windows, knots)
    hats -= hats.mean(axis=1)[:, None]
    return Columns((hats[1:, None, None] * twin.windows.world_axes).reshape(3 * knots - 3, 3, -1), None)


def _unit(signals: Signals) -> Array:
    field = signals.need("field")
    return field / np.sqrt((field**2).sum(axis=0).mean())


def _powers(vector: Array, least: int, most: int, bent: bool = False) -> Array:
    """Return the monomials of the components from degree `least` to `most`; `bent` adds x|x|."""
    terms = []
    if least <= 1:
        terms += list(vector)
    if least <= 2 <= most:
        terms += [vector[i] * vector[j] for i in range(3) for j in range(i, 3)]
    if most >= 3:
        terms += [vector[i] * vector[j] * vector[k] for i in range(3) for j in range(i, 3) for k in range(j, 3)]
    if bent:
        terms += list(vector * np.abs(vector))
    return np.array(terms)


def _rate_powers(signals: Signals) -> Array:
    return _powers(signals.need("rate"), 1, 2, bent=True)


def _rate_products(signals: Signals) -> Array:
    return _powers(signals.need("rate"), 2, 2)


def _bent_rate(signals: Signals) -> Array:
    """Return the monomials in units of the mean rate, so that their values are shares of it."""
    rate = signals.need("rate")
    mean = max(float(np.sqrt((rate**2).sum(axis=0).mean())), 1e-9)
    return mean * _rate_powers(replace(signals, rate=rate / mean))


def _rate_times_field(signals: Signals) -> Array:
    return np.einsum("in,jn->ijn", signals.need("rate"), _unit(signals)).reshape(9, -1)


def _uneven_lag(twin: Twin) -> Columns:
    """Return lags that grow and fall with the rate of turn; each per axis and common to the axes."""
    slope = twin.windows.need("field_rate")
    speed = np.linalg.norm(twin.windows.need("rate"), axis=0)
    speed = speed / max(float(np.sqrt((speed**2).mean())), 1e-9)
    profiles = [slope * speed, slope / np.sqrt(speed**2 + 0.05)]
    columns = [np.eye(3)[:, :, None] * profile for profile in profiles]
    return Columns(np.concatenate([*columns, np.stack(profiles)]), None)


def _tilts(signals: Signals) -> Array:
    """Return the tilt, its products, and its sign relative to the mean."""
    tilt = signals.need("acceleration") / STANDARD_GRAVITY
    lean = np.tanh(10 * (tilt - tilt.mean(axis=1)[:, None]))
    return np.concatenate([_powers(tilt, 1, 2), lean])


def _tilt_products(signals: Signals) -> Array:
    return _tilts(signals)[3:]  # without the tilt itself


def _channel(signals: Signals, kind: str) -> Array:
    value = _moving(signals, kind)
    return np.concatenate([value, value**2])


def _channel_field(twin: Twin, kind: str) -> Columns:
    """Return the columns of the field times the channel, then of each component of the field times the channel."""
    value, unit = _moving(twin.windows, kind), _unit(twin.windows)
    each = np.eye(3)[:, :, None] * unit
    return Columns(np.concatenate([value[:, None] * unit, *(each * row for row in value)]), None)


def _moving(signals: Signals, kind: str) -> Array:
    """Return the rows of a channel that are not constant, with zero mean and unit deviation."""
    value = signals.channels[kind]
    value = value[value.std(axis=1) > 0]
    result: Array = (value - value.mean(axis=1)[:, None]) / value.std(axis=1)[:, None]
    return result
