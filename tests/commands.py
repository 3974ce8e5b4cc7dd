"""The command line, in this process and as it is installed."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

from magyc_gtsam import cli

COMMAND = str(Path(sys.executable).with_name("magyc-gtsam"))
PATIENCE = 300.0  # s
Finished = subprocess.CompletedProcess[str]


def installed(*arguments: object, cwd: Path, stdin: str | None = None) -> Finished:
    """The installed command, with the environment of a plain pipe."""
    return subprocess.run(
        [COMMAND, *map(str, arguments)],
        cwd=cwd, input=stdin, capture_output=True, text=True, encoding="utf-8", timeout=PATIENCE,
    )  # fmt: skip


@contextlib.contextmanager
def _in_folder(folder: Path) -> Iterator[None]:
    """As contextlib.chdir, which Python has since 3.11."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def run(*arguments: object, cwd: Path, stdin: str = "") -> Finished:
    """The same in this process, which spares the second that a new one takes to import everything."""
    command = [*map(str, arguments)]
    output, errors = io.StringIO(), io.StringIO()
    assert threading.current_thread() is threading.main_thread()  # the folder is that of all threads
    disabled, before = logging.root.manager.disable, sys.stdin
    with tempfile.TemporaryFile("w+", encoding="utf-8") as given:
        given.write(stdin)
        given.seek(0)
        sys.stdin, descriptor = given, os.dup(0)
        os.dup2(given.fileno(), 0)  # for what reads without buffering
        try:
            with _in_folder(cwd), contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
                code = cli.main(command)
        finally:
            os.dup2(descriptor, 0)
            os.close(descriptor)
            sys.stdin = before
            logging.disable(disabled)  # `main` silences the libraries of its process
    return Finished(command, code, output.getvalue(), errors.getvalue())
