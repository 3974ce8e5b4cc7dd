"""`autocal` against the L2 ellipsoid fit, same process, same data; and where its time goes.

    python benchmarks/autocal_speed.py

The Autocal paper reports 0.303 s for its Cauchy variant and 0.002 s for its L2 fit on tracks of some 450 samples
(Table VI), a ratio of 151 in total; and 46 to 60 ms per iteration at 1,000 samples (section II-D7), 23 to 30
L2 fits. Printed are, by the number of samples N, the time of the L2 fit, and all others as multiples of it:
minima over repeated calls on samples of (35) to (38) with 5 % outliers. `--profile` adds cProfile's table.
"""

import argparse
import cProfile
import pstats
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.estimators.autocal.fit import autocal
from magyc_gtsam.estimators.ellipsoid.ellipsoid import fit_ellipsoid, standardise
from magyc_gtsam.estimators.ellipsoid.kok_schon import fit_kok_schon
from magyc_gtsam.estimators.ellipsoid.l1_ellipsoid import fit_l1_ellipsoid, l1_start
from magyc_gtsam.factors import KERNELS
from magyc_gtsam.study.autocal import synthetic

LARGEST_PROGRAM = 10_000  # samples of the semidefinite program that still take seconds


def least(function: Callable[..., Any], *arguments: Any, seconds: float) -> float:
    """Shortest time of a call within some `seconds` of trying, ms."""
    function(*arguments)
    times, end = [], time.perf_counter() + seconds
    while not times or time.perf_counter() < end:
        start = time.perf_counter()
        function(*arguments)
        times.append(time.perf_counter() - start)
    return min(times) * 1e3


def main() -> None:
    """Run and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=0.5, help="of repeated calls per figure")
    parser.add_argument("--profile", action="store_true", help="profile the Cauchy variant at N = 1,000")
    arguments = parser.parse_args()
    seconds = arguments.seconds

    heads = ["N", "L2 ms", "start", *KERNELS, "cauchy/iteration", "kok-schon", "L1 program"]
    print("".join(f"{head:>18s}" for head in heads))
    for n in (100, 1_000, 10_000, 100_000):
        samples = synthetic(1, samples=n, outliers=0.05)[0].magnetic_field
        l2 = least(fit_ellipsoid, samples, seconds=seconds)
        start = least(lambda m: l1_start(standardise(m)), samples, seconds=seconds)
        took = {kernel: least(autocal, samples, kernel, seconds=seconds) for kernel in KERNELS}
        iteration = (took["cauchy"] - start) / autocal(samples).iterations
        program = least(fit_l1_ellipsoid, samples, seconds=seconds) if n <= LARGEST_PROGRAM else np.nan
        figures = [start, *took.values(), iteration, least(fit_kok_schon, samples, seconds=seconds), program]
        print(f"{n:18,d}{l2:18.3f}" + "".join(f"{figure / l2:18.2f}" for figure in figures))

    print("\nAs methods of magyc_gtsam.calibrate, with covariance and verdict, N = 1,000:")
    recording = synthetic(1, outliers=0.05)[0]
    times = {m: least(mg.calibrate, recording, m, seconds=seconds) for m in ("ellipsoid", "autocal")}
    print(
        f"  ellipsoid {times['ellipsoid']:.2f} ms, autocal {times['autocal'] / times['ellipsoid']:.2f} times that"
    )

    if arguments.profile:
        samples = recording.magnetic_field
        profile = cProfile.Profile()
        profile.enable()
        for _ in range(300):
            autocal(samples)
        profile.disable()
        pstats.Stats(profile).sort_stats("cumulative").print_stats(16)


if __name__ == "__main__":
    main()
