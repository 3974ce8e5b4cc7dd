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

import math
import operator
import threading
from collections.abc import Callable, Sequence
from typing import Any

import gtsam
import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import is_finite, is_positive, numbers, real_array
from magyc_gtsam.factors.units import check_lag
from magyc_gtsam.factors.variables import Array, Variable, key_name, reader

Residual = tuple[Array, Sequence[Array]]
ErrorFunction = Callable[..., Residual]
Noise = float | gtsam.noiseModel.Base

_EMPTY = gtsam.Values()
_asked = threading.local()


class NonFiniteError(MagycError):
    """A variable, residual or Jacobian that is NaN or infinite: the step has diverged, the program is not at fault."""


def custom_factor(
    name: str,
    noise: Noise,
    keys: Sequence[int],
    variables: Sequence[Variable],
    rows: int,
    error: ErrorFunction,
    *,
    details: object = None,
) -> gtsam.CustomFactor:
    """Return a factor whose error function cannot crash or mislead GTSAM.

    Args:
        name: the factor's name in error messages.
        noise: standard deviation of every row, or a GTSAM noise model of dimension `rows`.
        keys: the variables, in the order of the error function's arguments.
        variables: the accepted types of each key (`magyc_gtsam.factors.variables`); the type that a key holds is
            looked up once per factor.
        rows: number of rows of the residual.
        error: (*values, want_jacobians) → residual (rows,), Jacobians (rows, len(value)) in key order.
        details: what `factor_details` returns for this factor; its name if None.

    Raises:
        MagycError: immediately, if the arguments do not fit together; later, from inside the optimiser, if a key is
            missing or of another type, or a shape is wrong.
        NonFiniteError: later, if a variable, the residual or a Jacobian is not finite.
    """
    keys = checked_keys(name, keys, len(variables))
    readers = [reader(name, variable, key) for variable, key in zip(variables, keys, strict=True)]

    def evaluate(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if getattr(_asked, "waits", False):
            _asked.waits, _asked.answer = False, name if details is None else details
            return np.zeros(rows)
        arguments, tangents = [], []
        for key, read in zip(keys, readers, strict=True):
            value, tangent = read(values)
            _check(name, "variable", value, value.shape, key)
            arguments.append(value)
            tangents.append(tangent)
        residual, derivatives = error(*arguments, jacobians is not None)
        _check(name, "residual", residual, (rows,))
        if jacobians is not None:
            if len(derivatives) != len(keys):
                raise MagycError(f"{name}: {len(derivatives)} Jacobians for {len(keys)} keys")
            for i, (derivative, tangent) in enumerate(zip(derivatives, tangents, strict=True)):
                _check(name, "Jacobian on", derivative, (rows, len(arguments[i])), keys[i])
                jacobians[i] = derivative if tangent is None else derivative @ tangent
        return residual

    return gtsam.CustomFactor(noise_model(noise, rows), keys, evaluate)


def factor_details(factor: gtsam.NonlinearFactor) -> Any:
    """Return the `details` of a `custom_factor`, or its name; None for any other factor.

    GTSAM keeps a custom factor's function but not its Python object, so the details are requested through the
    function.
    """
    if not isinstance(factor, gtsam.CustomFactor):
        return None
    _asked.waits, _asked.answer = True, None
    try:
        factor.unwhitenedError(_EMPTY)
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError):
        # A custom factor of another maker, on values that do not hold its keys.
        return None
    finally:
        _asked.waits = False
    return _asked.answer


def checked_keys(name: str, keys: Sequence[Any], count: int) -> list[int]:
    """Return the keys of a factor as integers.

    Raises:
        MagycError: one is no key, or they are not `count` different ones.
    """
    indices = [_index(name, key) for key in keys]
    if len(indices) != count or len(set(indices)) != count:
        raise MagycError(
            f"{name}: {count} different keys are needed, got {', '.join(map(key_name, indices)) or 'none'}"
        )
    return indices


