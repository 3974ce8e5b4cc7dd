"""`magyc-gtsam gap LOGS…`: find effects over many logs of one instrument, and whether they belong to the instrument."""

from __future__ import annotations

import json as json_text
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magyc_gtsam.cli.files import replacing_folder
from magyc_gtsam.cli.many import unique_names
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.results import dated_folder
from magyc_gtsam.cli.terminal import complain, show, show_json, show_page, show_results, show_table, stages
from magyc_gtsam.foreign_text import clauses, counted, first_of
from magyc_gtsam.gap.effects import LABELS
from magyc_gtsam.option_names import as_options

if TYPE_CHECKING:
    from magyc_gtsam.gap.many.result import GapOfMany, SharedEffect

EFFECTS = ("effect", "belongs to", "value", "logs", "evidence (nats)", "or")
VALUES = ("effect", "log", "value", "probability")
WEIGHTS = ("hypothesis", "one value (nats)", "one in each log (nats)")
_SHOWN = 8  # hypotheses on the terminal without --verbose; page and gap.json have more
_LISTED = 20
_GOOD = ("none", "closed")


def gap_of_logs(
    reading: Reading,
    logs: Sequence[Path],
    names: Sequence[str] | None,
    output: Path | None,
    open_page: bool,
    verbose: bool,
    quiet: bool,
    json: bool,
) -> int:
    """Compare all logs, and write gap.json, report.html and a calibration for each log.

    Returns:
        The exit code: 0 if nothing is missing or all of it is named, and all calibrations are trusted, else 1.

    Raises:
        MagycError: no log can be read.
    """
    from magyc_gtsam import MagycError, find_gap
    from magyc_gtsam.gap.many.result import LogLeftOut
    from magyc_gtsam.storage.files import write_text

    reading.check()
    recordings, unread = [], []
    folder = output or dated_folder(Path("logs"), "-gap")
    with replacing_folder(folder) as part, stages(shown=not (quiet or json)) as stage:
        progress = stage(f"reading {len(logs)} logs")
        for done, (log, name) in enumerate(zip(logs, unique_names(logs), strict=True), start=1):
            try:
                recordings.append(replace(replace(reading, log=log).recording(), name=name))
            except MagycError as problem:
                unread.append(LogLeftOut(name, str(problem).removeprefix(f"{log}: ")))
            progress(done / len(logs))
        if not recordings:
            each = "; ".join(first_of([f"{own.log}: {own.sentence}" for own in unread], "logs"))
            raise MagycError(f"none of {counted(len(logs), 'log')} can be read: {each}")
        gap = find_gap(recordings, candidates=names, progress=stage("searching"))
        gap = replace(gap, own=(*unread, *gap.own))
        text = json_text.dumps(gap.to_dict(), indent=2, ensure_ascii=False) + "\n"
        write_text(part / "gap.json", text)
        (part / "calibrations").mkdir()
        for name, calibration in gap.calibrations.items():
            calibration.save(part / "calibrations" / f"{name}.yaml")
        write_text(part / "report.html", _page(gap))
    if open_page:
        show_page(folder / "report.html")
    if json:
        show_json(gap.to_dict() | {"folder": str(folder)})
    elif not quiet:
        _show(gap, folder, verbose)
    untrusted = [name for name, calibration in gap.calibrations.items() if not calibration.trusted]
    if gap.verdict not in _GOOD:
        complain(f"the gap is left open: {gap.sentence}")
    for name in untrusted:
        why = as_options(clauses(gap.calibrations[name].message)[0])
        complain(f"{name}: its calibration must not be used ({why}); run `magyc-gtsam gap` on this log alone")
    return int(gap.verdict not in _GOOD or bool(untrusted))


def effect_rows(gap: GapOfMany) -> list[list[str]]:
    """Return one row for each effect."""
    return [
        [
            effect.label,
            f"{effect.of} ({max(effect.instrument, 1 - effect.instrument):.0%})",
            value_of(effect, effect.value, effect.sigma) if len(effect.value) else "one in each log",
            f"{len(effect.logs)} of {len(gap.calibrations)}",
            f"{effect.evidence:.0f}",
            ", ".join(LABELS.get(name, name) for name in effect.ambiguous_with),
        ]
        for effect in gap.effects
    ]


def value_of(effect: SharedEffect, value: np.ndarray, sigma: np.ndarray) -> str:
    """Return values with unit, and with standard deviations where they are known."""
    shown = (f"{v:.3g}" + (f" ± {s:.2g}" if np.isfinite(s) else "") for v, s in zip(value, sigma, strict=True))
    return f"{', '.join(shown)} {effect.unit}".rstrip()


def _log_rows(gap: GapOfMany) -> list[list[str]]:
    """Return one row for each effect and log."""
    return [
        [effect.label, log.log, value_of(effect, log.value, log.sigma), f"{log.present:.0%}"]
        for effect in gap.effects
        for log in effect.logs
    ]


def weight_rows(gap: GapOfMany, count: int) -> list[list[str]]:
    """Return rows of the strongest remaining hypotheses against the final model."""
    return [
        [w.name, f"{w.shared:.1f}" if np.isfinite(w.shared) else "–", f"{w.apart:.1f}"]
        for w in gap.weights[:count]
    ]


def _show(gap: GapOfMany, folder: Path, every: bool) -> None:
    """Show effects, logs and hypotheses; with `every` also the value in each log and as many hypotheses as the page."""
    show(f"{'✔' if gap.verdict in _GOOD else '✘'} {_headline(gap)}: {gap.sentence}")
    if gap.effects:
        show("")
        show_table(EFFECTS, effect_rows(gap))
    if gap.effects and every:
        show("", "Log by log:")
        show_table(VALUES, _log_rows(gap), words=(1,))
    if gap.own:
        show("", *(f"{own.log}: {own.sentence}" for own in gap.own))
    if parts := _left_out(gap):
        show("", *parts)
    if gap.weights:
        show("", "Other hypotheses, against the model with these effects:")
        show_table(WEIGHTS, weight_rows(gap, _LISTED if every else _SHOWN))
    show_results(folder)


def _left_out(gap: GapOfMany) -> list[str]:
    """Return a sentence on each stretch of a log that was left out because a sensor was faulty."""
    return [
        f"{name}: left out: {where}"
        for name, calibration in gap.calibrations.items()
        for where in calibration.diagnostics.get("left_out", ())
    ]


def _headline(gap: GapOfMany) -> str:
    """Return the verdict in words, as for one log."""
    from magyc_gtsam.report.gap_verdict import TITLES

    return TITLES[gap.verdict]


def _page(gap: GapOfMany) -> str:
    from magyc_gtsam.report.summary_page import Section, summary_page

    sections = [
        Section("Effects", EFFECTS, effect_rows(gap), [] if gap.effects else ["None."]),
        Section("Log by log", VALUES, _log_rows(gap)),
        Section("Logs left out", sentences=[f"{own.log}: {own.sentence}" for own in gap.own] or ["None."]),
        Section("Parts of logs left out", sentences=_left_out(gap)),
        Section("Other hypotheses, against the model with these effects", WEIGHTS, weight_rows(gap, _LISTED)),
    ]
    kept = [section for section in sections if section.rows or section.sentences]
    return summary_page("The gap over many logs", _headline(gap), gap.verdict in _GOOD, [gap.sentence], kept)
