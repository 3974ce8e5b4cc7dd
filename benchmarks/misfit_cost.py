"""What a log that no calibration fits costs, beside a clean one of as many rows.

    python benchmarks/misfit_cost.py FOLDER|LOG ...

Prints for each log the processor time of `calibrate` (least of some calls), that of a clean simulated log with as many
samples of the magnetometer, their ratio, and whether the calibration is trusted. Logs are all that `magyc-gtsam` reads,
and arrays (*.npz: tm, m, tg, w in SI units; tg equals tm where it is missing).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import magyc_gtsam as mg

NO_LOGS = (".md", ".json")


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", type=Path, nargs="+", help="logs, or folders of them")
    parser.add_argument("--repeat", type=int, default=3, help="calls per log; the least counts")
    arguments = parser.parse_args()
    mg.calibrate(mg.simulate("wide", seed=99).recording)  # imports are not part of the time
    print(f"{'log':52s}{'rows':>7s}{'s':>8s}{'clean s':>9s}{'ratio':>7s}  trusted")
    ratios = []
    for path in arguments.logs:
        for each in sorted(p for p in path.iterdir() if p.suffix not in NO_LOGS) if path.is_dir() else [path]:
            for recording in _recordings(each):
                rows = len(recording.magnetometer.time)
                clean = mg.simulate("wide", duration=max(rows / 10, 60), seed=0).recording
                (took, trusted), (beside, _) = (_took(one, arguments.repeat) for one in (recording, clean))
                ratios.append(took / beside)
                print(f"{each.name:52s}{rows:7d}{took:8.3f}{beside:9.3f}{ratios[-1]:7.1f}  {trusted}", flush=True)
    print(f"ratio: median {np.median(ratios):.1f}, most {max(ratios):.1f}")


def _recordings(path: Path) -> Iterator[mg.Recording]:
    """The recording of a file; none of one that cannot be calibrated."""
    try:
        if path.suffix == ".npz":
            with np.load(path) as kept:
                when = kept["tg"] if "tg" in kept else kept["tm"]
                field, rate = kept["m"].astype(float), kept["w"].astype(float)
                yield mg.Recording.from_streams((kept["tm"], field), (when, rate))
        elif path.is_file():
            recording = mg.read(path)
            if recording.angular_rate is not None:
                yield recording
    except mg.MagycError as reason:
        print(f"{path.name}: {reason}")


def _took(recording: mg.Recording, repeat: int) -> tuple[float, str]:
    """Processor time of `calibrate`, s, and its verdict."""
    times, verdict = [], "no"
    for _ in range(repeat):
        begun = time.process_time()
        try:
            verdict = "yes" if mg.calibrate(recording).trusted else "no"
        except mg.MagycError:
            verdict = "refused"
        times.append(time.process_time() - begun)
    return min(times), verdict


if __name__ == "__main__":
    main()
