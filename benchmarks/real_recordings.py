"""Calibrate public recordings and judge the heading by their optical reference.

    python benchmarks/real_recordings.py FOLDER

FOLDER holds recordings named in datasets/README.md, as MCAP (broad_*.mcap, nexus5_*.mcap). Prints hard iron
(µT), gyroscope bias (mrad/s), delay (ms) and the standard deviation of the magnetic heading (deg): raw, and
calibrated, both with the field taken as late as it was found to be.
"""

import argparse
from pathlib import Path

import numpy as np

import magyc_gtsam as mg
from magyc_gtsam.study.outcome import heading_error

INTERVALS = {  # s, the parts that move; the magnet is attached from 41.5 to 92 s
    "broad_01_slow_rotation": (34, 160),
    "broad_06_fast_rotation": (38, 160),
    "broad_32_attached_magnet_1cm": (41.5, 92),
    "nexus5_augmented_reality": (None, None),
    "nexus5_calibration_d1": (None, None),
}


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    for name, interval in INTERVALS.items():
        print_row(name, mg.read(folder / f"{name}.mcap").between(*interval))


def print_row(name: str, recording: mg.Recording) -> None:
    """Print the calibration and the heading before and after."""
    raw = mg.Calibration(np.eye(3), np.zeros(3))
    calibration = mg.calibrate(recording)
    hard, bias = calibration.hard_iron * 1e6, calibration.gyro_bias * 1e3
    heading = ""
    if recording.attitude is not None:
        before, after = (heading_error(recording, c, calibration.delay).deviation for c in (raw, calibration))
        heading = f"heading {before:.2f}° raw, {after:.2f}° calibrated"
    print(
        f"{name:30s} hard iron {hard[0]:6.1f} {hard[1]:6.1f} {hard[2]:6.1f}  bias {bias[0]:5.1f} {bias[1]:5.1f} "
        f"{bias[2]:5.1f}  delay {calibration.delay * 1e3:4.1f}  {heading}"
    )


if __name__ == "__main__":
    main()
