"""What the compiled inner loops save: `calibrate` with them and in numpy, in one process, call by call.

    python benchmarks/compiled_loops.py

Prints for each motion the processor time of ten minutes at 10 Hz, in the median over the recordings of the fastest call
of each, their ratio, and the largest difference of hard iron, gyroscope bias and their log variances, in sigmas.
"""

import os

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read when numpy is loaded

import argparse
import time

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.factors.chain import compiled

MOTIONS = ("wide", "moderate", "low", "tiny")


def difference(one: mg.Calibration, other: mg.Calibration) -> float:
    """The largest difference of hard iron, gyroscope bias and their log variances, in sigmas."""
    assert one.covariance is not None
    assert other.covariance is not None
    variance = np.diag(other.covariance)[6:12]
    moved = np.concatenate([one.hard_iron - other.hard_iron, one.gyro_bias - other.gyro_bias])
    wider = np.log(np.diag(one.covariance)[6:12] / variance)
    return float(max(np.abs(moved / np.sqrt(variance)).max(), np.abs(wider).max()))


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--repeat", type=int, default=7)
    arguments = parser.parse_args()
    loops = compiled.loops
    if loops is None:
        raise SystemExit("the inner loops were not compiled: install with a C compiler at hand")
    mg.calibrate(mg.simulate("wide", seed=99).recording)  # imports and caches are not part of the time
    print(f"{'motion':10s}{'numpy ms':>10s}{'compiled ms':>13s}{'ratio':>8s}{'difference':>12s}")
    for motion in MOTIONS:
        fastest = np.full((2, arguments.seeds), np.inf)
        apart = 0.0
        for seed in range(arguments.seeds):
            recording = mg.simulate(motion, seed=seed).recording
            made: dict[int, mg.Calibration] = {}
            for _ in range(arguments.repeat):
                for which, chosen in enumerate((None, loops)):
                    compiled.loops = chosen
                    start = time.process_time()
                    made[which] = mg.calibrate(recording)
                    fastest[which, seed] = min(fastest[which, seed], time.process_time() - start)
            apart = max(apart, difference(made[1], made[0]))
        numpy, fast = np.median(fastest, axis=1) * 1e3
        ratio = np.median(fastest[0] / fastest[1])
        print(f"{motion:10s}{numpy:10.1f}{fast:13.1f}{ratio:8.2f}{apart:12.0e}", flush=True)
    compiled.loops = loops


if __name__ == "__main__":
    main()
