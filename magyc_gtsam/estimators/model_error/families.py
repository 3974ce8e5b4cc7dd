"""What real recordings have and the model lacks, as groups of columns with one amplitude each.

Generic on purpose: functions of time, of the direction of the field, of the attitude, of the rate of turn and of
their products, on the magnetometer and on the gyroscope. Each says in plain words where it lives. Their units make
amplitudes comparable: shares of the field strength, or rad/s.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from magyc_gtsam.estimators.smoother.beside import Columns
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.rotations import Array, cross
from magyc_gtsam.factors.chain.vech import unvech

_SLOW, _FASTER = (1, 7), (7, 21)  # half waves in the recording of the slow and of the faster variation
_ALIKE = 1e-9  # rad/s, below which nothing turns


@dataclass(frozen=True, eq=False)
class Motion:
    """What the windows of a fit say of the motion, all (…, n) with the windows last.

    Attributes:
        time: (n,) s.
        rotation: (3, 3, n) integrated world → sensor.
        seen: (3, 3, n) T, the reading of the world's axes with the field's strength: soft iron times rotation.
        unit: (3, n) the field's direction in the sensor; change: (3, n) 1/s, its derivative in time.
        rate: (3, n) rad/s, of turn; relative: the same over its deviation, `spread` rad/s an axis.
        direction: (3, n) of the field in the integrated world.
        strength: T; soft_iron: (3, 3) T, times it.
    """

    time: Array
    rotation: Array
    seen: Array
    unit: Array
    change: Array
    rate: Array
    direction: Array
    strength: float
    soft_iron: Array

    @classmethod
    def of(cls, fit: Fit) -> Motion:
        """Of a fit at its minimum."""
        windows, parameters = fit.chain.windows, fit.state.parameters
        soft = unvech(parameters[:6])
        rotation = fit.chain.rotation(parameters)
        turning = np.einsum("ijn,kjn->ikn", windows.rotation_rate, rotation)  # [ω]×
        rate = 0.5 * np.array(
            [turning[2, 1] - turning[1, 2], turning[0, 2] - turning[2, 0], turning[1, 0] - turning[0, 1]]
        )
        g = fit.state.direction
        return cls(
            time=windows.time,
            rotation=rotation,
            seen=(soft @ rotation.reshape(3, -1)).reshape(rotation.shape),
            unit=np.einsum("ijn,jn->in", rotation, g),
            change=np.einsum("ijn,jn->in", windows.rotation_rate, g),
            rate=rate,
            direction=g,
            strength=float(np.cbrt(abs(np.linalg.det(soft)))),
            soft_iron=soft,
        )

    @cached_property
    def spread(self) -> float:
        """rad/s, root mean square of the rate of turn, an axis."""
        return max(float(np.sqrt(np.mean(self.rate**2))), _ALIKE)

    @cached_property
    def relative(self) -> Array:
        """(3, n) the rate of turn over `spread`."""
        return self.rate / self.spread

    def in_sensor(self, profiles: Array) -> Columns:
        """Profiles (k, n) along each of the sensor's axes, in units of the field strength."""
        columns = profiles[:, None, None, :] * (np.eye(3) * self.strength)[:, :, None]
        return Columns(columns.reshape(3 * len(profiles), 3, -1), None)

    def in_world(self, profiles: Array) -> Columns:
        """Profiles (k, n) along each of the world's axes."""
        columns = profiles[:, None, None, :] * self.seen.swapaxes(0, 1)
        return Columns(columns.reshape(3 * len(profiles), 3, -1), None)

    def on_gyroscope(self, profiles: Array) -> Columns:
        """Errors of the rate (k, 3, n) rad/s: links turn by −∫ R ω dt more than the model says."""
        turned = np.einsum("jin,kjn->kin", self.rotation, profiles)
        angle = -0.5 * (turned[..., 1:] + turned[..., :-1]) * np.diff(self.time)
        link = -cross(self.direction[:, None, :-1], angle.swapaxes(0, 1))
        return Columns(None, np.ascontiguousarray(link.swapaxes(0, 1)))

    def waves(self, first: int, stop: int) -> Array:
        """(stop − first, n) cosines of unit deviation with `first` to `stop` − 1 half waves in the recording."""
        if stop <= _SLOW[1]:
            return self._slow_waves[first - _SLOW[0] : stop - _SLOW[0]]
        return self._waves(first, stop)

    @cached_property
    def _slow_waves(self) -> Array:
        return self._waves(*_SLOW)

    def _waves(self, first: int, stop: int) -> Array:
        share = (self.time - self.time[0]) / max(float(self.time[-1] - self.time[0]), 1e-9)
        return np.sqrt(2) * np.cos(np.pi * np.arange(first, stop)[:, None] * share)


