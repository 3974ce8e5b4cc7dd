"""`magyc-gtsam study gap`: the blind test of the gap workflow."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magyc_gtsam.cli.study_options import recordings_of
from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.recording import Recording


def blind_test(
    folder: Path,
    runs: int,
    motions: Sequence[str] | None,
    sets: Sequence[str] | None,
    logs: Sequence[str],
    edition: int,
    foreign: Path | None,
    workers: int,
) -> int:
    """Generate, seal, diagnose and score recordings; completed parts are not repeated.

    Returns:
        The exit code: 0 if all gates are passed, else 1.
    """
    from magyc_gtsam.blindtest.detectability import stands_out
    from magyc_gtsam.blindtest.from_outside import EffectsFromFile
    from magyc_gtsam.blindtest.gates import gates, missing
    from magyc_gtsam.blindtest.heading import heading_errors
    from magyc_gtsam.blindtest.pictures import write_pictures
    from magyc_gtsam.blindtest.running import run
    from magyc_gtsam.blindtest.scenarios import MOTIONS, SETS, real_scenarios, scenarios
    from magyc_gtsam.blindtest.scoring import score
    from magyc_gtsam.blindtest.tables import GATE_HEADER, gate_rows, outcome_header, outcome_rows, write_tables
    from magyc_gtsam.factors.errors import MagycError

    code = 0
    tests: dict[str, tuple[list, dict[str, Recording]]] = {}
    unknown = sorted(set(sets or ()) - set(SETS[:-1]))
    if unknown:
        raise MagycError(f"--set: {unknown[0]!r} is not one of {', '.join(SETS[:-1])}")
    if foreign is not None and sets:
        raise MagycError("--set: has no effect with --foreign, whose effects are the only ones; leave it out")
    outside = None if foreign is None else EffectsFromFile.read(foreign)
    if outside is not None:
        for motion in motions or MOTIONS:
            tests[f"{motion}-{outside.name}"] = outside.scenarios(motion, runs, edition), {}
    elif not logs or motions or sets:
        for motion in motions or MOTIONS:
            tests[motion] = scenarios(motion, runs, edition, sets or SETS[:-1]), {}
    if logs:
        recordings = recordings_of(logs)
        tests["real"] = real_scenarios(list(recordings), max(1, round(runs / 50)), edition), recordings
    for name, (scenario_list, recordings) in tests.items():
        place = folder / name
        with stages() as stage:
            run(
                place,
                scenario_list,
                recordings,
                workers,
                sealing=stage(f"{name}: sealing {len(scenario_list)} recordings"),
                diagnosing=stage(f"{name}: diagnosing"),
                outside=None if outside is None else outside.effects,
            )
            outcomes = score(place, heading_errors, stands_out, stage(f"{name}: scoring"))
        show("", f"{name}: {len(outcomes)} recordings", "")
        measured = gates(outcomes)
        show_table(GATE_HEADER, gate_rows(measured))
        short = missing(outcomes)
        if short:
            show("", "named in less than 90 % of the runs at published strength:")
            show(*(f"  {effect}: {hit} of {total}" for effect, (hit, total) in short.items()))
        show("")
        show_table(outcome_header(outcomes), outcome_rows(outcomes))
        files = write_tables(place, outcomes, f"Blind test, {name}, edition {edition}")
        files += write_pictures(place, outcomes)
        show("", *(f"{file}" for file in files))
        code |= not all(gate.passed for gate in measured)
    return int(code)
