"""Whether the stated sigmas of real calibrations are true, judged by optical references.

    python benchmarks/real_honesty.py FOLDER [MORE.mcap ...] [--half tuning|unseen] [--by calibrate|scale|gap]

FOLDER holds recordings as arrays (*.npz: tm, m, tg, w, ta, a, tq, q, move, dev in SI units; where tg and ta are
missing they equal tm) and `truth_by_optics.json`: for each recording the full matrix `A` (µT), the hard iron `h`
(µT), its covariance `cov` (µT²), the `rms` that it leaves (µT) and the magnetometer's `delay` (s). A BROAD trial may
also be given as MCAP. BROAD trials are calibrated whole and in their moving part. A folder of another form is an
error of one sentence, exit code 2.

An error counts against the stated covariance, the truth's own and the scatter of one unit's hard iron from trial to
trial. A trial with translation has a weak truth of its own: it is judged by its unit's rotation trials. The truth of a
trial with a magnet that is attached and taken off is with the magnet: jumps before the middle of the motion count. The
truth of the gyroscope's bias is the optical rotation over half-second intervals, with a matrix and the gyroscope's own
lag beside it: the delay of the truth is behind the cameras, the calibration's behind the gyroscope.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from real_logs import TRUTHS, Log, read_all
from scipy.spatial.transform import Slerp

import magyc_gtsam as mg
from magyc_gtsam.recording import Array

DELAY_TRUTH = 1.5e-3  # s, how well optics know the delay: found in steps of 2 ms
KNOWN = {"hard iron": 3, "gyroscope bias": 3, "delay": 1}
Method = Callable[[mg.Recording], mg.Calibration]
METHODS: dict[str, Method] = {
    "calibrate": mg.calibrate,
    "scale": lambda recording: mg.calibrate(recording, gyroscope_scale=0.01),
    "gap": lambda recording: mg.find_gap(recording).calibration,
}


@dataclass(frozen=True)
class Row:
    """What one calibration came to: errors (µT, mrad/s, ms) and their total covariances, and the headings, deg."""

    log: Log
    part: str
    calibration: mg.Calibration
    seconds: float
    errors: dict[str, Array]
    covariances: dict[str, Array]
    heading: tuple[float, float] | None

    @property
    def worse(self) -> bool:
        """Trusted, and the heading on another log of the unit is worse than the raw reading's."""
        return self.calibration.trusted and self.heading is not None and self.heading[1] > 1.02 * self.heading[0]

    def nees(self, what: str) -> float:
        error = self.errors[what]
        return float(error @ np.linalg.solve(self.covariances[what], error))


