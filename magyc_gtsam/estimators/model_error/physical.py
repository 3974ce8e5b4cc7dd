"""Known sensor errors as families of one or a few columns, in the units of data sheets.

The general families of `families` have many columns, so that only large effects are significant. A single column is
detected much earlier, and its amplitude is known a priori: the linearity of magnetometers is stated as 0.1 to 1 % of
the full scale, the scale error of low-cost gyroscopes as 1 to 3 %, and filters of compasses take 0.01 to 0.5 s. Each
of these families therefore has prior odds, and counts with its posterior probability (`not_excluded`).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from magyc_gtsam.estimators.model_error import drifts
from magyc_gtsam.estimators.model_error.by_attitude import flex
from magyc_gtsam.estimators.model_error.families import COMMON, EVEN, GENERAL, LIKELY, USUAL, ColumnFamily
from magyc_gtsam.estimators.model_error.motion import ALIKE, WindowMotion
from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rotations import Array

_LATE = 0.3  # s, lag of an axis for which the ratio of second to first order is exact
# T, half width of a hysteresis (play): one to test, which stands for loops of 0.1 to 3 µT, and others for loops that
# the data show: of 64 loops of 2 and 5 µT in one, the ellipsoid of 68 % held 43 by the first width alone, and 50 by the
# likeliest. A second width beside the first, or one proportional to the sweep (2 to 15 µT), would also explain a stay
# beside steel.
_WIDTH = 0.7e-6
_OTHER_WIDTHS = (0.35e-6, 1.4e-6, 2.8e-6)
_BAND = 0.02  # rad/s, half the width of a gyroscope's dead band
_DATA_SHEET = 0.03  # share, largest scale error of a gyroscope under the prior
LATE_DRIFT = "late drift"
CROSS_AXIS = "gyroscope:cross-axis"
# Share, largest cross-axis sensitivity under the prior. Data sheets state 1 to 2 % at most; with 0.45 % the heading of
# one of 56 cars is beyond three sigmas, with 0.9 % that of seven of 28.
_CROSS_AXIS = 0.005
# Share, largest scale error that the data may show. A gyroscope filtered by 0.5 s loses 10 to 30 % of oscillations,
# which looks like a scale error: with a bound of 3 %, a trusted hard iron was 17 µT off at 4 to 5 sigmas.
_OF_SCALE = 0.3
_LEAST_FILTER = 1e-3  # s², of a filter of 45 ms, below which the effect is negligible
# Share of the field, largest bend: 0.2 % of a full scale of 800 µT, where data sheets state 0.1 to 1 %. Three octaves
# reach down to 1 %; a smaller one is either seen or matters less than noise.
_BEND = 0.04
_RARE = 5e-4  # odds of a hard iron that begins to change just before the end
_SHARP = 0.05  # width of the smoothed sign function, as a share of the field strength


def _one(profile: Array) -> Array:
    """Return (1, 3, n), one column for all three axes."""
    return profile[None]


def _bend(motion: WindowMotion) -> UnmodelledColumns:
    """Return the column of the cube of the reading, relative to the largest reading."""
    share = motion.reading / float(np.abs(motion.reading).max())
    return UnmodelledColumns(_one(motion.strength * share * share * share), None)


def _dead_zone(motion: WindowMotion) -> UnmodelledColumns:
    sign = motion.reading / np.sqrt(motion.reading**2 + (_SHARP * motion.strength) ** 2)
    return UnmodelledColumns(_one(motion.strength * sign), None)


def _play(motion: WindowMotion, width: float = _WIDTH) -> UnmodelledColumns:
    """Return the columns of a hysteresis: the reading lags the field by up to `width`, and sweeps less than the field.

    A play of half width w takes about the share w / A of a sweep of amplitude A. The lag is seen; the smaller sweep has
    the form of the iron, and depends on widths that the lag does not tell.
    """
    behind = (followed(motion.reading, width) - motion.reading) / width
    less = motion.reading.mean(axis=1, keepdims=True) - motion.reading
    size = np.sqrt(2 * np.einsum("in,in->i", less, less) / less.shape[1])
    less /= np.maximum(size, ALIKE * motion.strength)[:, None]
    return UnmodelledColumns.axis_by_axis(motion.strength * np.concatenate([behind, less]))


def followed(values: Array, width: float) -> Array:
    """Return (k, n) the output of a play operator of half width `width` on values (k, n), started at the first values.

    Each step y → clip(y, x − width, x + width) is a clip, and clips compose to clips, so that all steps are computed by
    doubling.
    """
    if compiled.loops:
        result = np.empty(values.shape)
        compiled.loops.follow(values.shape[1], compiled.given(values), np.array([width]), result)
        return result
    low, high = values - width, values + width
    low[:, 0] = high[:, 0] = values[:, 0]
    reach = 1
    while reach < values.shape[1] and (low != high).any():
        least, most = low[:, reach:], high[:, reach:]
        both = [np.minimum(np.maximum(side[:, :-reach], least), most) for side in (low, high)]
        least[:], most[:] = both
        reach *= 2
    return low


def _late_axis(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns, per s, of a lag of each axis against the others, to first and to second order."""
    first, second = motion.reading_change, motion.reading_curvature
    return UnmodelledColumns.axis_by_axis(np.concatenate([first, 0.5 * _LATE * second]))


def _filter(motion: WindowMotion) -> UnmodelledColumns:
    """Return the column, per s², of the second order of a filter; its first order is a delay."""
    return UnmodelledColumns(_one(motion.reading_curvature), None)


