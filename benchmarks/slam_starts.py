"""Batches with robust blocks from wrong starts: where do GTSAM's own optimiser, `solve` and `optimize` end?

    python benchmarks/slam_starts.py --seeds 3 --first 600 --starts 50

Three vehicles, 60 s, a block of 25 samples each second, spikes in 5 % of the samples, steel for 5 % of the time:
`inertial` (poses, velocities and biases with IMU factors and positions), `odometry` (tilts by 45°) and `level`
(tilts by 8°). A start has all headings turned by one random angle, each attitude off by 0.15 rad, and random
soft iron (0.2), hard iron (1.5 fields) and bias (20 mrad/s). Right: within 0.3 sigma of the hard iron found from the
truth; else the sigmas that each run is off by follow.
"""

from __future__ import annotations

import argparse
import time

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors import KERNELS, KeyframeBuffer, NativeFactors, keyframe_field_factor, vech
from magyc_gtsam.runners import optimize

UNIT, FIELD, SIGMA = 50e-6, np.array([22e-6, 1e-6, 42e-6]), 0.4e-6  # T
RATE, DURATION = 25, 60  # Hz, s
NO_BIAS = gtsam.imuBias.ConstantBias()
ODOMETRY = gtsam.noiseModel.Diagonal.Sigmas(np.r_[np.full(3, 0.006), np.full(3, 0.05)])  # rad, m in a second


def isotropic(rows: int, sigma: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Isotropic.Sigma(rows, sigma)


def samples(kind: str, random: np.random.Generator):
    """Time, attitude, gyroscope, field and acceleration, and the true soft and hard iron (T) and bias."""
    t = np.arange(DURATION * RATE) / RATE
    tilt, turn, periods = 0.15 if kind == "level" else 0.8, random.uniform(14, 30), random.uniform(5, 13, 2)

    def attitude(time):
        yaw = 2 * np.pi * time / turn + 0.5 * np.sin(time / 3)
        pitch, roll = (
            tilt * np.sin(2 * np.pi * time / periods[0] + 0.3),
            0.8 * tilt * np.sin(2 * np.pi * time / periods[1]),
        )
        return Rotation.from_euler("ZYX", np.c_[yaw, pitch, roll])

    turned, half = attitude(t), 0.5 / RATE
    soft_iron = random.normal(0, 0.06, (3, 3))
    soft_iron = np.eye(3) + (soft_iron + soft_iron.T) / 2
    hard_iron, bias = random.normal(0, 0.6, 3) * UNIT, random.normal(0, 5e-3, 3)
    rate = (attitude(t - half).inv() * attitude(t + half)).as_rotvec() * RATE + bias
    field = turned.inv().apply(FIELD) @ soft_iron.T + hard_iron + random.normal(0, SIGMA, (len(t), 3))
    spikes = random.random(len(t)) < 0.05
    field[spikes] += random.normal(0, 20e-6, (spikes.sum(), 3))
    field[(t > 0.4 * DURATION) & (t < 0.45 * DURATION)] += [0.0, 15e-6, -10e-6]
    acceleration = turned.inv().apply([0, 0, 9.81]) + random.normal(0, 0.02, (len(t), 3))
    return (
        t,
        turned,
        rate + random.normal(0, 2e-3, rate.shape),
        field,
        acceleration,
        soft_iron,
        hard_iron,
        bias,
    )


def problem(kind: str, seed: int, robust: str):
    """The graph with its blocks, and the truth."""
    random = np.random.default_rng(seed)
    t, turned, rate, field, acceleration, soft_iron, hard_iron, bias = samples(kind, random)
    graph, truth, buffer, keyframes = (
        gtsam.NonlinearFactorGraph(),
        gtsam.Values(),
        KeyframeBuffer(),
        range(0, len(t), RATE),
    )
    poses = [gtsam.Pose3(gtsam.Rot3(turned[row].as_matrix()), np.zeros(3)) for row in keyframes]
    first = gtsam.noiseModel.Diagonal.Sigmas(np.r_[0.02, 0.02, 0.3, 0.1, 0.1, 0.1])
    graph.addPriorPose3(X(0), poses[0], first)
    graph.addPriorVector(A(0), vech(np.eye(3)), isotropic(6, 0.3))
    graph.addPriorPoint3(H(0), np.zeros(3), isotropic(3, 1.5))
    truth.insert(A(0), vech(soft_iron))
    truth.insert(H(0), hard_iron / UNIT)
    inertial = kind == "inertial"
    if inertial:
        parameters = gtsam.PreintegrationParams(np.array([0, 0, -9.81]))
        parameters.setGyroscopeCovariance(np.eye(3) * 2e-3**2 / RATE)
        parameters.setAccelerometerCovariance(np.eye(3) * 0.02**2 / RATE)
        parameters.setIntegrationCovariance(np.eye(3) * 1e-10)
        graph.addPriorVector(V(0), np.zeros(3), isotropic(3, 0.1))
        graph.addPriorConstantBias(B(0), NO_BIAS, isotropic(6, 0.02))
    for k, row in enumerate(keyframes):
        truth.insert(X(k), poses[k])
        if inertial:
            truth.insert(V(k), np.zeros(3))
            truth.insert(B(k), gtsam.imuBias.ConstantBias(np.zeros(3), bias))
            graph.push_back(gtsam.GPSFactor(X(k), np.zeros(3), isotropic(3, 0.1)))
        if k == 0:
            continue
        if inertial:
            moved = gtsam.PreintegratedImuMeasurements(parameters, NO_BIAS)
            for j in range(row - RATE, row):
                moved.integrateMeasurement(acceleration[j : j + 2].mean(0), rate[j : j + 2].mean(0), 1 / RATE)
            graph.push_back(gtsam.ImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), moved))
            graph.push_back(gtsam.BetweenFactorConstantBias(B(k - 1), B(k), NO_BIAS, isotropic(6, 1e-5)))
        else:
            error = gtsam.Pose3.Expmap(random.normal(size=6) * ODOMETRY.sigmas())
            step = poses[k - 1].between(poses[k]).compose(error)
            graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), step, ODOMETRY))
        rows = slice(max(row - RATE, 0) + (k > 1), row + 1)
        buffer.add_rate(t[rows], rate[rows])
        buffer.add_field(t[rows], field[rows])
        block = buffer.close(t[row], np.zeros(3) if inertial else bias)
        key = {"gyro_bias_key": B(k)} if inertial else {}
        graph.push_back(
            keyframe_field_factor(
                X(k), A(0), H(0), block, SIGMA, field=FIELD, field_unit=UNIT, robust=robust, **key
            )
        )
    return graph, truth