def main() -> int:
    """Run, print the table and the summary; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("more", type=Path, nargs="*", help="BROAD trials as MCAP")
    parser.add_argument("--half", choices=("tuning", "unseen"), help="every other recording, by name")
    parser.add_argument("--by", choices=METHODS, default="calibrate", help="what calibrates")
    parser.add_argument("--words", action="store_true", help="print the whole message")
    arguments = parser.parse_args()
    try:
        logs = list(read_all(arguments.folder, arguments.more))
        if not logs:
            raise mg.MagycError(
                f"{arguments.folder}: no recording (*.npz) in it has an optical attitude and an entry in {TRUTHS}"
            )
    except mg.MagycError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    chosen = {"tuning": logs[::2], "unseen": logs[1::2], None: logs}[arguments.half]
    print(f"{'recording':34s} {'part':6s} {'error µT':>21s} {'sigma µT':>8s} {'NEES':>6s} {'bias':>6s} {'delay':>6s}"
          f" {'heading':>12s}  trusted")  # fmt: skip
    rows = []
    for log in chosen:
        for part, recording in parts_of(log):
            row = judge(log, part, METHODS[arguments.by], recording, logs)
            rows.append(row)
            print(line_of(row, arguments.words), flush=True)
    summarise(rows)
    return 0


def parts_of(log: Log) -> Iterator[tuple[str, mg.Recording]]:
    yield "whole", log.recording
    if log.moving is not None:
        yield "moving", log.recording.between(*log.moving)


def judge(log: Log, part: str, method: Method, recording: mg.Recording, logs: list[Log]) -> Row:
    """Calibrate and compare."""
    begun = time.process_time()
    calibration = method(recording)
    seconds = time.process_time() - begun
    stated = calibration.covariance
    jumped = [
        term for term in calibration.terms if term.name == "hard-iron-step" and term.setting["time"] < log.middle
    ]
    hard_iron = calibration.hard_iron + sum((term.value for term in jumped), np.zeros(3))
    own_covariance = stated[6:9, 6:9] + sum((term.covariance for term in jumped), np.zeros((3, 3)))
    errors = {
        "hard iron": (hard_iron - log.hard_iron) * 1e6,
        "gyroscope bias": (calibration.gyro_bias - log.bias) * 1e3,
        "delay": np.array([calibration.delay - log.delay]) * 1e3,
    }
    covariances = {
        "hard iron": (own_covariance + log.covariance) * 1e12,
        "gyroscope bias": (stated[9:12, 9:12] + log.bias_covariance) * 1e6,
        "delay": np.array([[(calibration.delay_sigma or 0.0) ** 2 + DELAY_TRUTH**2]]) * 1e6,
    }
    others = [o for o in logs if o.unit == log.unit and o.name != log.name and "Dist_" not in o.name]
    others = [o for o in others if "disturbed" not in o.name.replace("undisturbed", "")]
    heading = None
    if others:
        raw = np.median(
            [heading_of(o, np.eye(3), o.device if o.device is not None else np.zeros(3)) for o in others]
        )
        own = np.median([heading_of(o, calibration.soft_iron, calibration.hard_iron) for o in others])
        heading = (float(raw), float(own))
    return Row(log, part, calibration, seconds, errors, covariances, heading)


def line_of(row: Row, words: bool) -> str:
    e, c = row.errors["hard iron"], row.calibration
    sigma = float(np.sqrt(np.trace(row.covariances["hard iron"]) / 3))
    heading = "" if row.heading is None else f"{row.heading[0]:5.2f} {row.heading[1]:5.2f}"
    verdict = "yes" if c.trusted else "no"
    wrong = " WRONG" if c.trusted and row.nees("hard iron") > 16.3 else ""
    worse = " WORSE" if row.worse else ""
    message = c.message if words or not c.trusted else ""
    return (
        f"{row.log.name[:34]:34s} {row.part:6s} {e[0]:6.2f} {e[1]:6.2f} {e[2]:6.2f}  {sigma:8.2f}"
        f" {row.nees('hard iron'):6.1f} {row.nees('gyroscope bias'):6.1f} {row.nees('delay'):6.1f} {heading:>12s}"
        f"  {verdict}{wrong}{worse} {message if words else message[:100]}"
    )


def summarise(rows: list[Row]) -> None:
    """Median NEES and rms error over rms sigma of the trusted ones, by kind of recording."""
    kinds = {
        "rotation, whole": lambda r: "rotation" in r.log.name and r.part == "whole",
        "rotation, moving": lambda r: "rotation" in r.log.name and r.part == "moving",
        "other BROAD": lambda r: r.log.name.startswith("broad") and "rotation" not in r.log.name,
        "phones": lambda r: not r.log.name.startswith("broad"),
        "all": lambda r: True,
    }
    print()
    for kind, chosen in kinds.items():
        of_kind = [row for row in rows if chosen(row)]
        trusted = [row for row in of_kind if row.calibration.trusted]
        print(f"{kind}: {len(trusted)} of {len(of_kind)} trusted, {sum(r.worse for r in trusted)} worse than raw")
        for what, freedoms in KNOWN.items():
            if not trusted:
                continue
            nees = float(np.median([row.nees(what) for row in trusted]))
            error = np.sqrt(np.mean([row.errors[what] @ row.errors[what] for row in trusted]))
            sigma = np.sqrt(np.mean([np.trace(row.covariances[what]) for row in trusted]))
            print(
                f"    {what:15s} median NEES {nees:6.1f} of {freedoms}   rms error / rms sigma {error / sigma:.2f}"
            )
    print(f"\n{np.median([1e3 * row.seconds for row in rows]):.0f} ms a recording (median)")


def heading_of(log: Log, soft_iron: Array, hard_iron: Array) -> float:
    """deg, circular deviation of the magnetic heading in the optical world."""
    stamps, field = log.recording.magnetometer
    stamps, field = stamps - log.delay_optics, field
    inside = (stamps > log.attitude_time[0]) & (stamps < log.attitude_time[-1])
    body = np.linalg.solve(soft_iron, (field[inside] - hard_iron).T).T
    world = Slerp(log.attitude_time, log.attitude)(stamps[inside]).apply(body)
    angle = np.exp(1j * np.arctan2(world[:, 1], world[:, 0]))
    return float(np.rad2deg(np.sqrt(np.mean(np.angle(angle * np.conj(angle.mean())) ** 2))))


if __name__ == "__main__":
    sys.exit(main())
