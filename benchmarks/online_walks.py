"""A hard iron that walks at random, followed by the online smoother with the option and without.

python benchmarks/online_walks.py [--runs 20]
"""

import argparse
from itertools import pairwise

import numpy as np
from online import MOTIONS

import magyc_gtsam as mg


def walks(arguments):
    """A hard iron that walks at random by `--size` µT per √h, followed with the option and without."""
    runs, walk, hours = arguments.runs, arguments.size * 1e-6, arguments.hours
    print("hard iron, from its convergence on, every five minutes: rms error µT, stated µT, rms of error / stated")
    for motion in arguments.motion or MOTIONS:
        for option in ({"hard_iron_drift": walk}, {}):
            squares, stated, score, false = [], [], [], 0
            for seed in range(arguments.seed, arguments.seed + runs):
                simulation = mg.simulate(motion, duration=3600 * hours, seed=seed)
                recording, truth = simulation.recording, simulation.truth.hard_iron
                random = np.random.default_rng(10_000 + seed).standard_normal((len(recording.time), 3))
                moved = walk * np.cumsum(random * np.sqrt(np.median(np.diff(recording.time)) / 3600), axis=0)
                online, last = (
                    mg.OnlineCalibrator(**option),
                    np.searchsorted(recording.time, np.arange(300, 3600 * hours + 1, 300)),
                )
                for start, end in pairwise(np.concatenate([[0], last])):
                    rows = slice(start, end)
                    online.update(
                        recording.time[rows],
                        recording.magnetic_field[rows] + moved[rows],
                        recording.angular_rate[rows],
                    )
                    calibration = online.calibration
                    if calibration is not None and online.converged:
                        error = calibration.hard_iron - truth - moved[end - 1]
                        covariance = calibration.covariance[6:9, 6:9]
                        squares.append(error @ error / 3)
                        stated.append(np.trace(covariance) / 3)
                        score.append(error @ np.linalg.solve(covariance, error) / 3)
                false += len(online.changes)
            print(
                f"{motion:10s}{'with' if option else 'without':8s}{1e6 * np.sqrt(np.mean(squares)):8.3f}"
                f"{1e6 * np.sqrt(np.mean(stated)):8.3f}{np.sqrt(np.mean(score)):8.2f}"
                f"  ({runs} runs, {len(squares)} readings, steps {false})",
                flush=True,
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--hours", type=float, default=0.5)
    parser.add_argument("--size", type=float, default=2.0, help="µT per √h")
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--motion", action="append", choices=MOTIONS, help="only this one")
    walks(parser.parse_args())


if __name__ == "__main__":
    main()
