"""A level turn, and the effect of calibration errors on heading over it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.rotations import cross, exponential_matrices
from magyc_gtsam.factors.chain.small import inverse
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS
from magyc_gtsam.recording import Array, Recording

_MOST_ROWS = 1000  # largest number of rows used for the vertical and the dip
_UPRIGHT = 0.5  # length of the mean vertical above which the vehicle has an axis that points up
_DEFAULT_DIP = 60.0  # deg, as in middle latitudes; used if the recording shows no vertical
# Ratio of the two smallest variances of the field below which it sweeps about an axis. Simulated at dips of 20, 60 and
# 85°: 0.001 to 0.06 on ships, cars and multirotors, 0.03 to 0.33 on a diving vehicle, 0.31 to 0.96 in a hand.
_FLAT = 0.1
TILT = 20.0  # deg, of a vehicle that is not level
_STEPS = 120  # number of headings of a turn
_HEADING = np.linspace(0.0, 360.0, _STEPS + 1)
_HEADING.flags.writeable = False
_COSINE, _SINE = np.cos(np.radians(_HEADING))[:, None], np.sin(np.radians(_HEADING))[:, None]


class MisalignmentError(NamedTuple):
    """The uncertainty of the sensors' axes, which adds to that of heading.

    Attributes:
        covariance: (3, 3) rad² of the rotation between magnetometer and gyroscope.
        cross: (9, 3) covariance of vech(soft_iron) and hard_iron (T) with the rotation.
        gyroscope: (12, 12) covariance to be added to that of vech(soft_iron), hard_iron and the rotation: the error by
            axes of the gyroscope that are not at right angles.
    """

    covariance: Array
    cross: Array
    gyroscope: Array

    @classmethod
    def of(cls, diagnostics: Mapping[str, Any]) -> MisalignmentError | None:
        """Return the uncertainty in a calibration's diagnostics; None if the method did not estimate it."""
        skew, gyroscope = diagnostics.get("skew"), diagnostics.get("gyroscope_axes")
        if skew is None and gyroscope is None:
            return None
        skew = {"covariance": np.zeros((3, 3)), "cross": np.zeros((9, 3))} if skew is None else skew
        gyroscope = np.zeros((12, 12)) if gyroscope is None else gyroscope
        return cls(np.array(skew["covariance"]), np.array(skew["cross"]), np.array(gyroscope))


