"""What calibration inside a SLAM graph costs and gains (docs/slam.md).

    python benchmarks/slam.py cost                # a graph of 10,000 poses in iSAM2, with and without
    python benchmarks/slam.py accuracy            # Monte-Carlo: against `smoother`, NEES, iSAM2 against batch, heading

`accuracy --figure FILE` draws the heading errors. Times are process times; compare them within one run.
"""

import argparse
import sys
import time
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X

import magyc_gtsam as mg
from magyc_gtsam.factors import (
    KeyframeField,
    NativeFactors,
    hard_iron_walk,
    keyframe_field_factor,
    magnetometer_factor,
    soft_iron_walk,
    vech,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from vehicle import CURRENT, Vehicle

NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])
UNIT = 50e-6  # T per unit of the hard iron
SIGMA = 1e-6  # T, magnetometer
ISOTROPIC = gtsam.noiseModel.Isotropic.Sigma


def block(vehicle: Vehicle, k: int, keyframes: int, step: int, bias: np.ndarray) -> KeyframeField:
    """The samples of the last `keyframes` keyframes up to k, every `step`-th of the magnetometer's."""
    rows = slice((k - keyframes) * vehicle.every, k * vehicle.every + 1)
    time_, rate, field = (getattr(vehicle.recording, n)[rows] for n in ("time", "angular_rate", "magnetic_field"))
    magnetometer = (time_[1:][::step], field[1:][::step])
    return KeyframeField.from_samples(magnetometer, (time_, rate), time_[-1], bias=bias)


def calibration_start(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, free: str = "Ah") -> None:
    """Vague priors on soft and hard iron, tight ones where they are not free."""
    graph.addPriorVector(A(0), NO_IRON, ISOTROPIC(6, 0.3 if "A" in free else 1e-4))
    graph.addPriorPoint3(H(0), np.zeros(3), ISOTROPIC(3, 1.0 if "h" in free else 1e-4))
    values.insert(A(0), NO_IRON)
    values.insert(H(0), np.zeros(3))


# --- cost ------------------------------------------------------------------------------------------------

BLOCK, NODE, FIX = 10, 240, 40  # keyframes per block, calibration node and position fix


def isam2(wildfire: float) -> gtsam.ISAM2:
    """iSAM2 as for any graph, with thresholds in each variable's own unit."""
    settings, thresholds = gtsam.ISAM2Params(), gtsam.ISAM2ThresholdMap()
    limits = {
        "x": [0.1] * 3 + [1.0] * 3,
        "v": [1.0] * 3,
        "b": [0.1] * 3 + [0.01] * 3,
        "a": [1e9] * 6,
        "h": [1e9] * 3,
    }
    for letter, limit in limits.items():
        thresholds.insert((letter, np.array(limit)))
    settings.setRelinearizeThreshold(thresholds)
    settings.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(wildfire))
    return gtsam.ISAM2(settings)


def drive(vehicle: Vehicle, path: str, wildfire: float, count: int) -> np.ndarray:
    """Process time of each update, s, of the graph with the given magnetometer path."""
    isam, native, node = isam2(wildfire), NativeFactors(), 0
    random = np.random.default_rng(0)
    graph, values = vehicle.start(heading_error=0.0)
    if path != "none":
        calibration_start(graph, values)
    isam.update(graph, values)
    spent, bias = np.zeros(count), gtsam.imuBias.ConstantBias()
    for k in range(1, count + 1):
        begin = time.process_time()
        pose, velocity = isam.calculateEstimatePose3(X(k - 1)), isam.calculateEstimateVector(V(k - 1))
        bias = isam.calculateEstimateConstantBias(B(k - 1))
        graph, values = vehicle.step(k, pose, velocity, bias)
        if k % FIX == 0:
            fix = vehicle.poses[k].translation() + random.normal(size=3)
            graph.push_back(gtsam.GPSFactor(X(k), fix, ISOTROPIC(3, 1.0)))
        remove = []
        if path == "native":
            if k % NODE == 0:
                elapsed = NODE * vehicle.every / vehicle.rate
                graph.push_back(soft_iron_walk(A(node), A(k), elapsed, 1e-3))
                graph.push_back(hard_iron_walk(H(node), H(k), elapsed, 0.1e-6, field_unit=UNIT))
                values.insert(A(k), isam.calculateEstimateVector(A(node)))
                values.insert(H(k), isam.calculateEstimatePoint3(H(node)))
                node = k
            if k % BLOCK == 0:
                samples = block(vehicle, k, BLOCK, 5, bias.gyroscope())
                keys = (X(k), A(node), H(node))
                factor = keyframe_field_factor(*keys, samples, SIGMA, field=vehicle.field, field_unit=UNIT)
                native.add(graph, factor, isam, values)
            remove = native.refresh(graph, isam)
        elif path == "per sample":
            for row in range((k - 1) * vehicle.every + 5, k * vehicle.every + 1, 5):
                field = vehicle.recording.magnetic_field[row]
                graph.push_back(
                    magnetometer_factor([X(k), A(0), H(0)], field, SIGMA, field=vehicle.field, field_unit=UNIT)
                )
        native.placed(isam.update(graph, values, remove).getNewFactorsIndices())
        isam.calculateEstimatePose3(X(k))
        spent[k - 1] = time.process_time() - begin
    return spent


