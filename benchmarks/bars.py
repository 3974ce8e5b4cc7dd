"""The bars of this package in one table: what is asked, what the code as it is reaches, in small editions.

    python benchmarks/bars.py [efficiency] [online] [blind] [kills] [--runs 20] [--edition 90] [--every 1] [--stops 3]

Before and after a change, on the same seeds, on a machine that is otherwise quiet for the kills:

- efficiency: `--runs` simulated recordings of ten minutes on each of four motions, error over the Cramér–Rao bound
  and mean NEES (`magyc-gtsam study efficiency`);
- online: a quarter as many, the end of an online run against `calibrate` (`online.py batch`);
- blind: the blind test of the gap workflow on the wide motion (`magyc-gtsam study gap`), a third as many recordings
  without an effect and at least one of each kind, or of these every third (`--every 3`); an edition that the workflow
  was tuned with says less;
- kills: `--stops` of each of SIGINT, SIGTERM and SIGKILL for every command (`kills.py`, POSIX only).

The exit code is 1 where a bar is missed. So few runs leave chance a part: a bar is taken as missed where the 95 %
interval of what was measured lies beyond it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.io import write_mcap
from magyc_gtsam.simulation import AMPLITUDES
from magyc_gtsam.study.efficiency import BLOCKS, efficiency

_BOUND = 1.10  # root-mean-square error over the Cramér–Rao bound, of each block of parameters
_APART = 0.05  # sigmas between the end of an online run and the batch


class Bar(NamedTuple):
    """One row: what is measured, the value with its unit, what is asked, and whether it is reached."""

    name: str
    value: str
    asked: str
    reached: bool


def at_the_bound(options: argparse.Namespace) -> Iterator[Bar]:
    """Efficiency and consistency of the covariance."""
    for motion in AMPLITUDES:
        found = efficiency(motion, options.runs)
        for block, ratio in found.ratio.items():
            size = BLOCKS[block].stop - BLOCKS[block].start
            chance = 1.96 / np.sqrt(2 * options.runs * size)
            yield Bar(f"{motion}: {block}", f"{ratio:.3f}", f"≤ {_BOUND}", ratio < _BOUND + chance)
        low, high = found.band
        # Beyond the noise the covariance holds what an instrument may do, which these have not: below is no miss.
        yield Bar(f"{motion}: NEES", f"{found.nees:.2f}", f"≤ {high:.2f} (band from {low:.2f})", found.nees < high)


def as_the_batch(options: argparse.Namespace) -> Iterator[Bar]:
    """The end of online runs."""
    from online import distance, feed

    for motion in AMPLITUDES:
        apart, steps = [], 0
        for seed in range(9000, 9000 + max(options.runs // 4, 1)):
            recording = mg.simulate(motion, seed=seed).recording
            online = feed(mg.OnlineCalibrator(), recording, 2.0)
            apart.append(distance(online.calibration, mg.calibrate(recording)))
            steps += len(online.changes)
        yield Bar(f"{motion}: online less batch, σ", f"{max(apart):.3f}", f"≤ {_APART}", max(apart) <= _APART)
        yield Bar(f"{motion}: false steps", f"{steps} of {len(apart)} runs", "0", steps == 0)


def blind(options: argparse.Namespace) -> Iterator[Bar]:
    """The gates of the blind test."""
    from magyc_gtsam.blindtest.detectability import stands_out
    from magyc_gtsam.blindtest.gates import gates
    from magyc_gtsam.blindtest.heading import heading_errors
    from magyc_gtsam.blindtest.running import run
    from magyc_gtsam.blindtest.scenarios import SETS, scenarios
    from magyc_gtsam.blindtest.scoring import score

    with tempfile.TemporaryDirectory() as folder:
        hidden = scenarios("wide", max(options.runs // 3, 1), options.edition, SETS[:-1])
        run(Path(folder), hidden[:: options.every])
        for gate in gates(score(Path(folder), heading_errors, stands_out)):
            low, high = gate.interval
            reached = high >= gate.limit if gate.at_least else low <= gate.limit
            counted = f"{gate.share:.3g} ({gate.count} of {gate.total})"
            yield Bar(f"gap, {gate.name}", counted, f"{'≥' if gate.at_least else '≤'} {gate.limit:g}", reached)


def stopped(options: argparse.Namespace) -> Iterator[Bar]:
    """Commands stopped at random moments."""
    import kills

    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.mcap"
        write_mcap(log, mg.simulate("wide", duration=60, rate=10, seed=0).recording)
        mg.calibrate(mg.read(log))  # imports what it needs
        for name in kills.COMMANDS:
            kills.undisturbed(name, log)
            whole, length = kills.undisturbed(name, log)
            with contextlib.redirect_stdout(io.StringIO()):
                found = [
                    violation
                    for number in kills.SIGNALS
                    for violation in kills.series(name, number, options.stops, log, whole, length)
                ]
            said = f"{len(found)} of {3 * options.stops} stops" + "".join(f"; {v}" for v in sorted(set(found)))
            yield Bar(f"{name} stopped: violations", said, "0", not found)


BARS = {"efficiency": at_the_bound, "online": as_the_batch, "blind": blind, "kills": stopped}


def main() -> int:
    """Measure and print row by row."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bars", nargs="*", metavar="BAR", help=f"of {', '.join(BARS)}; default all")
    parser.add_argument("--runs", type=int, default=20, help="recordings a motion")
    parser.add_argument("--edition", type=int, default=90, help="of the blind test's seeds")
    parser.add_argument("--every", type=int, default=1, help="of the blind test's recordings, every so many")
    parser.add_argument("--stops", type=int, default=3, help="of each signal and command")
    options = parser.parse_args()
    unknown = sorted(set(options.bars) - set(BARS))
    if unknown:
        parser.error(f"{unknown[0]!r} is not one of {', '.join(BARS)}")
    missed = 0
    print("| bar | measured | asked | |\n|---|---|---|---|")
    for name in options.bars or BARS:
        for bar in BARS[name](options):
            print(f"| {bar.name} | {bar.value} | {bar.asked} | {'' if bar.reached else 'missed'} |", flush=True)
            missed += not bar.reached
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
