"""Readings that were truncated towards zero, each moved to the middle of what it stands for.

A cast to integers drops the digits behind the point: a reading of 3.7 steps is logged as 3, one of −3.7 as −3.
Truncated turns are half a step too slow in either direction, which passes for a scale of the gyroscope or for iron
(14 µT at steps of 20 mrad/s). Rounded readings have steps as well, but are right on average; the fit tells which.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording

_READINGS = {"gyroscope": "angular_rate", "magnetometer": "magnetic_field"}  # of a recording
_FINEST = 0.05  # step over the noise of a sample, below which truncation does no harm; BROAD has 0.08 to 0.3
_TWICE = 1.5  # zeros over what the counts beside zero let expect; truncation makes it 2, rounding 1
_BESIDE = np.array([-3, -2, -1, 1, 2, 3])  # steps by whose counts the zeros are expected
_OFF = 0.05  # steps by which a reading may deviate from a multiple of them
_NEAR = 10.0  # steps, up to which a step is known well enough from two neighbours, and the factor from there on
_ROUNDING = 1e-6  # of the largest reading, by which equal ones may differ
_CHANCE = 9.0  # nats that may be gained by chance


@dataclass(frozen=True)
class Truncated:
    """A sensor whose readings were truncated.

    Attributes:
        sensor: its name.
        step: T or rad/s, the largest of its axes.
    """

    sensor: str
    step: float

    @property
    def sentence(self) -> str:
        """The finding, and what follows from it for readings to which the calibration is applied."""
        return (
            f"the {self.sensor}'s readings are truncated towards zero, in steps of {self._shown}: calibrated as if "
            "half a step were added to positive ones and subtracted from negative ones"
        )

    @property
    def error(self) -> str:
        """What was taken out of the readings."""
        return f"the truncation towards zero of the {self.sensor}'s readings, in steps of {self._shown}"

    @property
    def _shown(self) -> str:
        return f"{self.step * 1e6:.2g} µT" if self.sensor == "magnetometer" else f"{self.step * 1e3:.2g} mrad/s"


def without_truncation(
    recording: Recording,
    fit: Fit,
    fit_again: Callable[[Recording], Fit],
    sensors: Sequence[str] = ("gyroscope", "magnetometer"),
) -> tuple[Recording, Fit, tuple[Truncated, ...]]:
    """Return the recording with the middles of truncated readings, its fit, and the sensors concerned.

    Args:
        recording: with readings as they were logged.
        fit: to them.
        fit_again: fits another recording.
        sensors: whose readings to look at.
    """
    found = []
    for sensor in sensors:
        reading: Array = getattr(recording, _READINGS[sensor])
        if reading.all():  # nearly always
            continue
        step = steps_from_zero(reading, getattr(short_term_noise(recording), sensor))
        if not step.any():
            continue
        changed: dict[str, Any] = {_READINGS[sensor]: middles(reading, step)}
        middle = replace(recording, **changed)
        try:
            again = fit_again(middle)
        except MagycError:  # without a minimum it is no explanation
            continue
        if nats_gained(fit, again) > _CHANCE:
            recording, fit = middle, again
            found.append(Truncated(sensor, float(step.max())))
    return recording, fit, tuple(found)


def steps_from_zero(reading: Array, noise: float) -> Array:
    """Return the steps (3,) of readings (n, 3) that are multiples of them and 0 as often as truncation makes them.

    Axes without such steps, or with steps that are too fine to do harm, have 0. An axis that never reads zero has them
    if another one does.

    Args:
        reading: T or rad/s.
        noise: standard deviation of a sample, in the same unit.
    """
    step, zeros, expected = np.zeros(3), 0, 0.0
    for axis, values in enumerate(reading.T):
        own = _step(values)
        if own > _FINEST * noise:
            step[axis] = own
            there, usual = _zeros(np.round(values / own))
            zeros, expected = zeros + there, expected + usual
    return step if zeros > _TWICE * expected else np.zeros(3)


def _zeros(multiple: Array) -> tuple[int, float]:
    """Return how many of the values (n,), in steps, are 0, and how many would be if they were rounded.

    The logarithm of their density is taken for a parabola there, as that of a normal distribution is. Both are 0 if too
    few values are near.
    """
    count = np.array([np.count_nonzero(multiple == number) for number in _BESIDE])
    known = count > 0
    if np.count_nonzero(known) < len(_BESIDE) - 1:
        return 0, 0.0
    at_zero = np.polyfit(_BESIDE[known], np.log(count[known]), 2, w=np.sqrt(count[known]))[-1]
    return int(np.count_nonzero(multiple == 0)), float(np.exp(at_zero))


def _step(values: Array) -> float:
    """Return the step of values (n,) that are multiples of it; 0 if there is none."""
    size = np.unique(np.abs(values))
    away = size - size[0]
    apart = np.diff(size)
    step, reach = float(apart[apart > _ROUNDING * size[-1]].min(initial=np.inf)), _NEAR
    while True:  # nearer differences tell the step well enough to number farther ones
        near = away[away < reach * step]
        multiple = np.round(near / step)
        if not multiple.any():
            return 0.0
        step, reach = float(near @ multiple / (multiple @ multiple)), _NEAR * reach
        if len(near) == len(size):
            off = np.abs(size / step - np.round(size / step)).max()
            return step if float(off) < _OFF else 0.0


def middles(reading: Array, step: Array) -> Array:
    """Return truncated readings (n, 3), each in the middle of what it stands for; zero stands for both sides of it."""
    result = reading.copy()
    has_steps = step > 0
    result[:, has_steps] += 0.5 * step[has_steps] * np.sign(np.round(reading[:, has_steps] / step[has_steps]))
    return result


def nats_gained(before: Fit, after: Fit) -> float:
    """Return the nats by which a fit explains other readings of the same windows better.

    A common factor of both noise levels is a parameter of either likelihood, so that a missing effect adds to neither.
    """

    def log(fit: Fit) -> float:
        windows, links = len(fit.chain.windows), np.count_nonzero(fit.chain.link_scale)
        noise = windows * np.log(fit.chain.noise.magnetometer) + links * np.log(fit.chain.noise.gyroscope)
        return -3.0 * float(noise) - 1.5 * windows * float(np.log(fit.reduced.cost))

    return log(after) - log(before)


def with_truncation(calibration: Calibration, found: tuple[Truncated, ...]) -> Calibration:
    """Return the calibration with the truncated sensors in its message and its diagnostics."""
    if not found:
        return calibration
    message = "; ".join([calibration.message, *(one.sentence for one in found)])
    steps = {one.sensor: one.step for one in found}
    return replace(calibration, message=message, diagnostics={**calibration.diagnostics, "truncated": steps})
