"""Output of commands on the terminal: progress, tables and sentences."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import zip_longest
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

from magyc_gtsam.foreign_text import printable, with_minus
from magyc_gtsam.option_names import as_options

if TYPE_CHECKING:
    from rich.console import Console

    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.report.verdict import Verdict

Progress = Callable[[float], None]

_MOST_DETAILS = 4  # that are shown without --verbose
_wrapped = partial(wrap, break_on_hyphens=False, break_long_words=False)
_PIPE_WIDTH = 200  # columns; output to a file or pipe is not cut


@contextmanager
def stages(shown: bool = True) -> Iterator[Callable[[str], Progress]]:
    """Yield a function that opens a named stage and returns its progress callback; each stage has a bar.

    With MAGYC_GTSAM_PROGRESS=lines in the environment progress is printed as lines of JSON on standard error instead.
    """
    if os.environ.get("MAGYC_GTSAM_PROGRESS") == "lines":
        yield _stage_in_lines
        return
    if not shown or sys.stderr is None or not sys.stderr.isatty():
        yield lambda name: lambda share: None
        return
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    screen = console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Bars(*columns, console=screen, transient=True) as bars:

        def stage(name: str) -> Progress:
            for task in bars.tasks:
                bars.update(task.id, completed=1.0)
            current = bars.add_task(name, total=1.0)
            return lambda share: bars.update(current, completed=share)

        yield stage


def _stage_in_lines(name: str) -> Progress:
    """Open a stage whose progress is printed as {"stage": …, "share": 0 to 1}, at most ten lines a second."""
    import json

    printed = -1.0

    def progress(share: float) -> None:
        nonlocal printed
        if share >= 1.0 or time.monotonic() - printed > 0.1:
            printed = time.monotonic()
            with suppress(OSError):  # the program that reads progress has closed it; the work goes on
                print(json.dumps({"stage": name, "share": round(float(share), 4)}), file=sys.stderr, flush=True)

    progress(0.0)
    return progress


def show(*sentences: str) -> None:
    """Print sentences on standard output: wrapped at words to their indent on a terminal, one per line in a pipe."""
    if not sentences:
        return
    if not _on_a_terminal():
        _write([_shown(sentence) for sentence in sentences])
        return
    output = console()
    for sentence in sentences:
        text = _shown(sentence)
        indent = text[: len(text) - len(text.lstrip(" "))]
        lines = _wrapped(text, output.width, subsequent_indent=indent) if indent else [text]
        for line in lines:
            output.print(line, markup=False, highlight=False)


def show_json(value: object) -> None:
    """Print a value of JSON types on standard output, with the arguments in its texts as options."""
    import json

    _write([as_options(json.dumps(value, indent=2))])


def _shown(text: str) -> str:
    """Return a text of the library or of a file as it is shown."""
    return printable(as_options(text))


def show_table(header: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[int] = ()) -> None:
    """Print a table, with the first column and those in `words` aligned left, and the others right."""
    cells = [[_shown(text) for text in (row[0], *map(with_minus, row[1:]))] for row in rows]
    left = {0, *words}
    if not _on_a_terminal():
        _write(_aligned([list(header), *cells], left))
        return
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for index, name in enumerate(header):
        table.add_column(name, justify="left" if index in left else "right", overflow="fold")
    for row in cells:
        table.add_row(*row)
    console().print(table, markup=False, highlight=False)


def _aligned(rows: Sequence[Sequence[str]], left: Collection[int]) -> list[str]:
    """Return the rows of a table as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
    lines = []
    for row in rows:
        cells = (
            text.ljust(width) if index in left else text.rjust(width)
            for index, (text, width) in enumerate(zip(row, widths, strict=False))
        )
        lines.append("  ".join(cells).rstrip())
    return lines


def _on_a_terminal() -> bool:
    """Return whether standard output is a terminal; only then is rich imported, which takes a tenth of the start-up."""
    return sys.stdout is not None and (sys.stdout.isatty() or bool(os.environ.get("FORCE_COLOR")))


