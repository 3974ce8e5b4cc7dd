"""The command line `magyc-gtsam`, which turns arguments into one call, and its result into files and an exit code.

Each command is a file with a function `run` that returns the exit code: 0 done, 1 done but the result must not be
trusted, 2 wrong input or arguments. Commands import other modules when they run, so that `--help` is fast.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

from magyc_gtsam.cli.interrupts import EXIT_CODES, Stopped, cause, interrupted

# Number of new objects between garbage collections; with Python's 700, collections take a tenth of the start-up time.
_COLLECTION_THRESHOLD = 100_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; None for those of the process.

    Returns:
        The exit code. With MAGYC_DEBUG=1 in the environment a failure raises its exception instead.
    """
    before = {number: signal.getsignal(number) for number in EXIT_CODES}
    hook, sys.unraisablehook = sys.unraisablehook, _unraisable
    thresholds = gc.get_threshold()
    gc.set_threshold(_COLLECTION_THRESHOLD, *thresholds[1:])
    try:
        _install_handlers()
        from magyc_gtsam.cli.app import run  # after the handlers, as it takes some tenths of a second

        return run(arguments)
    except KeyboardInterrupt as stopped:
        return interrupted(stopped)
    except ImportError as error:
        if (stop := cause(error)) is None:
            raise
        return interrupted(stop)
    finally:
        gc.set_threshold(*thresholds)
        sys.unraisablehook = hook
        for number, handler in before.items():
            if getattr(signal.getsignal(number), "__name__", "") == _stop.__name__:
                signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    raise Stopped(number)


def _unraisable(dropped: sys.UnraisableHookArgs) -> None:
    """Send a signal again whose exception Python dropped, as it does in destructors."""
    stop = dropped.exc_value
    if not isinstance(stop, Stopped):
        sys.__unraisablehook__(dropped)
    while isinstance(stop, Stopped):
        try:
            threading.Timer(0.01, os.kill, (os.getpid(), stop.number)).start()
            stop = None
        except Stopped as again:  # on a busy machine the timer can fire before `start` returns
            stop = again


def _install_handlers() -> None:
    """Turn SIGINT and SIGTERM into `Stopped`; a signal that the process was started to ignore stays ignored."""
    for number in EXIT_CODES:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            try:
                signal.signal(number, _stop)
            except ValueError:  # outside the main thread the caller is responsible for signals
                return
