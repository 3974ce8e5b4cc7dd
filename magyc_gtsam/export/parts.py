"""Assignment of a calibration's terms to what a target can represent: mounting, motor current and temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from magyc_gtsam.export.ardupilot import motors_of
from magyc_gtsam.export.correction import Correction, degrees
from magyc_gtsam.export.power import power_of
from magyc_gtsam.factors.effects.changes import referenced
from magyc_gtsam.factors.effects.corrections import corrected_field
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.foreign_text import shortened
from magyc_gtsam.recording.autopilot import Autopilot

_SMALLEST_ROTATION = 1e-6  # rad; less is rounding
_THERMAL = {"temperature-hard-iron": "magnetometer", "temperature-gyro": "gyroscope"}  # the sensor concerned
_ROTATIONS = ("misalignment", "axis-order")  # terms that turn the field to the gyroscope's axes


def _not_own(term: Term, autopilot: Autopilot | None) -> str:
    """Return why a target's correction, which follows the sensor's own thermometer, is none of a term; "" if it is."""
    if autopilot is None or not term.channels:
        return ""
    channel, sensor = term.channels[referenced(term.channels, term.setting)[0]], _THERMAL[term.name]
    own = autopilot.thermometers.get(channel) == sensor
    return "" if own else f"{shortened(channel)} is not the {sensor}'s own thermometer"


def with_terms(
    bare: Correction,
    terms: Sequence[Term],
    target: str,
    per_motor: bool,
    voltage: float | None = None,
    autopilot: Autopilot | None = None,
) -> tuple[Correction, list[str]]:
    """Return a correction with each term in the parameter that a target has for it, and the names of the others.

    Args:
        bare: matrix, offset and gyroscope bias of the calibration, the bias in the magnetometer's axes; that of the
            result, and its change with temperature, are in the gyroscope's own.
        terms: of the calibration.
        target: "px4", "ardupilot", "vectornav" or "ros".
        per_motor: the channels of current are outputs of motors, each with separate compensation.
        voltage: V, of the battery, for compensation per motor.
        autopilot: of the log, if it is the target's.

    Raises:
        MagycError: the effect of the motors cannot be compensated for each, or there is none.
    """
    missing: list[str] = []
    found: dict[str, Any] = {}
    offset, own_axes = bare.offset, bare.gyro_axes
    for term in terms:
        exchanged = term.name == "axis-order"
        at_once = not term.setting.get("lag")  # no target corrects what follows its channel late
        steady = len(term.value) == 3 and at_once
        motor = term.name == "motor-current" and at_once
        if exchanged:
            own_axes = term.value.reshape(3, 3) @ own_axes
        if motor and per_motor and "motors" not in found and target == "ardupilot":
            found["motors"], at_rest = motors_of(term, voltage)
            offset = offset - at_rest
        elif motor and steady and not per_motor and "motor" not in found:
            power = power_of(term, autopilot)
            if isinstance(power, str):
                missing.append(f"{term.name} ({power})")
                continue
            found |= {"motor": term.value * power.unit, "power": power}
            offset = offset - term.value * sum(term.setting.values())  # at most one reference: it has one channel
        elif term.name in _THERMAL and steady and (why := _not_own(term, autopilot)):
            missing.append(f"{term.name} ({why})")
        elif term.name == "temperature-hard-iron" and steady:
            found |= {"thermal": term.value, "reference": term.setting.get("reference_0", 0.0)}
        elif term.name == "temperature-gyro" and steady:
            found |= {"warming_gyro": term.value, "gyro_reference": term.setting.get("reference_0", 0.0)}
        elif (exchanged and np.linalg.det(term.value.reshape(3, 3)) < 0) or (
            term.side is not None and term.name != "misalignment"
        ):  # a term without a side that is not an exchange of axes concerns only the noise
            missing.append(term.name)
    if per_motor and target == "ardupilot" and "motors" not in found:
        raise MagycError(
            "per motor: the calibration has no effect of the motors; export it without, or find the effect with the "
            "outputs of the motors as channels"
        )
    rotations = [term for term in terms if term.name in _ROTATIONS]
    if rotations:
        rotation = corrected_field(np.eye(3), np.eye(3), np.zeros(3), rotations, Signals(np.zeros(3)))
        if np.radians(degrees(rotation)) > _SMALLEST_ROTATION:
            found["rotation"] = rotation
    gyroscope = {"gyro_bias": bare.gyro_bias, "warming_gyro": found.get("warming_gyro")}
    found |= {name: value if value is None else own_axes.T @ value for name, value in gyroscope.items()}
    return replace(bare, offset=offset, gyro_axes=own_axes, **found), missing
