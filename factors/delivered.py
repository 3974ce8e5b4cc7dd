"""A Python factor and the quadratic that stands for it in a graph."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import gtsam
import numpy as np

from magyc_gtsam.factors.alignment import rotation_of
from magyc_gtsam.factors.guard import factor_details
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array, choose, gyro_bias

_HOLDING = (gtsam.PriorFactorRot3, gtsam.PriorFactorDouble)
# Of the tolerance, from which a quadratic is made anew at the first look, when that costs least. With 1 in its place 25
# blocks of `benchmarks/slam.py cost --motion wide` are linearised 62 times to be looked at, with this 36 times.
_AT_FIRST = 0.1


@dataclass(frozen=True, eq=False)
class _Place:
    """Where a quadratic was made, or was found fresh.

    Attributes:
        rotation, soft_iron, bias: (3, 3), (6,), (3,) rad/s, attitude, soft iron and bias there.
        shift: by how many standard deviations it was stale there.
        angle, iron: rad and 1, at least as far as this is from where the quadratic was made, the attitude with what
            the bias turns the samples by.
    """

    rotation: Array
    soft_iron: Array
    bias: Array
    shift: float = 0.0
    angle: float = 0.0
    iron: float = 0.0

    def moved(self, point: gtsam.Values, details: BlockDetails) -> tuple[float, float]:
        """How far the attitude (rad), with what the bias turns the samples by, and the soft iron are from here."""
        turned = rotation_of(point, details.attitude_key) - self.rotation
        soft_iron = point.atVector(details.soft_iron_key) - self.soft_iron
        angle = math.sqrt(0.5 * float(np.vdot(turned, turned)))
        angle += details.lever * math.dist(_bias_of(point, details), self.bias)
        return angle, math.sqrt(float(np.vdot(soft_iron, soft_iron)))


@dataclass(frozen=True, eq=False)
class _Beside:
    """A held mounting's part of a linearisation [J M −r].

    Attributes:
        point: where it was made.
        crossed, square, gradient: (p, 3) JᵀM, (3, 3) MᵀM, (3,) −Mᵀr.
    """

    point: gtsam.Values
    crossed: Array
    square: Array
    gradient: Array

    def joined(self, plain: Array, keys: list[int], point: gtsam.Values) -> Array:
        """(p + 4, p + 4) products of all columns, from (p + 1, p + 1) of [J −r] at `point`."""
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
    """A Python factor, the quadratic that stands for it, and the quadratic's slot in the solver's graph."""

    factor: gtsam.NonlinearFactor
    details: BlockDetails | None
    native: gtsam.NonlinearFactor
    slot: int = -1
    place: _Place | None = None  # where it was made, or looked at last
    beside: _Beside | None = None  # of the native one
    looked_at: bool = False  # whether it has been since it entered

    @property
    def is_block(self) -> bool:
        """Whether it is a block of samples on an attitude, which the coarse alignment understands."""
        return self.details is not None and not self.details.on_direction

    def within(self, spans: Sequence[tuple[float, float]]) -> bool:
        """Whether it is a block of samples in one of these spans, s."""
        return self.details is not None and any(first <= self.details.block.time < last for first, last in spans)

    def make(self, view: View) -> None:
        """The quadratic at the present estimate."""
        point = view.values(self.factor.keys())
        self._make(self.factor.linearize(point), point)
        self.place = _place_of(self.details, point)

    def _make(self, linear: gtsam.GaussianFactor, point: gtsam.Values) -> None:
        self.native = gtsam.LinearContainerFactor(_square_root(linear), point)
        self.beside = None if self.details is None else _beside(linear, point, self.details)

    def products(self, point: gtsam.Values) -> tuple[Array, Array | None]:
        """Products of the columns of [J −r] of the native factor, and of [J M −r] where the mounting M is held."""
        linear = self.native.linearize(point)
        plain: Array = linear.augmentedInformation()
        if self.details is None:
            return plain, None
        beside = _beside(linear, point, self.details) if self.native is self.factor else self.beside
        return plain, None if beside is None else beside.joined(plain, self.factor.keys(), point)

    def renew(self, view: View, tolerance: float) -> float:
        """Make it anew if its gradient is stale by more than `tolerance` standard deviations; by how many it was.

        At the first look, in the update after its own, a tenth of that will do: made where the graph has settled, it is
        less often near the tolerance later, when it is linearised only to be found fresh.
        """
        point = view.values(self.factor.keys())
        place, details = self.place, self.details
        if not self.looked_at:
            self.looked_at, tolerance = True, _AT_FIRST * tolerance
        angle = iron = 0.0
        if place is not None and details is not None and details.width == 1.0:
            # The residual is linear in soft iron, attitude (to first order) and bias each: what a quadratic lacks is of
            # second order in how far these are from where it was made, and so is what it lacks beyond the last look.
            angle, iron = place.moved(point, details)
            lost = angle * (place.angle + 0.5 * angle + place.iron + iron) + iron * place.angle  # of the field
            # The samples' noise acts through Jacobians that have changed by as much, twice its deviation counting.
            shift = place.shift + lost * details.field_over_noise + 2 * (angle + iron)
            if shift < tolerance:
                return shift
        exact = self.factor.linearize(point)
        shift = _shift(exact, self.native.linearize(point))
        self.place = _place_of(details, point)
        if shift > tolerance:
            self._make(exact, point)
        elif place is not None and self.place is not None:
            self.place = replace(self.place, shift=shift, angle=place.angle + angle, iron=place.iron + iron)
        return shift

    def lag(self, view: View) -> float:
        """By how many standard deviations the solver's own linearisation of the Python factor is stale."""
        keys = self.factor.keys()
        point, before = view.values(keys), view.linearized(keys)
        stale = gtsam.LinearContainerFactor(self.factor.linearize(before), before)
        return _shift(self.factor.linearize(point), stale.linearize(point))


