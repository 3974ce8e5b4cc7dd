"""The application of all commands, which reports every failure in one line and an exit code."""

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
from magyc_gtsam.cli.interrupts import cause, explained, interrupted
from magyc_gtsam.cli.terminal import complain, discard_output

WRONG, UNREAD = 2, 141  # exit codes of wrong input, and of a closed output (SIGPIPE, as in shells)

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


_COMPLETION = "_MAGYC_GTSAM_COMPLETE"  # set by a shell that asks for completions


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options before the command."""


def application(commands: Sequence[str] = COMMANDS) -> typer.Typer:
    """Return the command line with some commands, each the function `run` of the module with its name."""
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
        arguments: without the program's name; None for those of the process.

    Returns:
        The exit code. With MAGYC_DEBUG=1 in the environment a failure raises its exception instead.
    """
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    debug = bool(os.environ.get("MAGYC_DEBUG"))
    if not debug:
        warnings.simplefilter("ignore")  # warnings of libraries do not concern the user
        logging.disable(logging.WARNING)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal that cannot show µ shows a question mark
    named = words[:1] if words[0] in COMMANDS and _COMPLETION not in os.environ else COMMANDS
    group = typer.main.get_command(application(named))  # importing one command is enough to run it
    if _COMPLETION in os.environ:
        group.main([], "magyc-gtsam")  # prints the completions and exits
    try:
        with group.make_context("magyc-gtsam", words, obj=words) as context:
            code = int(group.invoke(context) or 0)
        if sys.stdout is not None:  # closed by the shell (>&-)
            sys.stdout.flush()
        return code
    except typer.Exit as finished:
        return finished.exit_code
    except KeyboardInterrupt as stop:
        return interrupted(stop)
    except BrokenPipeError:  # the reader of the output has closed it, as `head` does
        with contextlib.suppress(OSError):  # without a null device Python reports the closed pipe once more
            discard_output()
        return UNREAD
    except Exception as error:  # every other failure becomes one line, or a traceback with MAGYC_DEBUG
        if (behind := cause(error)) is not None:
            return interrupted(behind)
        if debug:
            raise
        complain(explained(error, words[0] if words[0] in COMMANDS else ""))
        return WRONG
