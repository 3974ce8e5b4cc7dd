"""The prior that turns a graph towards the heading of its blocks, and the heading of an attitude variable."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.special import chdtrc

from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array, attitude, choose, stored_type

_SEEN = 0.02  # share of the prior's variance that the other factors must take away before they can contradict it
_UNLIKELY = 1e-9  # probability of the prior's innovation below which they do
# From where iSAM2 linearised; of a graph that turns further its covariance says nothing.
_TURNED = np.radians(15.0)
_STEPS = 3  # of Gauss–Newton, after which a graph that stands half a turn off has moved by some degrees


@dataclass(frozen=True, eq=False)
class HeadingPull:
    """A native prior on an attitude, which GTSAM relinearises by itself.

    Attributes:
        key: of the attitude.
        target: (3, 3) attitude.
        sigma: rad, standard deviation about the vertical; about the other axes it is 1 rad.
        factor: the prior.
    """

    key: int
    target: Array
    sigma: float
    factor: gtsam.NonlinearFactor

    @classmethod
    def of(cls, point: gtsam.Values, key: int, angle: float, sigma: float) -> HeadingPull:
        """Return the prior that turns the attitude of `key` by an angle (rad) about the vertical."""
        turned = gtsam.Rot3.Rz(angle) * gtsam.Rot3(rotation_of(point, key))
        return cls(key, turned.matrix(), sigma, _prior(point, key, turned, sigma))

    def resisted(self, view: View) -> float | None:
        """Return the angle (rad) from the heading of the solver's other factors to the target where they contradict
        the prior; None where they do not, or the graph is still turning.

        With the prior in the graph, r the heading's distance from the target and P its variance, that angle is
        r / (1 − P / σ²), and the innovation against all other factors has the square r² / (σ² (1 − P / σ²)), as that of
        a block (`block_fit.py`).
        """
        if not view.exists(self.key) or view.new.exists(self.key):
            return None
        point = view.values([self.key])
        sigma = known_heading(view, point, self.key)
        left = 0.0 if sigma is None else 1 - (sigma / self.sigma) ** 2
        if left < _SEEN:
            return None
        angle = turn_between(rotation_of(point, self.key), self.target)
        unlikely = chdtrc(1, (angle / self.sigma) ** 2 / left) < _UNLIKELY
        return float(np.clip(angle / left, -np.pi, np.pi)) if unlikely else None


def _prior(point: gtsam.Values, key: int, turned: gtsam.Rot3, sigma: float) -> gtsam.NonlinearFactor:
    """Return a native prior on the rotation of an attitude variable of any kind."""
    axis = turned.matrix()[2]  # the world's vertical in the body frame
    tight, loose = 1 / sigma**2, 1.0
    noise = gtsam.noiseModel.Gaussian.Information(loose * np.eye(3) + (tight - loose) * np.outer(axis, axis))
    kind = stored_type(attitude, point, key)
    if kind == "Pose3":
        return gtsam.PoseRotationPrior3D(key, turned, noise)
    if kind == "Rot3":
        return gtsam.PriorFactorRot3(key, turned, noise)
    flat = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
    if kind == "Pose2":
        return gtsam.PoseRotationPrior2D(key, gtsam.Rot2(turned.yaw()), flat)
    if kind == "Rot2":
        return gtsam.PriorFactorRot2(key, gtsam.Rot2(turned.yaw()), flat)
    state = point.atNavState(key)
    loose_rest = np.zeros((9, 9))
    loose_rest[:3, :3] = noise.information()
    loose_rest[3:, 3:] = 1e-12 * np.eye(6)
    return gtsam.PriorFactorNavState(
        key,
        gtsam.NavState(turned, state.position(), state.velocity()),
        gtsam.noiseModel.Gaussian.Information(loose_rest),
    )


def rotation_of(point: gtsam.Values, key: int) -> Array:
    """Return the rotation matrix (3, 3) of the attitude that a key holds."""
    try:
        pose: Array = point.atPose3(key).rotation().matrix()  # the usual case, without its tangent space
        return pose
    except RuntimeError:
        return choose("coarse alignment", attitude, point, key)(point, key)[0].reshape(3, 3)


def heading_axis(point: gtsam.Values, key: int) -> Array:
    """Return the tangent vector of a rotation by 1 rad about the world's vertical."""
    try:
        rotation, columns = point.atPose3(key).rotation().matrix(), 6  # the usual case
    except RuntimeError:
        rotation, tangent = choose("coarse alignment", attitude, point, key)(point, key)
        assert tangent is not None
        columns = tangent.shape[1]
        if stored_type(attitude, point, key) in ("Rot2", "Pose2"):
            return np.eye(columns)[-1]
    axis = np.zeros(columns)
    axis[:3] = rotation.reshape(3, 3)[2]
    return axis


def heading_sigma(point: gtsam.Values, key: int, covariance: Array) -> float:
    """Return the standard deviation, in rad, of an attitude about the vertical, from its covariance."""
    axis = heading_axis(point, key)
    return float(np.sqrt(axis @ covariance @ axis))


def known_heading(view: View, point: gtsam.Values, key: int) -> float | None:
    """Return the standard deviation (rad) of the solver's heading at an attitude that it holds; None while it turns.

    iSAM2's covariance is that where it linearised: of a graph that turns, and waits for its next relinearisation
    (`relinearizeSkip`), it says nothing.
    """
    covariance = view.covariance([key])
    return heading_sigma(point, key, covariance) if covariance is not None and linearized_near(view, key) else None


def linearized_near(view: View, key: int) -> bool:
    """Return whether a solver linearised an attitude that it holds near its present estimate."""
    turned = np.linalg.norm(rotation_of(view.linearized([key]), key) - rotation_of(view.values([key]), key))
    return bool(turned < np.sqrt(2) * _TURNED)


def solved_turn(view: View, key: int) -> float | None:
    """Return the largest angle (rad) by which the next Gauss–Newton steps of a solver's graph turn an attitude; None
    where its variables are not determined.

    Half a turn off, the gradient about the vertical is nearly 0: a graph whose relinearisation is still to come stands
    there with a small standard deviation.
    """
    start, largest = view.estimate(), 0.0
    graph, values = view.placed(view.factors()), start
    for _ in range(_STEPS):
        try:
            values = values.retract(graph.linearize(values).optimize())
        except RuntimeError:  # the variables are not determined
            return None
        largest = max(largest, abs(turn_between(rotation_of(start, key), rotation_of(values, key))))
    return largest


def turn_between(first: Array, second: Array) -> float:
    """Return the angle (rad) about the vertical from one attitude (3, 3) to another."""
    between = second @ first.T
    return float(np.arctan2(between[1, 0] - between[0, 1], between[0, 0] + between[1, 1]))