@dataclass(frozen=True)
class Family:
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
        unit: "field", "rate" (rad/s) or "share".
        waves: half waves in the recording, from and up to; None where it is not one of time.
    """

    name: str
    place: str
    columns: Callable[[Motion], Columns]
    most: float
    functions: int = 1
    first: bool = False
    of_place: bool = False
    of_iron: bool = False
    unit: str = "field"
    waves: tuple[int, int] | None = None

    def size(self, amplitude: float, motion: Motion) -> float:
        """Root mean square an axis of an amplitude of each column: T, rad/s or a share."""
        scale = motion.strength if self.unit == "field" else 1.0
        return amplitude * scale * float(np.sqrt(self.functions))

    def period(self, motion: Motion) -> float | None:
        """s, the middle one of its waves."""
        if self.waves is None:
            return None
        return 4 * float(motion.time[-1] - motion.time[0]) / sum(self.waves)

    def sentence(self, size: float, period: float | None) -> str:
        """Where it is and how large."""
        shown = {"field": f"{size * 1e6:.2g} µT", "rate": f"{size * 1e3:.2g} mrad/s", "share": f"{size:.2g}"}[
            self.unit
        ]
        if self.unit == "share":
            shown = f"{100 * size:.2g} %"
        return self.place.format(shown)


def _each(profiles: Array) -> Array:
    """(3k, 3, n) of profiles (k, n): each on each axis."""
    return (profiles[:, None, None, :] * np.eye(3)[:, :, None]).reshape(3 * len(profiles), 3, -1)


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


def _skew(motion: Motion) -> Columns:
    """The soft iron's antisymmetric part: the axes of the two chips turned against each other."""
    turned = cross(np.eye(3)[:, :, None], motion.unit[:, None, :])  # e_k × u, (3, 3, n)
    return Columns(np.einsum("ab,bkn->kan", motion.soft_iron, turned), None)


def _attitude(motion: Motion) -> Columns:
    """The world's field linear in the attitude: the field's gradient times an arm, rigid or a person's."""
    return motion.in_world(motion.rotation.swapaxes(0, 1).reshape(9, -1) * np.sqrt(3.0))


def _rate_times_field(motion: Motion) -> Columns:
    products = np.einsum("in,jn->ijn", motion.relative, motion.unit).reshape(9, -1)
    return motion.in_sensor(products * np.sqrt(3.0))


def _slope(motion: Motion) -> Array:
    """(3, n) T, the change of the reading over its deviation, times the field strength: a delay's own shape."""
    change = motion.soft_iron @ motion.change
    size = float(np.sqrt(np.mean(motion.change**2)))
    return change / max(size, _ALIKE)


def _delays(motion: Motion) -> Columns:
    """A delay that varies slowly, with the speed of turn, and against it; and a filter, by its second order."""
    speed = np.sqrt(np.square(motion.relative).sum(axis=0) / 3.0)
    profiles = np.concatenate([motion.waves(1, 5), [speed, 1 / np.sqrt(speed**2 + 0.05)]])
    bent = motion.soft_iron @ np.gradient(motion.change, motion.time, axis=1)
    filtered = bent * motion.strength / max(float(np.sqrt(np.mean(bent**2))), _ALIKE * motion.strength)
    return Columns(np.concatenate([profiles[:, None, :] * _slope(motion), filtered[None]]), None)


