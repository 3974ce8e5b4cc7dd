"""What calibration inside a SLAM graph gains (docs/slam_measured.md).

    python benchmarks/slam_accuracy.py            # Monte-Carlo: against `smoother`, NEES, iSAM2 against batch, heading

`--figure FILE` draws the heading errors.
"""

import argparse
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, X
from slam_graph import SIGMA, UNIT, block, calibration_start
from vehicle import CURRENT, Vehicle

import magyc_gtsam as mg
from magyc_gtsam.factors import NativeFactors, keyframe_field_factor, vech


def batch(vehicle: Vehicle, free: str) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The dive smoothed as one: no magnetometer (""), uncalibrated ("m"), hard iron only ("mh"), all ("mAh")."""
    graph, values = vehicle.start()
    native = NativeFactors(tolerance=0.01)
    if free:
        calibration_start(graph, values, free)
    for k in range(1, len(vehicle.poses)):
        last = values.atPose3(X(k - 1))
        more, new = vehicle.step(k, last, CURRENT, values.atConstantBias(B(0)))
        graph.push_back(more)
        values.insert(new)
    for k in range(1, len(vehicle.poses) if free else 0):
        samples = block(vehicle, k, 1, 1, np.zeros(3))
        factor = keyframe_field_factor(
            X(k), A(0), H(0), samples, SIGMA, gyro_bias_key=B(k - 1), field=vehicle.field, field_unit=UNIT
        )
        graph.push_back(factor)
    return native.solve(graph, values)


def incremental(vehicle: Vehicle) -> gtsam.Values:
    """The same graph in iSAM2."""
    settings = gtsam.ISAM2Params()
    settings.setFactorization("QR")
    settings.setRelinearizeThreshold(0.01)
    isam, native = gtsam.ISAM2(settings), NativeFactors(tolerance=0.01)
    graph, values = vehicle.start()
    calibration_start(graph, values)
    isam.update(graph, values)
    for k in range(1, len(vehicle.poses)):
        graph, values = vehicle.step(
            k, isam.calculateEstimatePose3(X(k - 1)), CURRENT, gtsam.imuBias.ConstantBias()
        )
        samples = block(vehicle, k, 1, 1, np.zeros(3))
        factor = keyframe_field_factor(
            X(k), A(0), H(0), samples, SIGMA, gyro_bias_key=B(k - 1), field=vehicle.field, field_unit=UNIT
        )
        graph.push_back(factor)
        native.update(isam, graph, values)
    native.settle(isam)
    return isam.calculateEstimate()


def calibration(values: gtsam.Values) -> np.ndarray:
    """(9,) vech(soft iron) and hard iron in UNIT."""
    return np.concatenate([values.atVector(A(0)), values.atPoint3(H(0))])


def accuracy(runs: int, motion: str, figure: Path | None) -> None:
    """Print errors over `runs` dives."""
    names = {"": "no magnetometer", "mplain": "uncalibrated", "mh": "hard iron only", "mAh": "calibrated"}
    heading = {free: [] for free in names}
    graph_error, smoother_error, nees, off = [], [], [], []
    for seed in range(runs):
        vehicle = Vehicle(motion, 300.05, seed, every=20)
        strength = float(np.linalg.norm(vehicle.field))
        truth = vehicle.simulation.truth
        true = np.r_[vech(truth.soft_iron) * truth.field_strength / strength, truth.hard_iron / UNIT]
        for free in names:
            graph, values = batch(vehicle, free)
            heading[free].append(vehicle.heading_error(values))
        covariance = gtsam.Marginals(graph, values).jointMarginalCovariance([A(0), H(0)]).fullMatrix()
        error = calibration(values) - true
        graph_error.append(error)
        nees.append(error @ np.linalg.solve(covariance, error))
        distance = calibration(incremental(vehicle)) - calibration(values)
        off.append(np.abs(distance / np.sqrt(np.diag(covariance))).max())
        alone = mg.calibrate(vehicle.recording, field_strength=strength, noise=(SIGMA, 5e-3), delay=0.0)
        smoother_error.append(np.r_[vech(alone.soft_iron), alone.hard_iron / UNIT] - true)
    half = 1.96 * np.sqrt(2 * 9 / runs)
    print(f"{runs} runs of 300 s, {motion}; NEES {np.mean(nees):.2f}, its band {9 - half:.2f} to {9 + half:.2f}")
    for name, errors in (("graph", graph_error), ("smoother", smoother_error)):
        square = np.mean(np.square(errors), axis=0)
        print(
            f"{name:9s} soft iron {np.sqrt(square[:6].sum()):.5f}   "
            f"hard iron {np.sqrt(square[6:].sum()) * UNIT * 1e9:.0f} nT (root mean square of the norm)"
        )
    print(f"iSAM2 against batch: largest difference {max(off):.3f} sigma, median {np.median(off):.4f}")
    for free, name in names.items():
        overall = np.sqrt(np.mean(np.square(heading[free])))
        print(f"heading, {name:16s} {overall:.2f}° (worst run {max(heading[free]):.2f}°)")
    if figure:
        import matplotlib.pyplot as plt

        fig, axes = plt.subplots(figsize=(6.4, 2.6), layout="constrained")
        axes.boxplot([heading[free] for free in names], orientation="horizontal", tick_labels=list(names.values()))
        axes.set(xscale="log", xlabel=f"heading error of the graph, degrees RMS over a 300 s dive, {runs} runs")
        axes.invert_yaxis()
        axes.grid(axis="x", alpha=0.3, which="both")
        fig.savefig(figure)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--motion", default="dive")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    accuracy(arguments.runs, arguments.motion, arguments.figure)


if __name__ == "__main__":
    main()
