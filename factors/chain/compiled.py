"""The inner loops in C (`_loops.c`), if they were compiled at installation.

Each caller takes the compiled loop if there is one, and its own version in numpy otherwise. Both give the same numbers
up to rounding (`tests/test_compiled.py`); a calibration takes 2.2 to 2.4 times as long in numpy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

loops: Any
try:
    from magyc_gtsam.factors.chain import _loops as loops  # type: ignore[attr-defined, no-redef]
except ImportError:
    loops = None

NONE = np.empty(0)  # stands for an array that there is not


def given(array: NDArray[Any] | None) -> NDArray[Any]:
    """Return an array as the compiled loops take it."""
    return NONE if array is None else np.ascontiguousarray(array)
