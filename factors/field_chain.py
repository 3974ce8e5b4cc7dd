"""The field chain as ONE GTSAM factor on soft iron, hard iron, gyroscope bias[, mounting][, delay].

As GTSAM's smart factors eliminate landmarks, this factor eliminates the field direction of every window: its
error is the cost at the best directions for the given values; its linearisation is the Schur complement
S = RᵀR with gradient g, written as the residual (R⁻ᵀg, rest) with the Jacobian (R, 0). A whole log, or any
part of it, thus enters a graph without a variable, or a Python call, per window.
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from scipy.linalg import solve_triangular

from magyc_gtsam.factors.chain.chain_values import (
    DELAY,
    PARAMETERS,
    SKEW,
    WITH_SKEW,
    ChainState,
    SensorNoise,
    Weights,
)
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.guard import check_delay, check_kind, custom_factor, standard_deviation
from magyc_gtsam.factors.pose import given_keys
from magyc_gtsam.factors.units import check_noise, check_rate_noise, check_rates, check_readings, check_unit
from magyc_gtsam.factors.variables import Array, Variable, gyro_bias, scalar, skew_angles, vector

_MOVED = 2e-3  # rad, rotation of a window by a changed bias or delay from which the gyroscope is integrated again


def field_chain_factor(
    soft_iron_key: int,
    hard_iron_key: int,
    gyro_bias_key: int,
    samples: Preintegration,
    noise: SensorNoise,
    *,
    mounting_key: int | None = None,
    delay_key: int | None = None,
    delay: float = 0.0,
    weights: Weights | None = None,
    soft_iron_unit: float = 1e-6,
    field_unit: float = 1e-6,
) -> gtsam.CustomFactor:
    """Return a factor over all windows of `samples` (docs/field_chain.md).

    Args:
        soft_iron_key: 6-vector, vech of soft iron times field strength, in `soft_iron_unit` T. With the field
            strength as its unit the key holds the soft iron itself.
        hard_iron_key: Point3 or 3-vector in `field_unit` T.
        gyro_bias_key: Point3, 3-vector or imuBias.ConstantBias, rad/s.
        samples: samples of both sensors, in windows.
        noise: standard deviations per sample.
        mounting_key: ᵇRₛ as a variable, `Rot3` (`mounting_prior`), from the magnetometer's axes to the gyroscope's:
            the skew between the chips, Exp(ε) = ᵇRₛᵀ; below 180°. Without it the axes are the same.
        delay_key: double or 1-vector, s; None fixes the delay at `delay`.
        delay: s, the fixed delay, and the linearisation point of one that is a variable.
        weights: robust weights of windows and links; None weights all of them by 1.
        soft_iron_unit, field_unit: T per unit of the keys; they keep a graph's variables of order one.

    Raises:
        MagycError: immediately, for samples, noise or a delay of another kind or unit, and units that are not
            positive; later, as `custom_factor`.
    """
    check_chain("field chain", samples, noise, delay, soft_iron_unit, field_unit)
    size = PARAMETERS if mounting_key is None else WITH_SKEW
    unit = np.concatenate([np.full(6, soft_iron_unit), np.full(3, field_unit), np.ones(size - 9)])
    marginal = _Marginal(samples, noise, weights, delay)
    optional, rows = optional_keys(mounting_key, delay_key)
    sizes = [6, 3, 3] + [3] * (mounting_key is not None) + [1] * (delay_key is not None)

    def error(*values: Array | bool) -> tuple[Array, Sequence[Array]]:
        parameters = np.full(size, delay)
        parameters[rows] = np.concatenate(values[:-1])
        cost, information, gradient = marginal.at(parameters * unit)
        root = np.linalg.cholesky((information * unit * unit[:, None])[np.ix_(rows, rows)]).T
        pull = solve_triangular(root, (gradient * unit)[rows], trans="T")
        rest = np.sqrt(max(2 * cost - float(pull @ pull), 0.0))
        jacobian = np.vstack([root, np.zeros((1, len(rows)))])
        return np.append(pull, rest), np.split(jacobian, np.cumsum(sizes)[:-1], axis=1)

    keys = [soft_iron_key, hard_iron_key, gyro_bias_key, *(key for key, _ in optional)]
    variables = [vector(6), vector(3), gyro_bias, *(variable for _, variable in optional)]
    return custom_factor("field chain", 1.0, keys, variables, len(rows) + 1, error)


def check_chain(
    name: str, samples: Preintegration, noise: SensorNoise, delay: float, soft_iron_unit: float, field_unit: float
) -> None:
    """Check the arguments that every factor of a chain has: kinds, units, finite numbers.

    Raises:
        MagycError: one of them is wrong.
    """
    check_unit(soft_iron_unit, "soft_iron_unit")
    check_unit(field_unit)
    check_kind(f"{name}: `samples`", samples, Preintegration, "a Preintegration of the samples of both sensors")
    check_kind(f"{name}: `noise`", noise, SensorNoise, "SensorNoise(magnetometer T, gyroscope rad/s)")
    check_noise(name, noise.magnetometer)
    check_rate_noise(name, standard_deviation(noise.gyroscope, "the gyroscope"))
    check_delay(name, delay)
    check_readings(name, samples.magnetic_field)
    check_rates(name, samples.angular_rate)


def optional_keys(
    mounting_key: int | None, delay_key: int | None
) -> tuple[list[tuple[int, Variable]], np.ndarray]:
    """Return the optional keys that were given, with their readers, and the rows of θ that all keys hold, in key
    order.
    """
    optional = given_keys((mounting_key, skew_angles), (delay_key, scalar))
    rows = np.r_[:DELAY, [] if mounting_key is None else SKEW, [] if delay_key is None else DELAY]
    return optional, rows.astype(int)


class _Marginal:
    """The chain's cost as a function of θ alone, with the directions eliminated.

    It keeps the last chain and directions as a warm start, which does not change the minimum.
    """

    def __init__(self, samples: Preintegration, noise: SensorNoise, weights: Weights | None, delay: float) -> None:
        self._samples, self._noise = samples, noise
        self._chain = FieldChain(samples.integrate(delay=delay), noise)
        self._weights = weights or self._chain.unweighted()
        self._direction: Array | None = None

    def at(self, parameters: Array) -> tuple[float, Array, Array]:
        """Return cost, information (p, p) and gradient (p,) at the best directions for θ (p,)."""
        windows = self._chain.windows
        turned = (
            np.abs(windows.lever[:, :, windows.linked]).max(initial=0.0)
            * np.abs(parameters[9:12] - windows.bias).max()
        )
        slid = np.abs(windows.rotation_rate).max() * abs(parameters[DELAY] - windows.delay)
        if max(turned, slid) > _MOVED:
            self._chain = FieldChain(self._samples.integrate(parameters[9:12], parameters[DELAY]), self._noise)
            self._direction = None
        chain = self._chain
        state = chain.start(parameters)
        if self._direction is not None:
            state = ChainState(parameters, self._direction)
        state, reduced = chain.settle(state, self._weights)
        self._direction = state.direction
        return reduced.cost, reduced.information, reduced.gradient
