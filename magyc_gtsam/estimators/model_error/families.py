"""What real recordings have and the model lacks, as groups of columns with one amplitude each.

Generic on purpose: functions of time, of the direction of the field, of the attitude, of the rate of turn and of
their products, on the magnetometer and on the gyroscope. Each says in plain words where it lives. Their units make
amplitudes comparable: shares of the field strength, or rad/s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from magyc_gtsam.estimators.model_error.motion import ALIKE, SLOW, WindowMotion
from magyc_gtsam.estimators.smoother.columns import Columns, Products, RateErrors, UnmodelledColumns
from magyc_gtsam.factors.chain.field_chain import PARAMETERS
from magyc_gtsam.factors.chain.rotations import Array, cross

_SLOWEST, _FASTER = (1, 4), (7, 21)  # half waves in the recording of the slowest and of the faster variation
# Odds beforehand that something is there at all. They set what clean logs pay, ten minutes at 10 Hz: with those given
# the mean NEES of 11 falls by 0.5 to 0.7, on tiny motion by 1.2, and the axis of hard iron and bias that is widened
# most is 1.05 to 1.06 times as wide in the median, 1.13 on tiny. It is 11 over instruments that have such errors as
# often as this says. A bend as likely as not would cost 1.04 to 1.12 times, for a 2 % bend that is still missed in 11
# of 60 logs on moderate and tiny motion instead of in 15 and 19 (of 23 and 27 with COMMON odds).
EVEN = 1.0  # what something else says that is measured
LIKELY = 0.3  # what is stated of the full scale: 0.1 % of 800 µT is 1.6 % of the field
COMMON = 0.1  # what every data sheet states as one number
USUAL = 0.05  # what some do
SELDOM = 0.02  # a gradient on an arm, which moves hardly anything of a clean log
GENERAL = 2.5e-3  # what has no one cause: with so many families some gain 6 nats by chance


@dataclass(frozen=True)
class ColumnFamily:
    """A group of columns with one amplitude.

    Attributes:
        name: short.
        place: where it lives, in plain words; `{}` stands for its size.
        columns: of a motion.
        most: largest amplitude of a column that is physical: a share of the field strength; on the gyroscope rad/s,
            or a share of its rate. What the motion does not show of a family has up to this.
        functions: of which an axis has one column each.
        first: whether it is in the first test, which decides if the others are looked at.
        of_place: whether it is the field of the place that varies.
        of_iron: whether it is the hard iron that varies: no single value of it holds, by as much.
        unit: "field", "rate" (rad/s), "share", "time" (s) or "filter" (s²).
        prior: odds, before the data, that it is there at all.
        expected: of a motion, the largest amplitude that what is known otherwise leaves; None where that is `most`.
        octaves: of amplitude, downwards from the largest, each as likely as the other.
        from_rate: whether the columns are made of changes of the measured rate of turn.
        mixed: whether mixtures of its columns are what the gyroscope's noise makes up. The data say nothing of these.
        at_end: of a motion, (13, k) by how much the parameters at the end of the recording differ from their mean.
        waves: half waves in the recording, from and up to; None where it is not one of time.
    """

    name: str
    place: str
    columns: Callable[[WindowMotion], Columns]
    most: float
    functions: int = 1
    first: bool = False
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

    def columns_of(self, motion: WindowMotion) -> Columns:
        """The columns of a motion; of what is on the gyroscope also by the motion while the field was not measured."""
        return self.columns(motion.along_links if self.name.startswith("gyroscope:") else motion)

    def likely(self, motion: WindowMotion) -> float:
        """The largest amplitude that is believed before the data show one."""
        return self.most if self.expected is None else min(self.expected(motion), self.most)

    def size(self, amplitude: float, motion: WindowMotion) -> float:
        """Root mean square an axis of an amplitude of each column: T, rad/s, a share or s."""
        if self.unit == "filter":
            return float(np.sqrt(2 * amplitude))
        scale = motion.strength if self.unit == "field" else 1.0
        return amplitude * scale * float(np.sqrt(self.functions))

    def period(self, motion: WindowMotion) -> float | None:
        """s, the middle one of its waves."""
        if self.waves is None:
            return None
        return 4 * float(motion.time[-1] - motion.time[0]) / sum(self.waves)

    def sentence(self, size: float, period: float | None) -> str:
        """Where it is and how large."""
        scale, unit = {"field": (1e6, "µT"), "rate": (1e3, "mrad/s"), "share": (1e2, "%")}.get(
            self.unit, (1e3, "ms")
        )
        shown = f"{scale * size:.2g} {unit}"
        return self.place.format(shown)


def _second(vector: Array) -> Array:
    """(5, n) harmonics of degree 2, of unit mean square over the sphere."""
    x, y, z = vector
    root = np.sqrt(15.0)
    return np.array([root * x * y, root * y * z, root * x * z, root * (x * x - y * y) / 2,
                     np.sqrt(5.0) * (3 * z * z - 1) / 2])  # fmt: skip


def _third(vector: Array) -> Array:
    """(7, n) harmonics of degree 3, likewise."""
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


def _skew(motion: WindowMotion) -> UnmodelledColumns:
    """The soft iron's antisymmetric part: the axes of the two chips turned against each other."""
    turned = cross(np.eye(3)[:, :, None], motion.unit[:, None, :])  # e_k × u, (3, 3, n)
    return UnmodelledColumns(np.einsum("ab,bkn->kan", motion.soft_iron, turned), None)


