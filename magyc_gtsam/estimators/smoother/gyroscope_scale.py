"""Joint estimation of the gyroscope's scale errors and the calibration, as an option.

The gyroscope is modelled as reading = ω ∘ (1 + g) + bias with g ~ N(0, s²) on each axis. The rates are divided by 1 + g
and fitted again until g converges (Gauss–Newton on g, each step at the minimum over all other parameters). Dividing the
rates also divides their noise, which would lower the cost of the links. In the likelihood of the readings, where the
noise is added after the scale, the gradient has the additional term Σ n²/σ² (`_noise_shrunk`; without it g is too large
by up to 2 % on a motion of small turns). Finally g is a term beside θ (`EstimatedTerms`) in the model error.

One log determines g to some tenths of a percent about the axes that it turns about, and no better than the prior about
others. Many logs of one instrument can share it (`magyc_gtsam.history`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.columns import EstimatedTerms, UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.estimators.smoother.search import fit_field_chain, shortened
from magyc_gtsam.factors.chain.chain_values import PARAMETERS
from magyc_gtsam.factors.chain.rate_columns import RateDerivatives
from magyc_gtsam.factors.chain.rotations import cross
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.held import with_equal_samples

SCALE = "gyro-scale"
SCALED_AXES = {"x": 1.0, "y": 1.0, "z": 1.0}  # estimated elements of this term
_FAMILIES = ("gyroscope:scale", "gyroscope:scales")
_ROUNDS = 12
_SETTLED = 0.01  # squared length of a step in sigmas
_MOST = 4.0  # prior standard deviations beyond which g is not plausible as a scale error


class ScaleError(NamedTuple):
    """The result of `with_scale`.

    Attributes:
        recording: with its rates corrected.
        fit: of the corrected recording, with the scales as terms.
        doubt: why the scales are implausible, in which case recording and fit are those given; "" if plausible.
    """

    recording: Recording
    fit: Fit
    doubt: str = ""


class GyroscopeScale(NamedTuple):
    """The scales of a fit.

    Attributes:
        value: (3,) g, relative.
        covariance: (3, 3) of g.
        gain: (13, 3) dθ/dg of the other parameters.
        shift: (13,) change of the other parameters from the fit's values to those that hold at `value`.
    """

    value: Array
    covariance: Array
    gain: Array
    shift: Array

    @property
    def term(self) -> Term:
        """The scales as a term of a calibration."""
        return Term(SCALE, self.value, self.covariance, SCALED_AXES)

    @property
    def cross(self) -> Array:
        """(13, 3) cross-covariance of θ with g."""
        return self.gain @ self.covariance


def scale_of(fit: Fit, factor: float) -> GyroscopeScale | None:
    """Return the scales of a fit that has them as terms; None if it has not.

    Args:
        fit: at its minimum.
        factor: by which the data's information is divided.
    """
    terms = fit.terms
    if terms is None:
        return None
    beside = replace(fit, terms=None).beside
    new = beside.of(terms.columns)
    covariance: Array = np.linalg.inv(new.normal / factor + np.diag(terms.precision)).astype(np.float64)
    step = covariance @ ((new.score - _noise_shrunk(fit)) / factor - terms.precision * terms.value)
    gain = -beside.move(new)[:PARAMETERS]
    return GyroscopeScale(terms.value + step, covariance, gain, gain @ step)


def with_scale(recording: Recording, fit: Fit, options: SmootherOptions) -> ScaleError:
    """Estimate the scales.

    Args:
        recording: as read.
        fit: of that recording, at its minimum.
        options: of the fit, with the prior standard deviation of each axis' scale, relative.
    """
    value, corrected, given, deviation = np.zeros(3), recording, fit, options.gyroscope_scale
    most = _MOST * deviation
    fit = _beside_scale(recording, fit, value, options)
    wanted = value
    for _ in range(_ROUNDS):
        scale = scale_of(fit, fit.colour * fit.widening)
        assert scale is not None
        wanted = scale.value
        # Far from the minimum a step may go beyond what is possible, although the minimum does not.
        towards = np.clip(wanted, -most, most)
        step = towards - value
        if step @ np.linalg.solve(scale.covariance, step) < _SETTLED:
            break
        value = towards
        corrected = corrected_rates(recording, value, fit.state.parameters[9:12])
        fit = fit_field_chain(corrected, options, start=fit.state.parameters)
        fit = _beside_scale(corrected, fit, value, options)
    if np.abs(wanted).max() > most:
        return ScaleError(recording, given, _doubt(wanted, deviation))
    return ScaleError(corrected, fit)


def _doubt(value: Array, deviation: float) -> str:
    worst = int(np.argmax(np.abs(value)))  # its value is not that of the minimum, which is farther away
    return (
        f"the gyroscope's scale would be off by more than {100 * _MOST * deviation:g} % along {'xyz'[worst]}, where "
        f"{100 * deviation:g} % (1σ) is expected: check its unit, or expect more (gyroscope_scale)"
    )


def _beside_scale(recording: Recording, fit: Fit, value: Array, options: SmootherOptions) -> Fit:
    """Return a fit with the scales, at `value`, as terms."""
    precision = np.full(3, options.gyroscope_scale**-2)
    return replace(fit, terms=EstimatedTerms(_columns(recording, fit, options), value, precision, _FAMILIES))


def _columns(recording: Recording, fit: Fit, options: SmootherOptions) -> UnmodelledColumns:
    """Return the change of the residuals per unit of each scale, integrated from the gyroscope's samples.

    A mean over a window does not resolve a sway of a second: on a hovering multirotor the hard iron was ten sigmas off.
    """
    windows = fit.chain.windows
    samples = preintegrate(recording, options.window, options.turn)
    if len(samples.starts) != len(windows):
        samples = preintegrate(recording, shortened(options.window), options.turn)
    rate = samples.angular_rate.T - windows.bias[:, None]
    derivatives = RateDerivatives.of(samples, rate, windows.delay)
    soft_iron, columns = unvech(fit.state.parameters[:6]), []
    for axis in np.eye(3):  # one after the other, since a long log has millions of samples
        error = (axis[:, None] * rate)[None]
        columns.append(derivatives.columns(windows, soft_iron, fit.state.direction, error))
    window, link = (np.concatenate(parts) for parts in zip(*(each[:2] for each in columns), strict=True))
    return UnmodelledColumns(window, link)


def _noise_shrunk(fit: Fit) -> Array:
    """Return (3,) Σ n²/σ² about each of the sensor's axes, with n the residuals of the links."""
    rotation, direction = fit.chain.windows.rotation[..., :-1], fit.state.direction[:, :-1]
    turned = np.einsum("ijn,jn->in", rotation, cross(direction, fit.residuals.link))
    result: Array = turned**2 @ (fit.weights.link * fit.chain.link_scale**2)
    return result


def corrected_rates(recording: Recording, value: Array, bias: Array) -> Recording:
    """Return the recording with its rates corrected for the scales (3,) about the bias (3,) rad/s."""
    time, rate = recording.gyroscope
    corrected = time, bias + (rate - bias) / (1 + value)
    return with_equal_samples(recording.with_samples(recording.magnetometer, corrected))
