"""Families of unmodelled effects in real recordings, as groups of columns with one amplitude each.

They are generic: functions of time, of the direction of the field, of the attitude, of the rate of turn and of their
products, on the magnetometer and on the gyroscope. Each has a plain-language description. Common units make the
amplitudes comparable: shares of the field strength, or rad/s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from magyc_gtsam.estimators.model_error import drifts
from magyc_gtsam.estimators.model_error.by_attitude import attitude, tilt
from magyc_gtsam.estimators.model_error.motion import ALIKE, SLOW, WindowMotion, root_mean_square
from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.rotations import Array, by_axes
from magyc_gtsam.factors.chain.vech import vech

# Half waves in the recording of the slowest, the slower and the faster variation.
_SLOWEST, _SLOWER, _FASTER = (1, 4), (4, SLOW[1]), (7, 21)
# Prior odds of an effect. They determine the cost for clean logs (ten minutes at 10 Hz): the mean NEES falls from 11 to
# 10.0, 8.3, 9.1 and 7.7 (wide, moderate, low and tiny motion, with what a misalignment may be), and the axis of hard
# iron and bias that is widened most is wider by a median factor of 1.06, 1.10, 1.07 and 1.14. docs/fault_study.md gives
# the NEES over instruments that bend as often as these odds state, and compares priors of a bend.
EVEN = 1.0  # effects of which another measured quantity gives the size
LIKELY = 0.15  # errors of which data sheets state a bound that most logs stay far below
COMMON = 0.3  # errors that every data sheet of a low-cost sensor states as one number
USUAL = 0.05  # errors of some sensors
SELDOM = 0.02  # a field gradient with a lever arm, which hardly moves the parameters of a clean log
GENERAL = 2.5e-3  # effects without a specific cause: with so many families some gain 6 nats by chance


_SHOWN = {"field": (1e6, "µT"), "rate": (1e3, "mrad/s"), "share": (1e2, "%"), "angle": (180 / np.pi, "°")}


@dataclass(frozen=True)
class ColumnFamily:
    """A group of columns with one amplitude.

    Attributes:
        name: short name.
        place: what it acts on, in plain words; `{}` stands for its size.
        columns: function that computes the columns from a motion.
        most: largest physically plausible amplitude of a column: a share of the field strength; on the gyroscope rad/s,
            or a share of its rate. It bounds directions of the family that the motion does not observe.
        functions: number of functions, each of which gives one column per axis.
        stage: the test that it belongs to, 0 to 2; the gains in one decide whether the next is made (`model_error`).
        of_place: whether it is a variation of the ambient field.
        of_iron: whether it is a variation of the hard iron; its size then adds to the hard iron's sigma.
        unit: "field", "rate" (rad/s), "share", "angle" (rad), "time" (s) or "filter" (s²).
        waves: number of half waves in the recording, from (inclusive) and to (exclusive); None if not a function of
            time.
        prior: prior odds of the effect.
        at_end: function that computes from a motion (13, k) by how much the parameters at the end of the recording
            differ from their mean, per unit of each column.
        expected: function that computes from a motion the largest plausible amplitude by other knowledge; None if it is
            `most`.
        octaves: number of octaves of amplitude, from the largest down, with equal prior probability.
        from_rate: whether the columns depend on changes of the measured rate of turn.
        mixed: whether some linear combinations of the columns consist of the gyroscope's noise, or vary faster than the
            windows resolve, and are to be removed.
        only_beside: whether it is added to the families that are shown instead of being fitted with them, because it
            resembles several of them and would take their place.
        other_shapes: other columns for the same effect, by which the data may show it better than by `columns`.
    """

    name: str
    place: str
    columns: Callable[[WindowMotion], UnmodelledColumns]
    most: float
    functions: int = 1
    stage: int = 0
    of_place: bool = False
    of_iron: bool = False
    unit: str = "field"
    waves: tuple[int, int] | None = None
    prior: float = GENERAL
    at_end: Callable[[WindowMotion], Array] | None = None
    expected: Callable[[WindowMotion], float] | None = None
    octaves: int = 6
    from_rate: bool = False
    mixed: bool = False
    only_beside: bool = False
    other_shapes: tuple[Callable[[WindowMotion], UnmodelledColumns], ...] = ()

    def columns_of(self, motion: WindowMotion) -> UnmodelledColumns:
        """Return the columns of a motion; on the gyroscope they include the motion while the field was not measured."""
        return self.columns(motion.along_links if self.name.startswith("gyroscope:") else motion)

    def likely(self, motion: WindowMotion) -> float:
        """Return the largest amplitude under the prior."""
        return self.most if self.expected is None else min(self.expected(motion), self.most)

    def size(self, amplitude: float, motion: WindowMotion) -> float:
        """Return the root mean square per axis, in T, rad/s, s or as a share, of columns with this amplitude."""
        if self.unit == "filter":
            return float(np.sqrt(2 * amplitude))
        scale = motion.strength if self.unit == "field" else 1.0
        return amplitude * scale * float(np.sqrt(self.functions))

    def period(self, motion: WindowMotion) -> float | None:
        """Return the period, in s, of the middle one of its waves; None if it is not a function of time."""
        if self.waves is None:
            return None
        return 4 * float(motion.time[-1] - motion.time[0]) / sum(self.waves)

    def sentence(self, size: float | None, period: float | None) -> str:
        """Return a sentence on what it acts on and its size; None if the data do not give it."""
        if size is None:
            return self.place.replace("±", "").format("an unknown amount")
        scale, unit = _SHOWN.get(self.unit, (1e3, "ms"))
        return self.place.format(f"{scale * size:.2g} {unit}")


def _second(vector: Array) -> Array:
    """Return the (5, n) spherical harmonics of degree 2, of unit mean square over the sphere."""
    x, y, z = vector
    root = np.sqrt(15.0)
    return np.array([root * x * y, root * y * z, root * x * z, root * (x * x - y * y) / 2,
                     np.sqrt(5.0) * (3 * z * z - 1) / 2])  # fmt: skip


def _third(vector: Array) -> Array:
    """Return the (7, n) spherical harmonics of degree 3, of unit mean square over the sphere."""
    x, y, z = vector
    a, b, c = np.sqrt(105.0), np.sqrt(21 / 8), np.sqrt(35 / 8)
    return np.array(
        [
            a * x * y * z,
            a * z * (x * x - y * y) / 2,
            b * x * (5 * z * z - 1),
            b * y * (5 * z * z - 1),
            np.sqrt(7.0) * z * (5 * z * z - 3) / 2,
            c * x * (x * x - 3 * y * y),
            c * y * (3 * x * x - y * y),
        ]
    )


def _main_axis(vector: Array) -> Array:
    """Return the axis (3,) along which vectors (3, n) are largest."""
    return np.asarray(np.linalg.eigh(vector @ vector.T)[1][:, -1])


def _skew(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns of a misalignment between the chips, the antisymmetric part of the soft iron."""
    return UnmodelledColumns(motion.soft_iron @ by_axes(motion.unit), None)


