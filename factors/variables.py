"""Readers of a factor's keys: each accepted type as a vector, with the derivative on its tangent space.

Every reader returns a value as a plain vector and, where the key's own tangent space differs, the derivative
(len(value), dimension) of the vector on it; otherwise None.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from types import MappingProxyType

import gtsam
import numpy as np
from numpy.typing import NDArray

from magyc_gtsam.factors.chain.rotations import skew
from magyc_gtsam.factors.errors import MagycError

Array = NDArray[np.float64]
Reader = Callable[[gtsam.Values, int], tuple[Array, Array | None]]
Variable = Mapping[str, Reader]
"""The types that a key may hold, {name: reader}."""

_GYROSCOPE_PART = np.hstack([np.zeros((3, 3)), np.eye(3)])  # order in a ConstantBias: accelerometer, gyroscope
_GYROSCOPE_PART.flags.writeable = False
_TURNS = skew(np.eye(3))
_STORED = re.compile(r"GenericValue<(.*)> but requested")


def vector(size: int) -> Variable:
    """Return the variable of a vector of `size` numbers; where `size` is 3 the key may also hold a `Point3`."""

    def read(values: gtsam.Values, key: int) -> tuple[Array, None]:
        value = values.atPoint3(key) if size == 3 else values.atVector(key)
        if value.shape != (size,):
            raise MagycError(f"{key_name(key)} holds {value.size} numbers, {size} are expected")
        return value, None

    return MappingProxyType({"Point3 or 3-vector" if size == 3 else f"{size}-vector": read})


def _at_unit(values: gtsam.Values, key: int) -> tuple[Array, Array]:
    unit = values.atUnit3(key)
    return unit.point3(), unit.basis()


def _at_rotation(rotation: Array, first: int, columns: int) -> tuple[Array, Array]:
    """Return R row by row (9,), and its derivative where the rotation is in the tangent space's columns `first` to
    first + 2.
    """
    tangent = np.zeros((9, columns))  # R Exp(φ) = R + R [φ]×, in the body frame as GTSAM has it
    tangent[:, first : first + 3] = (rotation @ _TURNS).reshape(3, 9).T
    return rotation.ravel(), tangent


def _at_heading(angle: float, column: int, columns: int) -> tuple[Array, Array]:
    rotation = gtsam.Rot3.Yaw(angle).matrix()
    tangent = np.zeros((9, columns))
    tangent[:, column] = (rotation @ _TURNS[2]).ravel()
    return rotation.ravel(), tangent


def _at_angles(rotation: gtsam.Rot3) -> tuple[Array, Array]:
    # Log(R Exp(φ)) = Log(R) + J⁻¹ φ, J the right Jacobian of SO(3) at Log(R).
    angles = gtsam.Rot3.Logmap(rotation)
    return -angles, -np.linalg.inv(gtsam.Rot3.ExpmapDerivative(angles)).astype(np.float64)


direction: Variable = MappingProxyType({"Unit3": _at_unit})
"""A direction, read as a unit vector (3,)."""

gyro_bias: Variable = MappingProxyType(
    {
        "ConstantBias": lambda values, key: (values.atConstantBias(key).gyroscope(), _GYROSCOPE_PART),
        "Point3 or 3-vector": lambda values, key: (values.atPoint3(key), None),
    }
)
"""The gyroscope bias (3,) rad/s."""

attitude: Variable = MappingProxyType(
    {
        "Pose3": lambda values, key: _at_rotation(values.atPose3(key).rotation().matrix(), 0, 6),
        "Rot3": lambda values, key: _at_rotation(values.atRot3(key).matrix(), 0, 3),
        "NavState": lambda values, key: _at_rotation(values.atNavState(key).attitude().matrix(), 0, 9),
        "Pose2": lambda values, key: _at_heading(values.atPose2(key).theta(), 2, 3),
        "Rot2": lambda values, key: _at_heading(values.atRot2(key).theta(), 0, 1),
    }
)
"""The attitude body→world, read as the rotation matrix row by row (9,)."""

mounting: Variable = MappingProxyType({"Rot3": attitude["Rot3"]})
"""The rotation sensor→body, read as the matrix row by row (9,)."""

skew_angles: Variable = MappingProxyType({"Rot3": lambda values, key: _at_angles(values.atRot3(key))})
"""The rotation sensor→body ᵇRₛ, read as the angles ε (3,) rad of its inverse: Exp(ε) = ᵇRₛᵀ. Below 180°."""

scalar: Variable = MappingProxyType(
    {
        "double": lambda values, key: (np.array([values.atDouble(key)]), None),
        "1-vector": vector(1)["1-vector"],
    }
)
"""A number, read as (1,)."""


def rotated(variable: Variable, rotation: Array) -> Variable:
    """Return the variable of a vector (3,) that is read as `rotation` (3, 3) times what its key holds."""

    def rotating(read: Reader) -> Reader:
        def read_rotated(values: gtsam.Values, key: int) -> tuple[Array, Array]:
            value, tangent = read(values, key)
            return rotation @ value, rotation if tangent is None else rotation @ tangent

        return read_rotated

    return MappingProxyType({name: rotating(read) for name, read in variable.items()})


def choose(name: str, variable: Variable, values: gtsam.Values, key: int) -> Reader:
    """Return the reader of the type that the key holds.

    Raises:
        MagycError: the key has no value, or one of a type that the variable does not accept.
    """
    if not values.exists(key):
        raise MagycError(f"{name}: {key_name(key)} has no value; insert one before the factor is evaluated")
    problem = ""
    for read in variable.values():
        try:
            read(values, key)
        except RuntimeError as refused:
            problem = str(refused)
        else:
            return read
    raise MagycError(f"{name}: {key_name(key)} holds a {_stored(problem)}; accepted: {', '.join(variable)}")


def stored_type(variable: Variable, values: gtsam.Values, key: int) -> str:
    """Return the type that a key holds; an empty text for one that the variable does not accept."""
    for name, read in variable.items():
        try:
            read(values, key)
        except RuntimeError:
            continue
        return name
    return ""


def reader(name: str, variable: Variable, key: int) -> Callable[[gtsam.Values], tuple[Array, Array | None]]:
    """Return the reader of one key of a factor, which looks up the type that the key holds once.

    Raises:
        MagycError: when it is called, as `choose`.
    """
    chosen: Reader | None = None

    def read(values: gtsam.Values) -> tuple[Array, Array | None]:
        nonlocal chosen
        if chosen is not None:
            try:
                return chosen(values, key)
            except RuntimeError:  # the same factor in another graph, where the key holds another type
                pass
        chosen = choose(name, variable, values, key)
        return chosen(values, key)

    return read


def key_name(key: int) -> str:
    """Return a key as GTSAM prints it."""
    return str(gtsam.DefaultKeyFormatter(key))


def _stored(problem: str) -> str:
    """Return the stored type according to GTSAM's error message."""
    found = _STORED.search(problem)
    if found is None:
        return "value of another type"
    text = found[1].replace("gtsam::", "")
    if text.startswith("Eigen::Matrix"):
        return "Point3" if "double, 3, 1" in text else "vector" if "-1, 1" in text else "matrix"
    return text
