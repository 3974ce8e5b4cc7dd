"""Whether the two sensors' axes, signs and units agree: checked before a misfit is called noise.

Field fixed in the world ⇒ ṁ = −(G ω) × (m − h) with G = I where magnetometer and gyroscope agree. Breakout
boards and drivers deliver signed permutations of each other's axes (48 of them, 24 of which change the
handedness), or degrees for radians.
"""

from __future__ import annotations

from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording

_PAIRS = 3000  # pairs of samples that are compared
_LAG = 0.12  # s between the samples of a pair; the rotation must stay small
_CLEARLY = 0.5  # share of the squared misfit below which another arrangement is clearly better
_EXPLAINS = 0.3  # share of the field's variation that an arrangement must leave unexplained at most

_SCALES = {"": 1.0, "deg/s": np.pi / 180, "rad/s read as deg/s": 180 / np.pi}


class Arrangement(NamedTuple):
    """ω = matrix · (angular_rate of the log), and the share of the field's variation it leaves unexplained."""

    matrix: Array
    unit: str
    unexplained: float

    @property
    def axes(self) -> str:
        """How to read the gyroscope in the magnetometer's axes, e.g. "x ← −y, y ← x, z ← z"."""
        parts = []
        for name, row in zip("xyz", np.sign(self.matrix), strict=True):
            column = int(np.argmax(np.abs(row)))
            parts.append(f"{name} ← {'−' if row[column] < 0 else ''}{'xyz'[column]}")
        return ", ".join(parts)


def arrangements(recording: Recording) -> list[Arrangement]:
    """All signed permutations and units of the gyroscope, the best first."""
    change, mid, turn, step = _pairs(recording)
    matrices = [
        (np.eye(3)[list(order)] * np.array(signs)[:, None] * scale, unit)
        for unit, scale in _SCALES.items()
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    total = float(np.einsum("ni,ni->", change, change))
    found = []
    for matrix, unit in matrices:
        # Δm = m × Gθ − h × Gθ − m × b' Δt + c Δt: linear in h, b' and c.
        rotation = turn @ matrix.T
        design = np.zeros((len(change), 3, 9))
        design[:, :, :3] = _skew(rotation)
        design[:, :, 3:6] = -_skew(mid) * step[:, None, None]
        design[:, :, 6:] = np.eye(3) * step[:, None, None]
        target = (change - np.cross(mid, rotation)).ravel()
        flat = design.reshape(-1, 9)
        scale = np.linalg.norm(flat, axis=0) + 1e-300
        solution = np.linalg.lstsq(flat / scale, target, rcond=None)[0]
        misfit = target - flat / scale @ solution
        found.append(Arrangement(matrix, unit, float(misfit @ misfit) / max(total, 1e-300)))
    return sorted(found, key=lambda a: a.unexplained)


def check(recording: Recording) -> None:
    """Compare the arrangements.

    Raises:
        MagycError: another arrangement than the given one explains the field's variation clearly better.
    """
    ranked = arrangements(recording)
    best = ranked[0]
    given = next(a for a in ranked if not a.unit and np.array_equal(a.matrix, np.eye(3)))
    if best.unexplained > _EXPLAINS or best.unexplained > _CLEARLY * given.unexplained:
        return
    if best.unit:
        raise MagycError(
            f"angular_rate: read as {best.unit} it explains the field's changes ({1 - best.unexplained:.0%}, as given "
            f"{max(1 - given.unexplained, 0):.0%}); convert it, or say the unit (--angular-unit)"
        )
    raise MagycError(
        f"the axes of gyroscope and magnetometer disagree: as given the gyroscope explains "
        f"{max(1 - given.unexplained, 0):.0%} of the field's changes, with {best.axes} {1 - best.unexplained:.0%}; "
        f"bring both to one frame (--gyroscope-axes)"
    )


def _pairs(recording: Recording) -> tuple[Array, Array, Array, Array]:
    """Change and middle of the field (n, 3), rotation vector in between (n, 3), and the time step (n,)."""
    time, field = recording.magnetometer
    gyro_time, rate = recording.gyroscope
    lag = max(int(round(_LAG / float(np.median(np.diff(time))))), 1)
    first = np.arange(0, len(time) - lag, max((len(time) - lag) // _PAIRS, 1))
    step = time[first + lag] - time[first]
    angle = np.zeros((len(gyro_time), 3))
    np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(gyro_time)[:, None], axis=0, out=angle[1:])
    at = np.stack([np.interp(time, gyro_time, column) for column in angle.T], axis=1)
    turn = at[first + lag] - at[first]
    kept = step < 3 * float(np.median(step))
    change, mid = field[first + lag] - field[first], 0.5 * (field[first + lag] + field[first])
    return change[kept], mid[kept], turn[kept], step[kept]


def _skew(vector: Array) -> Array:
    x, y, z = vector.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
