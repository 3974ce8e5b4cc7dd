"""What the fit of a recording begins with: its windows, and the sensors' short-term noise."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.recording import Recording, Samples

_TRIPLETS = 1000  # samples at which the short-term noise is taken


def preintegrate(recording: Recording, window: float = 1.5, turn: float | None = None) -> Preintegration:
    """The recording's samples, cut into windows."""
    magnetometer, gyroscope = recording.magnetometer, recording.gyroscope
    return Preintegration(
        *magnetometer,
        *gyroscope,
        interval_mean=recording.angular_rate_is == "interval-mean",
        length=window,
        turn=suitable_turn(magnetometer.value) if turn is None else turn,
    )


def suitable_turn(field: Array) -> float:
    """rad, the largest rotation inside a window, from the spread of the measured field (N, 3).

    Rotation inside a window costs information where it is not small against the field's spread over the whole log;
    at these values 1 to 6 % of the hard iron's sigma (docs/field_chain.md).
    """
    some = np.ascontiguousarray(field[:: max(len(field) // 500, 1)].T)
    some -= some.mean(axis=1)[:, None]
    spread = np.linalg.eigvalsh(some @ some.T) / (some.shape[1] - 1)
    turn = 1.7 * np.sqrt(max(spread[0], 0.0) / max(spread.sum(), 1e-30))
    # In steps: two ways of cutting a log differ by up to a third of a sigma, which a few samples more must not cause.
    steps = np.round(np.log(max(turn, 0.1) / 0.15) / np.log(1.2))
    return float(np.clip(0.15 * 1.2**steps, 0.15, 0.4))


class Streams(Protocol):
    """Both sensors' own samples, as a `Recording` holds them."""

    @property
    def magnetometer(self) -> Samples: ...

    @property
    def gyroscope(self) -> Samples: ...


def short_term_noise(recording: Streams) -> SensorNoise:
    """Noise per sample and axis from second differences, which smooth motion does not enter."""

    def level(samples: Samples, least: float) -> float:
        value = samples.value
        stride = len(value) // _TRIPLETS | 1  # odd, or every triplet may fall on the same of two interpolated rows
        second = value[2::stride] - 2 * value[1:-1:stride] + value[:-2:stride]
        square = np.einsum("ni,ni->n", second, second) / 18
        # Upper quartile of sqrt(χ²₃/3): drivers that interpolate leave half of the differences at zero.
        upper = 3 * (len(square) - 1) // 4
        return max(float(np.sqrt(np.partition(square, upper)[upper])) / 1.170, least)

    return SensorNoise(level(recording.magnetometer, 1e-10), level(recording.gyroscope, 1e-6))
