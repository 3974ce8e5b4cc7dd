"""Steps of the measured field that no turn explains: a magnet that is attached, a current that is switched on.

Seen without any calibration: over half a second the field, turned by the gyroscope into fixed axes, changes by
(R' − R) h, with h the hard iron (Troni and Whitcomb 2019, eq. 14, summed over a window). What is left of that after a
fit of h to the seconds before, and to those after, is soft iron, noise and, where it stands out, a jump.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.estimators.hard_iron.turning import turning_field
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.checks import EARTH_FIELD

_BIN = 0.25  # s
_LEAST = 0.2  # of the field's median strength: a change of this size spoils a calibration
_OUTSTANDING = 8.0  # times the spread of what is left elsewhere
_MOST = 4  # jumps; a field that jumps more often is not one that jumps
_LOCAL, _APART = 10.0, 1.0  # s
_USUAL, _NOISE = 100e-6, 1e-6  # T, hard iron and the noise of a bin
_STRETCH = 1.5  # by which a strong soft iron stretches the field along an axis
_FEW = 0.5  # % of the samples at either end, which may be wrong


@dataclass(frozen=True)
class FieldJump:
    """At `time` s since the first row the field changed by `size` T, in any direction."""

    time: float
    size: float


def field_jumps(recording: Recording) -> tuple[FieldJump, ...]:
    """The jumps of a recording in order; none without a gyroscope, or where the field changes all the time."""
    if recording.angular_rate is None:
        return ()
    try:
        samples = turning_field(recording)
    except MagycError:  # too short to hold any
        return ()
    time, still, turned = _binned(samples.time, samples.rotation, samples.field)
    if len(time) < 20:
        return ()
    change, turn = turned[2:] - turned[:-2], still[2:] - still[:-2]
    close = time[2:] - time[:-2] < 3 * _BIN
    change, turn, middle = change[close], turn[close], time[1:-1][close]
    if not len(middle):  # sampled too slowly to see one
        return ()
    left = _unexplained(middle, change, turn)
    spread = float(np.median(left)) / 1.538  # of |x| for three normal components of unit variance
    limit = max(_LEAST * float(np.median(np.linalg.norm(samples.field, axis=1))), _OUTSTANDING * spread)
    over = np.flatnonzero(left > limit)
    if not len(over):
        return ()
    groups = np.split(over, np.flatnonzero(np.diff(middle[over]) > 4 * _BIN) + 1)
    if len(groups) > _MOST:
        return ()
    peaks = [group[np.argmax(left[group])] for group in groups]
    return tuple(FieldJump(float(middle[k] - recording.time[0]), float(left[k])) for k in peaks)


def beyond_turning(recording: Recording) -> float | None:
    """T, how far the field swept along its widest axis, where that is more than turning over in the Earth's field does.

    None where turning over could be all.
    """
    low, high = np.percentile(recording.magnetic_field, (_FEW, 100 - _FEW), axis=0)
    swept = float(np.max(high - low))
    return swept if swept > 2 * _STRETCH * EARTH_FIELD[1] else None


def _binned(time: Array, rotation: Array, field: Array) -> tuple[Array, Array, Array]:
    """(n,) s, (n, 3, 3) mean rotation and (n, 3) mean field in fixed axes, over bins of `_BIN` s that hold samples."""
    number = np.floor((time - time[0]) / _BIN).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(starts, append=len(time))[:, None]
    fixed = np.einsum("nij,nj->ni", rotation, field)
    mean = np.add.reduceat(np.hstack([time[:, None], rotation.reshape(-1, 9), fixed]), starts) / count
    return mean[:, 0], mean[:, 1:10].reshape(-1, 3, 3), mean[:, 10:]


def _unexplained(time: Array, change: Array, turn: Array) -> Array:
    """(n,) T: length of change − turn · h, the smaller for h before and after, apart from what is around it.

    h is fitted to the `_LOCAL` seconds that end, or begin, `_APART` seconds from each change: it may have another
    value on either side of a jump. A deviation of `_USUAL` T holds what no turn determines.
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
