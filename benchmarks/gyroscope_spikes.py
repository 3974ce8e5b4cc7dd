"""How many samples of sound gyroscopes are taken for spikes: simulated ones, and the logs of a folder (first argument).

Logs are asked at their own rate and thinned to 50, 25 and 10 Hz, where motion comes near the edge of the band.
Usage: python benchmarks/gyroscope_spikes.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.recording import Array, Samples
from magyc_gtsam.sensor_faults.gate import SampleGate
from magyc_gtsam.sensor_faults.single_samples import found_in_turn
from magyc_gtsam.sensor_faults.spikes import Spikes

SEEDS = 50
READ = (".mcap", ".ulg", ".BIN", ".csv")


def spikes(value: Array) -> int:
    """Number of samples of (n, 3) that are taken for spikes."""
    samples, detectors = Samples(np.arange(len(value), dtype=float), value), (Spikes(), Spikes())
    for detector in detectors:
        samples = SampleGate(detector).take(samples)
    finding = found_in_turn(detectors)
    return 0 if finding is None else finding.count


def logs(folder: Path) -> Iterator[tuple[str, Samples]]:
    """The gyroscopes of a folder's logs, and of its arrays under `real/`."""
    for path in sorted([*folder.iterdir(), *folder.glob("real/*.npz")]):
        if path.suffix == ".npz":
            arrays = np.load(path)
            yield path.stem, Samples(arrays["tg" if "tg" in arrays else "tm"], arrays["w"].astype(float))
        elif path.suffix in READ:
            yield path.stem, mg.read(path).gyroscope


def main() -> None:
    """Print the counts."""
    for motion in ("wide", "moderate", "low", "tiny"):
        made = [mg.simulate(motion, seed=seed).recording.gyroscope.value for seed in range(SEEDS)]
        print(f"simulated, {motion}: {sum(map(spikes, made))} of {sum(map(len, made))}")
    for name, (time, value) in logs(Path(sys.argv[1])) if len(sys.argv) > 1 else ():
        rate = 1 / float(np.median(np.diff(time)))
        thinned = {each: value[:: max(round(rate / each), 1)] for each in (rate, 50, 25, 10) if each <= rate}
        print(f"{name}: " + ", ".join(f"{each:.0f} Hz {spikes(v)} of {len(v)}" for each, v in thinned.items()))


if __name__ == "__main__":
    main()
