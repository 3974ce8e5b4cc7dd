"""Correction of measured fields and rates for the terms of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from magyc_gtsam.factors.chain.gyroscope_track import GyroscopeTrack
from magyc_gtsam.factors.chain.rotations import Array, cross, exponential_matrices
from magyc_gtsam.factors.chain.turning import aligned
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.effects.turning import Turning

_PASSES = 20  # largest number of Newton steps; most inputs need three
_TOLERANCE = 1e-12  # T and rad/s, largest residual of a solution
_SLOPE_STEP = 1e-8  # T and rad/s, step of the numerical derivative
_DRIFTS = 20.0  # s, in which the integrated world hardly drifts, and the field's noise is averaged to 0.1°
_LEAST_SLOPE = 0.2  # smallest slope of the reading that can be inverted without amplifying noise too much


def corrected_rate(measured: Array, bias: Array, terms: Sequence[Term], signals: Signals) -> Array:
    """Return the true angular rate (3, n) in rad/s of the measured one.

    Where the axes were exchanged, `bias` is in the magnetometer's axes. The result stays in the gyroscope's axes,
    unless one of these is reversed.

    A misalignment is not corrected here but in the field, which is rotated to the gyroscope's axes.

    Raises:
        MagycError: a term needs a signal that is not available.
    """
    matrix, turn = _axis_exchange(terms)
    still = matrix @ measured - bias[:, None]
    own = [term for term in terms if term.side == "gyroscope" and term.subtracted]

    def added(rate: Array) -> Array:
        at = replace(signals, rate=rate)
        return sum((term.evaluate(at) for term in own), np.zeros_like(rate))

    return turn.T @ (_inverted(still, added) if own else still)


def _inverted(read: Array, added: Callable[[Array], Array]) -> Array:
    """Return the x (3, n) for which x + added(x) equals `read`, by Newton steps for each axis separately.

    Terms depend on the quantity that they change and may be strongly non-linear: for a response with the cube of the
    field the plain fixed-point iteration diverges beyond some field. A step that does not reduce a sample's residual
    is halved. Where no solution exists, as beyond the maximum of a response that is not monotonic, x stays at the
    smallest residual found.
    """
    x = read
    missing = read - x - added(x)
    share = np.ones(read.shape[1])
    for _ in range(_PASSES):
        if np.abs(missing).max() < _TOLERANCE:
            break
        slope = 1 + (added(x + _SLOPE_STEP) - added(x - _SLOPE_STEP)) / (2 * _SLOPE_STEP)
        ahead = x + share * missing / np.copysign(np.maximum(np.abs(slope), _LEAST_SLOPE), slope)
        left = read - ahead - added(ahead)
        closer = np.abs(left).max(axis=0) < np.abs(missing).max(axis=0)
        x = np.where(closer, ahead, x)
        missing = left if closer.all() else read - x - added(x)  # terms with memory depend on neighbours, too
        share = np.where(closer, 1.0, 0.5 * share)
    return x


def _axis_exchange(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Return the matrix of an `axis-order` term, and the rotation from the axes of the corrected data to the
    magnetometer's.

    The matrix G gives the rate in the magnetometer's axes, G · measured rate. The axes of the corrected data are the
    gyroscope's where G is a rotation. Where G is a reflection (an axis of the gyroscope is reversed, or two are
    exchanged), the gyroscope's axes are not a right-handed frame, and corrected data are in the magnetometer's axes.
    """
    for term in terms:
        if term.name == "axis-order":
            matrix = term.value.reshape(3, 3)
            return matrix, matrix if np.linalg.det(matrix) > 0 else np.eye(3)
    return np.eye(3), np.eye(3)


def corrected_field(
    measured: Array, soft_iron: Array, hard_iron: Array, terms: Sequence[Term], signals: Signals
) -> Array:
    """Return the calibrated field (3, n) in T in the gyroscope's axes; in the magnetometer's, if one of these is
    reversed.

    Args:
        measured: (3, n) T.
        soft_iron, hard_iron: (3, 3), (3,) T.
        terms: terms of the calibration.
        signals: time, true rate, acceleration and channels, as far as they are known.

    Raises:
        MagycError: a term needs a signal that is not available.
    """
    inverse = np.linalg.inv(soft_iron)
    _, turn = _axis_exchange(terms)
    if signals.rate is not None:
        signals = replace(signals, rate=turn @ signals.rate)
    own = [term for term in terms if term.side == "magnetometer" and term.subtracted]
    needed = {name for term in own for name in FORMS[term.name].needs}
    signals = replace(signals, soft_iron=soft_iron)
    if "to_sensor" in needed:
        signals = replace(signals, to_sensor=_to_sensor(signals))
    late = lag_of(terms)
    if late and any(FORMS[term.name].exact for term in own):  # the turns are those before the field was read
        signals = replace(signals, turning=Turning(signals.time, signals.need("rate"), signals.time - late))

    def added(iron: Array) -> Array:
        at = replace(signals, field=iron, hard_iron=hard_iron)
        if "field_rate" in needed:
            at = replace(at, field_rate=soft_iron @ -cross(signals.need("rate"), inverse @ iron))
        return sum((term.evaluate(at) for term in own), np.zeros_like(iron))

    iron = measured - hard_iron[:, None]
    field = inverse @ (_inverted(iron, added) if own else iron)
    if "to_sensor" in needed:
        signals = replace(signals, to_sensor=_without_drift(signals, field))
        field = inverse @ _inverted(iron, added)
    for term in terms:
        if term.name == "misalignment":
            field = exponential_matrices(term.value[:, None])[:, :, 0] @ field
    return turn.T @ field


def lag_of(terms: Sequence[Term]) -> float:
    """Return by how much the magnetometer lags the gyroscope by the terms of a calibration, s."""
    return sum(float(term.value[0]) for term in terms if term.name == "timing")


def _without_drift(signals: Signals, field: Array) -> Array:
    """Return the rotation (3, 3, n) to the sensor from the world in which the field (3, n) has one direction.

    The gyroscope's noise turns the integrated world within minutes by what the field shows of it.
    """
    to_sensor, time = signals.need("to_sensor"), signals.time
    rows = max(1, round(_DRIFTS * (len(time) - 1) / max(float(time[-1] - time[0]), 1e-9)))
    direction = uniform_filter1d(np.einsum("ijn,in->jn", to_sensor, field), rows, axis=1, mode="nearest")
    still = np.ones(len(time), complex), np.zeros(len(time), complex)
    return np.einsum("ijn,kjn->ikn", to_sensor, aligned(still, direction))


def _to_sensor(signals: Signals) -> Array:
    """Return the rotation (3, 3, n) from the integrated world to the sensor, with the identity at the first sample."""
    track = GyroscopeTrack.integrate(signals.time, signals.need("rate").T)
    return np.swapaxes(track.matrices.reshape(3, 3, -1), 0, 1)
