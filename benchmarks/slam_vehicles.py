"""Vehicles of the studies of faults inside SLAM: their motion, sensors and graph, independent of `simulation/`.

The graph has inertial factors between keyframes 1 s apart, positions of 1 m, and a block of the magnetometer every 2 s.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors import KeyframeBuffer, NativeFactors, keyframe_field_factor, vech
from magyc_gtsam.factors.heading_pull import heading_sigma

UNIT = 50e-6  # T per unit of the hard iron
FIELD = np.array([1.2e-6, 19.5e-6, -45.0e-6])  # T, east, north, up
GRAVITY = 9.81
RATE, EVERY = 50, 2  # Hz of the inertial sensors, of which the magnetometer reads every second sample
GYROSCOPE, ACCELEROMETER, MAGNETOMETER = 1.5e-3, 0.03, 0.5e-6  # rad/s, m/s², T per sample
ODOMETRY = np.r_[[0.005] * 3, [0.03] * 3]  # rad, m in a second
ISOTROPIC = gtsam.noiseModel.Isotropic.Sigma
SIGMAS = gtsam.noiseModel.Diagonal.Sigmas

# speed and its change, m/s; periods of the turns, s; tilt, rad, and its periods, s
_ALONG = {
    "ship": (3.0, 0.5, (40, 120), 0.08, (4, 9)),
    "car": (10.0, 3.0, (15, 60), 0.02, (2, 8)),
    "rover": (1.5, 0.6, (10, 40), 0.06, (3, 10)),
    "submarine": (1.5, 0.4, (30, 90), 0.3, (15, 50)),
}
KINDS = ("multirotor", *_ALONG, "hand")


class Vehicle:
    """A vehicle's motion and the readings of its sensors.

    Args:
        kind: one of `KINDS`.
        seed: of the motion, the instruments and the noise.
        duration: s.
        mounting: (3, 3) rotation from the magnetometer's axes to the body's.
        step: (s, T) after which the hard iron is off by that much.
        steel: (s, s, T) from and to which a field of that size at most is added in the body's axes.
        late: s by which the magnetometer's stamps are late.
    """

    def __init__(self, kind, seed, duration=120.0, *, mounting=None, step=None, steel=None, late=0.0):
        random = np.random.default_rng([seed, KINDS.index(kind)])
        self.duration, step_time = int(duration), 1 / RATE
        time = np.arange(int(duration) * RATE + 11) * step_time

        def waves(amplitude, periods):
            sines = [
                random.uniform(0.5, 1.2)
                * np.sin(2 * np.pi * time / random.uniform(*periods) + random.uniform(0, 6.3))
                for _ in range(3)
            ]
            return amplitude / np.sqrt(3) * sum(sines)

        if kind in _ALONG:
            mean, change, turns, tilt, periods = _ALONG[kind]
            yaw = random.uniform(-np.pi, np.pi) + waves(1.8, turns)
            yaw += random.choice([-1, 1]) * random.uniform(0.02, 0.06) * time
            speed, pitch, roll = mean + waves(change, (10, 40)), waves(tilt, periods), waves(tilt, (4, 12))
            dive = pitch if kind == "submarine" else np.zeros(len(time))
            along = np.c_[np.cos(yaw) * np.cos(dive), np.sin(yaw) * np.cos(dive), -np.sin(dive)]
            velocity = speed[:, None] * along
        else:
            size, periods = (4.0, (8, 25)) if kind == "multirotor" else (0.7, (6, 20))
            velocity = np.c_[waves(size, periods), waves(size, periods), waves(0.1 * size, (5, 15))]
            yaw = random.uniform(-np.pi, np.pi) + waves(1.5, (10, 40)) + random.uniform(-0.1, 0.1) * time
            pitch, roll = waves(0.6, (5, 15)), waves(0.5, (5, 15))
        if kind == "multirotor":  # its thrust is along the body's z axis
            thrust = np.gradient(velocity, step_time, axis=0) + [0, 0, GRAVITY]
            ahead = np.cos(yaw) * thrust[:, 0] + np.sin(yaw) * thrust[:, 1]
            aside = np.cos(yaw) * thrust[:, 1] - np.sin(yaw) * thrust[:, 0]
            pitch, roll = np.arctan2(ahead, thrust[:, 2]), np.arctan2(-aside, np.hypot(ahead, thrust[:, 2]))
        self.attitude = Rotation.from_euler("ZYX", np.c_[yaw, pitch, roll])
        self.velocity = velocity
        moved = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * step_time, axis=0)
        self.position = np.vstack([np.zeros(3), moved])
        turned = (self.attitude[:-1].inv() * self.attitude[1:]).as_rotvec()
        self.rate = turned / step_time + random.normal(0, 4e-3, 3) + random.normal(0, GYROSCOPE, turned.shape)
        specific = (velocity[1:] - velocity[:-1]) / step_time + [0, 0, GRAVITY]
        between = self.attitude[:-1] * Rotation.from_rotvec(0.5 * turned)
        self.acceleration = between.inv().apply(specific) + random.normal(0, 0.02, 3)
        self.acceleration += random.normal(0, ACCELEROMETER, turned.shape)
        self.hard_iron, self.time = random.normal(0, 15e-6, 3), time[::EVERY]
        iron, noise = random.normal(0, 0.06, (3, 3)), random.normal(0, MAGNETOMETER, (len(self.time), 3))
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        seen = self.attitude[::EVERY].inv().apply(FIELD)
        if steel is not None:
            first, last, size = steel
            share = np.clip((self.time - first) / (last - first), 0, 1)
            seen = seen + size * np.outer(np.sin(np.pi * share), direction)
        seen = seen if mounting is None else seen @ mounting
        self.field = seen @ (np.eye(3) + (iron + iron.T) / 2) + self.hard_iron + noise
        if step is not None:
            self.field[self.time > step[0]] += step[1] * direction
        self.time = self.time + late
        self.fix_errors = random.normal(size=(self.duration + 1, 3))
        self.odometry_errors = random.normal(size=(self.duration + 1, 6)) * ODOMETRY


@dataclass(frozen=True)
class Look:
    """What a graph says after a block.

    Attributes:
        time: s.
        health: of the magnetometer.
        waiting: number of blocks that wait.
        error, sigma: degrees, of the heading.
        iron: µT, error of the hard iron.
    """

    time: float
    health: object
    waiting: int
    error: float
    sigma: float
    iron: float

    @property
    def wrong(self) -> bool:
        """Whether the heading is off by more than five of its sigmas and three degrees."""
        return abs(self.error) > max(3.0, 5 * self.sigma)


class _Predicted:
    """Values in place of a solver's estimates."""

    def __init__(self, values):
        self.calculateEstimatePose3, self.calculateEstimateVector = values.atPose3, values.atVector
        self.calculateEstimateConstantBias = values.atConstantBias


