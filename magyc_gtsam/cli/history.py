"""`magyc-gtsam history`: follow the calibration of one instrument over many logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.cli.interrupts import explained
from magyc_gtsam.cli.known import Scale, scale_sigma
from magyc_gtsam.cli.many_table import distinct_names
from magyc_gtsam.cli.options import with_groups
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.results import dated_folder, write_exports
from magyc_gtsam.cli.terminal import (
    complain,
    concluded,
    show,
    show_calibration,
    show_json,
    show_results,
    show_table,
    stages,
)
from magyc_gtsam.foreign_text import counted, listed, with_minus

if TYPE_CHECKING:
    from magyc_gtsam.engine import Row
    from magyc_gtsam.history import History, LogFactor


@with_groups
def run(
    reading: Reading,
    scale: Scale,
    more: given.More = None,
    gyroscope_scale: given.GyroscopeScale = None,
    add: Annotated[
        Path | None,
        typer.Option(
            metavar="HISTORY", help="Add the logs to this history.yaml, whose own logs are not read again."
        ),
    ] = None,
    output: given.Output = None,
    engine: given.Engine = "local",
    quiet: given.Quiet = False,
    json: given.Json = False,
) -> int:
    """Follow one instrument over many logs.

    Its soft iron is constant between refits, its hard iron drifts and jumps. Writes history.yaml (a summary of each
    log, for --add), report.html, and next.yaml with parameters to paste for the next log. Exit code 1: done, but the
    logs are of several instruments, the last one contradicts those before it, or their order in time is not known
    (dates in the future, or years apart): no parameters, and next.yaml is marked as untrusted; or no log, or none of
    --add, can be used. 2: no log can be read.
    """
    try:
        return _followed(reading, scale, more, gyroscope_scale, add, output, engine, quiet, json)
    except _NoneUsableError as none:
        return _none_usable(none.factors, json)


class _NoneUsableError(Exception):
    """No log of a new history has a trusted calibration."""

    def __init__(self, factors: Sequence[LogFactor]) -> None:
        super().__init__()
        self.factors = factors


def _none_usable(factors: Sequence[LogFactor], json: bool) -> int:
    """Say why each log cannot be used, and return the exit code: 2 if none of them can be read."""
    if json:
        show_json({"contradictions": [[i, factor.name, factor.problem] for i, factor in enumerate(factors)]})
    complain(f"no history: none of {counted(len(factors), 'log')} has a trusted calibration, and one is needed")
    for factor in factors:
        complain(f"{factor.name}: {factor.problem}")
    return 1 if any(factor.samples for factor in factors) else 2


def _followed(
    reading: Reading,
    scale: Scale,
    more: list[Path] | None,
    gyroscope_scale: float | None,
    add: Path | None,
    output: Path | None,
    engine: str,
    quiet: bool,
    json: bool,
) -> int:
    """Write and show the history of the logs; see `run`.

    Raises:
        _NoneUsableError: a new history without a usable log.
    """
    from magyc_gtsam.engine import run_many
    from magyc_gtsam.estimators import check_options
    from magyc_gtsam.history import History, LogFactor
    from magyc_gtsam.io.many import find_logs
    from magyc_gtsam.report.summary_page import history_page, judged_history, parts_left_out
    from magyc_gtsam.storage.files import write_text

    logs = find_logs([reading.log, *(more or [])])
    before, notes = None if add is None else History.load(add), list[str]()
    strength = scale.tesla()
    options = {} if before is None else dict(before.options)
    if strength is not None:
        options["field_strength"] = strength
    if gyroscope_scale is not None:
        options["gyroscope_scale"] = scale_sigma(gyroscope_scale)
    reading.check()
    check_options(**options)
    tasks = {name: (replace(reading, log=log), options) for log, name in distinct_names(logs).items()}
    folder = output or dated_folder(Path("history"))
    with replacing_folder(folder) as part, stages(shown=not (quiet or json)) as stage:
        rows = run_many(_compress_one, tasks, engine=engine, progress=stage(f"calibrating {len(logs)} logs"))
        factors = [
            LogFactor(name, None, None, None, problem=row["error"])
            if "error" in row
            else replace(LogFactor.from_dict(row), name=name)
            for name, row in rows.items()
        ]
        if before is None and all(factor.mean is None for factor in factors):
            raise _NoneUsableError(factors)
        if before is not None:
            factors, notes = _new(factors, before)
            names = _named_apart([factor.name for factor in factors], before)
            factors = [replace(factor, name=name) for factor, name in zip(factors, names, strict=True)]
        history = History(factors, options=options) if before is None else before.extend(factors)
        verdict, following = judged_history(history), history.next
        history.save(part / "history.yaml")
        following.save(part / "next.yaml")
        write_exports(part, following)
        write_text(part / "report.html", history_page(history))
    unused = [factor for factor in factors if factor.mean is None]
    if quiet or json:  # the table has them
        notes += [f"{factor.name} is not used: {factor.problem}" for factor in unused]
    notes += parts_left_out(factors)
    for note in [*notes, *_order_given(history), *_without_the_last(history)]:
        complain(f"note: {note}")
    if json:
        told = _as_dict(history, folder) | {"next": following.to_dict(), "verdict": verdict.to_dict()}
        show_json(told)
    elif not quiet:
        show(verdict.sentence, "")
        _show(history)
        if verdict.trusted:
            show(f"next log: {following.message}")
            show_calibration(following)
        show_results(folder)
    added_none = before is not None and len(unused) == len(factors)
    return max(concluded(verdict, shown=not (quiet or json)), int(added_none))


def _new(factors: Sequence[LogFactor], before: History) -> tuple[list[LogFactor], list[str]]:
    """Return the logs that are not in the history already, which would count twice, and a note on each of the others.

    Raises:
        MagycError: there is no new log.
    """
    from magyc_gtsam.factors.errors import MagycError

    new, notes = [], []
    for factor in factors:
        known = before.counted.same_samples(factor)
        if known is None:
            new.append(factor)
            continue
        called = "" if known.name == factor.name else f" as {known.name}"
        notes.append(f"{factor.name}: its samples are in the history already{called}; left out")
    if not new:
        raise MagycError(f"{notes[0].removesuffix('; left out')}; name a new log")
    return new, notes


def _order_given(history: History) -> list[str]:
    """Return a note that some logs have no date, if others have one: all of them are in the order given then."""
    calibrated = [factor for factor in history.factors if factor.mean is not None]
    undated = [factor.name for factor in calibrated if factor.time is None]
    if not undated or len(undated) == len(calibrated):
        return []
    clock = "its clock was" if len(undated) == 1 else "their clocks were"
    has = "has" if len(undated) == 1 else "have"
    return [
        f"{listed(undated)} {has} no date ({clock} not set, or counts from the start): all logs are taken in the order "
        "given, those of a folder in that of their names"
    ]


def _without_the_last(history: History) -> list[str]:
    """Return a note that the last log is not used, in which the iron may have changed."""
    from magyc_gtsam.history.doubt import last_unused

    last = last_unused(history.factors, history.times)
    if last is None:
        return []
    return [f"{last.name}, the last log, is not used: the prediction holds if the iron did not change in it"]


def _named_apart(names: Sequence[str], before: History) -> list[str]:
    """Return the names of new logs, numbered where the history has another log of that name."""
    taken, result = set(before.names), []
    for name in names:
        number, apart = 1, name
        while apart in taken:
            number += 1
            apart = f"{name} ({number})"
        taken.add(apart)
        result.append(apart)
    return result


def _compress_one(task: tuple[Reading, dict[str, Any]]) -> Row:
    """Compress one log, read and calibrated with these options, into its factor as a row; errors are in the row."""
    from magyc_gtsam.history.log_factor import LogFactor, factor_of

    reading, options = task
    try:
        return factor_of(reading.recording(), None, options).to_dict()
    except Exception as error:  # noqa: BLE001 - a bug must not cost the results of the other logs
        problem = explained(error).removeprefix(f"{reading.log}: ")
        return LogFactor(reading.log.name, None, None, None, problem=problem).to_dict()


def _show(history: History) -> None:
    from magyc_gtsam.history.doubt import date_of
    from magyc_gtsam.report.summary_page import history_rows

    header, rows = ["log", "date", "hard iron x, y, z (µT)", "±", ""], []
    unused = {each.index: each.sentence for each in history.contradictions}
    for i, (factor, iron, calibration) in enumerate(
        zip(history.factors, history.hard_iron, history.calibrations, strict=True)
    ):
        called = [factor.name, "" if factor.time is None else date_of(factor.time)]
        if i in unused:  # the history knows a hard iron at that time, but not from this log
            rows.append([*called, "–", "–", f"not used: {unused[i]}"])
            continue
        sigma = calibration.sigma["hard_iron"].max() * 1e6
        rows.append([*called, ", ".join(f"{value * 1e6:.2f}" for value in iron), f"{sigma:.2f}", ""])
    show_table(header, rows, words=(4,))
    show("")
    show(*(with_minus(f"jump before {' '.join(map(str, row))}") for row in history_rows(history)))
    if len(history.groups) > 1:
        show(*(f"group: {', '.join(history.names[i] for i in group)}" for group in history.groups))


def _as_dict(history: History, folder: Path) -> dict[str, Any]:
    return {
        "folder": str(folder),
        "names": list(history.names),
        "hard_iron": history.hard_iron.tolist(),
        "hard_iron_covariance": history.hard_iron_covariance.tolist(),
        "jumps": [[index, size.tolist(), sigma.tolist()] for index, size, sigma in history.jumps],
        "refits": history.refits,
        "groups": [list(group) for group in history.groups],
        "contradictions": [[each.index, each.name, each.sentence] for each in history.contradictions],
    }
