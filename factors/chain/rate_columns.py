"""What an error of the angular rate does to the windows and links of a field chain, to first order.

An error ω of the rate turns the integrated world by φ = −∫ R ω dt: two windows are linked by g' = Exp(Δφ̄) g, φ̄
being the mean over a window, and inside a window, which turns meanwhile, the mean field gains
A mean_j Rⱼᵀ [g]× (φⱼ − φ̄).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import Array, cross


class RateColumns(NamedTuple):
    """Unwhitened derivatives per unit of the error: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad."""

    window: Array
    link: Array


def attitude(samples: Preintegration, rate: Array) -> Array:
    """(3, 3, G) sensor → integrated world at the gyroscope's samples, of the true rate (3, G)."""
    track = GyroscopeTrack.integrate(samples.gyroscope_time, rate.T, interval_mean=samples.interval_mean)
    return track.matrices.reshape(3, 3, -1)


def rate_columns(
    samples: Preintegration, windows: FieldWindows, soft_iron: Array, direction: Array, turn: Array, columns: Array
) -> RateColumns:
    """The derivatives of a chain's residuals on the value of an error of the rate.

    Args:
        samples, windows: of both sensors, integrated.
        soft_iron: (3, 3) times the field strength, T.
        direction: (3, n) of the field in the integrated world.
        turn: (3, 3, G) `attitude` at the gyroscope's samples.
        columns: (k, 3, G) rad/s per unit, at the gyroscope's samples.
    """
    turned = turned_by(turn, columns)
    angle = np.zeros_like(turned)
    if samples.interval_mean:
        steps = turned[..., 1:] * samples.step
    else:
        steps = 0.5 * (turned[..., 1:] + turned[..., :-1]) * samples.step
    np.cumsum(-steps, axis=-1, out=angle[..., 1:])
    when, gyro_time = samples.magnetometer_time - windows.delay, samples.gyroscope_time
    nearest = np.clip(np.searchsorted(gyro_time, when), 0, len(gyro_time) - 1)
    if len(when) == len(gyro_time) and np.array_equal(when, gyro_time):
        at = angle
    else:
        at = np.stack([[np.interp(when, gyro_time, a) for a in column] for column in angle])
    count = np.diff(np.append(samples.starts, len(when)))
    window_of = np.repeat(np.arange(len(count)), count)
    mean = np.add.reduceat(at, samples.starts, axis=-1) / count
    link = -cross(direction[:, None, :-1], np.diff(mean).swapaxes(0, 1)).swapaxes(0, 1)
    inside = at - mean[..., window_of]
    swung = cross(direction[:, None, window_of], inside.swapaxes(0, 1))
    body = turned_by(np.swapaxes(turn[..., nearest], 0, 1), swung.swapaxes(0, 1))
    window = np.einsum("ij,pjn->pin", soft_iron, np.add.reduceat(body, samples.starts, axis=-1) / count)
    return RateColumns(window, link)


def turned_by(rotation: Array, columns: Array) -> Array:
    """(p, a, n) columns turned by (a, a, n)."""
    result = np.zeros_like(columns)
    for j in range(columns.shape[1]):
        if columns[:, j].any():
            for i in range(columns.shape[1]):
                result[:, i] += rotation[i, j] * columns[:, j]
    return result
