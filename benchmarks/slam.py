"""What calibration inside a SLAM graph costs and gains (docs/slam.md).

    python benchmarks/slam.py cost                # a graph of 10,000 poses in iSAM2, with and without
    python benchmarks/slam.py accuracy            # Monte-Carlo: against `smoother`, NEES, iSAM2 against batch, heading

`accuracy --figure FILE` draws the heading errors. Times are process times; compare them within one run.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X

import magyc_gtsam as mg
from magyc_gtsam.factors import (
    KeyframeField,
    NativeFactors,
    calibration_prior,
    hard_iron_walk,
    keyframe_field_factor,
    magnetometer_factor,
    soft_iron_walk,
    unvech,
    vech,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from vehicle import CURRENT, Vehicle

NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])
UNIT = 50e-6  # T per unit of the hard iron
SIGMA = 1e-6  # T, magnetometer
GYROSCOPE = 5e-3  # rad/s, per sample
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

FIX = 40  # keyframes per position fix
VEHICLES = {"survey": "hardly turns", "wide": "turns all the time"}


@dataclass(frozen=True)
class Layout:
    """Where the magnetometer's samples go: keyframes per block, keyframes per calibration node, its walk."""

    block: int = 40
    node: int = 240
    carried: bool = False  # the next node starts from the last one's marginal as a prior, not by a walk


class Run:
    """One graph in iSAM2, and the process time of each of its updates."""

    def __init__(self, vehicle: Vehicle, path: str, layout: Layout, wildfire: float, count: int) -> None:
        self.vehicle, self.path, self.layout = vehicle, path, layout
        self.isam, self.native, self.node = isam2(wildfire), NativeFactors(), 0
        self.random, self.spent = np.random.default_rng(0), np.zeros(count)
        graph, values = vehicle.start(heading_error=0.0)
        if path != "none":
            calibration_start(graph, values)
        self.isam.update(graph, values)

    def step(self, k: int) -> None:
        """Keyframe k."""
        begin = time.process_time()
        isam, vehicle = self.isam, self.vehicle
        pose, velocity = isam.calculateEstimatePose3(X(k - 1)), isam.calculateEstimateVector(V(k - 1))
        bias = isam.calculateEstimateConstantBias(B(k - 1))
        graph, values = vehicle.step(k, pose, velocity, bias)
        if k % FIX == 0:
            fix = vehicle.poses[k].translation() + self.random.normal(size=3)
            graph.push_back(gtsam.GPSFactor(X(k), fix, ISOTROPIC(3, 1.0)))
        if self.path == "native":
            self.calibrate(k, graph, values, bias)
            self.native.update(isam, graph, values)
        else:
            if self.path == "per sample":
                for row in range((k - 1) * vehicle.every + 5, k * vehicle.every + 1, 5):
                    field = vehicle.recording.magnetic_field[row]
                    graph.push_back(
                        magnetometer_factor(X(k), A(0), H(0), field, SIGMA, field=vehicle.field, field_unit=UNIT)
                    )
            isam.update(graph, values)
        isam.calculateEstimatePose3(X(k))
        self.spent[k - 1] = time.process_time() - begin

    def calibrate(
        self, k: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, bias: gtsam.imuBias.ConstantBias
    ) -> None:
        """The nodes and blocks of keyframe k."""
        isam, vehicle, node = self.isam, self.vehicle, self.node
        if k % self.layout.node == 0:
            elapsed = self.layout.node * vehicle.every / vehicle.rate
            last = [isam.calculateEstimateVector(A(node)), isam.calculateEstimatePoint3(H(node))]
            values.insert(A(k), last[0])
            values.insert(H(k), last[1])
            if self.layout.carried:
                spread = isam.jointMarginalCovariance([A(node), H(node)]).fullMatrix()
                spread += elapsed / 3600 * np.diag(np.r_[np.full(6, 1e-6), np.full(3, (0.1e-6 / UNIT) ** 2)])
                unit = np.r_[np.ones(6), np.full(3, UNIT)]
                covariance = spread * unit * unit[:, None]
                graph.push_back(
                    calibration_prior(A(k), H(k), unvech(last[0]), last[1] * UNIT, covariance, field_unit=UNIT)
                )
            else:
                graph.push_back(soft_iron_walk(A(node), A(k), elapsed, 1e-3))
                graph.push_back(hard_iron_walk(H(node), H(k), elapsed, 0.1e-6, field_unit=UNIT))
            self.node = k
        if k % self.layout.block == 0:
            samples = block(vehicle, k, self.layout.block, 2, bias.gyroscope())
            keys = (X(k), A(self.node), H(self.node))
            options = {"field": vehicle.field, "gyroscope_noise": GYROSCOPE, "field_unit": UNIT}
            graph.push_back(keyframe_field_factor(*keys, samples, SIGMA, gyro_bias_key=B(k), **options))


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


