"""The parameters of a calibration that the motion determined, and the motion that would determine the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.chain.small import eigenvectors
from magyc_gtsam.foreign_text import two_digits
from magyc_gtsam.level_turn import LevelTurn, MisalignmentError, level_turn
from magyc_gtsam.recording import Array, Mask, Recording
from magyc_gtsam.recording.checks import EARTH_FIELD

# Limits of the standard deviation above which a result must not be trusted.
HARD_IRON_LIMIT = 0.05  # share of the field strength: three degrees of heading in a mid-latitude field
SOFT_IRON_LIMIT = 0.05
GYRO_BIAS_LIMIT = 15e-3  # rad/s
ROTATION_LIMIT = 0.03  # rad between the sensors: three degrees of heading in a mid-latitude field
_ROWS_FOR_VERTICAL = 2000
_LEAST_MEAN_FORCE = (
    5.0  # m/s²; an instrument whose mean specific force is less was tumbled and has no vertical axis
)
_UNDETERMINED = 100  # factor of the limit above which a parameter counts as not determined at all
_BANDS, _SECTORS = 6, 10  # cells of equal area: bands from −z to +z, sectors about z from −x on


@dataclass(frozen=True)
class Weakness:
    """A direction in parameter space that the motion determined only weakly.

    Attributes:
        what: the parameter and axis, in words.
        sigma: standard deviation along that direction, in `unit`.
        limit: standard deviation above which the result must not be trusted, in `unit`.
        unit: "µT" (or "counts"), "%", "mrad/s" or "°".
        remedy: the motion that would determine it.
    """

    what: str
    sigma: float
    limit: float
    unit: str
    remedy: str

    @property
    def sentence(self) -> str:
        """The weakness in one sentence, for terminal and page."""
        limit = f"{self.limit:.2g}"
        if self.sigma > _UNDETERMINED * self.limit:
            return f"{self.what} is not determined (limit ±{limit} {self.unit}): {self.remedy}"
        return f"{self.what} ±{two_digits(self.sigma)} {self.unit} (limit {limit}): {self.remedy}"


@dataclass(frozen=True)
class Observability:
    """The assessment whether the motion determined the calibration, and its weak directions.

    Attributes:
        observable: False if any weakness exceeds its limit.
        weak: the weak directions, worst first.
        heading_sigma: deg, largest standard deviation of heading over a level turn that the calibration's
            uncertainty causes (`level_turn.LevelTurn.systematic`).
    """

    observable: bool
    weak: tuple[Weakness, ...] = ()
    heading_sigma: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as JSON types."""
        return asdict(self) | {"weak": [asdict(w) for w in self.weak]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Observability:
        """Build from the result of `to_dict`."""
        return cls(**{**data, "weak": tuple(Weakness(**w) for w in data["weak"])})


@dataclass(frozen=True, eq=False)
class Assessor:
    """Assesses covariances of one calibration on one recording; see `assess` for the arguments."""

    soft_iron: Array
    field_strength: float
    recording: Recording
    hard_iron: Array | None = None
    misalignment: MisalignmentError | None = None

    def of(self, covariance: Array, rotation: Array | None = None, heading: bool = True) -> Observability:
        """Return the result of `assess` for a covariance, and for that (3, 3) rad² of the rotation between the sensors
        as far as it is to be judged; without a sigma of the heading if that is not needed.
        """
        shown, unit_shown = self.recording.field_shown
        in_tesla = self.recording.magnetic_field_unit == "T"
        limit = (
            float(min(max(self.field_strength, EARTH_FIELD[0]), EARTH_FIELD[1]))
            if in_tesla
            else self.field_strength
        )
        turned = np.zeros((3, 3)) if rotation is None else rotation
        groups = (
            ("hard iron along", covariance[6:9, 6:9], shown, HARD_IRON_LIMIT * limit * shown, unit_shown),
            ("soft iron along", covariance[:6, :6], 1e2, SOFT_IRON_LIMIT * 1e2, "%"),
            ("gyroscope bias about", covariance[9:, 9:], 1e3, GYRO_BIAS_LIMIT * 1e3, "mrad/s"),
            ("rotation of the magnetometer about", turned, 180 / np.pi, np.degrees(ROTATION_LIMIT), "°"),
        )
        weak = []
        for what, block, scale, largest, unit in groups:
            if float(block.trace()) * scale**2 <= (0.5 * largest) ** 2:
                continue  # the trace bounds the variance of every direction
            variance, vectors = eigenvectors(block)
            for sigma, vector in zip(np.sqrt(np.maximum(variance, 0.0)) * scale, vectors.T, strict=True):
                if sigma > 0.5 * largest:
                    axis = _stretched(vector) if len(vector) == 6 else vector
                    if unit == "mrad/s":
                        remedy = _rest_or_move(sigma)
                    elif unit == "°":
                        remedy = "fix the magnetometer to the gyroscope, and calibrate from then on"
                    else:
                        remedy = _remedy(axis, _vertical(self.recording))
                    weak.append(Weakness(f"{what} {_axis_name(axis)}", float(sigma), largest, unit, remedy))
        weak.sort(key=lambda w: -w.sigma / w.limit)
        return Observability(
            observable=all(w.sigma <= w.limit for w in weak),
            weak=tuple(weak),
            heading_sigma=self._heading_sigma(covariance) if heading else None,
        )

    def _heading_sigma(self, covariance: Array) -> float:
        return float(self._turn.spread(covariance, self._slopes, self.misalignment).max())

    @cached_property
    def _slopes(self) -> Array:
        """Derivative of the heading over the level turn with respect to soft and hard iron."""
        return self._turn.slopes(self.soft_iron)

    @cached_property
    def _turn(self) -> LevelTurn:
        """The level turn over which heading is assessed."""
        centre = np.zeros(3) if self.hard_iron is None else self.hard_iron
        return level_turn(self.recording, self.soft_iron, centre, self.field_strength)


def assess(
    covariance: Array,
    soft_iron: Array,
    field_strength: float,
    recording: Recording,
    hard_iron: Array | None = None,
    misalignment: MisalignmentError | None = None,
) -> Observability:
    """Name the weak directions of a calibration and the motion that would determine them.

    Args:
        covariance: (12, 12) of vech(soft_iron), hard_iron T, gyro_bias rad/s; (9, 9) without the bias.
        soft_iron: (3, 3).
        field_strength: T.
        recording: the calibrated data, for the vertical and the dip.
        hard_iron: (3,) T, subtracted from the field before its dip is measured; None for 0.
        misalignment: uncertainty of the sensors' axes, which adds to that of heading.

    Returns:
        All directions whose standard deviation exceeds half its limit, worst first; not observable if one exceeds its
        limit.
    """
    return Assessor(soft_iron, field_strength, recording, hard_iron, misalignment).of(covariance)


def cells(direction: Array) -> Mask:
    """Return (60,) whether unit vectors (n, 3) visited each cell; the cells are ordered by band."""
    return np.bincount(cell_of(direction), minlength=_BANDS * _SECTORS) > 0


def cell_of(direction: Array) -> NDArray[np.intp]:
    """Return which of 60 cells of equal area each unit vector (n, 3) is in."""
    band = np.clip((_BANDS / 2 * (direction[:, 2] + 1)).astype(np.intp), 0, _BANDS - 1)
    turn = np.arctan2(direction[:, 1], direction[:, 0]) / (2 * np.pi) + 0.5
    cell: NDArray[np.intp] = _SECTORS * band + (turn * _SECTORS).astype(np.intp) % _SECTORS
    return cell


def _stretched(vech: Array) -> Array:
    """Return the axis (3,) along which a change of the soft iron, vech (6,), stretches most."""
    shape = np.zeros((3, 3))
    shape[np.triu_indices(3)] = vech
    value, vector = np.linalg.eigh(shape + shape.T)
    axis: Array = vector[:, np.argmax(np.abs(value))]
    return axis


def _rest_or_move(sigma: float) -> str:
    """Return the remedy for a gyroscope bias with a standard deviation of `sigma` mrad/s."""
    return "record longer, with some seconds at rest" if sigma < 1e3 else "move: nothing turned"


def _axis_name(axis: Array) -> str:
    """Return the name of an axis (3,): "z" if it is close to a sensor axis, else its components: "0.7 x + 0.7 y"."""
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    if np.abs(axis).max() > 0.95:
        return "xyz"[int(np.argmax(np.abs(axis)))]
    parts = [f"{a:+.1f} {n}" for a, n in zip(axis, "xyz", strict=True) if abs(a) > 0.15]
    return " ".join(parts).removeprefix("+").replace(" +", " + ").replace(" -", " − ").replace("-", "−")


def _vertical(recording: Recording) -> Array | None:
    """Return the mean direction (3,) of the specific force in the sensor frame; None if there is none."""
    if recording.acceleration is None:
        return None
    every = max(len(recording.acceleration) // _ROWS_FOR_VERTICAL, 1)
    mean = recording.acceleration[::every].mean(axis=0)
    norm = float(np.linalg.norm(mean))
    return mean / norm if norm > _LEAST_MEAN_FORCE else None


def _remedy(axis: Array, up: Array | None) -> str:
    """Return the motion that would determine the hard or soft iron along an axis (3,), given the vertical (3,)."""
    if up is None:
        across = [n for a, n in zip(axis, "xyz", strict=True) if abs(a) < 0.6] or ["all axes"]
        return f"turn about {' and '.join(across)} by 30° or more"
    along = abs(float(axis @ up))
    if along > 0.8:
        return "pitch or roll by 20° or more while turning"
    if along < 0.4:
        return "turn through all headings"
    return "turn through all headings, and pitch or roll by 20° or more"
