"""The vehicle that the examples share: a simulated dive, its inertial sensors and odometry as GTSAM has them.

Nothing in here is about the magnetometer; in a real project this is the graph that exists already.
"""

from collections.abc import Iterator

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

import magyc_gtsam as mg

RATE = 20  # Hz, all sensors, unless said otherwise
CURRENT = np.array([0.4, 0.1, 0.0])  # m/s, the vehicle drifts with it
ODOMETRY = np.array([0.01, 0.01, 0.01, 0.05, 0.05, 0.05])  # rad, m between keyframes


class Vehicle:
    """Sensor samples between keyframes `every` samples apart, and the true poses."""

    def __init__(self, motion: str, duration: float, seed: int, every: int = 10, rate: int = RATE) -> None:
        self.simulation, self.every, self.rate = mg.simulate(motion, duration, rate, seed), every, rate
        self.recording, self.field = self.simulation.recording, self.simulation.field
        random = np.random.default_rng(seed)
        time, attitude = self.recording.time, self.recording.attitude
        self.poses = [
            gtsam.Pose3(gtsam.Rot3.Quaternion(*attitude[row, [3, 0, 1, 2]]), CURRENT * time[row])
            for row in range(0, len(time), every)
        ]
        noise = ODOMETRY * random.normal(size=(len(self.poses), 6))
        self.odometry = [
            a.between(b).compose(gtsam.Pose3.Expmap(n))
            for a, b, n in zip(self.poses[:-1], self.poses[1:], noise, strict=False)
        ]
        self.parameters = gtsam.PreintegrationCombinedParams.MakeSharedD(9.80665)
        self.parameters.setGyroscopeCovariance(np.eye(3) * 5e-3**2 / rate)
        self.parameters.setAccelerometerCovariance(np.eye(3) * 0.02**2 / rate)
        self.parameters.setIntegrationCovariance(np.eye(3) * 1e-6)
        self.parameters.setBiasAccCovariance(np.eye(3) * 1e-6)
        self.parameters.setBiasOmegaCovariance(np.eye(3) * 1e-9)

    def samples(self, k: int) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
        """Time, angular rate and magnetic field of the samples up to keyframe k."""
        for row in range((k - 1) * self.every + 1, k * self.every + 1):
            yield self.recording.time[row], self.recording.angular_rate[row], self.recording.magnetic_field[row]

    def start(self, heading_error: float = 0.35) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Priors and values of the first keyframe, its heading off as a raw compass may be."""
        graph, values, bias = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.imuBias.ConstantBias()
        first = gtsam.Pose3(gtsam.Rot3.Rz(heading_error) * self.poses[0].rotation(), np.zeros(3))
        sigmas = gtsam.noiseModel.Diagonal.Sigmas
        graph.addPriorPose3(X(0), first, sigmas(np.r_[0.3, 0.3, 0.5, 0.1, 0.1, 0.1]))
        graph.addPriorVector(V(0), CURRENT, sigmas(np.full(3, 0.1)))
        graph.addPriorConstantBias(B(0), bias, sigmas(np.r_[[0.05] * 3, [0.01] * 3]))
        for key, value in ((X(0), first), (V(0), CURRENT), (B(0), bias)):
            values.insert(key, value)
        return graph, values

    def step(
        self, k: int, pose: gtsam.Pose3, velocity: np.ndarray, bias: gtsam.imuBias.ConstantBias
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Inertial factor and odometry from keyframe k − 1, with these estimates, to k, and the prediction."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        inertial, recording = gtsam.PreintegratedCombinedMeasurements(self.parameters, bias), self.recording
        for row in range((k - 1) * self.every, k * self.every):
            rate = 0.5 * (recording.angular_rate[row] + recording.angular_rate[row + 1])
            inertial.integrateMeasurement(recording.acceleration[row], rate, 1 / self.rate)
        graph.push_back(gtsam.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), inertial))
        noise = gtsam.noiseModel.Diagonal.Sigmas(ODOMETRY)
        graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), self.odometry[k - 1], noise))
        predicted = pose.compose(self.odometry[k - 1])
        for key, value in ((X(k), predicted), (V(k), velocity), (B(k), bias)):
            values.insert(key, value)
        return graph, values

    def heading_error(self, values: gtsam.Values, first: int = 0) -> float:
        """Root-mean-square heading error from keyframe `first` on, degrees."""
        return float(np.sqrt(np.mean(np.square(self.heading_errors(values)[first:]))))

    def heading_errors(self, values: gtsam.Values) -> np.ndarray:
        """Heading error of every keyframe that is in `values`, degrees."""
        known = [k for k in range(len(self.poses)) if values.exists(X(k))]
        error = [(values.atPose3(X(k)).rotation() * self.poses[k].rotation().inverse()).yaw() for k in known]
        return np.degrees(error)
