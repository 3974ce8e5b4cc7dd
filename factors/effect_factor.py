"""Extra effects as variables of a graph, beside soft iron, hard iron and gyroscope bias.

`effect_chain_factor` is a field chain (a whole log, or any stretch of it) with one effect on either sensor, for batch
and incremental graphs; `effect_magnetometer_factor` one reading on an attitude of the graph, for pose graphs. The
effect adds Σ value_k · column_k to a reading, the columns (`effects.Form.columns`) being known: a current, a
temperature, a step; of an effect that reads a signal of its own sensor (a scale of the gyroscope), the columns at
the present estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import gtsam
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY, PARAMETERS, FieldChain, Noise, Reduced, State
from magyc_gtsam.factors.guard import Array, Residual, custom_factor, gyro_bias, measured, vector
from magyc_gtsam.factors.pose import MICROTESLA, attitude, body_field, check_unit, in_unit, sensor_rotation
from magyc_gtsam.factors.preintegration import Preintegration
from magyc_gtsam.factors.rate_columns import attitude as attitudes
from magyc_gtsam.factors.rate_columns import rate_columns, with_rate
from magyc_gtsam.factors.rotations import cross
from magyc_gtsam.factors.soft_iron import SYMMETRIC_UNITS, unvech

Side = Literal["magnetometer", "gyroscope"]


def effect_chain_factor(
    soft_iron_key: int,
    hard_iron_key: int,
    gyro_bias_key: int,
    value_key: int,
    samples: Preintegration,
    columns: Array,
    noise: Noise,
    *,
    side: Side = "magnetometer",
    delay: float = 0.0,
    soft_iron_unit: float = 1e-6,
    field_unit: float = 1e-6,
) -> gtsam.CustomFactor:
    """A factor over all windows of `samples`, the directions eliminated inside as in `field_chain_factor`.

    Args:
        soft_iron_key, hard_iron_key, gyro_bias_key: as in `field_chain_factor`, in its units.
        value_key: k-vector, the effect's value.
        samples: both sensors' samples in windows.
        columns: per unit of the value; of the magnetometer (k, 3, n) T, means over the windows; of the gyroscope
            (k, 3, G) rad/s, at its samples.
        noise: standard deviations per sample.
        side: the sensor that the effect adds to.
        delay: s, fixed.
        soft_iron_unit, field_unit: T per unit of the keys.

    Raises:
        MagycError: columns that do not fit the windows, or the gyroscope's samples.
    """
    if side not in ("magnetometer", "gyroscope"):
        raise MagycError(f"side {side!r} is neither 'magnetometer' nor 'gyroscope'")
    on_rate = side == "gyroscope"
    rows = len(samples.gyroscope_time) if on_rate else len(samples.starts)
    columns = np.asarray(columns, dtype=float)
    if columns.ndim != 3 or columns.shape[1:] != (3, rows):
        raise MagycError(
            f"columns: shape {columns.shape}, expected (k, 3, {rows}), one per "
            f"{'gyroscope sample' if on_rate else 'window'}"
        )
    count = len(columns)
    unit = np.concatenate([np.full(6, soft_iron_unit), np.full(3, field_unit), np.ones(3)])

    def error(*values: Array | bool) -> tuple[Array, Sequence[Array]]:
        soft_iron, hard_iron, bias, value, _ = values
        parameters = np.append(np.concatenate([soft_iron, hard_iron, bias]) * unit, delay)
        added = np.tensordot(np.asarray(value), columns, axes=1)
        if on_rate:
            corrected = with_rate(samples, samples.angular_rate - added.T)
            chain = FieldChain(corrected.integrate(parameters[9:12], delay), noise)
        else:
            windows = samples.integrate(parameters[9:12], delay)
            chain = FieldChain(replace(windows, field=windows.field - added), noise)
        state, reduced = chain.settle(chain.start(parameters), chain.unweighted())
        if on_rate:
            turn = attitudes(corrected, corrected.angular_rate.T - parameters[9:12, None])
            soft = unvech(parameters[:6])
            window, link = rate_columns(corrected, chain.windows, soft, state.direction, turn, columns)
        else:
            window, link = columns, np.zeros((count, 3, chain.link_scale.size))
        information, gradient = bordered(chain, state, reduced, window, link)
        scale = np.concatenate([unit, np.ones(count)])
        kept = np.concatenate([np.arange(DELAY), np.arange(PARAMETERS, PARAMETERS + count)])
        root = np.linalg.cholesky(information[np.ix_(kept, kept)] * scale * scale[:, None]).T
        pull = solve_triangular(root, gradient[kept] * scale, trans="T")
        rest = np.sqrt(max(2 * reduced.cost - float(pull @ pull), 0.0))
        jacobian = np.vstack([root, np.zeros((1, len(kept)))])
        return np.append(pull, rest), np.split(jacobian, [6, 9, 12], axis=1)

    keys = [soft_iron_key, hard_iron_key, gyro_bias_key, value_key]
    variables = [vector(6), vector(3), gyro_bias, vector(count)]
    return custom_factor("effect chain", 1.0, keys, variables, DELAY + count + 1, error)


def bordered(chain: FieldChain, state: State, reduced: Reduced, window: Array, link: Array) -> tuple[Array, Array]:
    """Information (13 + k, 13 + k) and gradient on θ and k more parameters, the directions eliminated.

    Args:
        chain, state, reduced: the chain at its best directions.
        window: (k, 3, n) T per unit, derivatives of the windows' predictions.
        link: (k, 3, n − 1) rad per unit, of the links' residuals.
    """
    window, link = window * chain.window_scale, link * chain.link_scale
    count, _, n = window.shape
    border = np.einsum("ian,pin->pna", reduced.on_direction, window)
    border[:, 1:] += np.einsum("ian,pin->pna", reduced.basis[:, :, 1:] * chain.link_scale, link)
    border[:, :-1] -= np.einsum("ian,pin->pna", reduced.basis[:, :, :-1] * chain.link_scale, link)
    half, _ = dtbtrs(reduced.factor, border.reshape(count, 2 * n).T, uplo="L")
    on_bias = np.zeros((PARAMETERS, 3, n - 1))
    on_bias[9:12] = -cross(state.direction[:, None, :-1], chain.windows.lever).swapaxes(0, 1)
    residuals = chain.residuals(state)

    def stacked(windows: Array, links: Array) -> Array:
        return np.concatenate([windows.reshape(len(windows), -1), links.reshape(len(links), -1)], axis=1)

    own = stacked(window, link)
    theta = stacked(reduced.on_parameters, on_bias * chain.link_scale)
    left = stacked(residuals.window[None] * chain.window_scale, residuals.link[None] * chain.link_scale)[0]
    inside = reduced.half[:, :PARAMETERS]
    size = PARAMETERS + count
    information = np.empty((size, size))
    information[:PARAMETERS, :PARAMETERS] = reduced.information
    information[PARAMETERS:, PARAMETERS:] = own @ own.T - half.T @ half
    information[:PARAMETERS, PARAMETERS:] = theta @ own.T - inside.T @ half
    information[PARAMETERS:, :PARAMETERS] = information[:PARAMETERS, PARAMETERS:].T
    gradient = np.append(reduced.gradient, own @ left - half.T @ reduced.half[:, PARAMETERS])
    return information, gradient


def effect_magnetometer_factor(
    keys: Sequence[int],
    measurement: ArrayLike,
    columns: ArrayLike,
    noise: float | gtsam.noiseModel.Base,
    *,
    field: ArrayLike,
    body_R_sensor: gtsam.Rot3 | None = None,
    field_unit: float = MICROTESLA,
) -> gtsam.CustomFactor:
    """`magnetometer_factor` in a known field, with an effect: m = A (ᵇRₛᵀ Rᵀ f) + h + Σ value_k · column_k.

    Args:
        keys: of R (`Pose3`, `Rot3`, `Rot2`, body→world), A (6-vector, vech of the soft iron), h (3-vector or
            `Point3`, `field_unit`) and the value (k-vector).
        measurement: (3,) T, sensor frame.
        columns: (k, 3) T per unit of the value, at the time of the measurement.
        noise: standard deviation per axis in T, or a noise model of the 3 rows in `field_unit`.
        field: (3,) T, world frame.
        body_R_sensor: sensor→body.
        field_unit: T per unit of the key h.

    Raises:
        MagycError: numbers that are not finite, or of a wrong shape.
    """
    check_unit(field_unit)
    m, f = measured("measurement", measurement, (3,)) / field_unit, measured("field", field, (3,)) / field_unit
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
    return custom_factor("magnetometer with an effect", in_unit(noise, field_unit), keys, variables, 3, error)
