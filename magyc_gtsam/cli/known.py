"""Options for prior knowledge: on the chips, an earlier calibration, location and heading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from magyc_gtsam.cli import options as given
from magyc_gtsam.cli.scale import Scale


@dataclass(frozen=True)
class GivenFacts:
    """Prior knowledge for the smoother."""

    misalignment: given.Misalignment = None
    gyroscope_scale: given.GyroscopeScale = None
    prior: given.Prior = None
    hard_iron_walk: given.HardIronWalk = None
    soft_iron_walk: Annotated[
        float | None,
        typer.Option(metavar="PERCENT", help="Possible change (1σ) of the soft iron since --prior. Default: 0."),
    ] = None

    heading: Annotated[
        str | None,
        typer.Option(
            metavar="CHANNEL",
            help="Channel of the log with the true heading of the sensor's x axis in degrees, as from two GNSS "
            "antennas. It helps to find a rotation between the chips about the vertical. Needs an accelerometer, "
            "--location and --date.",
        ),
    ] = None
    heading_sigma: Annotated[
        float | None,
        typer.Option(metavar="DEGREES", help="What --heading may be off by all the time (1σ). Default: 1."),
    ] = None

    def options(self, scale: Scale, method: str) -> dict[str, Any]:
        """Return the arguments of `magyc_gtsam.calibrate` for the options that were given.

        Raises:
            MagycError: a value is not a number, a file is not a calibration, or options contradict each other.
        """
        from magyc_gtsam.estimators.smoother.options import HEADING_SIGMA
        from magyc_gtsam.factors.errors import MagycError

        result: dict[str, Any] = {}
        place = scale.place() if method == "smoother" else None
        if place is not None:
            result["field"] = place
        else:
            result["field_strength"] = scale.tesla()
        result |= beforehand(self.misalignment, self.prior, self.hard_iron_walk)
        if self.gyroscope_scale is not None:
            result["gyroscope_scale"] = self.gyroscope_scale * 1e-2
        if self.heading is not None:
            sigma = HEADING_SIGMA if self.heading_sigma is None else math.radians(self.heading_sigma)
            result["heading"] = [self.heading, sigma]
            result["declination"] = scale.declination()
        elif self.heading_sigma is not None:
            raise MagycError("--heading-sigma: has no effect without --heading CHANNEL")
        if self.soft_iron_walk is not None:
            result["soft_iron_walk"] = 1e-2 * _not_negative("--soft-iron-walk", self.soft_iron_walk)
        return result


def beforehand(misalignment: str | None, prior: Path | None, hard_iron_walk: float | None) -> dict[str, Any]:
    """Return misalignment (degrees), prior and walk (µT) as arguments of the smoother, batch and online, in JSON types.

    Raises:
        MagycError: the misalignment or the walk is not such a number, or the prior is not a calibration.
    """
    from magyc_gtsam.factors.errors import MagycError

    result: dict[str, Any] = {}
    if misalignment is not None:
        result["misalignment"] = misalignment
        if misalignment != "auto":
            try:
                degrees = float(misalignment)
            except ValueError:
                degrees = math.nan
            if not 0 <= degrees < 45:
                raise MagycError(
                    f"--misalignment: must be a number of degrees from 0 to 45, or 'auto', got {misalignment!r}"
                )
            result["misalignment"] = math.radians(degrees)
    if prior is not None:
        from magyc_gtsam.calibration import Calibration

        result["prior"] = Calibration.load(prior).to_dict()
    if hard_iron_walk is not None:
        result["hard_iron_walk"] = 1e-6 * _not_negative("--hard-iron-walk", hard_iron_walk)
    return result


def _not_negative(option: str, value: float) -> float:
    from magyc_gtsam.factors.errors import MagycError

    if not value >= 0:
        raise MagycError(f"{option}: must be 0 or more, got {value:g}")
    return value
