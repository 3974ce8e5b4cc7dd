"""What is handed over in place of a recording, and what to do instead."""

from __future__ import annotations

import os
from typing import Any

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.checks import columns_of
from magyc_gtsam.recording.recording import Recording


def expect_recording(function: str, value: Any) -> None:
    """Say what to do where something else than a recording was handed over.

    Raises:
        MagycError: it was.
    """
    if isinstance(value, Recording):
        return
    if isinstance(value, str | os.PathLike):
        raise MagycError(
            f"{function}: {os.fspath(value)!r} is a file; read it first: {function}(mg.read({os.fspath(value)!r}))"
        )
    if columns := columns_of(value):
        raise MagycError(
            f"{function}: a table with the columns {columns}; say which are which: mg.Recording(table['time'], "
            "table[['mx', 'my', 'mz']], table[['gx', 'gy', 'gz']]), in s, T and rad/s"
        )
    raise MagycError(
        f"{function}: a {type(value).__name__}, a Recording is expected: mg.read(path), or "
        "mg.Recording(time, magnetic_field, angular_rate) in s, T and rad/s"
    )
