"""Taking the terms of a calibration out of what the sensors read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.effects import FORMS, Term
from magyc_gtsam.factors.rotations import (
    Array,
    chain,
    cross,
    exponential,
    exponential_matrices,
    increments,
    matrices,
)
from magyc_gtsam.factors.signals import Signals

_PASSES = 5  # a term reads the corrected signal, and is small: each pass gains two digits or more


def corrected_rate(measured: Array, bias: Array, terms: Sequence[Term], signals: Signals) -> Array:
    """True angular rate (3, n) rad/s of the measured one; where the axes were exchanged, `bias` is in the
    magnetometer's axes and the rate stays in the gyroscope's.

    A misalignment stays: it is taken out of the field, which is brought to the gyroscope's axes.

    Raises:
        MagycError: a term needs a signal that is not there.
    """
    sign, turn = _exchanged(terms)
    still = turn @ (sign * measured) - bias[:, None]
    own = [term for term in terms if term.side == "gyroscope" and term.name != "misalignment"]
    true = still
    for _ in range(_PASSES if own else 0):
        true = still - sum(term.evaluate(replace(signals, rate=true)) for term in own)
    return turn.T @ true


def _exchanged(terms: Sequence[Term]) -> tuple[float, Array]:
    """Of an `axis-order` term G (rate in the magnetometer's axes = G · rate read): the gyroscope's sign, and the
    proper rotation from its axes to the magnetometer's."""
    for term in terms:
        if term.name == "axis-order":
            matrix = term.value.reshape(3, 3)
            sign = float(np.sign(np.linalg.det(matrix)))
            return sign, sign * matrix
    return 1.0, np.eye(3)


def corrected_field(
    measured: Array, soft_iron: Array, hard_iron: Array, terms: Sequence[Term], signals: Signals
) -> Array:
    """Calibrated field (3, n) T in the gyroscope's axes.

    Args:
        measured: (3, n) T.
        soft_iron, hard_iron: (3, 3), (3,) T.
        terms: of the calibration.
        signals: time, true rate, acceleration and channels, as far as they are known.

    Raises:
        MagycError: a term needs a signal that is not there.
    """
    inverse = np.linalg.inv(soft_iron)
    _, turn = _exchanged(terms)
    if signals.rate is not None:
        signals = replace(signals, rate=turn @ signals.rate)
    own = [term for term in terms if term.side == "magnetometer" and term.name != "timing"]
    needed = {name for term in own for name in FORMS[term.name].needs}
    if "to_sensor" in needed:
        signals = replace(signals, to_sensor=_to_sensor(signals))
    iron = measured - hard_iron[:, None]
    for _ in range(_PASSES if own else 0):
        at = replace(signals, field=iron, hard_iron=hard_iron)
        if "field_rate" in needed:
            at = replace(at, field_rate=soft_iron @ -cross(signals.need("rate"), inverse @ iron))
        iron = measured - hard_iron[:, None] - sum(term.evaluate(at) for term in own)
    field = inverse @ iron
    for term in terms:
        if term.name == "misalignment":
            field = exponential_matrices(term.value[:, None])[:, :, 0] @ field
    return turn.T @ field


def shifted(time: Array, field: Array, terms: Sequence[Term]) -> Array:
    """The field (3, n) as it was when the gyroscope was sampled: read later by the delay of a `timing` term."""
    late = sum(float(term.value[0]) for term in terms if term.name == "timing")
    if late == 0:
        return field
    return np.stack([np.interp(time + late, time, axis) for axis in field])


def _to_sensor(signals: Signals) -> Array:
    """(3, 3, n) rotation of the integrated world into the sensor, the first row's attitude being the identity."""
    rate = signals.need("rate")
    turned = matrices(chain(exponential(increments(signals.time, rate.T)))).reshape(3, 3, -1)
    return np.swapaxes(turned, 0, 1)
