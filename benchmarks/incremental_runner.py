"""What `runners.Incremental` costs beside the `ISAM2` that it drives, update by update.

    python benchmarks/incremental_runner.py --poses 1000
    python benchmarks/incremental_runner.py --poses 10000

Poses one by one, each with odometry to the one before and a position fix every ten; both solvers get the same factors,
relinearise at 0.01 by Gauss-Newton, and give the estimate of the newest pose, in one process and in alternating order
(the second one finds its state out of the cache).
"""

import argparse
import time

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from magyc_gtsam.runners import Incremental

ODOMETRY = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.002, 0.002, 0.01, 0.02, 0.02, 0.02]))
PRIOR = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
FIX = gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
THRESHOLD = 0.01


def additions(poses: int, seed: int = 0):
    """(factors, initial value) of each pose."""
    random = np.random.default_rng(seed)
    true = guess = gtsam.Pose3()
    for k in range(poses):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if k == 0:
            graph.push_back(gtsam.PriorFactorPose3(X(0), true, PRIOR))
        else:
            step = gtsam.Pose3.Expmap(np.array([0.0, 0.0, 0.1 * np.sin(k / 30), 0.5, 0.0, 0.0]))
            read = step.compose(gtsam.Pose3.Expmap(random.normal(size=6) * ODOMETRY.sigmas()))
            true, guess = true.compose(step), guess.compose(read)
            graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), read, ODOMETRY))
        if k % 10 == 0:
            graph.push_back(gtsam.GPSFactor(X(k), true.translation() + 0.5 * random.normal(size=3), FIX))
        values.insert(X(k), guess)
        yield graph, values


def isam2() -> gtsam.ISAM2:
    """As `Incremental` sets it up."""
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams())
    parameters.setRelinearizeThreshold(THRESHOLD)
    parameters.relinearizeSkip = 1
    return gtsam.ISAM2(parameters)


def run(poses: int) -> tuple[np.ndarray, float]:
    """Seconds of each update (poses, 2) of both, and by how much their estimates differ."""
    plain, ours = isam2(), Incremental("gauss-newton", relinearize_threshold=THRESHOLD)
    spent = np.zeros((poses, 2))
    for k, (graph, values) in enumerate(additions(poses)):
        for which in (0, 1) if k % 2 else (1, 0):
            begun = time.process_time()
            if which == 0:
                plain.update(graph, values)
                plain.calculateEstimatePose3(X(k))
            else:
                result = ours.update(graph, values)
            spent[k, which] = time.process_time() - begun
        assert result.updated, result.message
    return spent, plain.calculateEstimate().localCoordinates(ours.values).norm()


def main() -> None:
    """Print milliseconds an update of both, in all and over the last tenth."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=1, help="runs, of which each update's least time counts")
    given = parser.parse_args()
    runs = [run(given.poses) for _ in range(given.repeats)]
    spent = np.min([spent for spent, _ in runs], axis=0)
    for name, rows in (("in all", spent), ("last tenth", spent[-given.poses // 10 :])):
        a, b = 1e3 * rows.mean(axis=0)
        print(f"{given.poses} poses, {name}: ISAM2 {a:.3f} ms an update, Incremental {b:.3f} ms, x{b / a:.2f}")
    print(f"the two estimates differ by {runs[-1][1]:.1e}")


if __name__ == "__main__":
    main()