def _attitude(motion: WindowMotion) -> Products:
    """The world's field linear in the attitude: the field's gradient times an arm, rigid or a person's."""
    return motion.in_world(motion.rotation.swapaxes(0, 1).reshape(9, -1) * np.sqrt(3.0))


def _speed(motion: WindowMotion) -> Products:
    """How fast it turns, about its mean: what disagrees between slow turns and fast ones shows in this first."""
    size = np.linalg.norm(motion.rate, axis=0)
    size -= size.mean()
    return motion.in_sensor(size[None] / max(float(size.std()), ALIKE))


def _rate_times_field(motion: WindowMotion) -> Products:
    products = np.einsum("in,jn->ijn", motion.relative, motion.unit).reshape(9, -1)
    return motion.in_sensor(products * np.sqrt(3.0))


def _slope(motion: WindowMotion) -> Array:
    """(3, n) T, the change of the reading over its deviation, times the field strength: a delay's own shape."""
    change = motion.soft_iron @ motion.change
    size = float(np.sqrt(np.mean(motion.change**2)))
    return change / max(size, ALIKE)


def _delays(motion: WindowMotion) -> UnmodelledColumns:
    """A delay that varies slowly, with the speed of turn, and against it; and a filter, by its second order."""
    speed = np.sqrt(np.square(motion.relative).sum(axis=0) / 3.0)
    profiles = np.concatenate([motion.waves(1, 5), [speed, 1 / np.sqrt(speed**2 + 0.05)]])
    bent = motion.soft_iron @ motion.derivative(motion.change)
    filtered = bent * motion.strength / max(float(np.sqrt(np.mean(bent**2))), ALIKE * motion.strength)
    return UnmodelledColumns(np.concatenate([profiles[:, None, :] * _slope(motion), filtered[None]]), None)


def _split(motion: WindowMotion, side: Array) -> UnmodelledColumns:
    """Soft iron, hard iron and delay that differ between two parts of the recording, `side` being ±1 (n,)."""
    irons = motion.in_sensor(np.concatenate([side[None], side * motion.unit]))
    return UnmodelledColumns(np.concatenate([irons.window, (side * _slope(motion))[None]]), None)


def _second_half(motion: WindowMotion) -> Array:
    """Of `_halves`: soft and hard iron of the second half against their means."""
    result = np.zeros((PARAMETERS, 13))
    result[6:9, :3] = -motion.strength * np.eye(3)
    rows, columns = np.triu_indices(3)
    for j in range(3):
        for i in range(3):
            change = np.zeros((3, 3))
            change[i, j] = -motion.strength
            result[:6, 3 + 3 * j + i] = (0.5 * (change + change.T))[rows, columns]
    return result


