"""`magyc-gtsam info`: what is in a log, and whether it can be calibrated."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.groups import with_groups
from magyc_gtsam.cli.options import spelled
from magyc_gtsam.cli.reading import Reading
from magyc_gtsam.cli.terminal import show, show_table, show_weak, stages

if TYPE_CHECKING:
    from magyc_gtsam.io import LogInfo
    from magyc_gtsam.recording import Array


@dataclass(frozen=True)
class Prospect:
    """What the default calibration makes of a log.

    Args:
        possible: whether it can be calibrated and the result be trusted.
        reason: why, or why not, in one sentence.
        turned: rad, the path that the attitude went; None without a gyroscope.
        weak: sentences on what the motion leaves weak, worst first.
    """

    possible: bool
    reason: str
    turned: float | None = None
    weak: tuple[str, ...] = ()


@with_groups
def run(
    reading: Reading,
    json: given.Json = False,
) -> int:
    """Say what a log holds, and whether it can be calibrated.

    Exit code 0 wherever the file is a log that can be read, whatever the answer is.
    """
    from magyc_gtsam.io import info

    with stages(shown=not json) as stage:
        stage("reading")
        described = info(reading.log)
        prospect = _prospect(reading, stage("calibrating"))
    if json:
        _show_json(described, prospect)
    else:
        _show(described, prospect)
    return 0


def _prospect(reading: Reading, progress: Any) -> Prospect:
    """Read and calibrate; a refusal is an answer here, not an error."""
    from magyc_gtsam import MagycError, calibrate

    turned = None
    try:
        recording = reading.recording()
        if recording.angular_rate is not None:
            turned = _turned(*recording.gyroscope)
        calibration = calibrate(recording, progress=progress)
    except MagycError as error:
        return Prospect(False, spelled(str(error)), turned)
    weak = calibration.observability.weak if calibration.observability is not None else ()
    return Prospect(
        calibration.converged, calibration.message, turned, tuple(weakness.sentence for weakness in weak)
    )


def _turned(time: Array, rate: Array) -> float:
    """rad; in steps of a second, so that the noise of the samples does not add up, nor the usual bias."""
    import numpy as np

    angle = np.zeros_like(rate)
    np.cumsum((rate - np.median(rate, axis=0))[1:] * np.diff(time)[:, None], axis=0, out=angle[1:])
    seconds = np.arange(time[0], time[-1], 1.0)
    steps = np.diff([np.interp(seconds, time, column) for column in angle.T])
    return float(np.linalg.norm(steps, axis=0).sum())


def _show(described: LogInfo, prospect: Prospect) -> None:
    show(f"{described.path}: {described.format}, {described.duration:.1f} s", "")
    rows = []
    for source in described.sources:
        span = "" if source.span is None else f"{source.span[0]:.1f}–{source.span[1]:.1f}"
        rate = "" if source.rate is None else f"{source.rate:.1f}"
        rows.append((source.name, source.type, str(source.count), rate, span, ", ".join(source.serves_as)))
    show_table(("source", "type", "samples", "Hz", "s", "serves as"), rows)
    show("", *(f"note: {warning}" for warning in described.warnings))
    if prospect.turned is not None:
        show(f"motion: turned by about {prospect.turned * 57.29578:.0f}° in all")
    show(f"can be calibrated: {'yes' if prospect.possible else 'no'}, {prospect.reason}")
    show_weak(prospect.weak)


def _show_json(described: LogInfo, prospect: Prospect) -> None:
    import json

    sources = [asdict(source) | {"rate": source.rate} for source in described.sources]
    result = asdict(described) | {"sources": sources, "calibration": asdict(prospect)}
    typer.echo(json.dumps(result, indent=2))
