"""Detection of steps in the measured field that rotation does not explain: a magnet attached, a current switched on.

No calibration is needed. Over half a second the field, rotated into fixed axes by the gyroscope, changes by
(R' − R) h, with h the hard iron (Troni and Whitcomb 2019, eq. 14, summed over a window). h is fitted to the seconds
before and to the seconds after; the residual contains soft iron, noise and, where it is an outlier, a jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.estimators.hard_iron.turning import turning_field
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.checks import EARTH_FIELD

_BIN = 0.25  # s
_LEAST = 0.2  # share of the median field strength; a change of this size spoils a calibration
_OUTSTANDING = 8.0  # multiple of the residual's spread over the whole recording
_MOST = 4  # jumps; with more, the field is taken to vary continuously
_LOCAL, _APART = 10.0, 1.0  # s, length of a fit of h, and its distance from the change
_USUAL, _NOISE = 100e-6, 1e-6  # T, prior standard deviation of the hard iron, and the noise of a bin
_STRETCH = 1.5  # factor by which a strong soft iron stretches the field along an axis
_FEW = 0.5  # % of the samples at either end of the range, which may be faulty


@dataclass(frozen=True)
class FieldJump:
    """A step of the field: `time` s since the first row, `size` T in any direction."""

    time: float
    size: float


def field_jumps(recording: Recording) -> tuple[FieldJump, ...]:
    """Return the jumps of a recording in order of time.

    There are none without a gyroscope, or where more than `_MOST` stretches exceed the limit.
    """
    if recording.angular_rate is None:
        return ()
    try:
        samples = turning_field(recording)
    except MagycError:  # too short to hold a jump
        return ()
    time, still, turned = _binned(samples.time, samples.rotation, samples.field)
    if len(time) < 20:
        return ()
    change, turn = turned[2:] - turned[:-2], still[2:] - still[:-2]
    close = time[2:] - time[:-2] < 3 * _BIN
    change, turn, middle = change[close], turn[close], time[1:-1][close]
    if not len(middle):  # the sampling rate is too low to detect jumps
        return ()
    left = _unexplained(middle, change, turn)
    spread = float(np.median(left)) / 1.538  # the median of |x| for three normal components of unit variance
    limit = max(_LEAST * float(np.median(np.linalg.norm(samples.field, axis=1))), _OUTSTANDING * spread)
    over = np.flatnonzero(left > limit)
    if not len(over):
        return ()
    groups = np.split(over, np.flatnonzero(np.diff(middle[over]) > 4 * _BIN) + 1)
    if len(groups) > _MOST:
        return ()
    peaks = [group[np.argmax(left[group])] for group in groups]
    return tuple(FieldJump(float(middle[k] - recording.time[0]), float(left[k])) for k in peaks)


def beyond_turning(recording: Recording, strength: float | None = None) -> float | None:
    """Return the field's range (T) along its widest axis, if larger than rotation can cause.

    None if rotation can explain the range, in the Earth's field or in one of the calibrated `strength` in T.
    """
    low, high = np.percentile(recording.magnetic_field, (_FEW, 100 - _FEW), axis=0)
    swept = float(np.max(high - low))
    return swept if swept > 2 * _STRETCH * max(EARTH_FIELD[1], strength or 0.0) else None


def _binned(time: Array, rotation: Array, field: Array) -> tuple[Array, Array, Array]:
    """Return time (n,) s, mean rotation (n, 3, 3) and mean field (n, 3) in fixed axes, of non-empty `_BIN` s bins."""
    number = np.floor((time - time[0]) / _BIN).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(starts, append=len(time))[:, None]
    fixed = np.einsum("nij,nj->ni", rotation, field)
    mean = np.add.reduceat(np.hstack([time[:, None], rotation.reshape(-1, 9), fixed]), starts) / count
    return mean[:, 0], mean[:, 1:10].reshape(-1, 3, 3), mean[:, 10:]


def _unexplained(time: Array, change: Array, turn: Array) -> Array:
    """Return (n,) T, the norm of change − turn · h, the smaller of the values for h fitted before and after.

    h is fitted to the `_LOCAL` seconds that end, or begin, `_APART` seconds from each change, because it may differ
    on the two sides of a jump. A prior of standard deviation `_USUAL` T regularises directions that no turn observes.
    """
    products = np.concatenate(
        [np.einsum("nij,nik->njk", turn, turn), np.einsum("nij,ni->nj", turn, change)[:, :, None]], axis=2
    )
    total = np.concatenate([np.zeros((1, 3, 4)), np.cumsum(products, axis=0)])
    left = []
    for start, end in ((-_LOCAL - _APART, -_APART), (_APART, _APART + _LOCAL)):
        rows = np.searchsorted(time, time + start), np.searchsorted(time, time + end)
        normal = total[rows[1]] - total[rows[0]]
        ridge = (_NOISE / _USUAL) ** 2 * np.eye(3)
        h = np.linalg.solve(normal[:, :, :3] + ridge, normal[:, :, 3:])
        left.append(np.linalg.norm(change - (turn @ h)[:, :, 0], axis=1))
    return np.minimum(*left)
