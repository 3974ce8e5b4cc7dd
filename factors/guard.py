"""One guard around every Python error function that is handed to GTSAM.

GTSAM crashes on a Jacobian with the wrong number of rows, accepts one with the wrong number of columns,
and returns the initial values when a residual is NaN. Behind the guard each of these is an exception,
which passes through the C++ optimisers unchanged.

An error function here is a pure function of arrays, so that it can be used and tested without GTSAM:

    residual, jacobians = error(*values, want_jacobians)

Its Jacobians are with respect to plain vectors; the guard turns them into those on the key's own tangent
space (`Unit3` has 2 columns instead of 3, `imuBias.ConstantBias` 6 instead of 3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from numpy.typing import ArrayLike, NDArray

from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]
Residual = tuple[Array, Sequence[Array]]
ErrorFunction = Callable[..., Residual]
Noise = float | gtsam.noiseModel.Base
Variable = Callable[[gtsam.Values, int], tuple[Array, Array | None]]

_GYROSCOPE_PART = np.hstack([np.zeros((3, 3)), np.eye(3)])  # of a ConstantBias: accelerometer, gyroscope
_GYROSCOPE_PART.flags.writeable = False


class NonFiniteError(MagycError):
    """A variable, residual or Jacobian is NaN or infinite: the step went wrong, not the program."""


def vector(size: int) -> Variable:
    """A key that holds a vector; where `size` is 3 it may also be a `Point3`."""

    def read(values: gtsam.Values, key: int) -> tuple[Array, None]:
        value = values.atPoint3(key) if size == 3 else values.atVector(key)
        if value.shape != (size,):
            raise MagycError(f"{_name(key)} holds {value.size} numbers, {size} are expected")
        return value, None

    return read


def direction(values: gtsam.Values, key: int) -> tuple[Array, Array]:
    """A key that holds a `Unit3`, read as a unit vector (3,)."""
    unit = values.atUnit3(key)
    return unit.point3(), unit.basis()


def gyro_bias(values: gtsam.Values, key: int) -> tuple[Array, Array | None]:
    """A key that holds the gyroscope bias (3,) rad/s: `Point3`, vector, or `imuBias.ConstantBias`."""
    try:
        return values.atPoint3(key), None
    except RuntimeError:
        return values.atConstantBias(key).gyroscope(), _GYROSCOPE_PART


def custom_factor(
    name: str,
    noise: Noise,
    keys: Sequence[int],
    variables: Sequence[Variable],
    rows: int,
    error: ErrorFunction,
) -> gtsam.CustomFactor:
    """A factor whose error function cannot crash or mislead GTSAM.

    Args:
        name: what the factor is, for error messages.
        noise: standard deviation of every row, or a GTSAM noise model of dimension `rows`.
        keys: the variables, in the order of the error function's arguments.
        variables: how each key is read: `vector(n)`, `direction` or `gyro_bias`.
        rows: number of rows of the residual.
        error: (*values, want_jacobians) → residual (rows,), Jacobians (rows, len(value)) in key order.

    Raises:
        MagycError: here, if the arguments do not fit together; later, from inside the optimiser, if a
            key is missing or of another type, or a shape is wrong.
        NonFiniteError: later, if a variable, the residual or a Jacobian is not finite.
    """
    keys = [int(key) for key in keys]
    if len(keys) != len(variables) or len(set(keys)) != len(keys):
        raise MagycError(
            f"{name}: {len(variables)} different keys are needed, got {', '.join(map(_name, keys)) or 'none'}"
        )

    def evaluate(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        arguments, tangents = [], []
        for key, read in zip(keys, variables, strict=True):
            try:
                value, tangent = read(values, key)
            except RuntimeError as problem:
                raise MagycError(f"{name}: {problem}") from None
            _check(name, f"variable {_name(key)}", value, value.shape)
            arguments.append(value)
            tangents.append(tangent)
        residual, derivatives = error(*arguments, jacobians is not None)
        _check(name, "residual", residual, (rows,))
        if jacobians is not None:
            if len(derivatives) != len(keys):
                raise MagycError(f"{name}: {len(derivatives)} Jacobians for {len(keys)} keys")
            for i, (derivative, tangent) in enumerate(zip(derivatives, tangents, strict=True)):
                _check(name, f"Jacobian on {_name(keys[i])}", derivative, (rows, len(arguments[i])))
                jacobians[i] = derivative if tangent is None else derivative @ tangent
        return residual

    return gtsam.CustomFactor(noise_model(noise, rows), keys, evaluate)


def noise_model(noise: Noise, rows: int) -> gtsam.noiseModel.Base:
    """A GTSAM noise model of `rows` rows, from itself or from one standard deviation."""
    if isinstance(noise, gtsam.noiseModel.Base):
        if noise.dim() != rows:
            raise MagycError(f"noise model of dimension {noise.dim()} for a residual of {rows} rows")
        return noise
    return gtsam.noiseModel.Isotropic.Sigma(rows, standard_deviation(noise))


def standard_deviation(sigma: float) -> float:
    """`sigma`, checked to be finite and above 0."""
    if not (np.isfinite(sigma) and sigma > 0):
        raise MagycError(f"standard deviation {sigma} of a residual; it must be finite and above 0")
    return float(sigma)


def measured(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """A read-only float64 copy of a measurement; None in `shape` stands for any length.

    Raises:
        MagycError: wrong shape, or not finite.
    """
    array = np.array(value, dtype=np.float64)
    if array.ndim != len(shape) or any(s not in (None, n) for s, n in zip(shape, array.shape, strict=True)):
        text = ", ".join("n" if s is None else str(s) for s in shape)
        raise MagycError(f"{name}: shape {array.shape}, expected ({text})")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0]) if array.ndim else 0
        raise MagycError(f"{name}: not finite in row {row}; leave such samples out")
    array.flags.writeable = False
    return array


def _check(name: str, what: str, array: Array, shape: tuple[int, ...]) -> None:
    if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.shape != shape:
        found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise MagycError(f"{name}: {what} is {found}, expected float64 {shape}")
    if not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise NonFiniteError(f"{name}: {what} is {array[place]} at {place}")


def _name(key: int) -> str:
    return str(gtsam.DefaultKeyFormatter(key))
