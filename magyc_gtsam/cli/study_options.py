"""The options of `magyc-gtsam study`: those that only some studies use, and the logs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from magyc_gtsam.cli.terminal import stages

if TYPE_CHECKING:
    from magyc_gtsam.recording import Recording

_PAPERS = ("table-one", "settling", "dive-survey", "autocal", "review", "real-tracks")
_USED_BY = {
    "runs": (
        *("efficiency", "table-one", "settling", "dive-survey", "autocal", "review", "gap"),
        *("faults", "known", "duration"),
    ),
    "disturbed": ("efficiency",),
    "gyroscope_noise": ("efficiency", "settling", "table-one"),
    "motion": ("gap", "faults"),
    "sets": ("gap",),
    "log": ("gap", "real-tracks"),
    "sensor": ("real-tracks",),
    "edition": ("gap",),
    "foreign": ("gap",),
    "fault": ("faults",),
    "strength": ("faults",),
    "by": ("faults",),
    "draw": ("faults",),
    "first_seed": ("efficiency", "faults", "known"),
    "workers": ("gap", "faults", "known", "duration", "leaderboard", *_PAPERS),
    "engine": ("known", "duration", "leaderboard", *_PAPERS),
    "folder": ("leaderboard",),
    "base_url": ("leaderboard",),
    "method": ("leaderboard",),
    "output": ("gap", "faults", "known", "duration", "leaderboard", *_PAPERS),
}


def refuse_unused(context: typer.Context, study: str) -> None:
    """Refuse an option that was given and that the study does not use.

    Raises:
        MagycError: with the option and the studies that use it.
    """
    from magyc_gtsam.factors.errors import MagycError

    for parameter in context.command.params:
        used_by = _USED_BY.get(parameter.name or "", (study,))
        source = context.get_parameter_source(parameter.name or "")
        if source is not None and source.name == "COMMANDLINE" and study not in used_by:
            option = max(parameter.opts, key=len)
            raise MagycError(
                f"{option}: has no effect on study {study}, only on {', '.join(used_by)}; leave it out"
            )


_PART = re.compile(r"(.+)@(\d+(?:\.\d+)?):(\d+(?:\.\d+)?)")


def recordings_of(logs: Sequence[str]) -> dict[str, Recording]:
    """Read logs, and return {stem of the file and @START:END: recording}."""
    from magyc_gtsam.io import read
    from magyc_gtsam.study.leaderboard.reading import ARRAYS, read_public

    result = {}
    with stages() as stage:
        for log in logs:
            path, start, end = log, None, None
            if part := _PART.fullmatch(log):
                path, start, end = part[1], float(part[2]), float(part[3])
            name = Path(path).stem + log[len(path) :]
            if Path(path).suffix in ARRAYS:
                recording, _ = read_public(Path(path), read)
                result[name] = recording if start is None or end is None else recording.between(start, end)
            else:
                result[name] = read(path, start=start, end=end, progress=stage(f"reading {name}"))
    return result