@dataclass(frozen=True, eq=False)
class LevelTurn:
    """A level turn through all headings in the field of a recording.

    Attributes:
        heading: (n,) deg, 0 to 360.
        field: (n, 3) T, true field in sensor axes.
        ahead, left: (3,) unit vectors in sensor axes at heading 0.
        dip: deg, angle of the field below the horizontal.
        about: the axis of the turn, in words.
    """

    heading: Array
    field: Array
    ahead: Array
    left: Array
    dip: float
    about: str

    def raw_error(self, soft_iron: Array, hard_iron: Array) -> Array:
        """Return the heading error (n,) deg of the uncalibrated compass."""
        return self.error(self.field @ soft_iron.T + hard_iron)

    def error(self, field: Array) -> Array:
        """Return the heading error (n,) deg of a field (n, 3) that is measured on this turn."""
        angle = np.arctan2(field @ self.left, field @ self.ahead) - np.radians(self.heading)
        return cast(Array, np.degrees(np.angle(np.exp(1j * angle))))

    def systematic(
        self, covariance: Array, soft_iron: Array, misalignment: MisalignmentError | None = None
    ) -> Array:
        """Return the standard deviation (n,) deg of heading due to the calibration's covariance, shared by all samples.

        A calibration error (dA, dh) changes the field u by −A⁻¹ (dA u + dh), a rotation error dε by u × dε. The
        component of the change across the horizontal field turns the heading.

        Args:
            covariance: (9, 9) or (12, 12) of vech(soft_iron), hard_iron and gyro_bias.
            soft_iron: (3, 3) A.
            misalignment: uncertainty of the sensors' axes.
        """
        return self.spread(covariance, self.slopes(soft_iron), misalignment)

    def tilted(self) -> list[LevelTurn]:
        """Return the turn with the vehicle pitched and rolled by ±`TILT`, through the same headings."""
        axes = np.radians(TILT) * np.stack([self.left, -self.left, self.ahead, -self.ahead], axis=1)
        return [
            replace(self, field=self.field @ turn, ahead=self.ahead @ turn, left=self.left @ turn)
            for turn in np.moveaxis(exponential_matrices(axes), 2, 0)
        ]

    def slopes(self, soft_iron: Array) -> Array:
        """Return the derivative (n, 9) of heading, rad, with respect to vech(soft_iron) and hard_iron."""
        gain = self._gain(soft_iron)
        of_matrix = (gain[:, :, None] * self.field[:, None, :]).reshape(-1, 9)
        return np.hstack([of_matrix @ SYMMETRIC_UNITS.reshape(6, 9).T, gain])

    def spread(self, covariance: Array, slopes: Array, misalignment: MisalignmentError | None = None) -> Array:
        """Return the result of `systematic`, from given `slopes` of the soft iron."""
        whole = covariance[:9, :9]
        if misalignment is not None:
            slopes, whole = np.hstack([slopes, -self.turned]), misalignment.gyroscope.copy()
            whole[:9, :9] += covariance[:9, :9]
            whole[9:, 9:] += misalignment.covariance
            whole[:9, 9:] += misalignment.cross
            whole[9:, :9] += misalignment.cross.T
        variance = np.einsum("na,na->n", slopes @ whole, slopes)
        return cast(Array, np.degrees(np.sqrt(np.maximum(variance, 0.0))))

    def per_sample(self, noise: float, soft_iron: Array) -> Array:
        """Return the standard deviation (n,) deg of heading of one sample with `noise` T per axis."""
        return cast(Array, np.degrees(noise * np.linalg.norm(self._gain(soft_iron), axis=1)))

    def _gain(self, soft_iron: Array) -> Array:
        """Return the derivative (n, 3) rad/T of heading with respect to the measured field."""
        return self._across @ inverse(soft_iron)

    @cached_property
    def turned(self) -> Array:
        """Derivative (n, 3) of heading, rad, with respect to a rotation between magnetometer and gyroscope."""
        return cross(self._across.T, self.field.T).T

    @cached_property
    def _across(self) -> Array:
        """Derivative (n, 3) rad/T of heading with respect to the calibrated field."""
        angle = np.radians(self.heading)[:, None]
        sideways = np.cos(angle) * self.left - np.sin(angle) * self.ahead
        horizontal = np.linalg.norm(self.field[0]) * np.cos(np.radians(self.dip))
        return cast(Array, sideways / horizontal)


