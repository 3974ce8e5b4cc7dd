"""MAGYC-IFG over a mission of hours: ours, compressed and as published, and `magyc_ifg` of the authors' package.

    pip install magyc==1.0.0 "numpy<2"        # beside this package, in an environment of its own
    python benchmarks/incremental.py [--hours 10] [--published MINUTES] [--peer MINUTES]

Per window of one second: median time in the first ten minutes and in the last hour, and how much memory grew after
the first hour. As published, every update linearises all factors again, so it is run for minutes only; the peer,
which updates every tenth window, likewise. Times are of the process, so that others on the machine do not count.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from magyc_gtsam import OnlineCalibrator, Simulation, simulate

RATE = 10
BLOCK = RATE  # samples handed over at a time: one window


def resident() -> float:
    """MB of this process that lie in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def online(simulation: Simulation, **options: object) -> tuple[np.ndarray, list[float]]:
    """s per window, and MB after every hour; the calibration is read once a minute as a vehicle would."""
    at = simulation.recording
    calibrator = OnlineCalibrator("magyc-ifg", estimate="current", **options)
    windows = len(at.time) // BLOCK
    took, memory = np.zeros(windows), []  # set aside, not to count as the method's memory
    for window in range(windows):
        rows = slice(window * BLOCK, (window + 1) * BLOCK)
        began = time.process_time()
        calibrator.update(at.time[rows], at.magnetic_field[rows], at.angular_rate[rows])
        took[window] = time.process_time() - began
        if window % 60 == 59:
            assert calibrator.progress.windows > 0
        if window % 3600 == 3599:
            memory.append(resident())
    error = np.linalg.norm(calibrator.calibration.hard_iron - simulation.truth.hard_iron) * 1e7
    print(f"{'':30}hard iron off by {error:.2f} mG at the end")
    return took, memory


def told(name: str, took: np.ndarray, memory: list[float], first: int = 600, last: int = 3600) -> None:
    """One line."""
    early, late = 1e3 * np.median(took[:first]), 1e3 * np.median(took[-min(last, first) :])
    grown = f"{memory[-1] - memory[0]:+.2f} MB after hour 1" if len(memory) > 1 else ""
    print(
        f"{name:30}{len(took):6} windows  first {early:7.3f} ms  last {late:7.3f} ms  ×{late / early:.2f}  {grown}"
    )


def peer(minutes: int) -> None:
    """Their total over twice and four times the data: the cost of a window as the mission grows."""
    from magyc import magyc_ifg

    for factor in (1, 2, 4):
        simulation = simulate("wide", duration=60 * minutes * factor, rate=RATE, seed=0)
        at = simulation.recording
        began = time.process_time()
        hard_iron, *_ = magyc_ifg(at.magnetic_field * 1e4, np.array(at.angular_rate), at.time, RATE)
        took = time.process_time() - began
        error = np.linalg.norm(np.ravel(hard_iron) * 1e-4 - simulation.truth.hard_iron) * 1e7
        windows = 60 * minutes * factor
        print(
            f"{'magyc_ifg of magyc 1.0.0':30}{windows:6} windows  {1e3 * took / windows:7.3f} ms each, "
            f"every tenth updated; hard iron off by {error:.2f} mG"
        )


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--hours", type=float, default=10.0)
    arguments.add_argument("--published", type=int, default=10, metavar="MINUTES")
    arguments.add_argument("--peer", type=int, default=10, metavar="MINUTES")
    given = arguments.parse_args()
    simulation = simulate("dive", duration=3600 * given.hours, rate=RATE, seed=0)
    told("magyc-ifg, compressed", *online(simulation))
    short = simulate("wide", duration=60 * given.published, rate=RATE, seed=0)
    took, memory = online(short, compressed=False)
    told("magyc-ifg, as published", took, memory, first=60)
    peer(given.peer)


if __name__ == "__main__":
    main()
