"""`magyc-gtsam calibrate --plan`: show which motion, for how long, gives a heading accuracy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from magyc_gtsam.cli.terminal import show, show_json, show_table, stages

if TYPE_CHECKING:
    from magyc_gtsam.study.plan import Planned

_DEFAULT_NOISE = (1e-6, 5e-3)  # T and rad/s per sample
_RELEVANT = ("noise", "prior", "hard_iron_walk", "soft_iron_walk", "misalignment")  # options that affect a plan


def show_plan(heading: float, options: dict[str, Any], quiet: bool, json: bool) -> int:
    """Show the shortest time for a heading accuracy, by motion and prior knowledge; return the exit code.

    Args:
        heading: standard deviation of heading, deg.
        options: arguments of `magyc_gtsam.calibrate`; those that do not affect a plan are ignored.
        quiet, json: of the command line.
    """
    from magyc_gtsam.estimators.smoother.options import SmootherOptions
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.study.plan import DURATIONS, MOTIONS, WAYS, plan, shortest

    if not 0 < heading < 90:
        raise MagycError(f"--plan: the heading must be between 0 and 90°, got {heading:g}")
    chosen = {name: options[name] for name in _RELEVANT if name in options}
    noise = tuple(chosen.pop("noise", _DEFAULT_NOISE))
    with stages(shown=not (quiet or json)) as stage:
        planned = plan(
            (noise[0], noise[1]), SmootherOptions(**chosen), durations=DURATIONS, progress=stage("planning")
        )
    if json:
        from dataclasses import asdict

        show_json({"heading_deg": heading, "planned": [asdict(each) for each in planned]})
        return 0
    if quiet:
        return 0
    rows = []
    for motion, words in MOTIONS.items():
        rows.append([words, *(_cell(shortest(planned, motion, way, heading)) for way in WAYS)])
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
            else "--prior, its matrix good to 0.2 %, its hard iron not at all"
        )
        + ". A misalignment of the chips as boards have it is left open; level motion does not show its part about "
        "the vertical. Where that is the limit, --heading helps, or --misalignment 0 if the chips are aligned.",
    )
    return 0


def _cell(planned: Planned | None) -> str:
    """Return the time and the standard deviation of the hard iron; "–" if no time is enough."""
    if planned is None:
        return "–"
    time = f"{planned.duration:g} s" if planned.duration < 120 else f"{planned.duration / 60:g} min"
    iron = planned.hard_iron * 1e6
    return f"{time} ({f'{iron:#.2g}' if iron < 9.95 else f'{iron:.0f}'} µT)"
