"""Freed memory that stays with the process, so that the next array does not have to fetch it again page by page.

The C library of Linux gives memory at the top of its heap back to the system when more is free than twice the largest
block that was ever mapped by itself and freed. A calibration frees a few megabytes many times a second: without a block
of that size beforehand it fetched 200 to 900 pages anew, each time, which took up to 2 ms of 25.
"""

from __future__ import annotations

import functools

import numpy as np

_BYTES = 8 << 20  # above what a calibration of an hour frees at a time; 4 MB were enough for ten minutes


@functools.cache
def keep_freed_memory() -> None:
    """Map and free one block of `_BYTES`, untouched, which takes no memory; nothing where the library is another."""
    np.empty(_BYTES, dtype=np.uint8)
