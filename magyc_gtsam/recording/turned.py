"""A gyroscope whose axes are not those of the magnetometer, brought into them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.recording.axes import axes_text, parse_axes
from magyc_gtsam.recording.checks import Array
from magyc_gtsam.recording.recording import Recording


def with_turned_gyroscope(recording: Recording, axes: Array) -> Recording:
    """Return the recording with the gyroscope in other axes: `axes` (3, 3) times its rate."""
    if recording.angular_rate is None:
        return recording
    together = axes @ parse_axes(recording.gyroscope_axes)
    return replace(recording, angular_rate=recording.angular_rate @ axes.T, gyroscope_axes=axes_text(together))


def in_magnetometer_axes(recording: Recording, axes: Array) -> Recording:
    """Return the recording with gyroscope and accelerometer, which share a chip, in the magnetometer's axes.

    Args:
        recording: as the sensors deliver it.
        axes: (3, 3) of `parse_axes`.
    """
    acceleration, notes = recording.acceleration, recording.notes
    if acceleration is not None and np.linalg.det(axes) < 0:
        # A mirrored gyroscope has other signs than its accelerometer, whose signs are then unknown.
        acceleration = None
        notes = (
            *notes,
            "acceleration left out: the gyroscope's axes mirror (gyroscope_axes=), and the accelerometer's are unknown",
        )
    return replace(
        with_turned_gyroscope(recording, axes),
        acceleration=None if acceleration is None else acceleration @ axes.T,
        notes=notes,
    )
