"""How a command ends other than by its result: the message of a failure, and interrupts (SIGINT, SIGTERM)."""

from __future__ import annotations

import re
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from magyc_gtsam.cli.terminal import complain
from magyc_gtsam.option_names import as_options

_NOT_A_NUMBER = re.compile(r"('-+[a-zA-Z][^']*') is not a valid ")
EXIT_CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}  # as shells count them


class Stopped(KeyboardInterrupt):
    """Interruption by SIGINT (Ctrl-C) or SIGTERM; open files are closed and temporary ones removed, as for Ctrl-C."""

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__()
        self.number = signal.Signals(number)
        self.code = EXIT_CODES[self.number]


def interrupted(stop: KeyboardInterrupt) -> int:
    """Print that the command was interrupted, and return the exit code."""
    complain("interrupted; no file is left half written")
    return int(getattr(stop, "code", EXIT_CODES[signal.SIGINT]))


def cause(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the interruption that caused an error, for example while an extension module was loaded; None without."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error


@contextmanager
def noted_interrupts() -> Iterator[list[int]]:
    """Yield a list to which the first interrupt in the block is appended; a second one has its usual effect.

    Outside the main thread, which alone receives signals, the list stays empty.
    """
    noted: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield noted
        return

    def note(number: int, frame: object) -> None:
        noted.append(number)
        restore()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    before = {number: signal.getsignal(number) for number in EXIT_CODES}
    for number in EXIT_CODES:
        signal.signal(number, note)
    try:
        yield noted
    finally:
        restore()


def explained(error: Exception, command: str = "") -> str:
    """Return the message of a failure, with arguments of the library named as options of the command line.

    Args:
        error: the failure.
        command: the command that failed, if its name is known.
    """
    usage = getattr(error, "format_message", None)  # of usage errors, in every version of click
    if usage is not None:
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else f"magyc-gtsam {command}".rstrip()
        text = usage().replace("Value error, ", "").removesuffix(".")
        parameter, value = getattr(error, "param", None), _NOT_A_NUMBER.search(text)
        if parameter is not None and parameter.nargs > 1 and value is not None:  # the next option was taken for it
            wanted = f"needs {parameter.nargs} values ({parameter.metavar})"
            text = (
                f"Invalid value for '{parameter.opts[0]}': {wanted}, and {value[1]} comes before the last of them"
            )
        return f"{text}{' See' if text.endswith('?') else '; see'} {path} --help"
    from magyc_gtsam.factors.errors import MagycError

    if isinstance(error, MagycError):
        return as_options(str(error))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}; check the path, its permissions and the space left"
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}); use a part of the log (--start, --end)"
    return (
        f"internal error: {type(error).__name__}: {error}; this is a bug, please report it "
        "(MAGYC_DEBUG=1 shows the traceback)"
    )
