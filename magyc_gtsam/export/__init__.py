"""Export of calibrations as parameters of PX4, ArduPilot, VectorNav and ROS, ready to paste; one file per target.

All four correct with a matrix and an offset, like this package (`soft_iron⁻¹ (m − hard_iron)`), but differ in units, in
the sign of the offset and in the matrices they can represent. Nothing is rescaled: the field strength that `soft_iron`
implies is kept. A rotation to the gyroscope's axes goes into the mounting; motor current and temperature go into the
parameters that the target has for them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from magyc_gtsam.export.ardupilot import ardupilot
from magyc_gtsam.export.correction import Correction
from magyc_gtsam.export.parts import with_terms
from magyc_gtsam.export.places import OF_THE_FIRST, cleared, in_places, numbered, places_of
from magyc_gtsam.export.px4 import px4
from magyc_gtsam.export.ros import ros
from magyc_gtsam.export.vectornav import vectornav
from magyc_gtsam.factors.effects.dated import afterwards
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording.applied import ONLY_THE_REST
from magyc_gtsam.recording.autopilot import Autopilot
from magyc_gtsam.recording.axes import OWN_AXES, axes_text, parse_axes

__all__ = ["TARGETS", "do_not_use", "export", "exported"]

TARGETS: dict[str, Callable[[Correction], list[str]]] = {
    "px4": px4,
    "ardupilot": ardupilot,
    "vectornav": vectornav,
    "ros": ros,
}
_WITH_MOTOR = ("px4", "ardupilot")
_WITH_TEMPERATURE = ("px4",)


def export(
    target: str,
    soft_iron: ArrayLike,
    hard_iron: ArrayLike,
    gyro_bias: ArrayLike | None = None,
    terms: Sequence[Term] = (),
    *,
    per_motor: bool = False,
    battery_voltage: float | None = None,
    compass: int = 1,
    gyroscope_axes: str = OWN_AXES,
    autopilot: Autopilot | None = None,
) -> str:
    """Return the text to paste into `target`.

    Args:
        target: "px4", "ardupilot", "vectornav" or "ros".
        soft_iron: (3, 3).
        hard_iron: (3,) T.
        gyro_bias: (3,) rad/s, in the axes of the calibrated field; None leaves the gyroscope out.
        terms: other effects of the calibration. Jumps of iron and bias that last are in the values, which are those
            after them; a comment says so, and lists the terms that the target cannot represent.
        per_motor: the channels of current are outputs of motors, each with separate compensation (ArduPilot).
        battery_voltage: V, while the effect of the motors was found; needed with `per_motor`.
        compass: number of the compass on the vehicle, from 1, for targets with several, without `autopilot`.
        gyroscope_axes: `Recording.gyroscope_axes`; the gyroscope's values are turned back into its own axes.
        autopilot: `Recording.autopilot`; the parameters are those of its sensors, in the axes of its firmware.

    Raises:
        MagycError: the target is unknown or cannot represent the calibration, the axes are no axes, or the log is of
            another autopilot or does not say which of the parameters are those of the sensors.
    """
    if target not in TARGETS:
        raise MagycError(f"unknown export target {target!r}; there are {', '.join(TARGETS)}")
    places = places_of(autopilot, target, compass)
    after = afterwards(
        np.asarray(soft_iron, dtype=np.float64),
        np.asarray(hard_iron, dtype=np.float64),
        None if gyro_bias is None else np.asarray(gyro_bias, dtype=np.float64),
        terms,
    )
    bare = Correction(
        np.asarray(np.linalg.inv(after.soft_iron), dtype=np.float64),
        after.hard_iron,
        after.gyro_bias,
        parse_axes(gyroscope_axes),
    )
    correction, missing = with_terms(
        bare, after.terms, target, per_motor, battery_voltage, _of_target(autopilot, target)
    )
    placed, left_out = in_places(correction, *places)
    lines = numbered(TARGETS[target](placed), target, *places)
    lines += cleared(lines, target, places[0], autopilot)
    missing += ["motor-current"] if correction.motor is not None and target not in _WITH_MOTOR else []
    if target not in _WITH_TEMPERATURE:
        missing += ["temperature-hard-iron"] if correction.thermal is not None else []
        missing += ["temperature-gyro"] if correction.warming_gyro is not None else []
    first = [OF_THE_FIRST[target]] if autopilot is None and compass == 1 and target in OF_THE_FIRST else []
    remarks = [
        *_limits(missing, [term.name for term in after.jumps]),
        *left_out,
        *_in_own_axes(placed),
        *first,
    ]
    return "\n".join([*remarks, *lines]) + "\n"


def _of_target(autopilot: Autopilot | None, target: str) -> Autopilot | None:
    return autopilot if autopilot is not None and autopilot.firmware == target else None


def _in_own_axes(correction: Correction) -> list[str]:
    """Return a comment on the axes of the gyroscope's values, if they are others of the magnetometer's."""
    axes = axes_text(correction.gyro_axes)
    oblique = not np.allclose(np.abs(correction.gyro_axes).max(axis=1), 1.0)
    if correction.gyro_bias is None or axes == OWN_AXES or oblique:
        return []
    return [f"# Gyroscope values are in its own axes, of which {axes} lie along the magnetometer's x, y, z."]


def _limits(missing: Sequence[str], jumps: Sequence[str]) -> list[str]:
    """Return comments on the effects that an export lacks, and on those whose end state it has."""
    limits = []
    if missing:
        limits.append(f"not included: {_each(missing)}. Only `magyc-gtsam apply` corrects it.")
    if jumps:
        limits.append(
            f"the values are those after {_each(jumps)}, at the end of the log. "
            "Only `magyc-gtsam apply` corrects that log before it."
        )
    return [f"# LIMIT: {limit}" for limit in limits]


def _each(names: Sequence[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def exported(
    calibration: Any, target: str, force: bool, per_motor: bool, battery_voltage: float | None = None
) -> str:
    """Return the text for a `Calibration`; `Calibration.export` describes it."""
    if not calibration.trusted:
        reason = calibration.message or "not observable"
        if not force:
            raise MagycError(
                f"the result must not be trusted, so nothing is exported: {reason}; "
                "record again, or see the values as comments (force=True)"
            )
        trusted = replace(calibration, converged=True, observability=None)
        return do_not_use(reason, exported(trusted, target, False, per_motor, battery_voltage))
    if calibration.configuration.get("calibrated_before"):
        raise MagycError(f"nothing for {target}: {ONLY_THE_REST}")
    if calibration.magnetic_field_unit == "counts":
        raise MagycError("a calibration in raw counts cannot be exported; calibrate in tesla")
    known = calibration.configuration.get("autopilot")
    return export(
        target,
        calibration.soft_iron,
        calibration.hard_iron,
        calibration.gyro_bias,
        calibration.terms,
        per_motor=per_motor,
        battery_voltage=battery_voltage,
        compass=calibration.configuration.get("compass", 1),
        gyroscope_axes=calibration.configuration.get("gyroscope_axes", OWN_AXES),
        autopilot=None if known is None else Autopilot.from_dict(known),
    )


def do_not_use(reason: str, text: str) -> str:
    """Return an exported text as comments, which no target reads, under DO NOT USE and the reason."""
    lines = [f"DO NOT USE: {' '.join(reason.split())}", *text.splitlines()]
    return "".join(f"# {line}\n" for line in lines)
