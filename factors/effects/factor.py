"""Extra effects as variables of a graph, in addition to soft iron, hard iron and gyroscope bias.

`effect_chain_factor` is a field chain (a whole log, or any stretch of it) with effects on either sensor, for batch
and incremental graphs; `effect_magnetometer_factor` is one reading on an attitude of the graph, for pose graphs. An
effect adds Σ value_k · column_k to a reading. The columns (`effects.Form.columns`) are known: a current, a
temperature, a step; for an effect that depends on a signal of its own sensor (a scale error of the gyroscope), they
are evaluated at the present estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import gtsam
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.factors.chain.chain_values import (
    DELAY,
    PARAMETERS,
    WITH_SKEW,
    ChainState,
    Reduced,
    SensorNoise,
    iron_matrix,
)
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rate_columns import RateDerivatives
from magyc_gtsam.factors.chain.rotations import cross
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import check_chain, optional_keys
from magyc_gtsam.factors.guard import Residual, custom_factor, listed_keys, measured
from magyc_gtsam.factors.pose import MICROTESLA, body_field, in_unit, sensor_rotation
from magyc_gtsam.factors.units import check_field, check_readings, check_unit
from magyc_gtsam.factors.variables import Array, attitude, gyro_bias, vector

Side = Literal["magnetometer", "gyroscope"]

_LEAST = 3  # smallest number of windows of a chain
_BEYOND = 1.0  # s of the gyroscope kept at either end of a stretch, to allow for a change of the delay
_ROUNDING = 1e-12  # share of a parameter's information before elimination below which it counts as zero


def effect_chain_factor(
    soft_iron_key: int,
    hard_iron_key: int,
    gyro_bias_key: int,
    value_key: int | Sequence[int],
    samples: Preintegration,
    columns: Array | Sequence[Array],
    noise: SensorNoise,
    *,
    side: Side | Sequence[Side] = "magnetometer",
    mounting_key: int | None = None,
    delay_key: int | None = None,
    delay: float = 0.0,
    part: tuple[int, int] | None = None,
    soft_iron_unit: float = 1e-6,
    field_unit: float = 1e-6,
) -> gtsam.CustomFactor:
    """Return a factor over all windows of `samples`, with the directions eliminated as in `field_chain_factor`.

    It contains the whole sum of squares of its windows: effects on the same data go into one factor, each with its
    own key, not into separate factors. Stretches of a log share keys; a parameter that one of them does not
    determine (a step outside it) has rows of zeros in its Jacobian.

    Args:
        soft_iron_key, hard_iron_key, gyro_bias_key: as in `field_chain_factor`, in its units.
        value_key: k-vector, the effect's value; or a sequence of keys, one per effect, which may be empty.
        samples: samples of both sensors, in windows.
        columns: per unit of the value; for the magnetometer (k, 3, n) T, means over the windows; for the gyroscope
            (k, 3, G) rad/s, at its samples. With a sequence of keys, one array per key.
        noise: standard deviations per sample.
        side: the sensor that the effect acts on; one for all effects, or one per effect.
        mounting_key: as in `field_chain_factor`.
        delay_key: 1-vector, s; None fixes the delay at `delay`. The order of the factor's keys is soft iron, hard
            iron, gyroscope bias, values, mounting if any, delay if any.
        delay: s, the fixed delay.
        part: (first, last) windows of the factor, `last` excluded; None for all. `columns` still cover all samples,
            so that an effect with memory is the same in every stretch.
        soft_iron_unit, field_unit: T per unit of the keys.

    Raises:
        MagycError: as `field_chain_factor`; columns that do not fit the windows, or the gyroscope's samples; numbers
            of columns or sides that differ from that of the keys; a part of fewer than 3 windows.
    """
    check_chain("effect chain", samples, noise, delay, soft_iron_unit, field_unit)
    value_keys = listed_keys(value_key)
    effects = list(columns) if np.iterable(value_key) else [np.asarray(columns)]
    sides = list(side) if np.iterable(side) and not isinstance(side, str) else [side] * len(value_keys)
    if not len(value_keys) == len(effects) == len(sides):
        raise MagycError(
            f"{len(value_keys)} value keys, {len(effects)} columns and {len(sides)} sides; each effect has one of each"
        )
    effects = [_fitting(samples, each, its_side) for each, its_side in zip(effects, sides, strict=True)]
    counts = [len(each) for each in effects]
    rated = np.repeat(np.array([each == "gyroscope" for each in sides], dtype=bool), counts)
    samples, windows_of, rates_of = _stretch(samples, part, delay)

    def of(its_side: Side, rows: slice) -> list[Array]:
        return [each[:, :, rows] for each, side_ in zip(effects, sides, strict=True) if side_ == its_side]

    on_field = np.concatenate([np.empty((0, 3, len(samples.starts))), *of("magnetometer", windows_of)])
    on_rate = np.concatenate([np.empty((0, 3, len(samples.gyroscope_time))), *of("gyroscope", rates_of)])
    size = PARAMETERS if mounting_key is None else WITH_SKEW
    unit = np.concatenate([np.full(6, soft_iron_unit), np.full(3, field_unit), np.ones(size - 9 + sum(counts))])
    optional, rows = optional_keys(mounting_key, delay_key)
    rows = np.r_[rows[:DELAY], size : len(unit), rows[DELAY:]]  # the values precede the optional parameters
    keys = [soft_iron_key, hard_iron_key, gyro_bias_key, *value_keys, *(key for key, _ in optional)]
    sizes = [6, 3, 3, *counts] + [3] * (mounting_key is not None) + [1] * (delay_key is not None)

    def error(*arguments: Array | bool) -> tuple[Array, Sequence[Array]]:
        full = np.full(len(unit), delay)
        full[rows] = np.concatenate(arguments[:-1])
        full *= unit
        parameters, value = full[:size], full[size:]
        turning = np.tensordot(value[rated], on_rate, axes=1)
        corrected = samples.with_rate(samples.angular_rate - turning.T) if rated.any() else samples
        windows = corrected.integrate(parameters[9:12], parameters[DELAY])
        added = np.tensordot(value[~rated], on_field, axes=1)
        chain = FieldChain(replace(windows, field=windows.field - added), noise)
        state, reduced = chain.settle(chain.start(parameters), chain.unweighted())
        window = np.empty((len(value), 3, len(windows)))
        link = np.zeros((len(value), 3, len(windows) - 1))
        window[~rated] = on_field
        if rated.any():
            rate = corrected.angular_rate.T - parameters[9:12, None]
            errors = RateDerivatives.of(corrected, rate, windows.delay)
            window[rated], link[rated] = errors.columns(windows, iron_matrix(parameters), state.direction, on_rate)
        information, gradient, alone = bordered(chain, state, reduced, window, link)
        root, pull = semidefinite_root(
            (information * unit * unit[:, None])[np.ix_(rows, rows)], (gradient * unit)[rows], (alone * unit)[rows]
        )
        rest = np.sqrt(max(2 * reduced.cost - float(pull @ pull), 0.0))
        jacobian = np.vstack([root, np.zeros((1, len(root)))])
        return np.append(pull, rest), np.split(jacobian, np.cumsum(sizes)[:-1], axis=1)

    variables = [vector(6), vector(3), gyro_bias, *map(vector, counts), *(variable for _, variable in optional)]
    return custom_factor("effect chain", 1.0, keys, variables, sum(sizes) + 1, error)


def _fitting(samples: Preintegration, columns: ArrayLike, side: str) -> Array:
    """Check the columns of one effect against the samples of its sensor and return them as an array."""
    if side not in ("magnetometer", "gyroscope"):
        raise MagycError(f"side {side!r} is neither 'magnetometer' nor 'gyroscope'")
    on_rate = side == "gyroscope"
    rows = len(samples.gyroscope_time) if on_rate else len(samples.starts)
    result = np.asarray(columns, dtype=float)
    if result.ndim != 3 or result.shape[1:] != (3, rows):
        raise MagycError(
            f"columns: shape {result.shape}, expected (k, 3, {rows}), one per "
            f"{'gyroscope sample' if on_rate else 'window'}"
        )
    return result


def _stretch(
    samples: Preintegration, part: tuple[int, int] | None, delay: float
) -> tuple[Preintegration, slice, slice]:
    """Return the samples of a part of their windows, the slice of these windows and that of the gyroscope samples."""
    count = len(samples.starts)
    first, last = (0, count) if part is None else part
    if not 0 <= first <= last - _LEAST <= count - _LEAST:
        raise MagycError(
            f"windows {first} to {last} of {count}: at least {_LEAST} that exist are needed; take a longer stretch"
        )
    if last - first == count:
        return samples, slice(None), slice(None)
    result, rates = samples.stretch(first, last, _BEYOND + abs(delay))
    return result, slice(first, last), rates


def semidefinite_root(information: Array, gradient: Array, alone: Array) -> tuple[Array, Array]:
    """Return R (p, p) and r (p,) with RᵀR = information and Rᵀr = gradient, also where directions are not determined.

    Args:
        information: (p, p), positive semidefinite up to rounding.
        gradient: (p,) in its range.
        alone: (p,) square roots of the information's diagonal before any elimination, to which rounding is relative;
            0 for a parameter on which nothing depends.
    """
    scale = np.where(alone > 0, alone, 1.0)
    weight, direction = np.linalg.eigh(information / scale / scale[:, None])
    length = np.sqrt(np.where(weight > _ROUNDING, weight, 0.0))
    pull = np.divide(direction.T @ (gradient / scale), length, out=np.zeros_like(length), where=length > 0)
    return length[:, None] * direction.T * scale, pull


def bordered(
    chain: FieldChain, state: ChainState, reduced: Reduced, window: Array, link: Array
) -> tuple[Array, Array, Array]:
    """Return the information (p + k, p + k) and gradient on θ (p,) and k more parameters, with the directions
    eliminated.

    The third result holds the square roots (p + k,) of the information's diagonal with the directions held.

    Args:
        chain, state, reduced: the chain at its optimal directions.
        window: (k, 3, n) T per unit, derivatives of the windows' predictions.
        link: (k, 3, n − 1) rad per unit, derivatives of the links' residuals.
    """
    window, link = window * chain.window_scale, link * chain.link_scale
    (count, _, n), theirs = window.shape, len(reduced.gradient)
    border = np.einsum("ian,pin->pna", reduced.on_direction, window)
    border[:, 1:] += np.einsum("ian,pin->pna", reduced.basis[:, :, 1:] * chain.link_scale, link)
    border[:, :-1] -= np.einsum("ian,pin->pna", reduced.basis[:, :, :-1] * chain.link_scale, link)
    half = border.reshape(count, 2 * n).T
    if count:  # LAPACK writes beyond the memory of no columns
        half, _ = dtbtrs(reduced.factor, half, uplo="L")
    on_bias = np.zeros((theirs, 3, n - 1))
    on_bias[9:12] = -cross(state.direction[:, None, :-1], chain.windows.lever).swapaxes(0, 1)
    residuals = chain.residuals(state)

    def stacked(windows: Array, links: Array) -> Array:
        flat = [each.reshape(len(each), 3 * each.shape[-1]) for each in (windows, links)]
        return np.concatenate(flat, axis=1)

    own = stacked(window, link)
    theta = stacked(reduced.on_parameters, on_bias * chain.link_scale)
    left = stacked(residuals.window[None] * chain.window_scale, residuals.link[None] * chain.link_scale)[0]
    across = theta @ own.T - reduced.half[:, :-1].T @ half
    information = np.block([[reduced.information, across], [across.T, own @ own.T - half.T @ half]])
    gradient = np.append(reduced.gradient, own @ left - half.T @ reduced.half[:, -1])
    alone = np.append(np.linalg.norm(theta, axis=1), np.linalg.norm(own, axis=1))
    return information, gradient, alone


def effect_magnetometer_factor(
    attitude_key: int,
    soft_iron_key: int,
    hard_iron_key: int,
    value_key: int,
    measurement: ArrayLike,
    columns: ArrayLike,
    noise: float | gtsam.noiseModel.Base,
    *,
    field: ArrayLike,
    body_R_sensor: gtsam.Rot3 | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """Return `magnetometer_factor` in a known field with an effect: m = A (ᵇRₛᵀ Rᵀ f) + h + Σ value_k · column_k.

    Args:
        attitude_key, soft_iron_key, hard_iron_key: as in `magnetometer_factor`.
        value_key: k-vector, the effect's value.
        measurement: (3,) T, sensor frame.
        columns: (k, 3) T per unit of the value, at the time of the measurement.
        noise: standard deviation per axis in T, or a noise model of the 3 rows in `field_unit`.
        field: (3,) T, world frame.
        body_R_sensor: sensor→body.
        field_unit: T per unit of the key h.

    Raises:
        MagycError: numbers that are not finite, of a wrong shape or in an implausible unit.
    """
    name = "magnetometer with an effect"
    check_unit(field_unit)
    f = measured("field", field, (3,)) / field_unit
    check_field(name, float(np.linalg.norm(f)) * field_unit)
    m = measured("measurement", measurement, (3,)) / field_unit
    check_readings(name, m * field_unit)
    on_value = measured("columns", columns, (None, 3)).T / field_unit
    mounting = sensor_rotation(body_R_sensor)

    def error(rotation: Array, a: Array, h: Array, value: Array, want_jacobians: bool) -> Residual:
        seen, on_rotation, _ = body_field(mounting, rotation, f)
        soft_iron = unvech(a)
        residual = soft_iron @ seen + h + on_value @ value - m
        if not want_jacobians:
            return residual, []
        return residual, [soft_iron @ on_rotation, (SYMMETRIC_UNITS @ seen).T, np.eye(3), on_value]

    variables = [attitude, vector(6), vector(3), vector(on_value.shape[1])]
    keys = [attitude_key, soft_iron_key, hard_iron_key, value_key]
    return custom_factor(name, in_unit(name, noise, field_unit), keys, variables, 3, error)
