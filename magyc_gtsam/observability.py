"""What the motion determined, named for the user."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from magyc_gtsam.level_turn import Askew, LevelTurn, level_turn
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.checks import EARTH_FIELD

HARD_IRON_LIMIT = 0.05  # share of the field strength: three degrees of heading in a mid-latitude field
SOFT_IRON_LIMIT = 0.05
GYRO_BIAS_LIMIT = 15e-3  # rad/s
_UNDETERMINED = 100  # limits from which the size of a deviation says nothing more


@dataclass(frozen=True)
class Weakness:
    """A direction of the parameters that the motion left weak.

    Attributes:
        what: which parameter or axis, in the user's words.
        sigma: standard deviation along that direction, in `unit`.
        limit: the deviation from which the result must not be trusted, in `unit`.
        unit: "µT" (or "counts"), "%" or "mrad/s".
        remedy: the motion that would determine it.
    """

    what: str
    sigma: float
    limit: float
    unit: str
    remedy: str

    @property
    def sentence(self) -> str:
        """One line for terminal and page."""
        limit = f"{self.limit:.2g}"
        if self.sigma > _UNDETERMINED * self.limit:
            return f"{self.what} is not determined (limit ±{limit} {self.unit}): {self.remedy}"
        return f"{self.what} ±{self.sigma:.2g} {self.unit} (limit {limit}): {self.remedy}"


@dataclass(frozen=True)
class Observability:
    """Whether the motion determined the calibration, and what is weak.

    Attributes:
        observable: False where any weakness passes its limit.
        weak: the weak directions, worst first.
        heading_sigma: deg, largest standard deviation of heading that the calibration's own
            uncertainty causes over a level turn (`level_turn.LevelTurn.systematic`).
    """

    observable: bool
    weak: tuple[Weakness, ...] = ()
    heading_sigma: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON types."""
        return asdict(self) | {"weak": [asdict(w) for w in self.weak]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Observability:
        """The inverse of `to_dict`."""
        return cls(**{**data, "weak": tuple(Weakness(**w) for w in data["weak"])})


@dataclass(frozen=True, eq=False)
class Assessor:
    """Judges covariances of one calibration by the motion of one recording; see `assess` for the arguments."""

    soft_iron: Array
    field_strength: float
    recording: Recording
    hard_iron: Array | None = None
    askew: Askew | None = None

    def of(self, covariance: Array) -> Observability:
        """What a covariance says, as `assess`."""
        shown, unit_shown = self.recording.field_shown
        in_tesla = self.recording.magnetic_field_unit == "T"
        limit = (
            float(min(max(self.field_strength, EARTH_FIELD[0]), EARTH_FIELD[1]))
            if in_tesla
            else self.field_strength
        )
        groups = (
            ("hard iron along", covariance[6:9, 6:9], shown, HARD_IRON_LIMIT * limit * shown, unit_shown),
            ("soft iron along", covariance[:6, :6], 1e2, SOFT_IRON_LIMIT * 1e2, "%"),
            ("gyroscope bias about", covariance[9:, 9:], 1e3, GYRO_BIAS_LIMIT * 1e3, "mrad/s"),
        )
        weak = []
        for what, block, scale, most, unit in groups:
            if float(block.trace()) * scale**2 <= (0.5 * most) ** 2:
                continue  # no direction has more than the trace
            variance, vectors = np.linalg.eigh(block)
            for sigma, vector in zip(np.sqrt(np.maximum(variance, 0.0)) * scale, vectors.T, strict=True):
                if sigma > 0.5 * most:
                    axis = _stretched(vector) if len(vector) == 6 else vector
                    remedy = _rest_or_move(sigma) if unit == "mrad/s" else _remedy(axis, _vertical(self.recording))
                    weak.append(Weakness(f"{what} {_axis_name(axis)}", float(sigma), most, unit, remedy))
        weak.sort(key=lambda w: -w.sigma / w.limit)
        return Observability(
            observable=all(w.sigma <= w.limit for w in weak),
            weak=tuple(weak),
            heading_sigma=float(self._turn.systematic(covariance, self.soft_iron, self.askew).max()),
        )

    @cached_property
    def _turn(self) -> LevelTurn:
        """The level turn whose heading is judged."""
        centre = np.zeros(3) if self.hard_iron is None else self.hard_iron
        return level_turn(self.recording, self.soft_iron, centre, self.field_strength)


def assess(
    covariance: Array,
    soft_iron: Array,
    field_strength: float,
    recording: Recording,
    hard_iron: Array | None = None,
    askew: Askew | None = None,
) -> Observability:
    """Name the weak directions of a calibration and the motion that would fix them.

    Args:
        covariance: (12, 12) of vech(soft_iron), hard_iron T, gyro_bias rad/s; (9, 9) without the bias.
        soft_iron: (3, 3).
        field_strength: T.
        recording: the data it came from; says which way is up and about which axes it turned.
        hard_iron: (3,) T; None for 0. The dip is taken from the field without it.
        askew: what is open of the angles between magnetometer and gyroscope, which heading is as far off.

    Returns:
        All directions whose standard deviation passes half its limit, worst first; not observable where
        one passes the limit.
    """
    return Assessor(soft_iron, field_strength, recording, hard_iron, askew).of(covariance)


def _stretched(vech: Array) -> Array:
    """The axis along which a change of the soft iron stretches most."""
    shape = np.zeros((3, 3))
    shape[np.triu_indices(3)] = vech
    value, vector = np.linalg.eigh(shape + shape.T)
    axis: Array = vector[:, np.argmax(np.abs(value))]
    return axis


def _rest_or_move(sigma: float) -> str:
    return "record longer, with some seconds at rest" if sigma < 1e3 else "move: nothing turned"


def _axis_name(axis: Array) -> str:
    """ "z" where an axis is clear, else its components: "0.7 x + 0.7 y"."""
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    if np.abs(axis).max() > 0.95:
        return "xyz"[int(np.argmax(np.abs(axis)))]
    parts = [f"{a:+.1f} {n}" for a, n in zip(axis, "xyz", strict=True) if abs(a) > 0.15]
    return " ".join(parts).removeprefix("+").replace(" +", " + ").replace(" -", " − ").replace("-", "−")


def _vertical(recording: Recording) -> Array | None:
    """(3,) mean direction of the specific force in the sensor frame; None without an accelerometer."""
    if recording.acceleration is None:
        return None
    mean = _thin(recording.acceleration).mean(axis=0)
    norm = float(np.linalg.norm(mean))
    return mean / norm if norm > 5.0 else None  # an instrument turned all over has no vertical axis


def _thin(values: Array, most: int = 2000) -> Array:
    return values[:: max(len(values) // most, 1)]


def _remedy(axis: Array, up: Array | None) -> str:
    if up is None:
        across = [n for a, n in zip(axis, "xyz", strict=True) if abs(a) < 0.6] or ["all axes"]
        return f"turn about {' and '.join(across)} by 30° or more"
    along = abs(float(axis @ up))
    if along > 0.8:
        return "pitch or roll by 20° or more while turning"
    if along < 0.4:
        return "turn through all headings"
    return "turn through all headings, and pitch or roll by 20° or more"