def _split(motion: Motion, side: Array) -> Columns:
    """Soft iron, hard iron and delay that differ between two parts of the recording, `side` being ±1 (n,)."""
    irons = motion.in_sensor(np.concatenate([side[None], side * motion.unit]))
    return Columns(np.concatenate([irons.window, (side * _slope(motion))[None]]), None)


def _halves(motion: Motion) -> Columns:
    return _split(motion, np.where(np.arange(len(motion.time)) < len(motion.time) // 2, 1.0, -1.0))


def _directions(motion: Motion) -> Columns:
    """The sense of turn about the axis about which it turned most."""
    axis = np.linalg.eigh(motion.rate @ motion.rate.T)[1][:, -1]
    return _split(motion, np.sign(axis @ motion.rate))


def _speeds(motion: Motion) -> Columns:
    speed = np.linalg.norm(motion.rate, axis=0)
    return _split(motion, np.sign(speed - np.median(speed)))


def _bent_rate(motion: Motion) -> Columns:
    """Squares and products of the rate, and each rate times its size."""
    w = motion.relative
    products = np.array([w[i] * w[j] for i in range(3) for j in range(i, 3)] + [row * abs(row) for row in w])
    return motion.on_gyroscope(_each(motion.spread * products))


def _in_time(
    name: str,
    place: str,
    put: Callable[[Motion, Array], Columns],
    most: float,
    waves: tuple[int, int],
    **more: Any,
) -> Family:
    """A family of waves."""
    count = waves[1] - waves[0]
    return Family(name, place, lambda m: put(m, m.waves(*waves)), most, count, waves=waves, **more)


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
    _in_time("wander:slow", _VARIES, Motion.in_world, 0.05, _SLOW, first=True, of_place=True),
    _in_time("wander:fast", _VARIES, Motion.in_world, 0.05, _FASTER, of_place=True),
    _in_time("drift:slow", _CHANGES, Motion.in_sensor, 0.05, _SLOW, first=True, of_iron=True),
    _in_time("drift:fast", _CHANGES, Motion.in_sensor, 0.05, _FASTER, of_iron=True),
    Family("attitude", _GOES, _attitude, 0.03, 9, first=True, of_place=True),
    Family("skew", "the chips' axes are askew by {} of the field", _skew, 0.035, 2, first=True),
    Family("second", _TILTS, lambda m: m.in_sensor(_second(m.unit)), 0.006, 5, first=True),
    Family("third", "the reading bends by {}", lambda m: m.in_sensor(_third(m.unit)), 0.004, 7, first=True),
    Family("rate", _TURNS, lambda m: m.in_sensor(m.relative), 0.02, 3),
    Family("rate × field", _TURNS, _rate_times_field, 0.02, 9),
    Family("delay", _DELAYED, _delays, 0.03, 7, first=True),
    Family("gyroscope:linear", _SCALED, lambda m: m.on_gyroscope(_each(m.rate)), 0.03, first=True, unit="share"),
    _in_time("gyroscope:drift", _BIASED, lambda m, p: m.on_gyroscope(_each(p)), 0.015, _SLOW, unit="rate"),
    Family("gyroscope:bent", _BENT, _bent_rate, 0.02, 9, unit="share"),
    Family("gyroscope:field", _TILTED, lambda m: m.on_gyroscope(_each(m.unit)), 0.0075, 3, unit="rate"),
    Family("halves", "the first half and the second disagree by {}", _halves, 0.01, 4),
    Family("directions", "turns one way and the other disagree by {}", _directions, 0.01, 4),
    Family("speeds", "slow turns and fast ones disagree by {}", _speeds, 0.01, 4),
)
