"""Retention of freed memory in the process, so that the next array does not have to fetch it again page by page.

The C library of Linux returns memory at the top of its heap to the system when more is free than twice the largest
block that was ever mapped separately and freed. A calibration frees a few megabytes many times a second. Without a
block of that size beforehand it fetched 200 to 900 pages anew each time, which took up to 2 ms of 25.
"""

from __future__ import annotations

import functools

import numpy as np

_BYTES = 8 << 20  # more than a calibration of an hour frees at a time; 4 MB were enough for ten minutes


@functools.cache
def keep_freed_memory() -> None:
    """Map and free one block of `_BYTES` without touching it, so that it takes no memory; do nothing with other C
    libraries.
    """
    np.empty(_BYTES, dtype=np.uint8)
