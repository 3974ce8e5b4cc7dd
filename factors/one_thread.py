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
    from threadpoolctl import LibController

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


@functools.cache
def _libraries() -> list[LibController]:
    """Return the controllers of the loaded BLAS libraries."""
    import scipy.linalg  # noqa: F401  # has a separate BLAS, which is found only once it is loaded
    from threadpoolctl import ThreadpoolController

    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


class _Limit:
    """The BLAS limit of this process: set by the first thread that enters, lifted by the last that leaves."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._before: list[tuple[LibController, int]] = []

    @staticmethod
    def _set(counts: list[tuple[LibController, int]]) -> None:
        for library, count in counts:
            library.set_num_threads(count)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold BLAS to one thread inside the block."""
        with self._lock:
            if self._inside == 0:
                # Directly, in a third of the time that `ThreadpoolController.limit` takes at each calibration.
                self._before = [(library, library.num_threads) for library in _libraries()]
                self._set([(library, 1) for library, _ in self._before])
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if self._inside == 0:
                    self._set(self._before)


_limit = _Limit()


def one_thread(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Decorate `function` to run with BLAS on one thread; the caller's setting is restored afterwards."""

    @functools.wraps(function)
    def limited(*args: _Parameters.args, **kwargs: _Parameters.kwargs) -> _Result:
        with _limit.held():
            return function(*args, **kwargs)

    return limited
