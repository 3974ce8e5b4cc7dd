"""The axes of a gyroscope along those of the magnetometer, as text and as a matrix."""

from __future__ import annotations

import re

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import Array

OWN_AXES = "x,y,z"  # of a gyroscope that is left as it is delivered
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


def axes_text(axes: Array) -> str:
    """Return the text, such as "y,-x,z", of which `parse_axes` makes these axes (3, 3), whatever their scale."""
    columns = np.abs(axes).argmax(axis=1)
    return ",".join("-" * bool(row[k] < 0) + "xyz"[k] for row, k in zip(axes, columns, strict=True))
