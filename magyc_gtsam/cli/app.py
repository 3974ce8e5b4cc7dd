"""All commands under one name, and every failure as one line and an exit code."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Annotated

import typer

from magyc_gtsam import __version__
from magyc_gtsam.cli import cause, interrupted
from magyc_gtsam.cli.options import spelled
from magyc_gtsam.foreign_text import printable

WRONG, UNREAD = 2, 141  # the latter as shells count signal 13

COMMANDS = (
    "calibrate",
    "online",
    "apply",
    "info",
    "compare",
    "gap",
    "history",
    "serve",
    "simulate",
    "export",
    "study",
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"magyc-gtsam {__version__}")
        raise typer.Exit


_COMPLETION = "_MAGYC_GTSAM_COMPLETE"  # set by the shell that asks what may follow


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options before the command."""


def application(commands: Sequence[str] = COMMANDS) -> typer.Typer:
    """The command line with some of its commands, each a module of its name with a function `run`."""
    app = typer.Typer(
        name="magyc-gtsam",
        help="Calibrate magnetometers and gyroscopes from the data a vehicle records anyway.",
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    )
    app.callback()(_options)
    for name in commands:
        app.command(name)(import_module(f"magyc_gtsam.cli.{name}").run)
    return app


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: without the program's name; None takes the process's own.

    Returns:
        The exit code. MAGYC_DEBUG=1 in the environment lets the traceback of a failure through.
    """
    given = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    debug = bool(os.environ.get("MAGYC_DEBUG"))
    if not debug:
        warnings.simplefilter("ignore")  # a library's warning is no line of ours
        logging.disable(logging.WARNING)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal without µ shows a question mark
    named = given[:1] if given[0] in COMMANDS and _COMPLETION not in os.environ else COMMANDS
    group = typer.main.get_command(application(named))  # reading what one command takes is enough to run it
    if _COMPLETION in os.environ:
        group.main([], "magyc-gtsam")  # answers the shell, and exits
    try:
        with group.make_context("magyc-gtsam", given, obj=given) as context:
            code = int(group.invoke(context) or 0)
        if sys.stdout is not None:  # closed by the shell (>&-)
            sys.stdout.flush()
        return code
    except typer.Exit as finished:
        return finished.exit_code
    except KeyboardInterrupt as stop:
        return interrupted(stop)
    except BrokenPipeError:  # the reader of the output had enough, as `head` has
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNREAD
    except Exception as error:
        if (behind := cause(error)) is not None:
            return interrupted(behind)
        if debug:
            raise
        return _say(_explain(error), WRONG)


def _explain(error: Exception) -> str:
    """What, where, limit and remedy of a failure, in the command line's own words."""
    usage = getattr(error, "format_message", None)  # of every usage error, whichever click typer brings
    if usage is not None:
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else "magyc-gtsam"
        return f"{usage().replace('Value error, ', '').removesuffix('.')}; see {path} --help"
    from magyc_gtsam.factors.errors import MagycError

    if isinstance(error, MagycError):
        return spelled(str(error))
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}; check the path, its permissions and the space left"
    if isinstance(error, MemoryError):
        return f"not enough memory ({error}); take a part of the log (--start, --end), or less of all"
    return (
        f"internal error: {type(error).__name__}: {error}; this is a bug, please report it "
        "(MAGYC_DEBUG=1 shows the traceback)"
    )


def _say(message: str, code: int) -> int:
    print("magyc-gtsam:", printable(" ".join(message.split())), file=sys.stderr)
    return code
