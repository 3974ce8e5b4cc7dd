"""The start of a batch, turned about the vertical where the blocks contradict its heading."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import gtsam
import numpy as np

from magyc_gtsam.factors.alignment import AlignmentLimits, CoarseAlignment, HeadingVerdict
from magyc_gtsam.factors.calibration_before import calibration_before
from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.heading_pull import HeadingPull
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array, attitude, stored_type

Optimize = Callable[[gtsam.NonlinearFactorGraph, gtsam.Values], gtsam.Values]


def turned_start(
    limits: AlignmentLimits | None,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    fresh: Sequence[Delivered],
    optimize: Optimize,
) -> gtsam.Values:
    """Return the values of a batch, turned to the heading of its blocks where this is another one.

    Args:
        limits: limits of the coarse alignment; None turns nothing.
        graph: the other factors.
        values: where to begin; returned as they are where the blocks do not contradict their heading.
        fresh: the Python factors.
        optimize: (graph, values) → values.
    """
    blocks = [each.details for each in fresh if each.is_block and each.details is not None]
    if limits is None or not blocks:
        return values
    alignment = CoarseAlignment(limits)
    for details in blocks:
        alignment.add(details)
    prior = calibration_before(View(values), graph, alignment.last)
    for _ in range(limits.persistence):
        verdict = alignment.judge(values, *prior)
    if verdict is not HeadingVerdict.FAR:
        return values
    assert alignment.profile is not None
    pull = HeadingPull.of(values, alignment.last.attitude_key, alignment.profile.best, limits.pull)
    return _turned(graph, values, alignment, pull, optimize)


def _turned(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    alignment: CoarseAlignment,
    pull: HeadingPull,
    optimize: Optimize,
) -> gtsam.Values:
    """Return the values after optimising the other factors with a prior on the heading, from turned starts.

    An optimiser hardly turns a chain of poses by half a turn. The error of the other factors tells whether positions
    turn with the attitudes, as those of dead reckoning, or are known, as from fixes, and whether a pose that is none of
    the vehicle was turned by mistake.
    """
    turning, last = gtsam.NonlinearFactorGraph(), alignment.last
    turning.push_back(graph)
    turning.push_back(pull.factor)
    loose = gtsam.noiseModel.Isotropic.Sigma
    for key in {last.soft_iron_key, last.hard_iron_key} - set(turning.keyVector()):
        turning.addPriorVector(key, values.atVector(key), loose(values.atVector(key).size, 1.0))
    known, attitudes = set(turning.keyVector()), set(alignment.attitudes)
    assert alignment.profile is not None
    angle, first = alignment.profile.best, _position(values, alignment.attitudes[0])
    starts = [gtsam.Values(values), *(_about_vertical(values, angle, attitudes, each) for each in (first, None))]
    for start in starts:
        for key in set(start.keys()) - known:
            start.erase(key)
    found = min((optimize(turning, start) for start in starts), key=turning.error)
    result = gtsam.Values(values)
    result.update(found)
    return result


def _about_vertical(values: gtsam.Values, angle: float, attitudes: set[int], centre: Array | None) -> gtsam.Values:
    """Return values whose poses, and rotations of the blocks' `attitudes`, are turned about the vertical.

    About a point (3,) for dead reckoning; about each pose itself where `centre` is None.
    """
    result, turn = gtsam.Values(values), gtsam.Rot3.Rz(angle)
    flat = gtsam.Rot2(angle)

    def moved(position: Array) -> Array:
        if centre is None:
            return position
        origin = centre[: len(position)]
        rotate = turn.matrix()[: len(position), : len(position)]
        return np.asarray(origin + rotate @ (position - origin))

    for key in list(values.keys()):
        kind = stored_type(attitude, values, key)
        if kind == "Pose3":
            pose = values.atPose3(key)
            result.update(key, gtsam.Pose3(turn * pose.rotation(), moved(pose.translation())))
        elif kind == "NavState":
            state = values.atNavState(key)
            speed = turn.rotate(state.velocity())
            result.update(key, gtsam.NavState(turn * state.attitude(), moved(state.position()), speed))
        elif kind == "Pose2":
            plane = values.atPose2(key)
            result.update(key, gtsam.Pose2(flat * plane.rotation(), moved(plane.translation())))
        elif key in attitudes and kind == "Rot3":
            result.update(key, turn * values.atRot3(key))
        elif key in attitudes and kind == "Rot2":
            result.update(key, flat * values.atRot2(key))
    return result


def _position(values: gtsam.Values, key: int) -> Array:
    """Return the position (3,) of an attitude variable; 0 where it has none."""
    kind, result = stored_type(attitude, values, key), np.zeros(3)
    if kind == "Pose3":
        result = values.atPose3(key).translation()
    elif kind == "NavState":
        result = values.atNavState(key).position()
    elif kind == "Pose2":
        result[:2] = values.atPose2(key).translation()
    return result