def _speed(motion: WindowMotion) -> UnmodelledColumns:
    """Return columns of the size of the rate about each axis less its mean, as of the currents of thrusters."""
    size = np.abs(motion.rate)
    size -= size.mean(axis=1, keepdims=True)
    return motion.in_sensor(size / max(root_mean_square(size), ALIKE))


def _rate_times_field(motion: WindowMotion) -> UnmodelledColumns:
    products = np.einsum("in,jn->ijn", motion.relative, motion.unit).reshape(9, -1)
    return motion.in_sensor(products * np.sqrt(3.0))


def _slope(motion: WindowMotion) -> Array:
    """Return (3, n) T, the derivative of the reading by the delay, scaled to the field strength."""
    change = motion.soft_iron @ motion.change
    return change / max(root_mean_square(motion.change), ALIKE)


def _delays(motion: WindowMotion) -> UnmodelledColumns:
    """Return columns of a delay that varies slowly, with the speed of turn and inversely to it, and of a filter.

    The filter enters by its second order.
    """
    speed = np.sqrt(np.square(motion.relative).sum(axis=0) / 3.0)
    profiles = np.concatenate([motion.waves(1, 5), [speed, 1 / np.sqrt(speed**2 + 0.05)]])
    bent = motion.soft_iron @ motion.derivative(motion.change)
    filtered = bent * motion.strength / max(root_mean_square(bent), ALIKE * motion.strength)
    return UnmodelledColumns(np.concatenate([profiles[:, None, :] * _slope(motion), filtered[None]]), None)


def _split(motion: WindowMotion, side: Array) -> UnmodelledColumns:
    """Return columns of soft iron, hard iron and delay that differ between two parts, given by `side` (n,) of ±1."""
    irons = motion.in_sensor(np.concatenate([side[None], side * motion.unit])).on_all_axes
    return UnmodelledColumns(np.concatenate([irons.window, (side * _slope(motion))[None]]), None)


def _second_half(motion: WindowMotion) -> Array:
    """Return (13, 13) the soft and hard iron of the second half less their means, for `_halves`."""
    result = np.zeros((PARAMETERS, 13))
    result[6:9, :3] = -motion.strength * np.eye(3)
    for j in range(3):
        for i in range(3):
            change = np.zeros((3, 3))
            change[i, j] = -motion.strength
            result[:6, 3 + 3 * j + i] = vech(0.5 * (change + change.T))
    return result


