"""What sensors are known to do, a column or a few each, in the units of data sheets.

The families of `families` are general, so that each has many columns and what it shows must be much. What has one
column is seen much earlier, and its amplitude is known beforehand: the linearity of magnetometers is stated as 0.1 to
1 % of the full scale, scales of low-cost gyroscopes as 1 to 3 %, and filters of compasses take 0.01 to 0.5 s. So each
also has odds beforehand, and counts by those that the data leave it (`averaging`).
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.model_error.families import COMMON, EVEN, GENERAL, LIKELY, USUAL, ColumnFamily
from magyc_gtsam.estimators.model_error.motion import ALIKE, WindowMotion
from magyc_gtsam.estimators.smoother.columns import RateErrors, UnmodelledColumns
from magyc_gtsam.factors.chain.field_chain import PARAMETERS
from magyc_gtsam.factors.chain.rotations import Array

_LATE = 0.3  # s, the lag of an axis at which the first and the second order have their true proportion
# T, of a play. With this one width the hard iron of loops of 0.1 to 3 µT is off by 0.2 to 1.9 stated sigmas. A second
# one of 2 µT, or one that goes with the sweep (2 to 15 µT), explains a stay beside steel, too.
_WIDTH = 0.7e-6
_BAND = 0.02  # rad/s, half of a gyroscope's dead band
_DATA_SHEET = 0.03  # share, the largest error of a gyroscope's scale before the data show one
# Share, the largest when they do. A gyroscope filtered by 0.5 s loses 10 to 30 % of turns to and fro, which looks like
# it: held at 3 %, a trusted hard iron was 17 µT off at 4 to 5 sigmas.
_OF_SCALE = 0.3
_LEAST_FILTER = 1e-3  # s², of 45 ms, below which none moves anything
_SHARP = 0.05  # share of the field strength within which a sign is open


def _one(profile: Array) -> Array:
    """(1, 3, n): the three axes alike."""
    return profile[None]


def _each_axis(profile: Array) -> Array:
    """(3, 3, n): each axis by itself."""
    return profile[None] * np.eye(3)[:, :, None]


def _bend(motion: WindowMotion) -> UnmodelledColumns:
    """The cube of the reading over its largest."""
    share = motion.reading / float(np.abs(motion.reading).max())
    return UnmodelledColumns(_one(motion.strength * share * share * share), None)


def _dead_zone(motion: WindowMotion) -> UnmodelledColumns:
    sign = motion.reading / np.sqrt(motion.reading**2 + (_SHARP * motion.strength) ** 2)
    return UnmodelledColumns(_one(motion.strength * sign), None)


def _play(motion: WindowMotion) -> UnmodelledColumns:
    """The reading stays behind the field by up to a width, whichever way it goes."""
    behind = (_followed(motion.reading, _WIDTH) - motion.reading) / _WIDTH
    return UnmodelledColumns(_each_axis(motion.strength * behind), None)


def _followed(values: Array, width: float) -> Array:
    """(k, n) what follows values (k, n) once they have moved by `width`, from the middle of both.

    Each step y → clip(y, x − width, x + width) is a clip, and clips compose to clips: all of them by doubling.
    """
    low, high = values - width, values + width
    low[:, 0] = high[:, 0] = values[:, 0]
    reach = 1
    while reach < values.shape[1]:
        least, most = low[:, reach:], high[:, reach:]
        both = [np.minimum(np.maximum(side[:, :-reach], least), most) for side in (low, high)]
        least[:], most[:] = both
        reach *= 2
    return low


def _late_axis(motion: WindowMotion) -> UnmodelledColumns:
    """Per s: each axis later than the others, to the second order for a lag of some size."""
    first, second = motion.reading_change, motion.reading_curvature
    return UnmodelledColumns(np.concatenate([_each_axis(first), 0.5 * _LATE * _each_axis(second)]), None)


def _filter(motion: WindowMotion) -> UnmodelledColumns:
    """Per s²: the second order of a filter, whose first is a delay."""
    return UnmodelledColumns(_one(motion.reading_curvature), None)


def _steps(motion: WindowMotion) -> UnmodelledColumns:
    """Of the error by rounding, a sawtooth of the reading, the first harmonic at any phase, averaged over a window."""
    swept = motion.reading_change * np.gradient(motion.time)
    phase = 2 * np.pi * motion.reading / motion.step
    size = motion.strength * np.sinc(swept / motion.step)
    return UnmodelledColumns(
        np.concatenate([_each_axis(size * np.sin(phase)), _each_axis(size * np.cos(phase))]), None
    )


def _by_step(motion: WindowMotion) -> float:
    """Of the field's strength: the first harmonic of a sawtooth as high as a step."""
    return motion.step / (np.pi * motion.strength)


