"""Wrong starts, disturbances, steps and a wrong mounting in an iSAM2 graph: what the magnetometer costs and says.

    python benchmarks/slam_health.py starts            # headings 0 to 180 degrees off, native, Python, without
    python benchmarks/slam_health.py words             # what is named, and when
    python benchmarks/slam_health.py clean             # how many clean drives raise an alarm

A dive of an odometry–inertial graph with a position fix every 10 s and a block of 40 samples every 2 s.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, H, M, V, X

from magyc_gtsam.factors import KeyframeField, NativeFactors, keyframe_field_factor, mounting_prior, vech
from magyc_gtsam.factors.heading_pull import heading_sigma

sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
from vehicle import Vehicle

UNIT = 50e-6  # T per unit of the hard iron
NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])
ISOTROPIC = gtsam.noiseModel.Isotropic.Sigma


class Drive:
    """A dive in iSAM2 with a position fix every 10 s and a block every 2 s."""

    def __init__(
        self, seed, heading=0.0, duration=60.05, prior=0.5, fixes=True, mounting=None, magnetometer=True, **options
    ):
        self.magnetometer = magnetometer
        self.vehicle = vehicle = Vehicle("dive", duration, seed, every=20)
        self.options, self.mounting = options, mounting
        self.random = np.random.default_rng(seed)
        self.field, self.world = (
            np.array(vehicle.recording.magnetic_field),
            vehicle.field,
        )  # measured, held by blocks
        self.heading, self.prior, self.fixes = heading, prior, fixes
        self.renew_at = np.inf  # s, from which on blocks are on new variables of the calibration

    def start(self):
        graph, values = self.vehicle.start(np.radians(self.heading))
        others = gtsam.NonlinearFactorGraph()
        for i in range(graph.size()):
            factor = graph.at(i)
            if isinstance(factor, gtsam.PriorFactorPose3):
                noise = gtsam.noiseModel.Diagonal.Sigmas(np.r_[0.05, 0.05, self.prior, 0.1, 0.1, 0.1])
                factor = gtsam.PriorFactorPose3(X(0), values.atPose3(X(0)), noise)
            others.push_back(factor)
        if not self.magnetometer:
            return others, values
        self.add_calibration(others, values, 0)
        if self.mounting is not None:
            others.push_back(mounting_prior(M(0), None, self.mounting))
            values.insert(M(0), gtsam.Rot3())
        return others, values

    def add_calibration(self, graph, values, node):
        graph.addPriorVector(A(node), NO_IRON, ISOTROPIC(6, 0.3))
        graph.addPriorPoint3(H(node), np.zeros(3), ISOTROPIC(3, 1.0))
        values.insert(A(node), NO_IRON)
        values.insert(H(node), np.zeros(3))

    def step(self, isam, k):
        vehicle, recording = self.vehicle, self.vehicle.recording
        bias = isam.calculateEstimateConstantBias(B(k - 1))
        graph, values = vehicle.step(
            k, isam.calculateEstimatePose3(X(k - 1)), isam.calculateEstimateVector(V(k - 1)), bias
        )
        if self.fixes and k % 10 == 0:
            fix = vehicle.poses[k].translation() + self.random.normal(size=3)
            graph.push_back(gtsam.GPSFactor(X(k), fix, ISOTROPIC(3, 1.0)))
        if self.magnetometer and k % 2 == 0:
            rows = slice((k - 2) * 20, k * 20 + 1)
            block = KeyframeField.from_samples(
                (recording.time[rows][1:], self.field[rows][1:]),
                (recording.time[rows], recording.angular_rate[rows]),
                recording.time[k * 20],
                bias=bias.gyroscope(),
            )
            node = int(k >= self.renew_at)
            if node and not isam.valueExists(A(1)):
                self.add_calibration(graph, values, node)
            keys = {"gyro_bias_key": B(k)} | ({} if self.mounting is None else {"mounting_key": M(0)})
            graph.push_back(
                keyframe_field_factor(
                    X(k), A(node), H(node), block, 1e-6, field=self.world, field_unit=UNIT, **keys, **self.options
                )
            )
        return graph, values

    def run(self, **native):
        settings = gtsam.ISAM2Params()
        settings.setFactorization("QR")
        settings.setRelinearizeThreshold(0.05)
        settings.relinearizeSkip = 1
        isam, self.native = gtsam.ISAM2(settings), NativeFactors(**native)
        self.native.update(isam, *self.start())
        self.words, self.waiting = [], []
        for k in range(1, len(self.vehicle.poses)):
            self.native.update(isam, *self.step(isam, k))
            self.words.append(self.native.health)
            self.waiting.append(self.native.waiting)
        self.native.settle(isam)
        self.isam, self.values = isam, isam.calculateEstimate()
        return self

    @property
    def heading_error(self):
        return self.vehicle.heading_error(self.values, len(self.vehicle.poses) // 2)

    @property
    def heading_sigma(self):
        """Degrees, root mean square of what the graph states over the poses of `heading_error`."""
        keys = [X(k) for k in range(len(self.vehicle.poses) // 2, len(self.vehicle.poses))]
        sigmas = [heading_sigma(self.values, key, self.isam.marginalCovariance(key)) for key in keys]
        return np.degrees(np.sqrt(np.mean(np.square(sigmas))))

    @property
    def error(self):
        truth, strength = self.vehicle.simulation.truth, np.linalg.norm(self.vehicle.field)
        true = np.r_[vech(truth.soft_iron) * truth.field_strength / strength, truth.hard_iron / UNIT]
        return np.r_[self.values.atVector(A(0)), self.values.atPoint3(H(0))] - true

    @property
    def nees(self):
        covariance = self.isam.jointMarginalCovariance([A(0), H(0)]).fullMatrix()
        return self.error @ np.linalg.solve(covariance, self.error)


METHODS = {"without": {}, "native": {}, "python": {"quadratic": False}}


def starts(seeds: range, step: int, methods: list[str]) -> None:
    """Print heading errors and NEES by how far the heading is off at the start.

    By chance alone a graph whose errors are normal with the standard deviation a is worse than one with b in a share of
    2/π atan(a / b) of all runs; more says something only if the excess is above what the graph itself states.
    """
    print(f"{len(seeds)} seeds each, 60 s; root mean square heading error over the second half, worst; NEES (9)")
    band, total = 1.96 * np.sqrt(2 * 9 / len(seeds)), {}
    for heading in range(0, 181, step):
        parts, base = [f"{heading:4d}°"], None
        for name in methods:
            drives = [Drive(seed, heading, magnetometer=name != "without").run(**METHODS[name]) for seed in seeds]
            error = np.array([run.heading_error for run in drives])
            sigma = np.array([run.heading_sigma for run in drives])
            text = f"{name} {rms(error):.2f}° (worst {error.max():.2f}°; stated {rms(sigma):.2f}°"
            if name == "without":
                base = error
            else:
                consistent = [run for run in drives if run.native.health.status == "consistent"]
                nees = np.mean([run.nees for run in consistent]) if consistent else np.nan
                text += f"; NEES {nees:.2f} of {len(consistent)} consistent"
                if base is not None:
                    excess = error - base
                    total.setdefault(name, []).append(np.stack([error, base, sigma]))
                    text += f"; worse than without {np.sum(excess > 0)}, above sigma {np.sum(excess > sigma)}"
            parts.append(text + ")")
        print("   ".join(parts), flush=True)
    print(f"band of the NEES {9 - band:.2f} to {9 + band:.2f}")
    for name, rows in total.items():
        error, base, sigma = np.concatenate(rows, axis=1)
        excess = error - base
        print(
            f"{name}: worse than without in {np.sum(excess > 0)} of {len(error)}, by chance "
            f"{2 / np.pi * np.arctan(rms(error) / rms(base)) * len(error):.1f}; by more than its own sigma in "
            f"{np.sum(excess > sigma)}; largest excess {excess.max():.2f}°, {(excess / sigma).max():.2f} sigma"
        )


def rms(numbers: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(numbers))))


def words(seeds: range) -> None:
    """Print what is named and when."""
    begin = 75.0
    mountings = "mounting of 3°, held", "mounting of 3°, a variable"
    for kind in ("disturbance of 15 s", "step of 5 µT", *mountings, "field turned by 5°"):
        first, last = [], Counter()
        for seed in seeds:
            drive = Drive(seed, duration=200.05, mounting=np.radians(0.5) if "variable" in kind else None)
            random, time = np.random.default_rng(1000 + seed), drive.vehicle.recording.time
            axis = random.normal(size=3)
            axis /= np.linalg.norm(axis)
            if kind.startswith("field"):
                drive.world = gtsam.Rot3.Rz(np.radians(5) * np.sign(axis[2])).rotate(drive.vehicle.field)
            elif kind.startswith("mounting"):
                truth = drive.vehicle.simulation.truth
                turned = gtsam.Rot3.Expmap(np.radians(3) * axis).matrix()
                iron = truth.soft_iron @ turned.T @ np.linalg.inv(truth.soft_iron)
                drive.field = (drive.field - truth.hard_iron) @ iron.T + truth.hard_iron
            else:
                end = begin + 15 if kind.startswith("disturbance") else np.inf
                drive.field[(time > begin) & (time <= end)] += 5e-6 * axis
            drive.run()
            since = 0.0 if kind.startswith(("mounting", "field")) else begin
            name = kind.split()[0]
            at = [k for k, health in enumerate(drive.words, 1) if name in health.by and health.status != "waiting"]
            named = [
                k
                for k, health in enumerate(drive.words, 1)
                if name in health.by and health.status == "inconsistent"
            ]
            first.append((at[0] - since if at else np.nan, named[0] - since if named else np.nan))
            last[drive.words[-1].by.split(" of ")[0] or str(drive.words[-1].status)] += 1
        suspect, named = np.array(first).T
        print(
            f"{kind}: suspected in {np.isfinite(suspect).sum()} of {len(seeds)} (median {np.nanmedian(suspect):.0f} s, "
            f"latest {np.nanmax(suspect):.0f} s), inconsistent in {np.isfinite(named).sum()} (median "
            f"{np.nanmedian(named) if np.isfinite(named).any() else np.nan:.0f} s, latest "
            f"{np.nanmax(named) if np.isfinite(named).any() else np.nan:.0f} s); last words {dict(last)}",
            flush=True,
        )


def clean(seeds: range, minutes: float) -> None:
    """Print false alarms of clean drives, drive by drive."""
    alarms = 0
    for count, seed in enumerate(seeds, 1):
        drive = Drive(seed, duration=60 * minutes + 0.05).run()
        said = [health for health in drive.words if health.status in ("suspect", "inconsistent")]
        alarms += bool(said)
        print(
            f"seed {seed}: {said[0] if said else drive.words[-1]}, NEES {drive.nees:.1f}; {alarms} of {count} drives "
            f"with an alarm, {count * minutes / 60:.1f} h",
            flush=True,
        )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    option = commands.add_parser("starts")
    option.add_argument("--seeds", type=int, default=10)
    option.add_argument("--step", type=int, default=30)
    option.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    option = commands.add_parser("words")
    option.add_argument("--seeds", type=int, default=20)
    option = commands.add_parser("clean")
    option.add_argument("--seeds", type=int, default=20)
    option.add_argument("--minutes", type=float, default=30.0, help="of each clean drive")
    for option in commands.choices.values():
        option.add_argument("--first", type=int, default=0, help="first seed")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    if arguments.command == "starts":
        starts(seeds, arguments.step, arguments.methods)
    elif arguments.command == "words":
        words(seeds)
    else:
        clean(seeds, arguments.minutes)


if __name__ == "__main__":
    main()
