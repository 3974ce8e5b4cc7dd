"""Restriction of BLAS to one thread while a calibration is computed.

The matrices of a calibration are too small for the threads of OpenBLAS, which mostly wait for each other: next to other
work on the same cores `calibrate` and `find_gap` take about twice as long with them (`benchmarks/threads.py`).
"""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, ParamSpec, TypeVar

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


@functools.cache
def _libraries() -> ThreadpoolController:
    """Return the controller of the loaded BLAS libraries."""
    import scipy.linalg  # noqa: F401  # has a separate BLAS, which the controller finds only once it is loaded
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


class _Limit:
    """The BLAS limit of this process: set by the first thread that enters, lifted by the last that leaves."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold BLAS to one thread inside the block."""
        with self._lock:
            if self._inside == 0:
                self._set = _libraries().limit(limits=1, user_api="blas")
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if self._inside == 0:
                    self._set.restore_original_limits()


_limit = _Limit()


def one_thread(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Decorate `function` to run with BLAS on one thread; the caller's setting is restored afterwards."""

    @functools.wraps(function)
    def limited(*args: _Parameters.args, **kwargs: _Parameters.kwargs) -> _Result:
        with _limit.held():
            return function(*args, **kwargs)

    return limited
