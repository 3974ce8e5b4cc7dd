"""What a command shows: progress, tables and sentences."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from magyc_gtsam.foreign_text import printable, with_minus

if TYPE_CHECKING:
    from rich.console import Console

    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.report.verdict import Verdict

Progress = Callable[[float], None]

_WORST = 4  # details that are shown
_WIDE = 200  # columns of a file or pipe, in which nothing is to be cut


@contextmanager
def stages(shown: bool = True) -> Iterator[Callable[[str], Progress]]:
    """A function that opens a named stage and returns its progress callback; one bar per stage.

    With MAGYC_GTSAM_PROGRESS=lines in the environment, lines of JSON on standard error instead, for programs.
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
    """Progress as {"stage": …, "share": 0 to 1}, at most ten lines a second; who wants it may leave."""
    import json

    said = -1.0

    def progress(share: float) -> None:
        nonlocal said
        if share >= 1.0 or time.monotonic() - said > 0.1:
            said = time.monotonic()
            with suppress(OSError):
                print(json.dumps({"stage": name, "share": round(float(share), 4)}), file=sys.stderr, flush=True)

    progress(0.0)
    return progress


def show(*sentences: str) -> None:
    """Sentences on standard output: wrapped at words on a terminal, one to a line in a pipe."""
    if not _on_a_terminal():
        _write([printable(sentence) for sentence in sentences])
        return
    output = console()
    for sentence in sentences:
        output.print(printable(sentence), markup=False, highlight=False)


def show_table(header: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[int] = ()) -> None:
    """A table; the first column and those of `words` to the left, the others to the right, with minus signs."""
    cells = [[printable(text) for text in (row[0], *map(with_minus, row[1:]))] for row in rows]
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
    """The rows of a table as lines."""
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
    """Whether somebody looks at standard output, so that rich, which takes a tenth of the start, wraps and colours."""
    return sys.stdout is not None and (sys.stdout.isatty() or bool(os.environ.get("FORCE_COLOR")))


def _write(lines: Sequence[str]) -> None:
    """On standard output; a reader that had enough, as `head`, is met with silence: the exit code is still to come."""
    if sys.stdout is None:  # closed by the shell
        return
    try:
        print(*lines, sep="\n", flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def concluded(verdict: Verdict, shown: bool = False) -> int:
    """The exit code of a verdict; writes to standard error why a result must not be trusted.

    `shown`: the verdict is on standard output already, and is not repeated on the same terminal.
    """
    if verdict.trusted:
        return 0
    if shown and sys.stdout.isatty() and sys.stderr.isatty():
        return 1
    called = f"{verdict.called[:1].lower()}{verdict.called[1:]}: " if verdict.called else ""
    print(f"magyc-gtsam: the result must not be trusted: {printable(called + verdict.reason)}", file=sys.stderr)
    return 1


def refused(calibration: Calibration) -> int:
    """Say why a calibration is not written out for use; the exit code."""
    from magyc_gtsam.report.verdict import judged

    reason = judged(calibration).reason
    print(
        f"magyc-gtsam: the result must not be trusted: {printable(reason)}; nothing was written (--force)",
        file=sys.stderr,
    )
    return 1


def show_calibration(calibration: Calibration) -> None:
    """Parameters with their deviations, and what was disturbed."""
    from magyc_gtsam.report.words import parameter_rows, stretch

    rows = parameter_rows(calibration)
    show_table(("", "x", "y", "z"), [[name, *values] for name, values in rows if len(values) == 3])
    show("", *(f"{name}: {values[0]}" for name, values in rows if len(values) == 1))
    disturbed = calibration.diagnostics.get("disturbed") or []
    if disturbed:
        longest = ", ".join(stretch((start, end)) for start, end in sorted(disturbed[:5]))
        show(f"disturbed, and weighed down: {longest}{' and more' if len(disturbed) > 5 else ''}")
    show(*(f"left out: {where}" for where in calibration.diagnostics.get("left_out", ())))


def show_page(page: Path) -> None:
    """In the user's browser; where there is none the path is on the terminal."""
    import webbrowser

    webbrowser.open(page.resolve().as_uri())


def show_details(verdict: Verdict, every: bool = False) -> None:
    """What was noticed beside the verdict; the page and the JSON have all of it."""
    if len(verdict.details) == 1:
        show(*verdict.details)
    elif verdict.details:
        show("details:", *(f"  {sentence}" for sentence in verdict.details[: None if every else _WORST]))
    if len(verdict.details) > _WORST and not every:
        show(f"  and {len(verdict.details) - _WORST} more, on the page")


def console(stderr: bool = False) -> Console:
    """A console that outlives its reader, and that cuts nothing in a pipe."""
    from rich.console import Console

    class Patient(Console):
        def on_broken_pipe(self) -> None:
            """Go on in silence: `head` may have enough, the exit code is still to come."""
            self.quiet = True
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

    found = Patient(stderr=stderr)
    return found if found.is_terminal else Patient(stderr=stderr, width=_WIDE)
