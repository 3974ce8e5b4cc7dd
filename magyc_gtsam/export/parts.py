"""Assignment of a calibration's terms to what a target can represent: mounting, motor current and temperature."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.export.ardupilot import motors_of
from magyc_gtsam.export.correction import Array
from magyc_gtsam.factors.effects.corrections import corrected_field
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.factors.effects.term import Term

_ROTATIONS = ("misalignment", "axis-order")  # terms that turn the field to the gyroscope's axes


class Parts(NamedTuple):
    """The arguments of `export` that depend on the terms."""

    hard_iron: Array
    gyro_bias: Array | None
    terms: Sequence[str]
    rotation: Array | None
    motor: Array | None
    motors: Array | None
    thermal: Array | None
    reference: float
    warming_gyro: Array | None
    gyro_reference: float


def parts_of(
    terms: Sequence[Term], hard_iron: Array, gyro_bias: Array | None, target: str, per_motor: bool
) -> Parts:
    """Assign each term to the parameter that a target has for it.

    Args:
        terms: of the calibration.
        hard_iron: (3,) T.
        gyro_bias: (3,) rad/s, or None.
        target: "px4", "ardupilot", "vectornav" or "ros".
        per_motor: the channels of current are outputs of motors, each with separate compensation.
    """
    missing: list[str] = []
    motor, motors, thermal, reference = None, None, None, 0.0
    warming_gyro, gyro_reference = None, 0.0
    in_its_axes = all(term.name != "axis-order" for term in terms)
    for term in terms:
        exchanged = term.name == "axis-order"
        if exchanged and gyro_bias is not None:
            gyro_bias = term.value.reshape(3, 3).T @ gyro_bias  # from the magnetometer's axes to the gyroscope's
        if term.name == "motor-current" and per_motor and motors is None and target == "ardupilot":
            motors, at_rest = motors_of(term.value, term.setting)
            hard_iron = hard_iron - at_rest
        elif term.name == "motor-current" and len(term.value) == 3 and not per_motor and motor is None:
            motor = term.value
            reference_current = sum(term.setting.values())  # at most one: the term has one channel
            hard_iron = hard_iron - motor * reference_current
        elif term.name == "temperature-hard-iron" and len(term.value) == 3 and not term.setting.get("lag"):
            thermal, reference = term.value, term.setting.get("reference_0", 0.0)
        elif (
            term.name == "temperature-gyro"
            and len(term.value) == 3
            and not term.setting.get("lag")
            and in_its_axes
        ):
            warming_gyro, gyro_reference = term.value, term.setting.get("reference_0", 0.0)
        elif (exchanged and np.linalg.det(term.value.reshape(3, 3)) < 0) or (
            term.side is not None and term.name != "misalignment"
        ):  # a term without a side that is not an exchange of axes concerns only the noise
            missing.append(term.name)
    rotations = [term for term in terms if term.name in _ROTATIONS]
    rotation = None
    if rotations:
        rotation = corrected_field(np.eye(3), np.eye(3), np.zeros(3), rotations, Signals(np.zeros(3)))
    return Parts(
        hard_iron,
        gyro_bias,
        missing,
        rotation,
        motor,
        motors,
        thermal,
        reference,
        warming_gyro,
        gyro_reference,
    )
