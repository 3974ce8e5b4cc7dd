"""A Python factor and the quadratic that stands for it in a graph."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np

from magyc_gtsam.factors.alignment import rotation_of
from magyc_gtsam.factors.guard import factor_details
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array


@dataclass(eq=False)
class Delivered:
    """A Python factor, the quadratic that stands for it, and the quadratic's slot in the solver's graph."""

    factor: gtsam.NonlinearFactor
    details: BlockDetails | None
    native: gtsam.NonlinearFactor
    slot: int = -1
    made_at: tuple[Array, Array] | None = None  # attitude (3, 3) and calibration (9,) of the quadratic

    @property
    def is_block(self) -> bool:
        """Whether it is a block of samples on an attitude, which the coarse alignment understands."""
        return self.details is not None and not self.details.on_direction

    def make(self, view: View) -> None:
        """The quadratic at the present estimate."""
        point = view.values(self.factor.keys())
        self.native, self.made_at = native_factor(self.factor, point), _place_of(self.details, point)

    def renew(self, view: View, tolerance: float) -> float:
        """Make it anew if its gradient is stale by more than `tolerance`; by how many standard deviations it was."""
        point = view.values(self.factor.keys())
        if self._moved_little(point, tolerance):
            return 0.0
        exact = _square_root(self.factor, point)
        shift = _shift(exact, self.native.linearize(point))
        if shift > tolerance:
            self.native = gtsam.LinearContainerFactor(exact, point)
            self.made_at = _place_of(self.details, point)
        return shift

    def _moved_little(self, point: gtsam.Values, tolerance: float) -> bool:
        """Whether the block is certainly fresh: its residual is bilinear in attitude and calibration, so that what a
        quadratic lacks is at most of second order in what they have moved."""
        details, made_at = self.details, self.made_at
        if details is None or made_at is None or details.width != 1.0 or len(self.factor.keys()) > 3:
            return False
        here = _place_of(details, point)
        if here is None:
            return False
        angle = 0.5 * float(np.sum((here[0] - made_at[0]) ** 2))  # squared, to second order
        iron = float(np.linalg.norm(here[1][:6] - made_at[1][:6]))
        assert details.field is not None  # else `_place_of` is None
        lost = np.linalg.norm(details.field) * (0.5 * angle + np.sqrt(angle) * iron)  # T
        return bool(lost * np.sqrt(details.block.samples) < tolerance * details.sigma)


def native_factor(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.LinearContainerFactor:
    """The factor's quadratic at `point`, which must hold its keys: native, picklable, free of Python.

    Of a `field_chain_factor` at its solution it is the whole log's marginal, a prior for the next mission.
    """
    return gtsam.LinearContainerFactor(_square_root(factor, point), point)


def sorted_factors(graph: gtsam.NonlinearFactorGraph) -> tuple[gtsam.NonlinearFactorGraph, list[Delivered]]:
    """The other factors of a graph, and its Python ones of this package."""
    others, fresh = gtsam.NonlinearFactorGraph(), []
    for i in range(graph.size()):
        factor = graph.at(i)
        details = factor_details(factor)
        if details is None:
            others.push_back(factor)
        else:
            fresh.append(Delivered(factor, details if isinstance(details, BlockDetails) else None, factor))
    return others, fresh


def _place_of(details: BlockDetails | None, point: gtsam.Values) -> tuple[Array, Array] | None:
    """Attitude and calibration at which a block with a known field is linearised."""
    if details is None or details.field is None or details.on_direction:
        return None
    calibration = np.r_[point.atVector(details.soft_iron_key), point.atPoint3(details.hard_iron_key)]
    return rotation_of(point, details.attitude_key), calibration


def _square_root(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.JacobianFactor:
    """The factor's linearisation in as few rows as its keys have columns, and one for the rest."""
    return gtsam.JacobianFactor(gtsam.HessianFactor(factor.linearize(point)))


def _shift(exact: gtsam.GaussianFactor, stale: gtsam.GaussianFactor) -> float:
    """Largest difference of two gradients, in standard deviations of each variable given the factor alone."""
    first, second = exact.augmentedInformation(), stale.augmentedInformation()
    information: Array = np.diag(first)[:-1]
    difference = np.abs(first[:-1, -1] - second[:-1, -1])[information > 0]
    return float((difference / np.sqrt(information[information > 0])).max())
