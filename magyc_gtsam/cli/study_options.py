"""The options of `magyc-gtsam study` that only some studies use."""

from __future__ import annotations

import typer

_PAPERS = ("table-one", "settling", "dive-survey", "autocal", "review", "real-tracks")
_USED_BY = {
    "runs": (
        *("efficiency", "table-one", "settling", "dive-survey", "autocal", "review", "gap", "gap-strengths"),
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
