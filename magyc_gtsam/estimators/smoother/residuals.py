"""The residuals of a calibration in each window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother import starts
from magyc_gtsam.estimators.smoother.clock_drift import restamped
from magyc_gtsam.estimators.smoother.gyroscope_scale import SCALE, corrected_rates
from magyc_gtsam.estimators.smoother.noise_levels import weigh
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording


@dataclass(frozen=True, eq=False)
class WindowResiduals:
    """The residuals of windows and links, with their sigmas and robust weights.

    Attributes:
        time: (n,) s, window centres, on the recording's clock.
        magnetic_field: (n, 3) T, sensor axes.
        magnetic_sigma: (n,) T; magnetic_weight: (n,) robust weight in [0, 1].
        link: (n − 1, 3) rad, change of the field's direction between neighbouring windows less that by the gyroscope.
        link_sigma: (n − 1,) rad, infinite across a gap in the data; link_weight: (n − 1,) robust weight in [0, 1].
    """

    time: Array
    magnetic_field: Array
    magnetic_sigma: Array
    magnetic_weight: Array
    link: Array
    link_sigma: Array
    link_weight: Array


def window_residuals(recording: Recording, calibration: Calibration) -> WindowResiduals:
    """Return the residuals of any calibration with a gyroscope bias, smoothing the directions at its parameters.

    Raises:
        MagycError: no gyroscope, or no gyroscope bias.
    """
    if calibration.gyro_bias is None:
        raise MagycError(
            f"method {calibration.method!r} estimates no gyroscope bias, so there are no window residuals"
        )
    recording = restamped(recording, calibration.configuration.get("clock_drift", 0.0))
    for term in calibration.terms:
        if term.name == SCALE:
            recording = corrected_rates(recording, term.value, calibration.gyro_bias)
    samples = preintegrate(recording)
    windows = samples.integrate(calibration.gyro_bias, calibration.delay)
    noise = short_term_noise(recording)
    chain = FieldChain(
        windows,
        SensorNoise(
            calibration.noise.get("magnetic_field", noise.magnetometer),
            calibration.noise.get("angular_rate", noise.gyroscope),
        ),
    )
    strength = calibration.field_strength or float(
        np.median(np.linalg.norm(calibration.apply(recording.magnetometer.value), axis=1))
    )
    parameters = starts.parameters(
        calibration.soft_iron * strength, calibration.hard_iron, calibration.gyro_bias, calibration.delay
    )
    for term in calibration.terms:
        if term.name == "misalignment":
            parameters = np.append(parameters, -term.value)
    fit = weigh(chain, parameters)
    residuals = chain.residuals(fit.state)
    return WindowResiduals(
        windows.time,
        residuals.window.T,
        chain.window_sigma,
        fit.weights.window,
        residuals.link.T,
        chain.link_sigma,
        fit.weights.link,
    )