def _gain_drift(motion: WindowMotion) -> UnmodelledColumns:
    """Each axis' gain moves evenly."""
    share = np.linspace(-1, 1, len(motion.time))
    return UnmodelledColumns(_each_axis(share * (motion.soft_iron @ motion.unit)), None)


def _gain_at_end(motion: WindowMotion) -> Array:
    """(P, 3) by how much the soft iron is another one at the end."""
    result = np.zeros((PARAMETERS, 3))
    rows, columns = np.triu_indices(3)
    for axis in range(3):
        turned = np.zeros((3, 3))
        turned[axis] = motion.soft_iron[axis]
        result[:6, axis] = (0.5 * (turned + turned.T))[rows, columns]
    return result


def _by_data_sheet(motion: WindowMotion) -> float:
    return _DATA_SHEET


def _gyroscope_bend(motion: WindowMotion) -> RateErrors:
    share = motion.rate / max(float(np.abs(motion.rate).max()), ALIKE)
    return motion.on_gyroscope(_one(motion.rate * share * share))


def _dead_band(motion: WindowMotion) -> RateErrors:
    return motion.on_gyroscope(_one(np.clip(motion.rate / _BAND, -1.0, 1.0)))


def _gyroscope_filter(motion: WindowMotion) -> RateErrors:
    """Per s²: also what samples too far apart leave of a rate's integral, a twelfth of their step squared."""
    return motion.on_gyroscope(_one(motion.derivative(motion.derivative(motion.rate))))


def _by_delay(motion: WindowMotion) -> float:
    """s²: a filter of the first order with the delay τ has τ²/2, a mean has τ²/6, and a delay without filter none."""
    return _if_felt(0.5 * max(motion.delay, 0.0) ** 2)


def _by_lead(motion: WindowMotion) -> float:
    """s²: the same of the gyroscope, and the twelfth of the squared step that the trapezoidal rule leaves."""
    return _if_felt(max(0.5 * max(-motion.delay, 0.0) ** 2, motion.gyroscope_step**2 / 12))


def _if_felt(amplitude: float) -> float:
    return amplitude if amplitude > _LEAST_FILTER else 0.0


COARSE = ColumnFamily(
    "steps",
    "the magnetometer's steps put its reading off by {}",
    _steps,
    0.1,
    prior=EVEN,
    expected=_by_step,
    octaves=2,
)
PHYSICAL = (
    ColumnFamily("bend", "the reading bends by {} of the field", _bend, 0.02, prior=LIKELY),
    ColumnFamily(
        "dead zone",
        "the reading jumps by {} about zero",
        _dead_zone,
        0.1,
        prior=USUAL,
    ),
    ColumnFamily("play", "the reading stays behind the field by {}", _play, 0.05, prior=USUAL),
    ColumnFamily(
        "late axis",
        "axes of the magnetometer are late by {}",
        _late_axis,
        0.5,
        prior=USUAL,
        unit="time",
        from_rate=True,
    ),
    ColumnFamily(
        "filter",
        "the magnetometer is filtered by {}",
        _filter,
        0.5,
        prior=EVEN,
        unit="filter",
        expected=_by_delay,
        octaves=2,
        from_rate=True,
    ),
    ColumnFamily(
        "gain drift",
        "the magnetometer's gain drifts by {}",
        _gain_drift,
        0.03,
        prior=USUAL,
        unit="share",
        at_end=_gain_at_end,
    ),
    ColumnFamily(
        "gyroscope:scale",
        "the gyroscope's scale is off by {}, which calibrate --gyroscope-scale estimates",
        WindowMotion.gyroscope_scale,
        _OF_SCALE,
        prior=COMMON,
        unit="share",
        expected=_by_data_sheet,
    ),
    ColumnFamily(
        "gyroscope:scales",
        "the scales of the gyroscope's axes are off by {}, which calibrate --gyroscope-scale estimates",
        WindowMotion.gyroscope_scales,
        _OF_SCALE,
        prior=GENERAL,
        unit="share",
        expected=_by_data_sheet,
        mixed=True,
    ),
    ColumnFamily("gyroscope:bend", "the gyroscope bends by {}", _gyroscope_bend, 0.05, prior=USUAL, unit="share"),
    ColumnFamily(
        "gyroscope:dead band",
        "the gyroscope loses {} about zero",
        _dead_band,
        0.05,
        prior=USUAL,
        unit="rate",
    ),
    ColumnFamily(
        "gyroscope:filter",
        "the gyroscope is filtered by {}",
        _gyroscope_filter,
        0.5,
        prior=EVEN,
        unit="filter",
        expected=_by_lead,
        octaves=2,
        from_rate=True,
    ),
)