def _halves(motion: WindowMotion) -> UnmodelledColumns:
    return _split(motion, np.where(np.arange(len(motion.time)) < len(motion.time) // 2, 1.0, -1.0))


def _directions(motion: WindowMotion) -> UnmodelledColumns:
    """Return columns that differ between the two senses of turn about the axis of most rotation."""
    return _split(motion, np.sign(_main_axis(motion.rate) @ motion.rate))


def _speeds(motion: WindowMotion) -> UnmodelledColumns:
    speed = np.linalg.norm(motion.rate, axis=0)
    return _split(motion, np.sign(speed - np.median(speed)))


def _bent_rate(motion: WindowMotion) -> UnmodelledColumns:
    """Return columns of the squares and products of the rates, and of each rate times its absolute value."""
    w = motion.relative
    products = np.array([w[i] * w[j] for i in range(3) for j in range(i, 3)] + [row * abs(row) for row in w])
    return motion.about_each_axis(motion.spread * products)


def _in_time(
    name: str,
    place: str,
    put: Callable[[WindowMotion, Array], UnmodelledColumns],
    most: float,
    waves: tuple[int, int],
    **more: Any,
) -> ColumnFamily:
    """Return a family of functions of time."""
    count = waves[1] - waves[0]
    return ColumnFamily(name, place, lambda m: put(m, m.waves(*waves)), most, count, waves=waves, **more)


_VARIES = "the field varies along the way by {}"
_CHANGES = "the hard iron changes with time by {}"
_GOES = "the field of the place varies with the attitude by {}"
_TILTS = "the reading's error grows with the tilt, to {}"
_LEANS = "the reading's error follows pitch and roll, by {}"
_TURNS = "in fast turns the reading is off by {}"
_DELAYED = "the delay varies, or a filter is in it, which is worth {}"
_SCALED = "the gyroscope's scale or axes are off by {}"
_BIASED = "the gyroscope's bias changes with time by {}"
_BENT = "in fast turns the gyroscope is off by {} of its rate"
_TILTED = "the gyroscope's bias varies with the attitude by {}"
_ALONG = WindowMotion.in_sensor

FAMILIES = (
    _in_time("wander:slow", _VARIES, WindowMotion.in_world, 0.05, SLOW, of_place=True),
    _in_time("wander:fast", _VARIES, WindowMotion.in_world, 0.05, _FASTER, of_place=True, stage=2),
    _in_time("drift:slow", _CHANGES, _ALONG, 0.05, SLOW, of_iron=True, at_end=drifts.waves_at_end(SLOW)),
    _in_time(
        "drift:fast", _CHANGES, _ALONG, 0.05, _FASTER, of_iron=True, at_end=drifts.waves_at_end(_FASTER), stage=2
    ),
    ColumnFamily("attitude", _GOES, attitude, 0.03, 9, stage=1, of_place=True, prior=SELDOM),
    ColumnFamily("tilt", _LEANS, tilt, 0.03, 3, stage=1),
    ColumnFamily(
        "skew", "the chips' axes are misaligned, which puts the reading off by {}", _skew, 0.035, 2, stage=1
    ),
    ColumnFamily("second", _TILTS, lambda m: m.in_sensor(_second(m.unit)), 0.006, 5),
    ColumnFamily("third", "the reading bends by {}", lambda m: m.in_sensor(_third(m.unit)), 0.004, 7, stage=1),
    ColumnFamily("rate", _TURNS, lambda m: m.in_sensor(m.relative), 0.02, 3),
    ColumnFamily("speed", _TURNS, _speed, 0.02, 3),
    ColumnFamily("rate × field", _TURNS, _rate_times_field, 0.02, 9, stage=2),
    ColumnFamily("delay", _DELAYED, _delays, 0.03, 7, from_rate=True),
    ColumnFamily(
        "gyroscope:linear", _SCALED, lambda m: m.about_each_axis(m.rate), 0.03, stage=1, unit="share", mixed=True
    ),
    _in_time(
        "gyroscope:drift",
        _BIASED,
        WindowMotion.slowly_about_each_axis,
        0.015,
        _SLOWEST,
        unit="rate",
        at_end=drifts.waves_at_end(_SLOWEST, of_bias=True),
    ),
    _in_time(
        "gyroscope:wander",
        _BIASED,
        WindowMotion.about_each_axis,
        0.015,
        _SLOWER,
        unit="rate",
        stage=2,
        at_end=drifts.waves_at_end(_SLOWER, of_bias=True),
    ),
    ColumnFamily("gyroscope:bent", _BENT, _bent_rate, 0.02, 9, unit="share", stage=2),
    ColumnFamily("gyroscope:field", _TILTED, lambda m: m.about_each_axis(m.unit), 0.0075, 3, unit="rate", stage=2),
    ColumnFamily(
        "halves", "the first half and the second disagree by {}", _halves, 0.01, 4, at_end=_second_half, stage=2
    ),
    ColumnFamily("directions", "turns one way and the other disagree by {}", _directions, 0.01, 4, stage=2),
    ColumnFamily("speeds", "slow turns and fast ones disagree by {}", _speeds, 0.01, 4, stage=2),
)
