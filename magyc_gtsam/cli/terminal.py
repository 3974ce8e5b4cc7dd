"""What a command shows: progress, tables and sentences."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from magyc_gtsam.calibration import Calibration

Progress = Callable[[float], None]

_WORST = 3  # weak directions that are shown
_WIDE = 200  # columns of a file or pipe, in which nothing is to be cut


@contextmanager
def stages(shown: bool = True) -> Iterator[Callable[[str], Progress]]:
    """A function that opens a named stage and returns its progress callback; one bar per stage."""
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    screen = console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Bars(*columns, console=screen, transient=True, disable=not (shown and screen.is_terminal)) as bars:

        def stage(name: str) -> Progress:
            for task in bars.tasks:
                bars.update(task.id, completed=1.0)
            current = bars.add_task(name, total=1.0)
            return lambda share: bars.update(current, completed=share)

        yield stage


def show(*sentences: str) -> None:
    """Sentences on standard output, each on a line of its own and never cut."""
    output = console()
    for sentence in sentences:
        output.print(sentence, markup=False, highlight=False, soft_wrap=True)


def show_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table; the first column to the left, the others to the right."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for index, name in enumerate(header):
        table.add_column(name, justify="left" if index == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console().print(table, markup=False, highlight=False)


def show_calibration(calibration: Calibration) -> None:
    """Parameters with their deviations, what the motion left weak, and what was disturbed."""
    from magyc_gtsam.report.words import parameter_rows, stretch

    rows = parameter_rows(calibration)
    show_table(("", "x", "y", "z"), [[name, *values] for name, values in rows if len(values) == 3])
    show("", *(f"{name}: {values[0]}" for name, values in rows if len(values) == 1))
    observability = calibration.observability
    if observability is None:
        show("observable: this method does not say")
    else:
        heading = observability.heading_sigma
        known = "" if heading is None else f"; heading uncertain by {heading:.2g}° at worst in a level turn"
        show(f"observable: {'yes' if observability.observable else 'no'}{known}")
        show_weak([weakness.sentence for weakness in observability.weak])
    disturbed = calibration.diagnostics.get("disturbed") or []
    if disturbed:
        longest = ", ".join(stretch((start, end)) for start, end in disturbed[:5])
        show(f"disturbed, and weighed down: {longest}{' and more' if len(disturbed) > 5 else ''}")
    show(*(f"left out: {where}" for where in calibration.diagnostics.get("left_out", ())))


def show_weak(sentences: Sequence[str]) -> None:
    """The worst of the weak directions; the files hold all of them."""
    show(*(f"  weak: {sentence}" for sentence in sentences[:_WORST]))
    if len(sentences) > _WORST:
        show(f"  weak: {len(sentences) - _WORST} more")


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
