"""Whether an estimate has settled: refits agree with the ones before, and with what was marginalised."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.reasons import misfits
from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.factors.chain.chain_values import DELAY, PARAMETERS, SKEW
from magyc_gtsam.online.report import observable
from magyc_gtsam.online.state import SmootherState
from magyc_gtsam.recording import Array

_STILL = 1.5  # sigmas of the preceding refit by which a parameter of a converged estimate may have moved
_CONTRADICTED = 3.0  # sigmas of a calibration without the past by which one with it is off, if it contradicts


def to_compare(online: SmootherState, fit: Fit, report: Calibration) -> Array | None:
    """Return θ and its sigmas (2, p), by which the next refit is judged; None if the model does not fit.

    Such a fit has sigmas so wide that any next one is within them, though its data let several minima appear. The
    sigmas include the model error: the mean of a bias that drifts moves by more than the noise of the sensors.
    """
    strength = report.field_strength
    if strength is None or misfits(fit, strength, observable(report)):
        return None
    variance, unexplained = fit.colour * np.diag(fit.covariance), online.belief.unexplained
    if unexplained is not None:
        variance[:PARAMETERS] += np.diag(unexplained.covariance)[:PARAMETERS]
    if online.belief.iron_change is not None:
        variance[:PARAMETERS] += np.diag(online.belief.iron_change.covariance)[:PARAMETERS]
    return np.array([fit.state.parameters, np.sqrt(variance)])


def is_stable(online: SmootherState, fit: Fit) -> bool:
    """Return whether no parameter moved by more than a few sigmas of the preceding refit and its random walk.

    The comparison is at the misalignment of the preceding refit, since the effect of a different decision about it is
    in the covariance of both.
    """
    belief, estimate = online.belief, online.last
    if belief.refitted is None:
        return False
    factor = 2 if belief.stable else 1  # hysteresis: convergence is revoked at a larger change
    variance = belief.refitted[1] ** 2
    hours = (online.buffer.magnetometer.time[-1] - online.buffer.magnetometer.time[0]) / 3600
    for rows, walk in online.settings.walks:
        variance[rows] += walk**2 * hours
    moved = estimate.parameters[:DELAY] - belief.refitted[0][:DELAY]
    if fit.skew is not None:
        angles = [with_angles(parameters)[SKEW] for parameters in (belief.refitted[0], estimate.parameters)]
        moved += fit.skew.gain[:DELAY] @ (angles[0] - angles[1])
    return bool((np.abs(moved) <= factor * _STILL * np.sqrt(variance[:DELAY])).all())


def agree(one: Calibration, other: Calibration) -> bool:
    """Return whether two calibrations agree within the sigmas of the `other`, which has fewer data."""
    assert one.gyro_bias is not None
    assert other.gyro_bias is not None
    assert other.covariance is not None
    away = [one.soft_iron - other.soft_iron, one.hard_iron - other.hard_iron, one.gyro_bias - other.gyro_bias]
    moved = np.concatenate([away[0][np.triu_indices(3)], *away[1:]])
    return bool((np.abs(moved) <= _CONTRADICTED * np.sqrt(np.diag(other.covariance))).all())
