"""The numbers behind the report's figures: from a recording and its calibration to what a navigator asks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.metrics import heading_error
from magyc_gtsam.recording import Array, Recording

DISTURBED_WEIGHT = 0.5  # a window whose robust weight is below counts as disturbed
_CELLS = (24, 12)  # of the coverage map: longitude × latitude, all of the same area


@dataclass(frozen=True, eq=False)
class FieldHistory:
    """The magnetometer's own samples, before and after.

    Attributes:
        time: (n,) s since the first row.
        raw, calibrated: (n, 3) T, sensor axes.
        aligned: (n, 3) T, the calibrated field at the instants of the references, its delay taken out.
        strength: T, of the calibrated field.
        up: (n, 3) unit vertical in sensor axes, rows of NaN where unknown; None without any reference.
        up_from: where the vertical is from, in words; "" without any reference.
        heading_error: (n, 2) deg, magnetic heading minus reference heading, raw and calibrated, each
            about its own mean; None without a reference attitude.
    """

    time: Array
    raw: Array
    calibrated: Array
    aligned: Array
    strength: float
    up: Array | None
    up_from: str
    heading_error: Array | None


@dataclass(frozen=True, eq=False)
class LevelTurn:
    """What the calibration does to heading while the vehicle turns level.

    Attributes:
        heading: (n,) deg, 0 to 360.
        error: (n,) deg, of the heading from the raw field.
        sigma: (n,) deg, of the heading from the calibrated field, by the covariance; None without one.
        inclination: deg, angle of the field below the horizontal.
        about: what the vehicle turns about.
    """

    heading: Array
    error: Array
    sigma: Array | None
    inclination: float
    about: str


@dataclass(frozen=True, eq=False)
class Coverage:
    """How long the field pointed where, in sensor axes.

    Attributes:
        longitude: (25,) rad, cell edges about the z axis, from x towards y.
        sine: (13,) sine of the latitude, cell edges from −z to +z.
        seconds: (12, 24) s per cell, all cells of the same area.
    """

    longitude: Array
    sine: Array
    seconds: Array

    @property
    def share(self) -> float:
        """Share of the directions that were visited."""
        return float((self.seconds > 0).mean())

    @property
    def middle(self) -> int:
        """1 where the field pointed to the side of +z most of the time, else −1."""
        return 1 if (self.sine[:-1] + self.sine[1:]) @ self.seconds.sum(axis=1) > 0 else -1


def field_history(recording: Recording, calibration: Calibration) -> FieldHistory:
    """The field before and after, with the references the recording has for it."""
    fresh = recording.magnetic_field_fresh
    time, raw = recording.magnetometer
    calibrated = calibration.apply(raw)
    strength = calibration.field_strength
    if strength is None:
        strength = float(np.median(np.linalg.norm(calibrated, axis=1)))
    aligned = calibrated
    if calibration.delay:  # the field at an instant is what the magnetometer says `delay` later
        later = time + calibration.delay
        aligned = np.stack([np.interp(later, time, axis) for axis in calibrated.T], axis=1)
    attitude = None if recording.attitude is None else recording.attitude[fresh]
    acceleration = None if recording.acceleration is None else recording.acceleration[fresh]
    if attitude is not None and not np.isfinite(attitude).any():
        attitude = None
    up, up_from = _up(attitude, acceleration)
    error = None
    if attitude is not None:
        error = np.degrees(np.column_stack([heading_error(field, attitude) for field in (raw, aligned)]))
    since = time - recording.time[0]
    return FieldHistory(since, raw, calibrated, aligned, strength, up, up_from, error)


def _up(attitude: Array | None, acceleration: Array | None) -> tuple[Array | None, str]:
    if attitude is not None:
        up = np.full((len(attitude), 3), np.nan)
        known = np.isfinite(attitude).all(axis=1)
        up[known] = Rotation.from_quat(attitude[known]).inv().apply([0.0, 0.0, 1.0])
        if acceleration is None:
            return up, "attitude, whose z axis is taken as up"
        downwards = np.nanmedian((up * acceleration).sum(axis=1)) < 0
        return (-up if downwards else up), "attitude"
    if acceleration is not None:
        norm = np.linalg.norm(acceleration, axis=1, keepdims=True)
        return acceleration / np.where(norm > 0, norm, np.nan), "accelerometer"
    return None, ""


def inclination(field: Array, up: Array) -> Array:
    """Angle of `field` below the horizontal, deg."""
    sine = -(field * up).sum(axis=1) / np.linalg.norm(field, axis=1)
    return cast(Array, np.degrees(np.arcsin(np.clip(sine, -1, 1))))


def level_turn(calibration: Calibration, history: FieldHistory) -> LevelTurn:
    """Heading error over a level turn: of the raw field, and what the covariance leaves."""
    axis, about = np.array([0.0, 0.0, 1.0]), "the sensor's z axis"
    if history.up is None:
        if np.median(history.calibrated[:, 2]) > 0:  # the northern half of the Earth
            axis = -axis
        up = np.broadcast_to(axis, history.raw.shape)
    else:
        up = history.up
        mean = np.nanmean(up, axis=0)
        if np.linalg.norm(mean) > 0.5:  # else the instrument was tumbled, and no axis was the vertical
            axis, about = mean / np.linalg.norm(mean), "the mean vertical of this recording"
    dip = np.radians(np.nanmedian(inclination(history.aligned, up)))
    forward = np.eye(3)[np.abs(axis).argmin()] if abs(axis[0]) > 0.9 else np.array([1.0, 0.0, 0.0])
    forward = forward - axis * (axis @ forward)
    forward /= np.linalg.norm(forward)
    left = np.cross(axis, forward)

    heading = np.radians(np.arange(0.0, 361.0, 3.0))
    horizontal = np.cos(heading)[:, None] * forward + np.sin(heading)[:, None] * left
    field = history.strength * (np.cos(dip) * horizontal - np.sin(dip) * axis)
    raw = field @ calibration.soft_iron.T + calibration.hard_iron
    error = np.angle(np.exp(1j * (np.arctan2(raw @ left, raw @ forward) - heading)))
    sigma = None
    if calibration.covariance is not None:
        sideways = -np.sin(heading)[:, None] * forward + np.cos(heading)[:, None] * left
        # A calibration error (dA, dh) leaves −A⁻¹ (dA u + dh) in the field u.
        through = -sideways @ np.linalg.inv(calibration.soft_iron) / (history.strength * np.cos(dip))
        symmetric = _symmetric_units()
        jacobian = np.hstack([np.einsum("ni,jik,nk->nj", through, symmetric, field), through])
        variance = np.einsum("ni,ij,nj->n", jacobian, calibration.covariance[:9, :9], jacobian)
        sigma = np.degrees(np.sqrt(np.clip(variance, 0, None)))
    return LevelTurn(np.degrees(heading), np.degrees(error), sigma, float(np.degrees(dip)), about)


def _symmetric_units() -> Array:
    """(6, 3, 3): the derivative of a symmetric matrix by its upper triangle, row by row."""
    units = np.zeros((6, 3, 3))
    for unit, i, j in zip(units, *np.triu_indices(3), strict=True):
        unit[i, j] = unit[j, i] = 1.0
    return units


def coverage(time: Array, field: Array) -> Coverage:
    """How long `field` (n, 3) pointed where."""
    unit = field / np.linalg.norm(field, axis=1, keepdims=True)
    longitude = np.linspace(-np.pi, np.pi, _CELLS[0] + 1)
    sine = np.linspace(-1, 1, _CELLS[1] + 1)
    visits, _, _ = np.histogram2d(unit[:, 2], np.arctan2(unit[:, 1], unit[:, 0]), bins=(sine, longitude))
    return Coverage(longitude, sine, visits * float(np.median(np.diff(time))))


def ellipsoid_outline(matrix: Array, centre: Array, plane: tuple[int, int]) -> Array:
    """(121, 2): outline of {matrix x + centre, ‖x‖ = 1} seen along the axis that `plane` leaves out."""
    axes = list(plane)
    silhouette = np.linalg.cholesky((matrix @ matrix.T)[np.ix_(axes, axes)])
    angle = np.linspace(0, 2 * np.pi, 121)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return cast(Array, circle @ silhouette.T + centre[axes])


def disturbed_stretches(time: Array, weight: Array) -> list[tuple[float, float]]:
    """(start, end) of the stretches whose windows have low weight; neighbours three windows apart are one."""
    low: NDArray[np.int_] = np.flatnonzero(weight < DISTURBED_WEIGHT)
    if not len(low):
        return []
    half = float(np.median(np.diff(time))) / 2
    groups = np.split(low, np.flatnonzero(np.diff(low) > 3) + 1)
    return [(max(float(time[g[0]]) - half, 0.0), float(time[g[-1]]) + half) for g in groups]


def summary(time: Array, value: Array, most: int = 600) -> tuple[Array, Array, Array, Array]:
    """(time, mean, lowest, highest) of at most `most` stretches of equally many samples, NaN left out."""
    per_bin = -(-len(time) // most)
    bins = len(time) // per_bin
    blocks = value[: bins * per_bin].reshape(bins, per_bin)
    known = np.isfinite(blocks)
    count = known.sum(axis=1)
    mean = np.where(count > 0, np.where(known, blocks, 0).sum(axis=1) / np.maximum(count, 1), np.nan)
    lowest = np.where(count > 0, np.where(known, blocks, np.inf).min(axis=1), np.nan)
    highest = np.where(count > 0, np.where(known, blocks, -np.inf).max(axis=1), np.nan)
    return time[: bins * per_bin].reshape(bins, per_bin).mean(axis=1), mean, lowest, highest


def spread(field: Array, cube: float, most: int = 3000) -> NDArray[np.int_]:
    """Rows of `field` (n, 3) to draw: one per cube of that side, so that time at rest hides no motion."""
    cells = np.floor(field / cube).astype(np.int64)
    cells -= cells.min(axis=0)
    cell = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, first = np.unique(cell, return_index=True)
    return first[:: -(-len(first) // most)]
