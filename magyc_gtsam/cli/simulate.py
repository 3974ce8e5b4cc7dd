"""`magyc-gtsam simulate`: simulate a recording with its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.files import replacing
from magyc_gtsam.cli.results import write_yaml
from magyc_gtsam.cli.terminal import show


def run(
    motion: Annotated[
        str,
        typer.Argument(
            metavar="MOTION",
            help="wide, moderate, low, tiny, level, ship, multi, dive or survey.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            parser=given.named_path,
            metavar="FILE",
            help="FILE.mcap; the truth is written to FILE.truth.yaml.",
            show_default=False,
        ),
    ],
    duration: Annotated[float, typer.Option(metavar="SECONDS")] = 600.0,
    rate: Annotated[float, typer.Option(metavar="HZ")] = 10.0,
    seed: Annotated[
        int, typer.Option(min=0, help="Random seed of motion, noise and the directions of effects.")
    ] = 0,
    field_strength: Annotated[
        float | None, typer.Option(metavar="µT", help="Field strength. Default: 47.3, as in the MAGYC paper.")
    ] = None,
    hard_iron: Annotated[
        tuple[float, float, float] | None, typer.Option(metavar="X Y Z", help="Hard iron in µT. Default: 2 12 9.")
    ] = None,
    gyroscope_bias: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y Z", help="Gyroscope bias in mrad/s. Default: 4 -5 2."),
    ] = None,
    magnetometer_noise: Annotated[
        float, typer.Option(metavar="µT", help="Standard deviation per sample and axis.")
    ] = 1.0,
    gyroscope_noise: Annotated[
        float, typer.Option(metavar="MRAD/S", help="Standard deviation per sample and axis.")
    ] = 5.0,
    delay: Annotated[float, typer.Option(metavar="MS", help="Delay of the magnetometer.")] = 0.0,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=FACTOR]",
            help="Add an effect of the gap workflow, with a factor on its published strength; may be repeated. "
            "The effects are written to FILE.effects.yaml.",
        ),
    ] = None,
) -> int:
    """Simulate a recording with its truth.

    The same arguments give the same messages.
    """
    import numpy as np

    from magyc_gtsam.cli.known import tesla_of
    from magyc_gtsam.factors.errors import MagycError
    from magyc_gtsam.io import write_mcap
    from magyc_gtsam.simulation import FIELD, simulate
    from magyc_gtsam.storage.json_types import json_types

    if output.suffix.lower() != ".mcap":
        raise MagycError(f"--output: must end in .mcap, got {output}")
    for option, value in (("--duration", duration), ("--rate", rate)):
        if not value > 0:
            raise MagycError(f"{option}: must be more than 0, got {value:g}")
    for option, values, least, most, unit in (
        ("--hard-iron", hard_iron, -1000.0, 1000.0, "µT"),
        ("--gyroscope-bias", gyroscope_bias, -5000.0, 5000.0, "mrad/s"),
        ("--magnetometer-noise", magnetometer_noise, 0.0, 1000.0, "µT"),
        ("--gyroscope-noise", gyroscope_noise, 0.0, 5000.0, "mrad/s"),
        ("--delay", delay, -10000.0, 10000.0, "ms"),
    ):
        given_values = () if values is None else np.atleast_1d(values)
        if not all(least <= value <= most for value in given_values):
            shown = " ".join(f"{value:g}" for value in given_values)
            raise MagycError(f"{option}: must be from {least:g} to {most:g} {unit}, got {shown}")
    sensor: dict[str, Any] = {
        "magnetometer_noise": magnetometer_noise * 1e-6,
        "gyroscope_noise": gyroscope_noise * 1e-3,
        "delay": delay * 1e-3,
    }
    if field_strength is not None:
        sensor["field"] = FIELD * (tesla_of(field_strength) / np.linalg.norm(FIELD))
    if hard_iron is not None:
        sensor["hard_iron"] = np.multiply(hard_iron, 1e-6)
    if gyroscope_bias is not None:
        sensor["gyro_bias"] = np.multiply(gyroscope_bias, 1e-3)
    simulation = simulate(motion, duration, rate, seed, [_factor(text) for text in effect or ()], **sensor)
    truth = output.with_suffix(".truth.yaml")
    with replacing(output) as part, replacing(truth) as truth_part:
        write_mcap(part, simulation.recording)
        simulation.truth.save(truth_part)
    show(f"{output}: {simulation.recording.duration:.1f} s at {rate:g} Hz", f"{truth}: the truth behind it")
    hidden = output.with_suffix(".effects.yaml")
    hidden.unlink(missing_ok=True)  # those of an earlier recording of this name
    if simulation.effects:
        with replacing(hidden) as part:
            write_yaml(part, {"effects": json_types(simulation.effects)})
        show(f"{hidden}: {', '.join(e.name for e in simulation.effects)}")
    return 0


def _factor(text: str) -> tuple[str, float]:
    """Return (name, factor) of "name" or "name=factor"; without one the factor is 1."""
    from magyc_gtsam.factors.errors import MagycError

    name, equals, factor = text.partition("=")
    try:
        return name, float(factor) if equals else 1.0
    except ValueError:
        raise MagycError(f"--effect: the factor of {name!r} must be a number, got {factor!r}") from None