def wrong(truth: gtsam.Values, random: np.random.Generator) -> gtsam.Values:
    """A start far from the truth."""
    start, turn, bias = (
        gtsam.Values(),
        gtsam.Rot3.Rz(random.uniform(-np.pi, np.pi)),
        random.normal(0, 0.02, 3),
    )
    for key in list(truth.keys()):
        letter = chr(gtsam.Symbol(key).chr())
        if letter == "x":
            tilted = gtsam.Rot3.Expmap(random.normal(0, 0.15, 3))
            start.insert(
                key,
                gtsam.Pose3(turn * truth.atPose3(key).rotation() * tilted, random.normal(0, 0.1, 3)),
            )
        elif letter == "b":
            start.insert(key, gtsam.imuBias.ConstantBias(np.zeros(3), bias))
        elif letter == "a":
            start.insert(key, vech(np.eye(3)) + random.normal(0, 0.2, 6))
        else:
            start.insert(key, random.normal(0, 1.5 if letter == "h" else 0.1, 3))
    return start


def gtsam_alone(graph, start):
    return gtsam.LevenbergMarquardtOptimizer(graph, start).optimize(), True


def solve(graph, start):
    native = NativeFactors()
    return native.solve(graph, start)[1], native.settled


def runner(graph, start):
    result = optimize(graph, start)
    return result.values, result.converged


SOLVERS = {"GTSAM alone": gtsam_alone, "solve": solve, "optimize": runner}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=600)
    parser.add_argument("--starts", type=int, default=50)
    parser.add_argument("--kernel", action="append", choices=list(KERNELS))
    parser.add_argument("--vehicle", action="append", choices=["inertial", "odometry", "level"])
    options = parser.parse_args()
    for kind in options.vehicle or ["inertial", "odometry", "level"]:
        for kernel in options.kernel or list(KERNELS):
            counts = {name: [0, 0, 0, 0.0] for name in SOLVERS}
            silent: dict[str, list[str]] = {name: [] for name in SOLVERS}
            for seed in range(options.first, options.first + options.seeds):
                graph, truth = problem(kind, seed, kernel)
                reference = runner(graph, truth)[0]
                covariance = gtsam.Marginals(graph, reference).marginalCovariance(H(0))
                for i in range(seed - options.first, options.starts, options.seeds):
                    start = wrong(truth, np.random.default_rng(options.first + 1000 + i))
                    for name, solver in SOLVERS.items():
                        graph, _ = problem(kind, seed, kernel)
                        began = time.process_time()
                        found, converged = solver(graph, start)
                        counts[name][3] += (time.process_time() - began) / options.starts
                        off = found.atPoint3(H(0)) - reference.atPoint3(H(0))
                        sigmas = float(np.sqrt(off @ np.linalg.solve(covariance, off)))
                        right = sigmas < 0.3
                        if converged and not right:
                            silent[name].append(f"{sigmas:.1f}")
                        counts[name][0 if right else 2 if converged else 1] += 1
            for name, (right, said, elsewhere, spent) in counts.items():
                print(
                    f"{kind:9s} {kernel:13s} {name:12s} right {right} of {options.starts}, not converged {said}, "
                    f"converged elsewhere {elsewhere}; {spent:.1f} s each {' '.join(silent[name])}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
