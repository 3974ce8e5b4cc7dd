"""Steps in hard iron wherever they are in a log: found by `OnlineCalibrator`, and what it says at the end.

    python benchmarks/online_steps.py anywhere [--runs 2] [--seed 100]   simulated, by size and place in the log
    python benchmarks/online_steps.py cuts FOLDER                        BROAD 32, 33, 35, a magnet on and off, in parts

FOLDER as for `online.py real`, with `real/` as in real_honesty.py. By the optical attitude the magnet arrives at 38.1,
40 to 43 and 42.5 s in the three, and is taken off at 95.0, 98.2 and 99.4 s.
"""

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from online import MOTIONS, feed
from real_logs import read_mcap, read_npz

import magyc_gtsam as mg

SIZES = (2, 10, 50)  # µT
PLACES = (0.04, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95)  # of the duration
DURATION = 400.0  # s
ARRIVES = {32: (38.1, 1.0), 33: (41.5, 2.0), 35: (42.5, 1.0)}  # s, by optics, and how long it takes
REMOVED = {32: (95.0, 1.0), 33: (98.2, 1.0), 35: (99.4, 1.0)}
CUTS = (
    *((32, cut) for cut in ((0, 167), (0, 110), (10, 130), (20, 125), (25, 104), (28, 115), (30, 120), (33, 115))),
    *((32, cut) for cut in ((50, 125), (70, 130), (85, 140))),
    *((33, cut) for cut in ((0, 169), (0, 120), (20, 115), (30, 112), (50, 130), (75, 140))),
    *((35, cut) for cut in ((0, 164), (0, 120), (20, 115), (30, 115), (50, 130), (75, 140))),
)


def main():
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    simulated = commands.add_parser("anywhere")
    simulated.add_argument("--runs", type=int, default=2)
    simulated.add_argument("--seed", type=int, default=100)
    commands.add_parser("cuts").add_argument("folder", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "cuts":
        cuts(arguments.folder)
    else:
        anywhere(arguments.runs, arguments.seed)


def anywhere(runs, first):
    """Steps in a random direction."""
    print("  µT  place  found  other  converged  wrong by over 3 sigma and 0.5 µT")
    for size in SIZES:
        for place in PLACES:
            counted = Counter()
            for motion in MOTIONS:
                for seed in range(first, first + runs):
                    counted.update(simulated_step(motion, size, place, seed))
            count = len(MOTIONS) * runs
            print(
                f"{size:4d}{place:7.2f}{counted['found']:4d}/{count}{counted['other']:6d}"
                f"{counted['converged']:11d}{counted['wrong']:7d}",
                flush=True,
            )


def simulated_step(motion, size, place, seed):
    """What came of one log: counts."""
    random = np.random.default_rng([seed, int(place * 100), size])
    step = random.standard_normal(3)
    step *= size * 1e-6 / np.linalg.norm(step)
    at = DURATION * (place + random.uniform(-0.02, 0.02))
    simulation = mg.simulate(motion, duration=DURATION, seed=seed)
    recording = simulation.recording
    field = recording.magnetic_field + (recording.time >= at)[:, None] * step
    online = feed(mg.OnlineCalibrator(), replace(recording, magnetic_field=field), 2.0)
    near = [abs(change.time - at) < 3 + 4 * change.time_sigma for change in online.changes]
    counts = {"found": any(near), "other": len(near) - any(near), "converged": online.converged}
    if online.converged and online.calibration.converged:
        error = np.abs(online.calibration.hard_iron - simulation.truth.hard_iron - step)
        counts["wrong"] = bool((error > np.maximum(3 * online.calibration.sigma["hard_iron"], 0.5e-6)).any())
    return {name: int(value) for name, value in counts.items()}


def cuts(folder):
    """What is found in each cut, with its time, size and sigmas, and what is missing."""
    for trial, (start, end) in CUTS:
        recording = trial_of(folder, trial).between(start, end)
        online = feed(mg.OnlineCalibrator(), recording, 1.0)
        found = [
            f"{c.time:.1f} ± {c.time_sigma:.1f} s ({', '.join(f'{x * 1e6:.1f}' for x in c.step)}) µT"
            for c in online.changes
        ]
        missing = [
            f"{at:.1f} s"
            for at, takes in (ARRIVES[trial], REMOVED[trial])
            if start < at < end and not any(abs(c.time - at) < takes + 3 * c.time_sigma for c in online.changes)
        ]
        print(
            f"{trial} {start:3d} to {end:3d} s: {'; '.join(found)}  missing: {', '.join(missing) or 'none'}",
            flush=True,
        )


def trial_of(folder, trial):
    """The whole recording, its time from 0."""
    (path,) = [*folder.glob(f"broad_{trial}_*.mcap"), *(folder / "real").glob(f"broad_{trial}_*.npz")]
    return (read_npz(path) if path.suffix == ".npz" else read_mcap(path))[0]


if __name__ == "__main__":
    main()
