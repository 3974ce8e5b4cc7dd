"""The check that an argument is the path of a file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from magyc_gtsam.factors.errors import MagycError


def expect_path(function: str, value: Any) -> Path:
    """Return the argument `value` of `function` as a path.

    Raises:
        MagycError: it is empty, or not a path.
    """
    if isinstance(value, str | os.PathLike) and os.fspath(value):
        return Path(value)
    raise MagycError(f"{function}: the path of a file is needed, got {value!r:.60}")
