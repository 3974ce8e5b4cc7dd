"""Processor time of the gap workflow on a 10-minute log at 10 Hz: one scan of all candidates, and the whole loop.

    python benchmarks/gap.py

The scan holds the linearisation, some two thousand columns whitened at once, and the bootstrap thresholds of every
candidate; the loop begins with the calibration and ends with the metrics. Run it with OMP_NUM_THREADS=1 for one core.
"""

import argparse
import time

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.scores.score import DRAWS, scan
from magyc_gtsam.simulation.environment import CHANNELS


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3, help="runs of each; the least counts")
    repeat = parser.parse_args().repeat
    print(
        f"{'motion':12s}{'windows':>9s}{'columns':>9s}{'scan, s':>9s}{'loop: nothing, s':>18s}{'loop: delay, s':>16s}"
    )
    for motion in ("wide", "moderate"):
        recording = mg.simulate(motion, seed=1, channels=CHANNELS).recording
        late = mg.simulate(motion, seed=1, delay=0.04, channels=CHANNELS).recording
        twin = base_model(recording, None, short_term_noise(recording)).twin
        scores, _, _ = scan(twin, tuple(TERMS), np.random.default_rng(0))
        columns = sum(len(v.unit) for s in scores for v in s.variants)
        least = [np.inf, np.inf, np.inf]
        for _ in range(repeat):
            for index, run in enumerate(
                (
                    lambda t=twin: scan(t, tuple(TERMS), np.random.default_rng(0)),
                    lambda r=recording: mg.find_gap(r),
                    lambda r=late: mg.find_gap(r),
                )
            ):
                began = time.process_time()
                run()
                least[index] = min(least[index], time.process_time() - began)
        print(f"{motion:12s}{twin.n:9d}{columns:9d}{least[0]:9.2f}{least[1]:18.2f}{least[2]:16.2f}")
    print(f"{DRAWS} draws for the thresholds")


if __name__ == "__main__":
    main()
