"""Methods of one object that threads, as of two drivers, call in turns."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Concatenate, ParamSpec, Protocol, TypeVar


class _Lockable(Protocol):
    _lock: threading.RLock


_Self = TypeVar("_Self", bound=_Lockable)
_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
_Method = Callable[Concatenate[_Self, _Given], _Result]


def locked(method: _Method[_Self, _Given, _Result]) -> _Method[_Self, _Given, _Result]:
    """Decorate a method to hold the lock of its object, `_lock`, which the same thread may take again."""

    @functools.wraps(method)
    def alone(self: _Self, /, *args: _Given.args, **kwargs: _Given.kwargs) -> _Result:
        with self._lock:
            return method(self, *args, **kwargs)

    return alone
