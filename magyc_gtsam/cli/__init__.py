"""The command line `magyc-gtsam`: arguments → one call → files and exit code.

One file per command, each with one function `run` that returns the exit code: 0 done, 1 done but the
result must not be trusted, 2 wrong input or arguments. Commands import what they need when they run, so
that `--help` waits for nothing.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

_CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}  # as shells count them
_COLLECTED = (
    100_000  # objects, new ones beyond those gone, between collections; Python's 700 take a tenth of the start
)


class Stopped(KeyboardInterrupt):
    """The process was asked to end, by Ctrl-C or by another process; what is open is closed and removed as for both."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__()
        self.number = signal.Signals(number)
        self.code = _CODES[self.number]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; None takes the process's own.

    Returns:
        The exit code. MAGYC_DEBUG=1 in the environment lets the traceback of a failure through.
    """
    before = {number: signal.getsignal(number) for number in _CODES}
    hook, sys.unraisablehook = sys.unraisablehook, _unraisable
    thresholds = gc.get_threshold()
    gc.set_threshold(_COLLECTED, *thresholds[1:])
    try:
        _obey()
        from magyc_gtsam.cli.app import run  # within reach of the signals: it takes some tenths of a second

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


def _unraisable(lost: sys.UnraisableHookArgs) -> None:
    """A request to end that was met where Python drops exceptions, as in a destructor, is made once more."""
    met = lost.exc_value
    if not isinstance(met, Stopped):
        sys.__unraisablehook__(lost)
    while isinstance(met, Stopped):
        try:
            threading.Timer(0.01, os.kill, (os.getpid(), met.number)).start()
            met = None
        except Stopped as again:  # a busy machine may take longer to start the timer than it runs
            met = again


def interrupted(stop: KeyboardInterrupt) -> int:
    """Say that the command was stopped; returns the exit code."""
    print("magyc-gtsam: interrupted; no file is left half written", file=sys.stderr)
    return int(getattr(stop, "code", _CODES[signal.SIGINT]))


def cause(error: BaseException | None) -> KeyboardInterrupt | None:
    """The interruption behind an error, as where it was met while an extension module was being loaded."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


def _obey() -> None:
    """Let a request to end be met as Ctrl-C is; one that this process was started to ignore stays ignored."""

    for number in _CODES:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            try:
                signal.signal(number, _stop)
            except ValueError:  # not in the main thread: whoever runs us there has handlers of his own
                return
