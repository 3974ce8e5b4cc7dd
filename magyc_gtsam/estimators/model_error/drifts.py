"""Drifts of gain, hard iron and gyroscope bias, as sensors warm up: columns, and their values at the end.

A calibration is the mean over a recording and is used afterwards. Families of several waves of time show a drift late,
since most of their columns are not in it; the three columns of a linear one show it early.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import UPPER, vech

_WARM = 300.0  # s, in which a sensor warms up; a shorter log has its share of the largest drift


_ONSET = 0.85  # share of a recording after which a late drift begins
_JUMPS = (0.7, 0.85, 0.93, 0.97)  # shares of a recording after which the gyroscope's bias may jump
_EACH_OFFSET, _EACH_BIAS = np.eye(PARAMETERS)[:, 6:9], np.eye(PARAMETERS)[:, 9:12]
# (6, 3) share of a change of each row of the soft iron in the entries of its symmetric part.
_OF_ROW = 0.5 * sum(np.equal.outer(side, np.arange(3)) for side in UPPER)


class SensorDrift(NamedTuple):
    """A change over a recording, linear or by jumps.

    Attributes:
        columns: function that computes its columns from a motion.
        at_end: function that computes (13, k) the parameters at the end less their means, per unit of each column.
    """

    columns: Callable[[WindowMotion], UnmodelledColumns]
    at_end: Callable[[WindowMotion], Array]


def up_to(largest: float) -> Callable[[WindowMotion], float]:
    """Return the function for the largest drift that is plausible within a recording; `largest` if it is long."""
    return lambda motion: largest * min(float(motion.time[-1] - motion.time[0]) / _WARM, 1.0)


def _gain(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns of a gain on the whole reading that changes linearly with time, one per axis."""
    return UnmodelledColumns.axis_by_axis(motion.since_mean * motion.reading)


def _gain_at_end(motion: WindowMotion) -> Array:
    """Return (13, 3) soft and hard iron at the end of the recording less their means, per unit of each column."""
    result = np.zeros((PARAMETERS, 3))
    result[:6] = vech(motion.soft_iron)[:, None] * _OF_ROW
    np.fill_diagonal(result[6:9], motion.hard_iron)
    return result


def _offset(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns of a hard iron that changes linearly with time, one per axis."""
    return motion.in_sensor(motion.since_mean[None])


def _offset_at_end(motion: WindowMotion) -> Array:
    """Return (13, 3) the hard iron at the end of the recording less its mean, per unit of each column."""
    return motion.strength * _EACH_OFFSET


def _bias(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns of a gyroscope bias that changes linearly with time, one per axis."""
    return motion.slowly_about_each_axis(motion.since_mean[None])


def _bias_at_end(motion: WindowMotion) -> Array:
    """Return (13, 3) the gyroscope bias at the end of the recording less its mean, per unit of each column."""
    return _EACH_BIAS


def late_up_to(largest: float) -> Callable[[WindowMotion], float]:
    """Return the function for the largest late drift that is plausible; 0 if a recording ends at rest."""

    def likely(motion: WindowMotion) -> float:
        late = motion.time > motion.time[-1] - (1 - _ONSET) * (motion.time[-1] - motion.time[0])
        return largest if motion.moving[late].mean() > 0.5 else 0.0

    return likely


def _late(motion: WindowMotion, onset: float = _ONSET) -> UnmodelledColumns:
    """Return the columns of a hard iron that begins to change at a share of the recording, linearly up to its end."""
    share = (motion.time - motion.time[0]) / (motion.time[-1] - motion.time[0])
    ramp = late_up_to(1.0)(motion) * np.maximum(share - onset, 0.0) / (1 - onset)
    return motion.in_sensor(ramp[None])


def _late_bias(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns of a gyroscope bias that jumps, three for each of the shares of the recording."""
    share = (motion.time - motion.time[0]) / (motion.time[-1] - motion.time[0])
    return motion.slowly_about_each_axis((share > np.array(_JUMPS)[:, None]).astype(float))


def _late_bias_at_end(motion: WindowMotion) -> Array:
    """Return (13, k) the gyroscope bias after all jumps, per unit of each column: most of a log is before them."""
    return np.tile(_EACH_BIAS, len(_JUMPS))


LATE_BIAS = SensorDrift(_late_bias, _late_bias_at_end)
LATE = SensorDrift(_late, _offset_at_end)
OTHER_LATE = tuple(partial(_late, onset=onset) for onset in (0.5, 0.7, 0.93))
GAIN = SensorDrift(_gain, _gain_at_end)
OFFSET = SensorDrift(_offset, _offset_at_end)
BIAS = SensorDrift(_bias, _bias_at_end)


def waves_at_end(waves: tuple[int, int], of_bias: bool = False) -> Callable[[WindowMotion], Array]:
    """Return the function for (13, 3w) the hard iron, or the bias, at the end of the recording of w waves per axis."""
    each = np.kron(np.sqrt(2) * (-1.0) ** np.arange(*waves), _EACH_BIAS if of_bias else _EACH_OFFSET)
    return lambda motion: each if of_bias else motion.strength * each