def _write(lines: Sequence[str]) -> None:
    """Print lines on standard output; if it is closed, as by `head`, go on silently, since the exit code matters."""
    if sys.stdout is None:  # closed by the shell
        return
    try:
        print(*lines, sep="\n", flush=True)
    except BrokenPipeError:
        discard_output()
    except OSError as error:  # as a full disk
        raise OSError(error.errno, error.strerror, "standard output") from None


def complain(text: str) -> None:
    """Print one line on standard error; if that is closed or full, go on silently, since the exit code matters."""
    if sys.stderr is None:
        return
    try:
        print("magyc-gtsam:", " ".join(_shown(text).split()), file=sys.stderr, flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def discard_output() -> None:
    """Discard standard output from now on, after its reader has closed it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def concluded(verdict: Verdict, shown: bool = False) -> int:
    """Return the exit code of a verdict, and print on standard error why a result must not be trusted.

    Args:
        verdict: the verdict.
        shown: whether the verdict is on standard output already; it is not repeated on the same terminal.
    """
    if verdict.trusted:
        return 0
    if shown and all(stream is not None and stream.isatty() for stream in (sys.stdout, sys.stderr)):
        return 1
    called = f"{verdict.called[:1].lower()}{verdict.called[1:]}: " if verdict.called else ""
    complain(f"the result must not be trusted: {called + verdict.reason}")
    return 1


def refused(reason: str) -> int:
    """Print why what must not be used is not written, and return the exit code."""
    complain(f"the result must not be trusted: {reason}; nothing was written, --force writes it")
    return 1


def show_parameters(rows: Sequence[tuple[str, list[str]]]) -> None:
    """Print (name, values) rows: those of three values as a table, those of one as lines."""
    show_table(("", "x", "y", "z"), [[name, *values] for name, values in rows if len(values) == 3])
    show("", *(f"{name}: {values[0]}" for name, values in rows if len(values) == 1))


def show_calibration(calibration: Calibration) -> None:
    """Print the parameters with their standard deviations, and the disturbed and omitted stretches."""
    from magyc_gtsam.report.words import parameter_rows, stretch

    show_parameters(parameter_rows(calibration))
    disturbed = calibration.diagnostics.get("disturbed") or []
    if disturbed:
        longest = ", ".join(stretch((start, end)) for start, end in sorted(disturbed[:5]))
        show(f"disturbed, with reduced weight: {longest}{' and more' if len(disturbed) > 5 else ''}")
    show_left_out(calibration)


def show_left_out(calibration: Calibration) -> None:
    """Print the stretches and samples that were left out because a sensor was faulty."""
    show(*(f"left out: {where}" for where in calibration.diagnostics.get("left_out", ())))


def noted(notes: Sequence[str]) -> list[str]:
    """Return the notes on a log as lines."""
    return [f"note: {note}" for note in notes]


def show_results(folder: Path, notes: Sequence[str] = (), page: str = "report.html") -> None:
    """Print the notes on a log, and where the results and their page are."""
    show(*noted(notes), "", f"results: {folder}", f"page: {folder / page}")


def show_page(page: Path | str) -> None:
    """Open a file or an address in the browser; without one the path on the terminal has to do."""
    import webbrowser

    webbrowser.open(page if isinstance(page, str) else page.resolve().as_uri())


def show_details(verdict: Verdict, every: bool = False) -> None:
    """Print the details of a verdict, all of them with `every`; page and JSON always have all."""
    if len(verdict.details) == 1:
        show(*verdict.details)
    elif verdict.details:
        show("details:", *(f"  {sentence}" for sentence in verdict.details[: None if every else _MOST_DETAILS]))
    if len(verdict.details) > _MOST_DETAILS and not every:
        show(f"  and {len(verdict.details) - _MOST_DETAILS} more, on the page")


def console(stderr: bool = False) -> Console:
    """Return a console that survives a closed output, and cuts nothing in a pipe."""
    from rich.console import Console

    class PipeSafeConsole(Console):
        def on_broken_pipe(self) -> None:
            """Go on silently if the output is closed, since the exit code matters."""
            self.quiet = True
            discard_output()

    default = PipeSafeConsole(stderr=stderr)
    return default if default.is_terminal else PipeSafeConsole(stderr=stderr, width=_PIPE_WIDTH)