def listed_keys(keys: Any) -> list[Any]:
    """Return the keys of an argument that takes one key or several."""
    return list(keys) if np.iterable(keys) else [keys]


def _index(name: str, key: Any) -> int:
    """Return a key as an integer.

    Raises:
        MagycError: it is no key: text, a fraction, negative, or of more than 64 bits.
    """
    try:
        index = operator.index(key)
    except TypeError:
        index = -1
    if not 0 <= index < 2**64 or isinstance(key, bool):
        raise MagycError(f"{name}: {key!r:.40} is not a key; give one as gtsam.symbol_shorthand makes them, X(0)")
    return index


def noise_model(noise: Noise, rows: int) -> gtsam.noiseModel.Base:
    """Return a GTSAM noise model of `rows` rows, from a model of that dimension or from one standard deviation."""
    if isinstance(noise, gtsam.noiseModel.Base):
        if noise.dim() != rows:
            raise MagycError(f"noise model of dimension {noise.dim()} for a residual of {rows} rows")
        return noise
    return gtsam.noiseModel.Isotropic.Sigma(rows, standard_deviation(noise))


def standard_deviation(sigma: float, name: str = "a residual") -> float:
    """Return `sigma` after checking that it is finite and above 0."""
    if not is_positive(sigma):
        raise MagycError(f"standard deviation {sigma!r:.40} of {name}; it must be a number, finite and above 0")
    return float(sigma)


def standard_deviations(name: str, sigma: ArrayLike, size: int) -> Array:
    """Return one standard deviation, or `size` of them, as (size,).

    Raises:
        MagycError: another number of them, no numbers, not finite, or not above 0.
    """
    stated = numbers(f"{name}: standard deviation", sigma)
    if stated.shape not in ((), (1,), (size,)) or not (np.isfinite(stated).all() and (stated > 0).all()):
        raise MagycError(
            f"{name}: standard deviation {stated.tolist()!r:.60}; it must be one number or {size}, finite and above 0"
        )
    return np.broadcast_to(stated, (size,))


def check_kind(name: str, value: Any, kind: type, source: str) -> None:
    """Raise a MagycError unless an argument is of a kind; `source` says what gives one."""
    if not isinstance(value, kind):
        raise MagycError(f"{name} is a {type(value).__name__}; give {source}")


def check_delay(name: str, delay: Any) -> None:
    """Raise a MagycError unless a delay is a finite number of s, and no longer than a magnetometer's."""
    if not is_finite(delay):
        raise MagycError(f"{name}: delay {delay!r:.40}; it must be a finite number of s")
    check_lag(name, delay)


def measured(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Return a read-only float64 copy of a measurement; None in `shape` stands for any length.

    Raises:
        MagycError: wrong shape, or values that are not finite.
    """
    try:
        array = real_array(value, copy=True)
    except (TypeError, ValueError) as error:
        raise MagycError(f"{name}: not an array of numbers ({error})") from None
    if array.ndim != len(shape) or any(s not in (None, n) for s, n in zip(shape, array.shape, strict=True)):
        text = ", ".join("n" if s is None else str(s) for s in shape)
        raise MagycError(f"{name}: shape {array.shape}, expected ({text})")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0]) if array.ndim else 0
        raise MagycError(f"{name}: not finite in row {row}; leave such samples out")
    array.flags.writeable = False
    return array


def _check(name: str, what: str, array: Array, shape: tuple[int, ...], key: int | None = None) -> None:
    right = isinstance(array, np.ndarray) and array.dtype == np.float64 and array.shape == shape
    if right:
        flat = array.ravel("K")  # the sum of squares is the fastest test; it overflows for some finite numbers
        if math.isfinite(flat.dot(flat)) or np.isfinite(array).all():
            return
    if key is not None:
        what = f"{what} {key_name(key)}"
    if not right:
        found = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        raise MagycError(f"{name}: {what} is {found}, expected float64 {shape}")
    place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
    raise NonFiniteError(f"{name}: {what} is {array[place]} at {place}")
