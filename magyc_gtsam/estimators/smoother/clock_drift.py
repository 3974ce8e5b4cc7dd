"""Drift between the clocks of the two sensors: a score test, and estimation by restamping the magnetometer.

If the magnetometer's clock gains ρ on the gyroscope's, its delay grows as τ(t) = τ₀ + ρ (t − t₀). At the minimum
without drift the score and information of ρ follow from one additional column, that of the delay times t − t̄, after
directions and parameters are projected out: z = score / √information has unit standard deviation if the clocks agree.
This costs one solve. Only if z is significant are the magnetometer's stamps t replaced by t₀ + (t − t₀)(1 − ρ) and
everything fitted again, until z is small; the change of the parameters is the error that the drift caused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.noise_levels import explained
from magyc_gtsam.estimators.smoother.options import MOST_DRIFT
from magyc_gtsam.estimators.smoother.preparation import magnetometer_noise
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.held import with_equal_samples

_SIGNIFICANT = 6.0  # sigmas of a significant drift; 280 clean logs reach 3.3, real instruments 4.8
_LARGEST_SHIFT = 0.5  # sigmas by which a drift may move a parameter
_ROUNDS = 6
_NOISY = 1.5  # ratio of fitted to short-term noise of the magnetometer above which the fit is not explained
_PART = (0.4, 0.6)  # shares of the duration between which a drift is estimated if the whole recording has no fit

Judge = Callable[[], bool]
Refit = Callable[[Recording, Array | None], tuple[Fit, Judge]]


class Drift(NamedTuple):
    """The drift of the magnetometer's clock.

    Attributes:
        rate, sigma: s/s that the magnetometer's clock gains on the gyroscope's, and its standard deviation.
        moved: largest change of soft iron, hard iron or gyroscope bias by correcting the drift, in sigmas.
        delay: s, at the first row and at the last.
        known: s/s, drift that was corrected in the stamps before.
    """

    rate: float
    sigma: float
    moved: float
    delay: tuple[float, float]
    known: float = 0.0

    @property
    def harms(self) -> bool:
        """Whether the calibration without the drift must not be trusted."""
        return self.moved > _LARGEST_SHIFT

    @property
    def sentence(self) -> str:
        """The drift in words, with the remedy."""
        first, last = (f"{1e3 * d:.0f}" for d in self.delay)
        digits = int(np.clip(-np.floor(np.log10(100 * self.sigma)), 2, 6))
        what = f"clock {'gains' if self.rate > 0 else 'loses'} {100 * abs(self.rate):.{digits}f} %"
        what = f"the magnetometer's {what} on the gyroscope's"
        delay = f"its delay goes from {first} to {last} ms"
        if not self.harms:
            return f"{what}: {delay}, which moves no parameter by more than {_LARGEST_SHIFT:g} sigma"
        taken_out = self.rate + self.known - self.rate * self.known
        remedy = f"correct the stamps, or have them corrected (clock_drift={taken_out:.4g})"
        return f"{what}: {remedy}; {delay}, which moves a parameter by {self.moved:.2g} sigma"


def with_drift(calibration: Calibration, drift: Drift | None) -> Calibration:
    """Return the calibration with the drift in its message; it is not trusted if the drift harms it."""
    if drift is None:
        return calibration
    trusted = calibration.converged and not drift.harms
    words = [calibration.message, drift.sentence]
    if not trusted:
        words = [drift.sentence] if calibration.converged else words[::-1]
    return replace(
        calibration,
        converged=trusted,
        message="; ".join(words),
        diagnostics={**calibration.diagnostics, "clock_drift": [drift.rate, drift.sigma]},
    )


def restamped(recording: Recording, drift: float) -> Recording:
    """Return the recording with the magnetometer's clock slowed down by `drift` s/s from the first row on."""
    if not drift:
        return recording
    time, field = recording.magnetometer
    stamps = slowed(time, recording.time[0], drift)
    return with_equal_samples(recording.with_samples((stamps, field), recording.gyroscope))


def slowed(time: Array, start: float, drift: float) -> Array:
    """Return the stamps, in s, of a clock slowed down by `drift` s/s from `start` on."""
    return start + (time - start) * (1 - drift)


