"""Processor time of the gap workflow on a 10-minute log at 10 Hz: one look at all candidates, and the whole loop.

    python benchmarks/gap.py

The look holds some two thousand whitened columns of all candidates and their evidence beside one model; the loop begins
with the calibration and ends with the metrics. Run it with OMP_NUM_THREADS=1 for one core.
"""

import argparse
import time

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates
from magyc_gtsam.gap.evidence.weighing import weigh
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.simulation.environment import CHANNELS


def look(twin: Twin) -> int:
    """Weigh all candidates beside a model, and return their number of columns."""
    candidates = Candidates.of(twin, tuple(TERMS))
    weigh(candidates, Beside.of_model(twin))
    return len(candidates.columns)


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3, help="runs of each; the least counts")
    repeat = parser.parse_args().repeat
    print(
        f"{'motion':12s}{'windows':>9s}{'columns':>9s}{'look, s':>9s}{'loop: nothing, s':>18s}{'loop: delay, s':>16s}"
    )
    for motion in ("wide", "moderate"):
        recording = mg.simulate(motion, seed=1, channels=CHANNELS).recording
        late = mg.simulate(motion, seed=1, delay=0.04, channels=CHANNELS).recording
        twin = base_model(recording, None, short_term_noise(recording)).twin
        columns = look(twin)
        least = [np.inf, np.inf, np.inf]
        for _ in range(repeat):
            for index, run in enumerate(
                (
                    lambda t=twin: look(t),
                    lambda r=recording: mg.find_gap(r),
                    lambda r=late: mg.find_gap(r),
                )
            ):
                began = time.process_time()
                run()
                least[index] = min(least[index], time.process_time() - began)
        print(f"{motion:12s}{twin.n:9d}{columns:9d}{least[0]:9.2f}{least[1]:18.2f}{least[2]:16.2f}")


if __name__ == "__main__":
    main()