def level_turn(recording: Recording, soft_iron: Array, hard_iron: Array, strength: float) -> LevelTurn:
    """Return a level turn in a field of `strength` T, with the vertical and the dip of the recording.

    Without an accelerometer or an attitude the vertical is the axis about which the field sweeps, as it does on a
    vehicle that turns more than it tilts. The turn is about the sensor's z axis if the recording has no mean vertical;
    the dip is 60° if it shows no vertical at all.
    """
    rows = slice(None, None, max(len(recording.time) // _MOST_ROWS, 1))
    field = calibrated(recording.magnetic_field[rows], soft_iron, hard_iron)
    up = vertical(
        None if recording.attitude is None else recording.attitude[rows],
        None if recording.acceleration is None else recording.acceleration[rows],
    )
    axis, about, dip = None, "the sensor's z axis", _DEFAULT_DIP
    known = np.zeros(0, dtype=bool) if up is None else np.isfinite(up[:, 0])
    if up is not None and known.any():
        up, seen = (up, field) if known.all() else (up[known], field[known])
        mean = up.mean(axis=0)
        if np.linalg.norm(mean) > _UPRIGHT:  # otherwise the instrument was tumbled and no axis stayed vertical
            axis, about = mean / np.linalg.norm(mean), "the mean vertical of this recording"
        dip = median(inclination(seen, up))
    elif (swept := _swept_about(field)) is not None:
        axis, about = swept, "the axis that the field sweeps about"
        dip = median(inclination(field, np.broadcast_to(swept, field.shape)))
    if axis is None:  # the field points down on the northern hemisphere
        axis = np.array([0.0, 0.0, -1.0 if np.median(field[:, 2]) > 0 else 1.0])
    dip = min(max(dip, -85.0), 85.0)  # at a steeper dip heading has no meaning
    ahead = np.eye(3)[np.abs(axis).argmin()] if abs(axis[0]) > 0.9 else np.array([1.0, 0.0, 0.0])
    ahead = ahead - axis * (axis @ ahead)
    ahead /= np.linalg.norm(ahead)
    left = cross(axis, ahead)
    horizontal = _COSINE * ahead + _SINE * left
    sine, cosine = np.sin(np.radians(dip)), np.cos(np.radians(dip))
    return LevelTurn(_HEADING, strength * (cosine * horizontal - sine * axis), ahead, left, dip, about)


def _swept_about(field: Array) -> Array | None:
    """Return the upward unit axis (3,) about which a field (n, 3) sweeps; None if it sweeps about no single one.

    The field is taken to point down, as on the northern hemisphere; the other sign turns the other way round.
    """
    mean = field.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov(field - mean, rowvar=False))
    if not spread[0] < _FLAT * spread[1]:
        return None
    axis = axes[:, 0]
    return cast(Array, -axis if axis @ mean > 0 else axis)


def calibrated(field: Array, soft_iron: Array, hard_iron: Array) -> Array:
    """Return the calibrated field soft_iron⁻¹ (field − hard_iron), (n, 3) T."""
    return cast(Array, (field - hard_iron) @ inverse(soft_iron).T)


def vertical(attitude: Array | None, acceleration: Array | None) -> Array | None:
    """Return the unit vertical (n, 3) in sensor axes, from the attitude or else the accelerometer; NaN where unknown.

    Args:
        attitude: (n, 4) quaternions x, y, z, w, sensor→world.
        acceleration: (n, 3) m/s².

    Returns:
        None if neither holds a finite value.
    """
    if attitude is not None and np.isfinite(attitude).any():
        x, y, z, w = np.ascontiguousarray(attitude.T)
        across, along = x * x + y * y, z * z + w * w
        # The world's z axis in sensor axes: the last row of the rotation matrix.
        up = (np.array([2 * (x * z - w * y), 2 * (y * z + w * x), along - across]) / (across + along)).T
        if acceleration is not None:
            upright = _dot(up, acceleration)
            if np.count_nonzero(upright < 0) > np.count_nonzero(upright > 0):
                up = -up
        return up
    if acceleration is not None:
        norm = np.linalg.norm(acceleration, axis=1, keepdims=True)
        if (norm > 0).any():  # zeros or NaN mean that it was not measured
            return acceleration / np.where(norm > 0, norm, np.nan)
    return None


def inclination(field: Array, up: Array) -> Array:
    """Return the angle (n,) deg of `field` (n, 3) below the horizontal, with the vertical `up` (n, 3)."""
    sine = -_dot(field, up) / np.sqrt(_dot(field, field))
    return cast(Array, np.degrees(np.arcsin(np.minimum(np.maximum(sine, -1.0), 1.0))))


def _dot(first: Array, second: Array) -> Array:
    """Return the products (n,) of vectors (n, 3)."""
    (a, b, c), (x, y, z) = first.T, second.T
    return cast(Array, a * x + b * y + c * z)
