"""The identity of a recording by its samples, so that no estimate counts the same samples twice."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from magyc_gtsam.recording.recording import Recording

_DIGITS = 16  # hexadecimal, 64 bits: two of a million logs agree by chance with a probability of 3·10⁻⁸


def fingerprint(recording: Recording) -> str:
    """Return a checksum of the magnetometer's samples, the same under any name and with any clock."""
    return sha256(recording.magnetic_field.tobytes()).hexdigest()[:_DIGITS]


def same_samples(one: Recording, other: Recording) -> bool:
    """Return whether more than half of the magnetometer's samples of the shorter recording are in the other."""
    vector = np.dtype([(axis, np.float64) for axis in "xyz"])
    first, second = (
        np.unique(np.ascontiguousarray(each.magnetic_field).view(vector).ravel()) for each in (one, other)
    )
    return 2 * len(np.intersect1d(first, second, assume_unique=True)) > min(len(first), len(second))
