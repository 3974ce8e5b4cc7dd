"""Taking the terms of a calibration out of what the sensors read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.rotations import Array, cross, exponential_matrices
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.factors.effects.term import Term

_PASSES = 20  # most need three; where next to nothing of a change is read, the last digits are lost anyway
_CLOSE = 1e-12  # T and rad/s
_NEARBY = 1e-8  # T and rad/s
_LOST = 0.2  # of a change in what is read, below which it is not to be had back from the noise


def corrected_rate(measured: Array, bias: Array, terms: Sequence[Term], signals: Signals) -> Array:
    """True angular rate (3, n) rad/s of the measured one; where the axes were exchanged, `bias` is in the
    magnetometer's axes and the rate stays in the gyroscope's, unless one of these is reversed.

    A misalignment stays: it is taken out of the field, which is brought to the gyroscope's axes.

    Raises:
        MagycError: a term needs a signal that is not there.
    """
    matrix, turn = _exchanged(terms)
    still = matrix @ measured - bias[:, None]
    own = [term for term in terms if term.side == "gyroscope" and term.name != "misalignment"]

    def added(rate: Array) -> Array:
        at = replace(signals, rate=rate)
        return sum((term.evaluate(at) for term in own), np.zeros_like(rate))

    return turn.T @ (_straightened(still, added) if own else still)


def _straightened(read: Array, added: Callable[[Array], Array]) -> Array:
    """The x (3, n) of which x + added(x) was read: Newton's steps, each axis by itself.

    Terms read what they change, and may bend it much: the plain iteration of a response that grows with the cube of
    the field runs away from some field on. A step that brings a sample no closer is halved, so that where nothing
    reads so, as beyond the top of a response that turns round, x stays where it comes closest.
    """
    x = read
    missing = read - x - added(x)
    share = np.ones(read.shape[1])
    for _ in range(_PASSES):
        if np.abs(missing).max() < _CLOSE:
            break
        slope = 1 + (added(x + _NEARBY) - added(x - _NEARBY)) / (2 * _NEARBY)
        ahead = x + share * missing / np.copysign(np.maximum(np.abs(slope), _LOST), slope)
        left = read - ahead - added(ahead)
        closer = np.abs(left).max(axis=0) < np.abs(missing).max(axis=0)
        x = np.where(closer, ahead, x)
        missing = left if closer.all() else read - x - added(x)  # what remembers reads its neighbours, too
        share = np.where(closer, 1.0, 0.5 * share)
    return x


def _exchanged(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Of an `axis-order` term the matrix G (rate in the magnetometer's axes = G · rate read), and the rotation to the
    magnetometer's axes from those of what is returned.

    These are the gyroscope's where G is a rotation. Where it mirrors, one of the gyroscope's axes is reversed or two
    are exchanged, and its axes are no frame: what is returned is in the magnetometer's.
    """
    for term in terms:
        if term.name == "axis-order":
            matrix = term.value.reshape(3, 3)
            return matrix, matrix if np.linalg.det(matrix) > 0 else np.eye(3)
    return np.eye(3), np.eye(3)


def corrected_field(
    measured: Array, soft_iron: Array, hard_iron: Array, terms: Sequence[Term], signals: Signals
) -> Array:
    """Calibrated field (3, n) T in the gyroscope's axes; in the magnetometer's, if one of these is reversed.

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

    def added(iron: Array) -> Array:
        at = replace(signals, field=iron, hard_iron=hard_iron)
        if "field_rate" in needed:
            at = replace(at, field_rate=soft_iron @ -cross(signals.need("rate"), inverse @ iron))
        return sum((term.evaluate(at) for term in own), np.zeros_like(iron))

    iron = measured - hard_iron[:, None]
    field = inverse @ (_straightened(iron, added) if own else iron)
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
    track = GyroscopeTrack.integrate(signals.time, signals.need("rate").T)
    return np.swapaxes(track.matrices.reshape(3, 3, -1), 0, 1)
