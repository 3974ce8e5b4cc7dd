"""The checks of arguments that several functions have: recordings, and functions that are told the progress."""

from __future__ import annotations

import os
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import columns_of
from magyc_gtsam.recording.recording import Recording


def expect_progress(value: Any) -> None:
    """Raise a MagycError unless the argument `progress` is a function or None."""
    if value is not None and not callable(value):
        raise MagycError(f"progress: a function of the share done is needed, got {type(value).__name__}")


def expect_recording(function: str, value: Any) -> None:
    """Check that the argument `value` of `function` is a `Recording`.

    Raises:
        MagycError: it is not; the message says how to make one from a path, a data frame or arrays.
    """
    if isinstance(value, Recording):
        return
    if isinstance(value, str | os.PathLike):
        raise MagycError(
            f"{function}: {os.fspath(value)!r} is a file; read it first: {function}(mg.read({os.fspath(value)!r}))"
        )
    if columns := columns_of(value):
        raise MagycError(
            f"{function}: expected a Recording, got a table with the columns {columns}; name the columns of each "
            "argument: mg.Recording(table['time'], "
            "table[['mx', 'my', 'mz']], table[['gx', 'gy', 'gz']]), in s, T and rad/s"
        )
    raise MagycError(
        f"{function}: expected a Recording, got a {type(value).__name__}; use mg.read(path) or "
        "mg.Recording(time, magnetic_field, angular_rate) in s, T and rad/s"
    )