def _steps(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns of quantisation: the first harmonic of the sawtooth error at any phase, window means."""
    swept = motion.reading_change * np.gradient(motion.time)
    phase = 2 * np.pi * motion.reading / motion.step
    size = motion.strength * np.sinc(swept / motion.step)
    return UnmodelledColumns.axis_by_axis(np.concatenate([size * np.sin(phase), size * np.cos(phase)]))


def _by_step(motion: WindowMotion) -> float:
    """Return the amplitude of the first harmonic of a sawtooth as high as a step, as a share of the field strength."""
    return motion.step / (np.pi * motion.strength)


def _by_data_sheet(motion: WindowMotion) -> float:
    return _DATA_SHEET


def _by_cross_axis(motion: WindowMotion) -> float:
    return _CROSS_AXIS


def _gyroscope_bend(motion: WindowMotion) -> UnmodelledColumns:
    share = motion.rate / max(float(np.abs(motion.rate).max()), ALIKE)
    return motion.on_gyroscope(_one(motion.rate * share * share))


def _dead_band(motion: WindowMotion) -> UnmodelledColumns:
    return motion.on_gyroscope(_one(np.clip(motion.rate / _BAND, -1.0, 1.0)))


def _gyroscope_filter(motion: WindowMotion) -> UnmodelledColumns:
    """Return the column, per s², of a filter's second order.

    The error of the trapezoidal rule, a twelfth of the squared sampling interval, has the same form.
    """
    return motion.on_gyroscope(_one(motion.derivative(motion.derivative(motion.rate))))


def _by_delay(motion: WindowMotion) -> float:
    """Return the second-order term, in s², of the magnetometer's filter.

    A first-order filter with the delay τ has τ²/2, a moving average τ²/6 and a pure delay none; the largest is assumed.
    """
    return _unless_negligible(0.5 * max(motion.delay, 0.0) ** 2)


def _by_lead(motion: WindowMotion) -> float:
    """Return the largest second-order term, in s², of the gyroscope's filter and of the trapezoidal rule (step²/12)."""
    return _unless_negligible(max(0.5 * max(-motion.delay, 0.0) ** 2, motion.gyroscope_step**2 / 12))


def _unless_negligible(amplitude: float) -> float:
    return amplitude if amplitude > _LEAST_FILTER else 0.0


def _drift(name: str, place: str, drift: drifts.SensorDrift, most: float, prior: float, unit: str) -> ColumnFamily:
    """Return the family of a drift."""
    likely = drifts.up_to(most)
    return ColumnFamily(
        name, place, drift.columns, most, prior=prior, unit=unit, at_end=drift.at_end, expected=likely
    )


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
    ColumnFamily("bend", "the reading bends by {}", _bend, _BEND, prior=LIKELY, octaves=3),
    ColumnFamily(
        "dead zone",
        "the reading jumps by {} about zero",
        _dead_zone,
        0.1,
        prior=USUAL,
    ),
    ColumnFamily(
        "play",
        "the reading stays behind the field by {}",
        _play,
        0.05,
        prior=USUAL,
        other_shapes=tuple(partial(_play, width=width) for width in _OTHER_WIDTHS),
    ),
    ColumnFamily(
        "flex",
        "the mount gives way by {} per g",
        flex,
        0.1,
        prior=USUAL,
        unit="angle",
        only_beside=True,
    ),
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
    _drift("gain drift", "the magnetometer's gain drifts by ±{}", drifts.GAIN, 0.03, USUAL, "share"),
    _drift("offset drift", "the hard iron drifts by ±{}", drifts.OFFSET, 0.05, USUAL, "field"),
    ColumnFamily(
        LATE_DRIFT,
        "the hard iron drifts by {} towards the end",
        drifts.LATE.columns,
        0.2,
        prior=_RARE,
        at_end=drifts.LATE.at_end,
        expected=drifts.late_up_to(0.2),
        other_shapes=drifts.OTHER_LATE,
    ),
    _drift("gyroscope:bias drift", "the gyroscope's bias drifts by ±{}", drifts.BIAS, 0.015, LIKELY, "rate"),
    _drift(
        "gyroscope:late jump",
        "the gyroscope's bias jumps by {} towards the end",
        drifts.LATE_BIAS,
        0.015,
        GENERAL,
        "rate",
    ),
    ColumnFamily(
        "gyroscope:scale",
        "the gyroscope's scale is off by {}, which calibrate estimates (gyroscope_scale=)",
        WindowMotion.gyroscope_scale,
        _OF_SCALE,
        prior=COMMON,
        unit="share",
        expected=_by_data_sheet,
    ),
    ColumnFamily(
        "gyroscope:scales",
        "the scales of the gyroscope's axes are off by {}, which calibrate estimates (gyroscope_scale=)",
        WindowMotion.gyroscope_scales,
        _OF_SCALE,
        prior=GENERAL,
        unit="share",
        expected=_by_data_sheet,
        mixed=True,
    ),
    ColumnFamily(
        CROSS_AXIS,
        "the gyroscope's axes are off right angles by {}",
        WindowMotion.gyroscope_cross_axis,
        _OF_SCALE,
        prior=USUAL,
        unit="share",
        expected=_by_cross_axis,
        octaves=3,
        mixed=True,
    ),
    ColumnFamily("gyroscope:bend", "the gyroscope bends by {}", _gyroscope_bend, 0.05, prior=USUAL, unit="share"),
    ColumnFamily(
        "gyroscope:dead band",
        "the gyroscope loses {} about zero",
        _dead_band,
        _BAND,  # no more is lost than there is
        prior=USUAL,
        unit="rate",
        from_rate=True,
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
