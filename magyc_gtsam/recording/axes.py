"""A gyroscope whose axes are not those of the magnetometer, brought into them."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import Array
from magyc_gtsam.recording.recording import Recording

_AXIS = re.compile(r"^(?:[xyz]\s*(?:←|<-|=)\s*)?([+−-]?)\s*([xyz])$")


def parse_axes(text: str) -> Array:
    """Return the matrix (3, 3) from the gyroscope's axes to the magnetometer's.

    Args:
        text: the gyroscope's signed axes along x, y, z: "y,-x,z" or "x ← y, y ← −x, z ← z".

    Raises:
        MagycError: the text does not name each axis once.
    """
    parts = [_AXIS.match(part.strip().lower()) for part in text.split(",")] if isinstance(text, str) else []
    matches = [match for match in parts if match]
    if len(parts) != 3 or sorted(match[2] for match in matches) != ["x", "y", "z"]:
        raise MagycError(f"gyroscope axes: must name x, y and z once each, such as 'y,-x,z', got {text!r:.60}")
    matrix = np.zeros((3, 3))
    for row, match in enumerate(matches):
        matrix[row, "xyz".index(match[2])] = -1.0 if match[1] in ("-", "−") else 1.0
    return matrix


def in_magnetometer_axes(recording: Recording, axes: Array) -> Recording:
    """Return the recording with gyroscope and accelerometer, which share a chip, in the magnetometer's axes.

    Args:
        recording: as the sensors deliver it.
        axes: (3, 3) of `parse_axes`.
    """
    rate, acceleration, notes = recording.angular_rate, recording.acceleration, recording.notes
    if acceleration is not None and np.linalg.det(axes) < 0:
        # A mirrored gyroscope has other signs than its accelerometer, whose signs are then unknown.
        acceleration = None
        notes = (
            *notes,
            "acceleration left out: the gyroscope's axes mirror (gyroscope_axes=), and the accelerometer's are unknown",
        )
    return replace(
        recording,
        angular_rate=None if rate is None else rate @ axes.T,
        acceleration=None if acceleration is None else acceleration @ axes.T,
        notes=notes,
    )
