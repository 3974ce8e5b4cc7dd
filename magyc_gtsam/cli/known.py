"""Options of what is known beforehand: the skew of the chips, an earlier calibration, the field at the place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from magyc_gtsam.cli.scale import Scale


@dataclass(frozen=True)
class Known:
    """What the smoother is told beforehand."""

    misalignment: Annotated[
        str | None,
        typer.Option(
            metavar="DEGREES",
            help="Of the two chips: 'auto' (default) asks the data; a number is the prior's deviation; 0 is none.",
        ),
    ] = None
    prior: Annotated[
        Path | None,
        typer.Option(
            metavar="CALIBRATION", help="calibration.yaml of the same instrument from earlier, as a prior."
        ),
    ] = None
    hard_iron_walk: Annotated[
        float | None,
        typer.Option(metavar="µT", help="By which the hard iron may have changed since --prior. Default: 0."),
    ] = None
    soft_iron_walk: Annotated[
        float | None,
        typer.Option(metavar="PERCENT", help="By which the soft iron may have changed since --prior. Default: 0."),
    ] = None

    def options(self, scale: Scale, method: str) -> dict[str, Any]:
        """Arguments of `magyc_gtsam.calibrate`; what was not said is left to the method.

        Raises:
            MagycError: what is no number, no calibration, or contradicts.
        """
        from magyc_gtsam.factors.errors import MagycError

        result: dict[str, Any] = {}
        place = scale.place() if method == "smoother" else None
        if place is not None:
            result["field"] = place
        else:
            result["field_strength"] = scale.tesla()
        if self.misalignment is not None:
            result["misalignment"] = self.misalignment
            if self.misalignment != "auto":
                try:
                    result["misalignment"] = math.radians(float(self.misalignment))
                except ValueError:
                    raise MagycError(
                        f"--misalignment: {self.misalignment!r} is neither a number of degrees nor 'auto'"
                    ) from None
        if self.prior is not None:
            from magyc_gtsam.calibration import Calibration

            result["prior"] = Calibration.load(self.prior).to_dict()
        if self.hard_iron_walk is not None:
            result["hard_iron_walk"] = self.hard_iron_walk * 1e-6
        if self.soft_iron_walk is not None:
            result["soft_iron_walk"] = self.soft_iron_walk * 1e-2
        return result
