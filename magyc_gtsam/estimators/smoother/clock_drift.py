"""Clocks of the two sensors that drift apart: found by a score test, measured by stamping the magnetometer anew.

A magnetometer whose clock gains ρ on the gyroscope's has a delay that grows, τ(t) = τ₀ + ρ (t − t₀). At the minimum
without it the derivative of the cost by ρ is known from one more column, the delay's times t − t̄, and with what
directions and parameters absorb of that column, its variance: z = gradient / √information, 1 in standard deviation
where the clocks agree. That costs one solve. Only where it speaks are the magnetometer's stamps t replaced by
t₀ + (t − t₀)(1 − ρ) and everything fitted again, until z is small; what then has moved is what the drift did.
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
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.field_chain import DELAY
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording

_SPEAKS = 6.0  # sigmas; clean logs reach 3.3 in 280, the recordings of real instruments 4.8
_HARMS = 0.5  # sigmas by which a drift may move a parameter
_ROUNDS = 6
_NOISY = 1.5  # short-term noises of the magnetometer from which a fit leaves more than the sensor's own
_PART = (0.4, 0.6)  # of a recording that fits nowhere as a whole, where the drift is looked for first

Judge = Callable[[], bool]
Refit = Callable[[Recording, Array | None], tuple[Fit, Judge]]


class Drift(NamedTuple):
    """What a clock did.

    rate: s/s that the magnetometer's clock gains on the gyroscope's, and its sigma; moved: largest change of soft
    iron, hard iron or gyroscope bias that taking it out makes, in their sigmas; delay: s, at the first row and the
    last; known: s/s, what was taken out of the stamps before.
    """

    rate: float
    sigma: float
    moved: float
    delay: tuple[float, float]
    known: float = 0.0

    @property
    def harms(self) -> bool:
        """Whether the calibration that ignores it must not be trusted."""
        return self.moved > _HARMS

    @property
    def sentence(self) -> str:
        """What it is, and the remedy."""
        first, last = (f"{1e3 * d:.0f}" for d in self.delay)
        digits = int(np.clip(-np.floor(np.log10(100 * self.sigma)), 2, 6))
        what = f"clock {'gains' if self.rate > 0 else 'loses'} {100 * abs(self.rate):.{digits}f} %"
        what = f"the magnetometer's {what} on the gyroscope's"
        delay = f"its delay goes from {first} to {last} ms"
        if not self.harms:
            return f"{what}: {delay}, which moves no parameter by more than {_HARMS:g} sigma"
        taken_out = self.rate + self.known - self.rate * self.known
        remedy = f"correct the stamps, or have them corrected (--option clock_drift={taken_out:.4g})"
        return f"{what}: {remedy}; {delay}, which moves a parameter by {self.moved:.2g} sigma"


def with_drift(calibration: Calibration, drift: Drift | None) -> Calibration:
    """A calibration that says what the clocks did while it was recorded, and is not trusted where that harms it."""
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
    """The same with the magnetometer's clock slowed down by `drift` s/s from the first row on."""
    if not drift:
        return recording
    time, field = recording.magnetometer
    return recording.with_samples((slowed(time, recording.time[0], drift), field), recording.gyroscope)


def slowed(time: Array, start: float, drift: float) -> Array:
    """s, the stamps of a clock slowed down by `drift` s/s from `start` on."""
    return start + (time - start) * (1 - drift)


def speaks(fit: Fit) -> bool:
    """Whether a minimum without a drift says that there is one."""
    return abs(_score(fit).ratio) > _SPEAKS


def find_drift(recording: Recording, fit: Fit, trusted: bool, refit: Refit, near: float = 0.0) -> Drift | None:
    """The drift of a recording whose minimum without one is `fit`; None where the clocks keep step.

    Args:
        recording, fit, trusted: what was fitted, and whether the fit may be used but for a drift.
        refit: the fit of a recording, from θ (13,) or from nothing, and what tells whether it may be used.
        near: s/s, what an earlier part of the recording showed, tried where the whole has no minimum near.
    """
    found = speaks(fit)
    if not found and (trusted or _explained(recording, fit)):
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
        # What does not fit with the drift taken out has, or has as well, another cause.
        if good():
            break
    else:
        return None
    sigma = _score(corrected).sigma
    if abs(rate) < _SPEAKS * sigma:
        return None
    deviation = np.sqrt(np.diag(fit.covariance)[:DELAY] * fit.colour * fit.widening)
    moved = np.abs(corrected.state.parameters[:DELAY] - fit.state.parameters[:DELAY]) / deviation
    delay = float(corrected.state.parameters[DELAY])
    return Drift(rate, sigma, float(moved.max()), (delay, delay + rate * recording.duration))


def _explained(recording: Recording, fit: Fit) -> bool:
    """Whether a fit leaves no more than the magnetometer's own noise."""
    return fit.chain.noise.magnetometer < _NOISY * short_term_noise(recording).magnetometer


def _measure(
    recording: Recording, fit: Fit, good: Judge, refit: Refit, rate: float = 0.0
) -> tuple[float, Fit, Judge]:
    """The rate at which no drift is left, the fit there and what tells whether it may be used, from those at `rate`."""
    for _ in range(_ROUNDS):
        step, _, ratio = _score(fit)
        if abs(ratio) < 1 or abs(rate + step) > MOST_DRIFT:
            break
        rate += step
        fit, good = refit(restamped(recording, rate), fit.state.parameters)
    return rate, fit, good


def _measure_from_part(recording: Recording, refit: Refit) -> tuple[float, Fit, Judge]:
    """The same, from the rate of a part, in which a drift too large for the whole to have a minimum near is smaller."""
    part = recording.between(*(share * recording.duration for share in _PART))
    rate, fit, _ = _measure(part, *refit(part, None), refit)
    if abs(rate) < _SPEAKS * _score(fit).sigma:
        return rate, fit, lambda: False
    parameters = fit.state.parameters.copy()
    parameters[DELAY] -= rate * (part.time[0] - recording.time[0])
    return _measure(recording, *refit(restamped(recording, rate), parameters), refit, rate)


class _Score(NamedTuple):
    """The Gauss–Newton step of ρ and its sigma, s/s, and their ratio."""

    step: float
    sigma: float
    ratio: float


def _score(fit: Fit) -> _Score:
    """Of one more column, the delay's times t − t̄."""
    time = fit.chain.windows.time
    column = fit.reduced.on_parameters[DELAY] * (time - np.average(time, weights=fit.weights.window))
    information = max(float(np.vdot(column, column)) - explained(fit, column, fit.covariance), 1e-300)
    sigma = float(np.sqrt(fit.colour * fit.widening / information))
    step = -float(np.vdot(column, fit.whitened[0])) / information
    return _Score(step, sigma, step / sigma)