def native_factor(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.LinearContainerFactor:
    """The factor's quadratic at `point`, which must hold its keys: native, picklable, free of Python.

    Of a `field_chain_factor` at its solution it is the whole log's marginal, a prior for the next mission.
    """
    return gtsam.LinearContainerFactor(_square_root(factor.linearize(point)), point)


class Sorted(NamedTuple):
    """The factors of a graph by what happens to them.

    Attributes:
        others: the graph itself where it has no Python factor of this package, else a new one.
        fresh: the Python factors.
        holding: priors among the others that may hold a mounting or a delay.
    """

    others: gtsam.NonlinearFactorGraph
    fresh: list[Delivered]
    holding: list[gtsam.NonlinearFactor]


def sorted_factors(graph: gtsam.NonlinearFactorGraph) -> Sorted:
    """Sort the factors of a graph, which is not changed."""
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
        if i not in own:
            others.push_back(graph.at(i))
    return Sorted(others, fresh, holding)


def _place_of(details: BlockDetails | None, point: gtsam.Values) -> _Place | None:
    """Attitude, soft iron and bias of a block whose residual these and the hard iron decide alone."""
    if details is None or details.field is None or details.on_direction or details.more_keys:
        return None
    attitude, soft_iron = rotation_of(point, details.attitude_key), point.atVector(details.soft_iron_key)
    return _Place(attitude, soft_iron, _bias_of(point, details))


def _bias_of(point: gtsam.Values, details: BlockDetails) -> Array:
    """(3,) rad/s, the bias at which a block stands."""
    key = details.gyro_bias_key
    if key is None:
        return details.block.bias
    try:
        bias: Array = point.atConstantBias(key).gyroscope()  # the usual case
        return bias
    except RuntimeError:
        return choose("bias", gyro_bias, point, key)(point, key)[0]


def _square_root(linear: gtsam.GaussianFactor) -> gtsam.JacobianFactor:
    """The same in as few rows as its keys have columns, and one for the rest."""
    return gtsam.JacobianFactor(gtsam.HessianFactor(linear))


def _beside(linear: gtsam.GaussianFactor, point: gtsam.Values, details: BlockDetails) -> _Beside | None:
    """The mounting's part of a block that has been linearised just now."""
    turned = details.on_mounting
    if turned is None:
        return None
    jacobian, right = linear.jacobian()
    return _Beside(point.extract(list(linear.keys())), jacobian.T @ turned, turned.T @ turned, turned.T @ right)


def _shift(exact: gtsam.GaussianFactor, stale: gtsam.GaussianFactor) -> float:
    """Largest difference of two gradients, in standard deviations of each variable given the factor alone."""
    first, second = exact.augmentedInformation(), stale.augmentedInformation()
    information: Array = np.diag(first)[:-1]
    difference = np.abs(first[:-1, -1] - second[:-1, -1])[information > 0]
    return float((difference / np.sqrt(information[information > 0])).max())
