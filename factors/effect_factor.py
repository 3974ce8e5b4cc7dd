"""A field chain with one extra effect on the magnetometer, as ONE GTSAM factor on soft iron, hard iron, bias and value.

The effect adds Σ value_k · column_k to every window's mean reading, the columns (`effects.Form.columns`, averaged over
the windows) being known: a current, a temperature, a step. The directions are eliminated inside, as in
`field_chain_factor`; effects on the gyroscope enter by its corrected rate (`corrections.corrected_rate`) instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY, PARAMETERS, FieldChain, Noise, State
from magyc_gtsam.factors.guard import Array, custom_factor, gyro_bias, vector
from magyc_gtsam.factors.preintegration import Preintegration


def effect_chain_factor(
    soft_iron_key: int,
    hard_iron_key: int,
    gyro_bias_key: int,
    value_key: int,
    samples: Preintegration,
    columns: Array,
    noise: Noise,
    *,
    delay: float = 0.0,
    soft_iron_unit: float = 1e-6,
    field_unit: float = 1e-6,
) -> gtsam.CustomFactor:
    """A factor over all windows of `samples`.

    Args:
        soft_iron_key, hard_iron_key, gyro_bias_key: as in `field_chain_factor`, in its units.
        value_key: k-vector, the effect's value.
        samples: both sensors' samples in windows.
        columns: (k, 3, n) T per unit of the value, means over the windows.
        noise: standard deviations per sample.
        delay: s, fixed.
        soft_iron_unit, field_unit: T per unit of the keys.

    Raises:
        MagycError: columns that do not fit the windows.
    """
    columns = np.asarray(columns, dtype=float)
    if columns.ndim != 3 or columns.shape[1:] != (3, len(samples.starts)):
        raise MagycError(f"columns: shape {columns.shape}, expected (k, 3, {len(samples.starts)}), one per window")
    count = len(columns)
    unit = np.concatenate([np.full(6, soft_iron_unit), np.full(3, field_unit), np.ones(3)])

    def error(*values: Array | bool) -> tuple[Array, Sequence[Array]]:
        soft_iron, hard_iron, bias, value, _ = values
        parameters = np.append(np.concatenate([soft_iron, hard_iron, bias]) * unit, delay)
        windows = samples.integrate(parameters[9:12], delay)
        added = np.tensordot(np.asarray(value), columns, axes=1)
        cost, information, gradient = extended(
            FieldChain(replace(windows, field=windows.field - added), noise), parameters, columns
        )
        scale = np.concatenate([unit, np.ones(count)])
        kept = np.concatenate([np.arange(DELAY), np.arange(PARAMETERS, PARAMETERS + count)])
        root = np.linalg.cholesky(information[np.ix_(kept, kept)] * scale * scale[:, None]).T
        pull = solve_triangular(root, gradient[kept] * scale, trans="T")
        rest = np.sqrt(max(2 * cost - float(pull @ pull), 0.0))
        jacobian = np.vstack([root, np.zeros((1, len(kept)))])
        return np.append(pull, rest), np.split(jacobian, [6, 9, 12], axis=1)

    keys = [soft_iron_key, hard_iron_key, gyro_bias_key, value_key]
    variables = [vector(6), vector(3), gyro_bias, vector(count)]
    return custom_factor("effect chain", 1.0, keys, variables, DELAY + count + 1, error)


def extended(chain: FieldChain, parameters: Array, columns: Array) -> tuple[float, Array, Array]:
    """Cost, information and gradient on θ (13) and the columns' values, the directions eliminated at their best.

    Args:
        chain: of windows whose field is free of the effect at its present value.
        parameters: (13,) θ.
        columns: (k, 3, n) T per unit.
    """
    weights = chain.unweighted()
    state, reduced = chain.settle(chain.start(parameters), weights)
    scaled = columns * chain.window_scale
    count, _, n = scaled.shape
    border = np.einsum("ian,pin->pna", reduced.on_direction, scaled).reshape(count, 2 * n)
    half, _ = dtbtrs(reduced.factor, border.T, uplo="L")
    flat, on_parameters = scaled.reshape(count, -1), reduced.on_parameters.reshape(PARAMETERS, -1)
    residual = (chain.residuals(State(parameters, state.direction)).window * chain.window_scale).ravel()
    inside = reduced.half[:, :PARAMETERS]
    size = PARAMETERS + count
    information = np.empty((size, size))
    information[:PARAMETERS, :PARAMETERS] = reduced.information
    information[PARAMETERS:, PARAMETERS:] = flat @ flat.T - half.T @ half
    information[:PARAMETERS, PARAMETERS:] = on_parameters @ flat.T - inside.T @ half
    information[PARAMETERS:, :PARAMETERS] = information[:PARAMETERS, PARAMETERS:].T
    gradient = np.append(reduced.gradient, flat @ residual - half.T @ reduced.half[:, PARAMETERS])
    return reduced.cost, information, gradient
