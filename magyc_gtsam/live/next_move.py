"""The move that shows the sensor most of the directions of the field that it has not seen."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from magyc_gtsam.observability import cell_of
from magyc_gtsam.recording import Array, Mask

_TILTS = (0.0, 20.0, 45.0, 90.0)  # deg, in both directions; smaller tilts are hard to do by hand
_STEP = 5.0  # deg between evaluated attitudes
_EFFORT = 20.0  # deg of tilt that must gain one more cell
_LEAST = 2  # smallest number of cells that a move must gain
_NAMES = {"x": "roll", "y": "pitch"}


@dataclass(frozen=True)
class NextMove:
    """A tilt about one of the sensor's axes, by the right-hand rule, followed by a turn about its z axis.

    Attributes:
        axis: axis of the tilt, "x" or "y"; "" without tilt.
        degrees: angle of the tilt.
        gain: number of new cells, of sixty, that the move shows.
    """

    axis: str
    degrees: float
    gain: int

    @property
    def sentence(self) -> str:
        """The move as an instruction."""
        if not self.axis:
            return "turn once about z"
        sign = "+" if self.degrees > 0 else "−"
        return f"{_NAMES[self.axis]} by {sign}{abs(self.degrees):.0f}° about {self.axis}, then turn once about z"

    def to_dict(self) -> dict[str, Any]:
        """Return the move as JSON types."""
        return asdict(self) | {"sentence": self.sentence}


def next_move(now: Array, seen: Mask) -> NextMove | None:
    """Return the move that gains most, or None if no move gains two cells.

    A rotation of the vehicle by φ about one of its axes rotates the field in its axes by −φ. The tilt starts from the
    present attitude, and the turn from the tilted one.

    Args:
        now: (3,) unit vector, the calibrated field in sensor axes.
        seen: (60,) whether each cell was visited, as from `cells`.
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
    """Return the directions (n, 3) of the field during a move."""
    count = max(int(abs(degrees) // _STEP), 1)
    tilted = _about(now[None], axis, -np.radians(np.linspace(0.0, degrees, count + 1)))
    turned = _about(tilted[-1:], 2, -np.radians(np.arange(0.0, 360.0, _STEP)))
    return np.vstack([tilted, turned])


def _about(vector: Array, axis: int, angle: Array) -> Array:
    """Return one vector (1, 3) rotated by each angle, rad, about a coordinate axis, (n, 3)."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    result = np.repeat(vector, len(angle), axis=0)
    result[:, a] = np.cos(angle) * vector[0, a] - np.sin(angle) * vector[0, b]
    result[:, b] = np.sin(angle) * vector[0, a] + np.cos(angle) * vector[0, b]
    return result