def cost(motion: str, count: int, layout: Layout, wildfire: float, repeats: int, seed: int) -> None:
    """Print what the magnetometer adds at 1,000, 5,000 and 10,000 poses; both graphs grow in turn, pose by pose.

    Each update's time is the least of `repeats` runs, which do the same: what others on the machine add goes.
    """
    vehicle = Vehicle(motion, count / 4 + 0.1, seed, every=25, rate=100)
    print(
        f"{motion} ({VEHICLES.get(motion, '')}), {count} poses at 4 Hz, inertial samples at 100 Hz, "
        f"{layout.block * 25 // 2} magnetometer samples per block of {layout.block / 4:g} s, node every "
        f"{layout.node / 4:g} s{', carried over' if layout.carried else ''}, wildfire {wildfire:g}, {repeats} runs"
    )
    spent = np.full((2, count), np.inf)
    for _ in range(repeats):
        runs = [Run(vehicle, path, layout, wildfire, count) for path in ("none", "native")]
        for k in range(1, count + 1):
            for run in runs if k % 2 else reversed(runs):
                run.step(k)
        spent = np.minimum(spent, [run.spent for run in runs])
    for k in (k for k in (1000, 5000, 10_000) if k <= count):
        base, own = spent[:, :k]
        tenth = k // 10
        print(
            f"  {k:6d} poses: {base.sum():6.2f} → {own.sum():6.2f} s (×{own.sum() / base.sum():.2f}); last tenth "
            f"{base[-tenth:].mean() * 1e3:.2f} → {own[-tenth:].mean() * 1e3:.2f} ms each "
            f"(×{own[-tenth:].mean() / base[-tenth:].mean():.2f})"
        )
    added, at = 1e3 * (spent[1] - spent[0]), np.arange(1, count + 1) % layout.block
    with_block, after, others = (added[rows] for rows in (at == 0, at == 1, at > 1))
    print(
        f"  added on the mean: {with_block.mean():.2f} ms in an update with a block, {after.mean():.2f} ms in the "
        f"next one, {others.mean():.3f} ms in others (median {np.median(others):.3f} ms)"
    )
    run, native = runs[1], runs[1].native
    values = run.isam.calculateEstimate()
    print(
        f"  {len(native)} blocks, {native.replaced} replaced; {native.health}; off by "
        f"{vehicle.heading_error(values, count // 2):.2f}° (heading, second half) and "
        f"{1e9 * np.linalg.norm(UNIT * values.atPoint3(H(run.node)) - vehicle.simulation.truth.hard_iron):.0f} nT"
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
    commands = parser.add_subparsers(dest="command", required=True)
    option = commands.add_parser("cost")
    option.add_argument("--poses", type=int, default=10_000)
    option.add_argument("--motion", default="survey", help=f"one of {', '.join(VEHICLES)}, or any other")
    option.add_argument("--block", type=int, default=Layout.block, help="keyframes per block")
    option.add_argument("--node", type=int, default=Layout.node, help="keyframes per calibration node")
    option.add_argument("--carried", action="store_true", help="nodes start from a marginal, not by a walk")
    option.add_argument("--wildfire", type=float, default=0.01)
    option.add_argument("--seed", type=int, default=1)
    option.add_argument("--repeats", type=int, default=1, help="runs, of which each update's least time counts")
    option = commands.add_parser("accuracy")
    option.add_argument("--runs", type=int, default=40)
    option.add_argument("--motion", default="dive")
    option.add_argument("--figure", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "cost":
        layout = Layout(arguments.block, arguments.node, arguments.carried)
        cost(arguments.motion, arguments.poses, layout, arguments.wildfire, arguments.repeats, arguments.seed)
    elif arguments.command == "accuracy":
        accuracy(arguments.runs, arguments.motion, arguments.figure)


if __name__ == "__main__":
    main()
