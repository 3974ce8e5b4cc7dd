"""Post-processing: a log in, a sentence and a figure out.

python examples/calibrate_log.py datasets/calibration_dive.mcap figure.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import magyc_gtsam as mg
from magyc_gtsam.report.verdict import judged

LOG = Path(__file__).parents[1] / "datasets" / "calibration_dive.mcap"


def main(log: Path = LOG, figure: Path = Path("calibrate_log.png")) -> str:
    """Calibrate the log and save the figure; the verdict."""
    recording = mg.read(log)
    calibration = mg.calibrate(recording)
    calibration.plot().savefig(figure)
    return judged(calibration, recording).sentence


if __name__ == "__main__":
    print(main(*map(Path, sys.argv[1:])))
