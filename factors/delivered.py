"""A Python factor together with the quadratic that replaces it in a graph."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import gtsam
import numpy as np
from scipy.linalg import lapack

from magyc_gtsam.factors.alignment import rotation_of
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import check_kind, factor_details
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array, key_name

_HOLDING = (gtsam.PriorFactorRot3, gtsam.PriorFactorDouble, gtsam.PriorFactorPoint3)
# Fraction of the tolerance that applies at the first check of a quadratic, when renewing it costs least. With 1
# instead, the checks on 25 blocks of `benchmarks/slam_cost.py --motion wide` need 62 linearisations; with 0.1 they
# need 36.
_FIRST_CHECK = 0.1


@dataclass(frozen=True, eq=False)
class _CheckedPoint:
    """The point at which a quadratic was linearised or last found fresh.

    Attributes:
        rotation, soft_iron, bias: (3, 3), (6,), (3,) rad/s, attitude, soft iron and bias at that point.
        shift: staleness there, in standard deviations.
        angle, iron: rad and 1, upper bounds of the distances in attitude (including the rotation of the samples by
            the bias) and in soft iron from the linearisation point.
    """

    rotation: Array
    soft_iron: Array
    bias: Array
    shift: float = 0.0
    angle: float = 0.0
    iron: float = 0.0

    def moved(self, point: gtsam.Values, details: BlockDetails) -> tuple[float, float]:
        """Return the distances of `point` in attitude (rad, including the rotation of the samples by the bias) and in
        soft iron.
        """
        turned = rotation_of(point, details.attitude_key) - self.rotation
        soft_iron = point.atVector(details.soft_iron_key) - self.soft_iron
        angle = math.sqrt(0.5 * float(np.vdot(turned, turned)))
        angle += details.lever * math.dist(details.bias_at(point), self.bias)
        return angle, math.sqrt(float(np.vdot(soft_iron, soft_iron)))


@dataclass(frozen=True, eq=False)
class _MountingPart:
    """The Jacobian M of a held mounting in a linearisation [J M −r].

    Attributes:
        point: linearisation point.
        crossed, square, gradient: (p, 3) JᵀM, (3, 3) MᵀM, (3,) −Mᵀr.
    """

    point: gtsam.Values
    crossed: Array
    square: Array
    gradient: Array

    def joined(self, plain: Array, keys: list[int], point: gtsam.Values) -> Array:
        """Return the products (p + 4, p + 4) of the columns of [J M −r] from those (p + 1, p + 1) of [J −r] at
        `point`.
        """
        moved = self.point.localCoordinates(point)
        step = np.concatenate([moved.at(key) for key in keys])
        gradient = self.gradient - self.crossed.T @ step
        p = len(step)
        result = np.empty((p + 4, p + 4))
        result[:p, :p], result[:p, -1], result[-1, :p] = plain[:p, :p], plain[:p, -1], plain[-1, :p]
        result[:p, p : p + 3], result[p : p + 3, :p] = self.crossed, self.crossed.T
        result[-1, -1] = plain[-1, -1]
        result[p : p + 3, p : p + 3] = self.square
        result[p : p + 3, -1] = result[-1, p : p + 3] = gradient
        return result


@dataclass(eq=False)
class Delivered:
    """A Python factor, the quadratic that replaces it, and the quadratic's slot in the solver's graph."""

    factor: gtsam.NonlinearFactor
    details: BlockDetails | None
    native: gtsam.NonlinearFactor
    slot: int = -1
    place: _CheckedPoint | None = None  # where it was linearised or last checked
    beside: _MountingPart | None = None  # part of the held mounting in `native`
    looked_at: bool = False  # whether it has been checked since it entered

    @property
    def is_block(self) -> bool:
        """Whether the factor is a block of samples on an attitude, which the coarse alignment can use."""
        return self.details is not None and not self.details.on_direction

    def within(self, spans: Sequence[tuple[float, float]]) -> bool:
        """Whether the factor is a block of samples inside one of these spans, (first, last) in s."""
        return self.details is not None and any(first <= self.details.block.time < last for first, last in spans)

    def make(self, view: View) -> None:
        """Linearise the factor at the present estimate."""
        point = view.values(self.factor.keys())
        self._make(self.factor.linearize(point), point)
        self.place = _checked_point(self.details, point)

    def _make(self, linear: gtsam.GaussianFactor, point: gtsam.Values) -> None:
        self.native = _quadratic(linear, point)
        self.beside = None if self.details is None else _mounting_part(linear, point, self.details)

    def products(self, point: gtsam.Values) -> tuple[Array, Array | None]:
        """Return the products of the columns of [J −r] of the native factor, and of [J M −r] where a mounting is
        held.
        """
        linear = self.native.linearize(point)
        plain: Array = linear.augmentedInformation()
        if self.details is None:
            return plain, None
        beside = _mounting_part(linear, point, self.details) if self.native is self.factor else self.beside
        return plain, None if beside is None else beside.joined(plain, self.factor.keys(), point)

    def renew(self, view: View, tolerance: float) -> float:
        """Renew the quadratic if its gradient is stale by more than `tolerance` standard deviations; return the
        staleness.

        At the first check, in the update after its own, a tenth of `tolerance` applies: a quadratic linearised where
        the graph has settled comes close to the tolerance less often later, and so needs fewer linearisations that
        only find it fresh.
        """
        point = view.values(self.factor.keys())
        place, details = self.place, self.details
        if not self.looked_at:
            self.looked_at, tolerance = True, _FIRST_CHECK * tolerance
        angle = iron = 0.0
        if place is not None and details is not None and details.width == 1.0:
            # The residual is linear in soft iron, in attitude (to first order) and in bias, each by itself. The error
            # of the quadratic is therefore of second order in the distance from its linearisation point, and so is
            # its growth since the last check.
            angle, iron = place.moved(point, details)
            lost = (
                angle * (place.angle + 0.5 * angle + place.iron + iron) + iron * place.angle
            )  # relative to the field
            # The samples' noise acts through Jacobians that changed by the same amount; two standard deviations
            # count.
            shift = place.shift + lost * details.field_over_noise + 2 * (angle + iron)
            if shift < tolerance:
                return shift
        exact = self.factor.linearize(point)
        shift = _staleness(exact, self.native.linearize(point))
        self.place = _checked_point(details, point)
        if shift > tolerance:
            self._make(exact, point)
        elif place is not None and self.place is not None:
            self.place = replace(self.place, shift=shift, angle=place.angle + angle, iron=place.iron + iron)
        return shift

    def lag(self, view: View) -> float:
        """Return how many standard deviations the solver's own linearisation of the Python factor is stale."""
        keys = self.factor.keys()
        point, before = view.values(keys), view.linearized(keys)
        stale = gtsam.LinearContainerFactor(self.factor.linearize(before), before)
        return _staleness(self.factor.linearize(point), stale.linearize(point))


