"""`magyc-gtsam calibrate --plan`: which motion, and how long, for a heading that is wanted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from magyc_gtsam.cli.terminal import show, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.study.plan import Planned

_NOISE = (1e-6, 5e-3)  # T and rad/s per sample, where nothing else is said
_PLANNED = ("noise", "prior", "hard_iron_walk", "soft_iron_walk", "misalignment")


def show_plan(heading: float, options: dict[str, Any], quiet: bool, json: bool) -> int:
    """A row a motion: the shortest time for a heading of so many degrees, by what is known beforehand.

    Args:
        heading: deg.
        options: of the calibration; those that make no difference to a plan are left.
        quiet, json: as of the command.
    """
    from magyc_gtsam.estimators.smoother.options import SmootherOptions
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.study.plan import DURATIONS, MOTIONS, WAYS, plan, shortest

    if not 0 < heading < 90:
        raise MagycError(f"--plan: a heading of {heading:g}°, it must be between 0 and 90")
    chosen = {name: options[name] for name in _PLANNED if name in options}
    noise = tuple(chosen.pop("noise", _NOISE))
    with stages(shown=not (quiet or json)) as stage:
        planned = plan(
            (noise[0], noise[1]), SmootherOptions(**chosen), durations=DURATIONS, progress=stage("planning")
        )
    if json:
        import json as text
        from dataclasses import asdict

        typer.echo(text.dumps({"heading_deg": heading, "planned": [asdict(each) for each in planned]}, indent=2))
        return 0
    if quiet:
        return 0
    rows = []
    for motion, words in MOTIONS.items():
        found = [shortest(planned, motion, way, heading) for way in WAYS]
        rows.append([words, *(_said(each) for each in found)])
    show(
        f"the shortest time for a heading within {heading:g}° (one sigma, over a level turn), and the sigma of the "
        f"hard iron then; magnetometer {noise[0] * 1e6:g} µT, gyroscope {noise[1] * 1e3:g} mrad/s per sample at 10 Hz",
        "",
    )
    show_table(["motion \\ known beforehand", *WAYS], rows)
    show(
        "",
        f"–: not within {DURATIONS[-1] / 60:g} min. The place: --location and --date, its dip by the accelerometer. An "
        "earlier calibration: "
        + (
            "--prior as given"
            if "prior" in chosen
            else "--prior, its matrix good to 0.2 %, its hard iron to nothing"
        )
        + ". A skew between the chips as boards have it is left open.",
    )
    return 0


def _said(planned: Planned | None) -> str:
    if planned is None:
        return "–"
    time = f"{planned.duration:g} s" if planned.duration < 120 else f"{planned.duration / 60:g} min"
    return f"{time} ({planned.hard_iron * 1e6:.2g} µT)"