def _halves(motion: WindowMotion) -> UnmodelledColumns:
    return _split(motion, np.where(np.arange(len(motion.time)) < len(motion.time) // 2, 1.0, -1.0))


def _directions(motion: WindowMotion) -> UnmodelledColumns:
    """The sense of turn about the axis about which it turned most."""
    axis = np.linalg.eigh(motion.rate @ motion.rate.T)[1][:, -1]
    return _split(motion, np.sign(axis @ motion.rate))


def _speeds(motion: WindowMotion) -> UnmodelledColumns:
    speed = np.linalg.norm(motion.rate, axis=0)
    return _split(motion, np.sign(speed - np.median(speed)))


def _bent_rate(motion: WindowMotion) -> RateErrors:
    """Squares and products of the rate, and each rate times its size."""
    w = motion.relative
    products = np.array([w[i] * w[j] for i in range(3) for j in range(i, 3)] + [row * abs(row) for row in w])
    return motion.about_each_axis(motion.spread * products)


def _bias(motion: WindowMotion, profiles: Array) -> RateErrors:
    return motion.about_each_axis(profiles)


def _drift_at_end(waves: tuple[int, int]) -> Callable[[WindowMotion], Array]:
    """Of waves along the sensor's axes: the hard iron by the end of the recording."""

    def there(motion: WindowMotion) -> Array:
        result = np.zeros((PARAMETERS, 3 * (waves[1] - waves[0])))
        ends = np.sqrt(2) * (-1.0) ** np.arange(*waves)
        result[6:9] = motion.strength * (ends[:, None, None] * np.eye(3)).swapaxes(0, 1).reshape(3, -1)
        return result

    return there


def _in_time(
    name: str,
    place: str,
    put: Callable[[WindowMotion, Array], Columns],
    most: float,
    waves: tuple[int, int],
    **more: Any,
) -> ColumnFamily:
    """A family of waves."""
    count = waves[1] - waves[0]
    return ColumnFamily(name, place, lambda m: put(m, m.waves(*waves)), most, count, waves=waves, **more)


_VARIES = "the field varies along the way by {}"
_CHANGES = "the hard iron changes with time by {}"
_GOES = "the field of the place goes with the attitude by {}"
_TILTS = "the reading's error grows with the tilt, to {}"
_TURNS = "in fast turns the reading is off by {}"
_DELAYED = "the delay varies, or a filter is in it, which is worth {}"
_SCALED = "the gyroscope's scale or axes are off by {}"
_BIASED = "the gyroscope's bias changes with time by {}"
_BENT = "in fast turns the gyroscope is off by {} of its rate"
_TILTED = "the gyroscope's bias goes with the attitude by {}"

FAMILIES = (
    _in_time("wander:slow", _VARIES, WindowMotion.in_world, 0.05, SLOW, first=True, of_place=True),
    _in_time("wander:fast", _VARIES, WindowMotion.in_world, 0.05, _FASTER, of_place=True),
    _in_time(
        "drift:slow",
        _CHANGES,
        WindowMotion.in_sensor,
        0.05,
        SLOW,
        first=True,
        of_iron=True,
        at_end=_drift_at_end(SLOW),
    ),
    _in_time(
        "drift:fast", _CHANGES, WindowMotion.in_sensor, 0.05, _FASTER, of_iron=True, at_end=_drift_at_end(_FASTER)
    ),
    ColumnFamily("attitude", _GOES, _attitude, 0.03, 9, first=True, of_place=True, prior=SELDOM),
    ColumnFamily("skew", "the chips' axes are askew by {} of the field", _skew, 0.035, 2, first=True),
    ColumnFamily("second", _TILTS, lambda m: m.in_sensor(_second(m.unit)), 0.006, 5, first=True),
    ColumnFamily("third", "the reading bends by {}", lambda m: m.in_sensor(_third(m.unit)), 0.004, 7, first=True),
    ColumnFamily("rate", _TURNS, lambda m: m.in_sensor(m.relative), 0.02, 3, first=True),
    ColumnFamily("speed", _TURNS, _speed, 0.02, first=True),
    ColumnFamily("rate × field", _TURNS, _rate_times_field, 0.02, 9),
    ColumnFamily("delay", _DELAYED, _delays, 0.03, 7, first=True, from_rate=True),
    ColumnFamily("gyroscope:linear", _SCALED, WindowMotion.gyroscope_matrix, 0.03, first=True, unit="share"),
    _in_time("gyroscope:drift", _BIASED, _bias, 0.015, _SLOWEST, unit="rate", first=True),
    _in_time("gyroscope:wander", _BIASED, _bias, 0.015, (_SLOWEST[1], SLOW[1]), unit="rate"),
    ColumnFamily("gyroscope:bent", _BENT, _bent_rate, 0.02, 9, unit="share"),
    ColumnFamily("gyroscope:field", _TILTED, lambda m: m.about_each_axis(m.unit), 0.0075, 3, unit="rate"),
    ColumnFamily("halves", "the first half and the second disagree by {}", _halves, 0.01, 4, at_end=_second_half),
    ColumnFamily("directions", "turns one way and the other disagree by {}", _directions, 0.01, 4),
    ColumnFamily("speeds", "slow turns and fast ones disagree by {}", _speeds, 0.01, 4),
)
