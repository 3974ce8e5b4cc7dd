"""Columns of effects that follow the attitude: fields of a place on an arm, currents and loads, a mount that flexes."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.estimators.model_error.motion import WindowMotion, along_axes
from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.factors.chain.rotations import Array, by_axes
from magyc_gtsam.factors.chain.small import singular_vectors


def attitude(motion: WindowMotion) -> UnmodelledColumns:
    """Return columns linear in the attitude in world axes: a field gradient times a lever arm, rigid or a person's."""
    return motion.in_world(motion.attitude.swapaxes(0, 1).reshape(9, -1) * np.sqrt(3.0))


def tilt(motion: WindowMotion) -> UnmodelledColumns:
    """Return columns linear in the vertical, along the sensor's axes: currents and loads that follow pitch or roll.

    The 27 columns of all axes of the world gain less.
    """
    return motion.in_sensor(vertical(motion) * np.sqrt(3.0))


def flex(motion: WindowMotion) -> UnmodelledColumns:
    """Return the columns, per rad and g, of a mount that turns about each axis in proportion to the weight along each.

    The sensor turns in the field and in the iron of the vehicle.
    """
    felt = vertical(motion)
    felt -= felt.mean(axis=1, keepdims=True)
    return along_axes(felt, by_axes(motion.reading))


def vertical(motion: WindowMotion) -> Array:
    """Return (3, n) the vertical in the sensor's axes: the axis of the world whose direction in these varies least.

    A buoy that rolls faster than it spins turns most about a horizontal axis.
    """
    steady = singular_vectors(motion.attitude.mean(axis=2))[1][0]
    return np.asarray(np.einsum("ijn,j->in", motion.attitude, steady))