def cost(count: int, per_sample: int, repeat: int) -> None:
    """Print the times with and without the magnetometer, the least of `repeat` runs in turn.

    The updates wait for memory, so that another load on the machine slows the faster graph more.
    """
    vehicle = Vehicle("survey", count / 4 + 0.1, 1, every=25, rate=100)
    print(f"{count} poses at 4 Hz, inertial samples at 100 Hz, magnetometer at 20 Hz, a block every 2.5 s")
    for wildfire in (1e-3, 1e-2):
        runs = [[drive(vehicle, path, wildfire, count) for path in ("none", "native")] for _ in range(repeat)]
        base, with_blocks = (min(of_path, key=np.sum) for of_path in zip(*runs, strict=True))
        for name, spent in (("without", base), ("native", with_blocks)):
            end = spent[-count // 10 :]
            whole, last = spent.sum() / base.sum() - 1, end.mean() / base[-count // 10 :].mean() - 1
            print(
                f"wildfire {wildfire:g}  {name:8s} total {spent.sum():6.2f} s ({whole:+.0%})   last tenth, per update: "
                f"mean {end.mean() * 1e3:.3f} ms ({last:+.0%}), median {np.median(end) * 1e3:.3f}, "
                f"largest {end.max() * 1e3:.1f}",
                flush=True,
            )
    for path in ("none", "native", "per sample"):
        spent = drive(vehicle, path, 1e-2, per_sample)
        print(
            f"{path:10s} {per_sample} poses: total {spent.sum():.2f} s, "
            f"last 50 updates {spent[-50:].mean() * 1e3:.2f} ms each"
        )


# --- accuracy --------------------------------------------------------------------------------------------


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
        native.add(graph, factor, values)
    for _ in range(20):
        values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        if not native.renew(graph, values):
            break
    return graph, values


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
        native.add(graph, factor, isam, values)
        remove = native.refresh(graph, isam)
        native.placed(isam.update(graph, values, remove).getNewFactorsIndices())
    for _ in range(10):
        graph = gtsam.NonlinearFactorGraph()
        remove = native.refresh(graph, isam, everything=True)
        native.placed(isam.update(graph, gtsam.Values(), remove).getNewFactorsIndices())
        if not remove:
            break
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
    commands = parser.add_subparsers(dest="command", required=True)
    option = commands.add_parser("cost")
    option.add_argument("--poses", type=int, default=10_000)
    option.add_argument("--per-sample", type=int, default=300)
    option.add_argument("--repeat", type=int, default=3, help="runs of which the least counts")
    option = commands.add_parser("accuracy")
    option.add_argument("--runs", type=int, default=40)
    option.add_argument("--motion", default="dive")
    option.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "cost":
        cost(arguments.poses, arguments.per_sample, arguments.repeat)
    elif arguments.command == "accuracy":
        accuracy(arguments.runs, arguments.motion, arguments.figure)


if __name__ == "__main__":
    main()