def native_factor(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.LinearContainerFactor:
    """Return the factor's quadratic at `point`, which must hold its keys: native, picklable and free of Python.

    For a `field_chain_factor` at its solution this is the marginal of the whole log, a prior for the next mission.

    Raises:
        MagycError: no factor, no values or not all of its keys in them, or as the factor itself.
    """
    check_kind("native factor: `factor`", factor, gtsam.NonlinearFactor, "a factor of GTSAM or of this package")
    check_kind("native factor: `point`", point, gtsam.Values, "the gtsam.Values at which to linearise")
    keys: list[int] = factor.keys()
    if missing := [key_name(key) for key in keys if not point.exists(key)]:
        raise MagycError(f"native factor: no value for {', '.join(missing)}; insert one before")
    return _quadratic(factor.linearize(point), point)


class Sorted(NamedTuple):
    """The factors of a graph, sorted by their treatment.

    Attributes:
        others: all other factors; the graph itself where it has no Python factor of this package.
        fresh: the Python factors of this package.
        holding: the priors among `others` that may hold a mounting, a delay or a field.
    """

    others: gtsam.NonlinearFactorGraph
    fresh: list[Delivered]
    holding: list[gtsam.NonlinearFactor]

    @property
    def keys(self) -> list[int]:
        """The keys of all factors."""
        found = list(self.others.keyVector())
        for each in self.fresh:
            found += each.factor.keys()
        return found


def sorted_factors(graph: gtsam.NonlinearFactorGraph) -> Sorted:
    """Sort the factors of a graph, leaving the graph unchanged."""
    fresh: list[Delivered] = []
    holding: list[gtsam.NonlinearFactor] = []
    own: list[int] = []
    for i in range(graph.size()):
        factor = graph.at(i)
        kind = type(factor)
        if kind is gtsam.CustomFactor:
            details = factor_details(factor)
            if details is not None:
                own.append(i)
                fresh.append(Delivered(factor, details if isinstance(details, BlockDetails) else None, factor))
        elif kind in _HOLDING:
            holding.append(factor)
    if not fresh:
        return Sorted(graph, fresh, holding)
    others = gtsam.NonlinearFactorGraph()
    for i in range(graph.size()):
        if i not in own and graph.exists(i):
            others.push_back(graph.at(i))
    return Sorted(others, fresh, holding)


def _checked_point(details: BlockDetails | None, point: gtsam.Values) -> _CheckedPoint | None:
    """Return attitude, soft iron and bias of a block, or None where its residual depends on more than these and hard
    iron.
    """
    if details is None or details.field is None or details.on_direction or details.more_keys:
        return None
    attitude, soft_iron = rotation_of(point, details.attitude_key), point.atVector(details.soft_iron_key)
    return _CheckedPoint(attitude, soft_iron, details.bias_at(point))


def _quadratic(linear: gtsam.GaussianFactor, point: gtsam.Values) -> gtsam.LinearContainerFactor:
    """Return the quadratic of a factor linearised at `point`: at most one row per column of its keys and one for the
    constant.

    By QR, which exists for every Jacobian. The information of a block is always singular and by rounding often
    indefinite, so that GTSAM's `JacobianFactor(HessianFactor(linear))` may find no square root of it.
    """
    if isinstance(linear, gtsam.JacobianFactor) and not linear.isConstrained():
        rows = linear.augmentedJacobian()
        count = rows.shape[1]
        if len(rows) > count:
            root = lapack.dgeqrf(rows, overwrite_a=True)[0][:count] * _upper(count)
            keys, dimensions = linear.keys(), point.dims()
            split = gtsam.VerticalBlockMatrix([dimensions[key] for key in keys], root, True)
            linear = gtsam.GaussianConditional(keys, 0, split)  # the container stores it as a JacobianFactor
    return gtsam.LinearContainerFactor(linear, point)


@cache
def _upper(count: int) -> Array:
    """Return the mask of the upper triangle of a (count, count) matrix; `np.triu` takes as long as the QR."""
    return np.triu(np.ones((count, count)))


def _mounting_part(
    linear: gtsam.GaussianFactor, point: gtsam.Values, details: BlockDetails
) -> _MountingPart | None:
    """Return the mounting's part of a block that has just been linearised; None where no mounting is held."""
    turned = details.on_mounting
    if turned is None:
        return None
    jacobian, right = linear.jacobian()
    return _MountingPart(
        point.extract(list(linear.keys())), jacobian.T @ turned, turned.T @ turned, turned.T @ right
    )


def _staleness(exact: gtsam.GaussianFactor, stale: gtsam.GaussianFactor) -> float:
    """Return the largest difference of two gradients, in standard deviations of a variable given the factor alone."""
    first, second = exact.augmentedInformation(), stale.augmentedInformation()
    information: Array = np.diag(first)[:-1]
    difference = np.abs(first[:-1, -1] - second[:-1, -1])[information > 0]
    return float((difference / np.sqrt(information[information > 0])).max())
