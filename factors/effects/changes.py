"""Forms of effects that follow a channel, or that set in or change at a time.

Each returns the columns (k, 3, n) per unit of the effect's values from the signals and a setting (`forms`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sized

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.linalg import solve_banded

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.factors.effects.turning import line
from magyc_gtsam.factors.errors import MagycError

Setting = Mapping[str, float]
_INSTANT = 1e-9  # s, length of a window of one sample


def per_axis(profile: Array) -> Array:
    """Return the columns e_i · profile_j (3p, 3, n) of profiles (p, n)."""
    p, n = profile.shape
    result = np.zeros((p, 3, 3, n))
    for i in range(3):
        result[:, i, i] = profile
    return result.reshape(3 * p, 3, n)


def referenced(channel: Sized, setting: Setting) -> list[int]:
    """Return the rows of a channel (k, n) that have a reference (`reference_0`, … in the setting); all, if none has."""
    known = [int(name.removeprefix("reference_")) for name in setting if name.startswith("reference_")]
    return sorted(known) or list(range(len(channel)))


def beyond_reference(channel: Array, setting: Setting) -> Array:
    """Return the referenced rows of a channel (k, n), less their references."""
    rows = referenced(channel, setting)
    if rows[-1] >= len(channel):
        raise MagycError(
            f"an effect of channel {rows[-1] + 1} of its kind meets data with {len(channel)}; the recording must have "
            "the same channels as the one that was calibrated"
        )
    if (absent := ~np.isfinite(channel[rows]).any(axis=1)).any():
        raise MagycError(
            f"an effect of channel {rows[int(absent.argmax())] + 1} of its kind meets data in which that has no value; "
            "the recording must have the same channels as the one that was calibrated"
        )
    result: Array = channel[rows] - np.array([[setting.get(f"reference_{i}", 0.0)] for i in rows])
    return result


def motor_current(s: Signals, setting: Setting) -> Array:
    """Return the columns of a current, or of one that follows it by `lag` s."""
    current = beyond_reference(s.need("current"), setting)
    return per_axis(lagged(s.need("time"), current, setting["lag"]) if "lag" in setting else current)


def temperature(s: Signals, setting: Setting) -> Array:
    """Return the columns of a part that follows the thermometer by `lag` s, as a battery does: a first-order
    response.
    """
    warm = beyond_reference(s.need("temperature"), setting)
    return per_axis(lagged(s.need("time"), warm, setting.get("lag", 0.0)))


def lagged(time: Array, rows: Array, lag: float) -> Array:
    """Return (k, n) rows after a first-order filter that starts in equilibrium.

    Between two rows its input is their mean, so that the lag is the same on samples and on windows of a second.
    """
    if lag <= 0:
        return rows
    decay = np.exp(-np.diff(time) / lag)
    driven = 0.5 * (1 - decay) * (rows[:, 1:] + rows[:, :-1])
    return _remembered(decay, np.column_stack([rows[:, :1], driven]))


def _remembered(decay: Array, driven: Array) -> Array:
    """Return yₙ = decayₙ yₙ₋₁ + drivenₙ, y₀ = driven₀, (k, n), by a bidiagonal system; decay (n − 1,)."""
    band = np.array([np.ones(driven.shape[1]), np.append(-decay, 0.0)])
    result: Array = solve_banded((1, 0), band, driven.T).T
    return result


def step(s: Signals, setting: Setting) -> Array:
    """Return the columns of a step at `time`, which ends at `until` where the setting has one."""
    return per_axis(during(s, setting)[None])


def during(s: Signals, setting: Setting) -> Array:
    """Return the share (n,) of each row that is after `time` and before `until`, as far as the setting has them; that
    before `until` or after `time` if `until` is earlier.
    """
    time, until = setting.get("time", -np.inf), setting.get("until", np.inf)
    return _after(s, time) - _after(s, until) + (time > until)


def _after(s: Signals, at: float) -> Array:
    """Return 1 for rows after a time, 0 for those before, and the share after it of a window that contains it."""
    since = s.need("time") - at
    if s.span is None:
        return np.asarray(since > 0, dtype=float)
    share: Array = np.clip(since / np.maximum(s.span, _INSTANT) + 0.5, 0.0, 1.0)
    return share


def drift(s: Signals, setting: Setting) -> Array:
    """Return the columns of a drift over [start, end]: `order` cosines of half periods, the modes of a random walk.

    An order of 0 is a linear drift or, with a time `constant` in s, that of a part that warms up or cools down.
    """
    return per_axis(_course(s, setting))


def gain_drift(s: Signals, setting: Setting) -> Array:
    """Return the columns of a gain per axis on the whole reading, hard iron included, with the course of a `drift`."""
    return per_axis(_course(s, setting)) * _reading(s)


def _course(s: Signals, setting: Setting) -> Array:
    straight, order = line(s.need("time"), setting["start"], setting["end"]), int(setting["order"])
    share = np.clip(straight + 0.5, 0.0, 1.0)
    if order == 0:
        if "constant" not in setting:
            return straight[None]
        reach = (setting["end"] - setting["start"]) / setting["constant"]
        return np.asarray(np.expm1(-reach * share) / np.expm1(-reach) - 0.5)[None]
    cosine = np.cos(np.pi * share)
    return np.asarray(chebvander(cosine, order).T[1:])  # of order k: cos k φ


def temperature_gain(s: Signals, setting: Setting) -> Array:
    """Return the columns of a gain per axis on the whole reading, hard iron included, that follows the thermometer."""
    warm = beyond_reference(s.need("temperature"), setting)
    return per_axis(lagged(s.need("time"), warm, setting.get("lag", 0.0))) * _reading(s)


def _reading(s: Signals) -> Array:
    return s.need("field") + s.need("hard_iron")[:, None]


def current_squared(s: Signals, setting: Setting) -> Array:
    """Return the columns of the square of a current, or of one that follows it by `lag` s."""
    rows = beyond_reference(s.need("current"), setting) ** 2
    return per_axis(lagged(s.need("time"), rows, setting.get("lag", 0.0)))


def load_soft_iron(s: Signals, setting: Setting) -> Array:
    """Return the columns of a symmetric soft iron (six elements) that changes with the current."""
    load = beyond_reference(s.need("current"), setting)
    return (_symmetric(s)[None] * load[:, None, None]).reshape(-1, 3, load.shape[1])


def soft_iron_step(s: Signals, setting: Setting) -> Array:
    """Return the columns of a symmetric soft iron (six elements) that appears at `time`."""
    return _symmetric(s) * during(s, setting)


def _symmetric(s: Signals) -> Array:
    """Return the products (6, 3, n) of the field with the matrices of vech."""
    result: Array = SYMMETRIC_UNITS @ s.need("field")
    return result
