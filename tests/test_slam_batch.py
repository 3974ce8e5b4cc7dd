"""Levenberg–Marquardt over 2,500 poses with blocks of magnetometer samples: native factors scale with the graph."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, H, X

from magyc_gtsam.factors import KeyframeField, NativeFactors, keyframe_field_factor, unvech

POSES, EVERY, STEP = 2_500, 50, 0.25  # s between poses
FIELD, UNIT, SIGMA = np.array([21e-6, 3e-6, 44e-6]), 50e-6, 0.5e-6
ODOMETRY = gtsam.noiseModel.Diagonal.Sigmas(np.r_[2e-3, 2e-3, 2e-3, 0.02, 0.02, 0.02])
SOFT_IRON, HARD_IRON = np.array([1.08, 0.02, -0.03, 0.94, 0.01, 1.03]), np.array([0.3, -0.2, 0.1])


def problem(seed):
    """The truth, the graph without magnetometer, its dead-reckoned start, and the blocks' factors."""
    random = np.random.default_rng(seed)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    true = guess = gtsam.Pose3()
    poses, factors = [true], []
    graph.push_back(gtsam.PriorFactorPose3(X(0), true, gtsam.noiseModel.Isotropic.Sigma(6, 0.05)))
    values.insert(X(0), true)
    for k in range(1, POSES):
        rate = np.array([0.3 * np.sin(0.11 * k), 0.3 * np.cos(0.07 * k), 0.25])  # rad/s
        step = gtsam.Pose3.Expmap(np.r_[rate * STEP, 0.3, 0.0, 0.0])
        read = step.compose(gtsam.Pose3.Expmap(random.normal(size=6) * ODOMETRY.sigmas()))
        true, guess = true.compose(step), guess.compose(read)
        graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), read, ODOMETRY))
        values.insert(X(k), guess)
        poses.append(true)
        if k % EVERY == 0:
            time = np.linspace(-STEP, 0.0, 11)
            turned = [gtsam.Rot3.Expmap(rate * t).matrix() for t in time]
            seen = np.array([each.T @ true.rotation().matrix().T @ FIELD for each in turned])
            field = seen @ unvech(SOFT_IRON).T + HARD_IRON * UNIT + SIGMA * random.normal(size=(11, 3))
            block = KeyframeField.from_samples((time, field), (time, np.tile(rate, (11, 1))), 0.0)
            factors.append(keyframe_field_factor(X(k), A(0), H(0), block, SIGMA, field=FIELD, field_unit=UNIT))
    return poses, graph, values, factors


def off(values, poses):
    """By which angle, rad, the field lies elsewhere in the last pose with a block; about it only odometry turns."""
    last = POSES - EVERY
    estimated, true = (pose.rotation().unrotate(FIELD) for pose in (values.atPose3(X(last)), poses[last]))
    return np.linalg.norm(np.cross(estimated, true)) / (FIELD @ FIELD)


def test_thousands_of_poses():
    poses, graph, values, factors = problem(3)
    start = off(values, poses)
    graph.addPriorVector(A(0), np.array([1.0, 0, 0, 1, 0, 1]), gtsam.noiseModel.Isotropic.Sigma(6, 0.3))
    graph.addPriorPoint3(H(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 1.0))
    values.insert(A(0), np.array([1.0, 0, 0, 1, 0, 1]))
    values.insert(H(0), np.zeros(3))
    for factor in factors:
        graph.push_back(factor)
    native = NativeFactors()
    solved, found = native.solve(graph, values)
    assert native.replaced > 0  # the first quadratics were made far from the solution
    assert solved.size() == graph.size()
    error = np.r_[found.atVector(A(0)) - SOFT_IRON, found.atPoint3(H(0)) - HARD_IRON]
    covariance = gtsam.Marginals(solved, found).jointMarginalCovariance([A(0), H(0)]).fullMatrix()
    assert error @ np.linalg.solve(covariance, error) < 27.9  # χ² of 9, 99.9 %
    assert off(found, poses) < 0.02
    assert off(found, poses) < 0.2 * start
    assert 2 * sum(factor.error(found) for factor in factors) == pytest.approx(3 * 11 * len(factors), rel=0.1)