def drift_is_significant(fit: Fit) -> bool:
    """Return whether the score test at a minimum without drift is significant."""
    return abs(_score(fit).ratio) > _SIGNIFICANT


def find_drift(recording: Recording, fit: Fit, trusted: bool, refit: Refit, near: float = 0.0) -> Drift | None:
    """Return the drift of a recording whose minimum without drift is `fit`; None if there is no significant drift.

    Args:
        recording, fit, trusted: the data, their fit, and whether the fit is trusted apart from a drift.
        refit: fits a recording, from θ (13,) or from no start, and returns the fit and a test whether it is trusted.
        near: s/s, drift of an earlier part of the recording, as a start if the whole has no minimum nearby.
    """
    found = drift_is_significant(fit)
    # Without a significant drift there is none, unless the residual is larger than the magnetometer's own noise.
    if not found and (trusted or fit.chain.noise.magnetometer < _NOISY * magnetometer_noise(recording)):
        return None
    ways: list[Callable[[], tuple[float, Fit, Judge]]] = [lambda: _measure_from_part(recording, refit)]
    if found:
        ways.insert(0, lambda: _measure(recording, fit, lambda: False, refit))
    if near:
        ways.append(lambda: _measure(recording, *refit(restamped(recording, near), None), refit, near))
    for way in ways:
        try:
            rate, corrected, good = way()
        except MagycError:
            continue
        # If the fit is still not trusted with the drift corrected, there is another cause.
        if good():
            break
    else:
        return None
    sigma = _score(corrected).sigma
    if abs(rate) < _SIGNIFICANT * sigma:
        return None
    deviation = np.sqrt(np.diag(fit.covariance)[:DELAY] * fit.colour * fit.widening)
    moved = np.abs(corrected.state.parameters[:DELAY] - fit.state.parameters[:DELAY]) / deviation
    delay = float(corrected.state.parameters[DELAY])
    return Drift(rate, sigma, float(moved.max()), (delay, delay + rate * recording.duration))


def _measure(
    recording: Recording, fit: Fit, good: Judge, refit: Refit, rate: float = 0.0
) -> tuple[float, Fit, Judge]:
    """Iterate from the fit at `rate` to the drift rate of zero score; return rate, fit and the test of its trust."""
    for _ in range(_ROUNDS):
        step, _, ratio = _score(fit)
        if abs(ratio) < 1 or abs(rate + step) > MOST_DRIFT:
            break
        rate += step
        fit, good = refit(restamped(recording, rate), fit.state.parameters)
    return rate, fit, good


def _measure_from_part(recording: Recording, refit: Refit) -> tuple[float, Fit, Judge]:
    """Estimate the rate on a part of the recording first, and start the whole from it.

    Within a part the delay changes less, so that a minimum is found at drifts that are too large for the whole.
    """
    part = recording.between(*(share * recording.duration for share in _PART))
    rate, fit, _ = _measure(part, *refit(part, None), refit)
    if abs(rate) < _SIGNIFICANT * _score(fit).sigma:
        return rate, fit, lambda: False
    parameters = fit.state.parameters.copy()
    parameters[DELAY] -= rate * (part.time[0] - recording.time[0])
    return _measure(recording, *refit(restamped(recording, rate), parameters), refit, rate)


class _Score(NamedTuple):
    """The score test of ρ: the Gauss–Newton step and its standard deviation, s/s, and their ratio."""

    step: float
    sigma: float
    ratio: float


def _score(fit: Fit) -> _Score:
    """Return the score test of one additional column, that of the delay times t − t̄."""
    time = fit.chain.windows.time
    weight = fit.weights.window
    column = fit.reduced.on_parameters[DELAY] * (time - weight @ time / weight.sum())
    information = max(float(np.vdot(column, column)) - explained(fit, column, fit.covariance), 1e-300)
    sigma = float(np.sqrt(fit.colour * fit.widening / information))
    step = -float(np.vdot(column, fit.whitened[0])) / information
    return _Score(step, sigma, step / sigma)
