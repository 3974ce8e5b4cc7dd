"""What calibration inside a SLAM graph costs (docs/slam_measured.md).

    python benchmarks/slam_cost.py                # a graph of 10,000 poses in iSAM2, with and without

Times are process times; compare them within one run.
"""

import argparse
import time
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, V, X
from slam_graph import ISOTROPIC, SIGMA, UNIT, block, calibration_start
from vehicle import Vehicle

from magyc_gtsam.factors import (
    NativeFactors,
    calibration_prior,
    hard_iron_walk,
    keyframe_field_factor,
    magnetometer_factor,
    soft_iron_walk,
    unvech,
)

FIX = 40  # keyframes per position fix
GYROSCOPE = 5e-3  # rad/s, per sample
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


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=10_000)
    parser.add_argument("--motion", default="survey", help=f"one of {', '.join(VEHICLES)}, or any other")
    parser.add_argument("--block", type=int, default=Layout.block, help="keyframes per block")
    parser.add_argument("--node", type=int, default=Layout.node, help="keyframes per calibration node")
    parser.add_argument("--carried", action="store_true", help="nodes start from a marginal, not by a walk")
    parser.add_argument("--wildfire", type=float, default=0.01)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=1, help="runs, of which each update's least time counts")
    arguments = parser.parse_args()
    layout = Layout(arguments.block, arguments.node, arguments.carried)
    cost(arguments.motion, arguments.poses, layout, arguments.wildfire, arguments.repeats, arguments.seed)


if __name__ == "__main__":
    main()
