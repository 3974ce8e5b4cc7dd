"""The next move: which turn of the vehicle, from where it is, shows the sensor most of the directions not seen yet."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from magyc_gtsam.online.coverage import cell_of
from magyc_gtsam.recording import Array, Mask

_TILTS = (0.0, 20.0, 45.0, 90.0)  # deg, either way; less than 20° is not done by hand
_STEP = 5.0  # deg of the turn between two looks
_EFFORT = 20.0  # deg of tilt that must gain one more cell of the sixty
_LEAST = 2  # cells that a move must gain
_NAMES = {"x": "roll", "y": "pitch"}


@dataclass(frozen=True)
class NextMove:
    """A tilt about one of the sensor's axes, by the right-hand rule, then one turn about its z axis.

    Attributes:
        axis: "x" or "y", "" for no tilt.
        degrees: of the tilt.
        gain: cells of the sixty that are seen on the way and were not before.
    """

    axis: str
    degrees: float
    gain: int

    @property
    def sentence(self) -> str:
        """One line."""
        if not self.axis:
            return "turn once about z"
        way = "+" if self.degrees > 0 else "−"
        return f"{_NAMES[self.axis]} by {way}{abs(self.degrees):.0f}° about {self.axis}, then turn once about z"

    def to_dict(self) -> dict[str, Any]:
        """JSON types."""
        return asdict(self) | {"sentence": self.sentence}


def next_move(now: Array, seen: Mask) -> NextMove | None:
    """The move that gains most.

    A vehicle that turns by φ about an axis of its own turns the field in its axes by −φ. The tilt comes first, from the
    present attitude; the turn goes on from there.

    Args:
        now: (3,) unit vector, the calibrated field in sensor axes.
        seen: (60,) as `coverage.cells`.

    Returns:
        None where no move gains two cells.
    """
    best, most = None, 0.0
    for axis in ("x", "y"):
        for degrees in sorted({sign * tilt for tilt in _TILTS for sign in (1.0, -1.0)}, key=abs):
            path = _path(now, "xyz".index(axis), degrees)
            gain = int((~seen[np.unique(cell_of(path))]).sum())
            score = gain - abs(degrees) / _EFFORT
            if gain >= _LEAST and score > most:
                best, most = NextMove(axis if degrees else "", degrees, gain), score
    return best


def _path(now: Array, axis: int, degrees: float) -> Array:
    """(n, 3) directions of the field on the way."""
    count = max(int(abs(degrees) // _STEP), 1)
    tilted = _about(now[None], axis, -np.radians(np.linspace(0.0, degrees, count + 1)))
    turned = _about(tilted[-1:], 2, -np.radians(np.arange(0.0, 360.0, _STEP)))
    return np.vstack([tilted, turned])


def _about(vector: Array, axis: int, angle: Array) -> Array:
    """(n, 3): one vector (1, 3) turned by each angle, rad, about a coordinate axis."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    result = np.repeat(vector, len(angle), axis=0)
    result[:, a] = np.cos(angle) * vector[0, a] - np.sin(angle) * vector[0, b]
    result[:, b] = np.sin(angle) * vector[0, a] + np.cos(angle) * vector[0, b]
    return result