@dataclass
class Graph:
    """A graph in iSAM2 on a vehicle's readings.

    Attributes:
        vehicle: what is driven.
        heading, prior: rad, by which the start is off, and the standard deviation of its prior.
        fixes: s between two positions.
        odometry: whether there is odometry.
        world: (3,) T, what the blocks hold of the world's field.
        mounting: rotation that the blocks hold.
        skip, threshold: of iSAM2's relinearisation; 10 and 0.1 are its own.
        bias: (3,) rad/s, start of the gyroscope's bias.
        looks: after each block.
    """

    vehicle: Vehicle
    heading: float = 0.3
    prior: float = 1.0
    fixes: int = 1
    odometry: bool = False
    world: np.ndarray = field(default_factory=lambda: FIELD)
    mounting: gtsam.Rot3 = field(default_factory=gtsam.Rot3)
    skip: int = 1
    threshold: float = 0.05
    bias: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def run(self) -> list[Look]:
        """Drive, and return the looks."""
        settings = gtsam.ISAM2Params()
        settings.setFactorization("QR")
        settings.setRelinearizeThreshold(self.threshold)
        settings.relinearizeSkip = self.skip
        self.isam, self.native = gtsam.ISAM2(settings), NativeFactors()
        self._prepare()
        self.native.update(self.isam, *self._start())
        self.looks = []
        for k in range(1, self.vehicle.duration + 1):
            self.native.update(self.isam, *self._step(k))
            if k % 2 == 0:
                self.looks.append(self._look(k))
        return self.looks

    def batch(self) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Return the whole graph, and a start by dead reckoning with the inertial sensors."""
        self._prepare()
        graph, values = self._start()
        self.isam = _Predicted(values)
        for k in range(1, self.vehicle.duration + 1):
            factors, predicted = self._step(k)
            graph.push_back(factors)
            values.insert(predicted)
        return graph, values

    def heading_error(self, values, k):
        """Return the error of the heading at keyframe k, rad."""
        return (values.atPose3(X(k)).rotation() * self._true(k).rotation().inverse()).yaw()

    def _prepare(self):
        self._next, self._buffer = 0, KeyframeBuffer(body_R_sensor=self.mounting)
        self._inertial = gtsam.PreintegrationCombinedParams.MakeSharedU(GRAVITY)
        self._inertial.setGyroscopeCovariance(np.eye(3) * GYROSCOPE**2 / RATE)
        self._inertial.setAccelerometerCovariance(np.eye(3) * ACCELEROMETER**2 / RATE)
        self._inertial.setIntegrationCovariance(np.eye(3) * 1e-8)
        self._inertial.setBiasAccCovariance(np.eye(3) * 1e-7)
        self._inertial.setBiasOmegaCovariance(np.eye(3) * 1e-10)

    def _start(self):
        vehicle, graph, values = self.vehicle, gtsam.NonlinearFactorGraph(), gtsam.Values()
        bias = gtsam.imuBias.ConstantBias(np.zeros(3), self.bias)
        first = gtsam.Rot3.Rz(self.heading) * gtsam.Rot3(vehicle.attitude[0].as_matrix())
        pose = gtsam.Pose3(first, vehicle.position[0])
        spread, turned = np.eye(6), first.matrix()
        spread[:3, :3] = (
            turned.T @ np.diag([0.1, 0.1, self.prior]) ** 2 @ turned
        )  # in body axes, where it may tilt
        graph.addPriorPose3(X(0), pose, gtsam.noiseModel.Gaussian.Covariance(spread))
        graph.addPriorVector(V(0), vehicle.velocity[0], ISOTROPIC(3, 1.0))
        graph.addPriorConstantBias(B(0), bias, SIGMAS(np.r_[[0.05] * 3, [0.02] * 3]))
        graph.addPriorVector(A(0), vech(np.eye(3)), ISOTROPIC(6, 0.3))
        graph.addPriorPoint3(H(0), np.zeros(3), ISOTROPIC(3, 1.0))
        for key, value in (
            (X(0), pose),
            (V(0), vehicle.velocity[0]),
            (B(0), bias),
            (A(0), vech(np.eye(3))),
            (H(0), np.zeros(3)),
        ):
            values.insert(key, value)
        return graph, values

    def _step(self, k):
        vehicle, isam, graph, values = self.vehicle, self.isam, gtsam.NonlinearFactorGraph(), gtsam.Values()
        bias, rows = isam.calculateEstimateConstantBias(B(k - 1)), range((k - 1) * RATE, k * RATE)
        inertial = gtsam.PreintegratedCombinedMeasurements(self._inertial, bias)
        for row in rows:
            inertial.integrateMeasurement(vehicle.acceleration[row], vehicle.rate[row], 1 / RATE)
        graph.push_back(gtsam.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), inertial))
        state = gtsam.NavState(isam.calculateEstimatePose3(X(k - 1)), isam.calculateEstimateVector(V(k - 1)))
        state = inertial.predict(state, bias)
        for key, value in ((X(k), state.pose()), (V(k), state.velocity()), (B(k), bias)):
            values.insert(key, value)
        if k % self.fixes == 0:
            fix = vehicle.position[k * RATE] + vehicle.fix_errors[k]
            graph.push_back(gtsam.GPSFactor(X(k), fix, ISOTROPIC(3, 1.0)))
        if self.odometry:
            read = self._true(k - 1).between(self._true(k))
            read = read.compose(gtsam.Pose3.Expmap(vehicle.odometry_errors[k]))
            graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), read, SIGMAS(ODOMETRY)))
        upto = min(k * RATE + 2, len(vehicle.rate))
        new, self._next = np.arange(self._next, upto), upto
        self._buffer.add_rate((new + 0.5) / RATE, vehicle.rate[new])
        read = (vehicle.time > k - 1) & (vehicle.time <= k)
        self._buffer.add_field(vehicle.time[read], vehicle.field[read])
        if k % 2 == 0:
            block = self._buffer.close(float(k), bias.gyroscope())
            held = {"gyro_bias_key": B(k), "field": self.world, "field_unit": UNIT}
            graph.push_back(keyframe_field_factor(X(k), A(0), H(0), block, MAGNETOMETER, **held))
        return graph, values

    def _true(self, k):
        row = k * RATE
        return gtsam.Pose3(gtsam.Rot3(self.vehicle.attitude[row].as_matrix()), self.vehicle.position[row])

    def _look(self, k):
        values = self.isam.calculateEstimate()
        error = self.heading_error(values, k)
        sigma = heading_sigma(values, X(k), self.isam.marginalCovariance(X(k)))
        iron = values.atPoint3(H(0)) * UNIT - self.vehicle.hard_iron if values.exists(H(0)) else np.full(3, np.nan)
        health, waiting = self.native.health, self.native.waiting
        degrees = np.degrees([error, sigma])
        return Look(float(k), health, waiting, *map(float, degrees), float(np.linalg.norm(iron)) * 1e6)
