"""Whether the stated sigmas of real calibrations are true, judged by optical references.

    python benchmarks/real_honesty.py FOLDER [MORE.mcap ...] [--half tuning|unseen] [--by calibrate|gap]

FOLDER holds recordings as arrays (*.npz: tm, m, tg, w, ta, a, tq, q, move, dev in SI units; where tg and ta are
missing they equal tm) and `truth_by_optics.json`: for each recording the full matrix `A` (µT), the hard iron `h`
(µT), its covariance `cov` (µT²), the `rms` that it leaves (µT) and the magnetometer's `delay` (s). A BROAD trial may
also be given as MCAP. BROAD trials are calibrated whole and in their moving part. A folder of another form is an
error of one sentence, exit code 2.

An error counts against the stated covariance, the truth's own and the scatter of one unit's hard iron from trial to
trial. A trial with translation has a weak truth of its own: it is judged by its unit's rotation trials. The truth of
the gyroscope's bias is the optical rotation over half-second intervals, with a matrix and the gyroscope's own lag
beside it: the delay of the truth is behind the cameras, the calibration's behind the gyroscope.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import magyc_gtsam as mg
from magyc_gtsam.recording import Array

UNITS = {"A": (1, 4, 6, 8, 10, 15), "B": (2, 5, 7, 11, 16, 18, 21, 28, 29, 30, 31), "C": (3, 24, 25, 26, 27)}
SCATTER = {"A": 0.3, "B": 0.06}  # µT an axis, of one unit's hard iron from trial to trial; else their rms
MOVING = {1: (34.0, 160.0), 6: (38.0, 160.0), 32: (41.5, 92.0)}  # s, of the MCAP files
TRUTHS = "truth_by_optics.json"
DELAY_TRUTH = 1.5e-3  # s, how well optics know the delay: found in steps of 2 ms
KNOWN = {"hard iron": 3, "gyroscope bias": 3, "delay": 1}
Method = Callable[[mg.Recording], mg.Calibration]
METHODS: dict[str, Method] = {
    "calibrate": mg.calibrate,
    "gap": lambda recording: mg.find_gap(recording).calibration,
}


@dataclass(frozen=True)
class Log:
    """A recording, its reference and its truth: hard iron (3,) T, covariance (3, 3) T², delay s; bias and covariance.

    `own`: whether the hard iron's truth is of this very log, and not of others of its unit.
    """

    name: str
    unit: str
    recording: mg.Recording
    attitude_time: Array
    attitude: Rotation
    device: Array | None
    hard_iron: Array
    covariance: Array
    delay_optics: float
    delay: float
    bias: Array
    bias_covariance: Array
    moving: tuple[float, float] | None


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
    errors = {
        "hard iron": (calibration.hard_iron - log.hard_iron) * 1e6,
        "gyroscope bias": (calibration.gyro_bias - log.bias) * 1e3,
        "delay": np.array([calibration.delay - log.delay]) * 1e3,
    }
    covariances = {
        "hard iron": (stated[6:9, 6:9] + log.covariance) * 1e12,
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


def read_all(folder: Path, more: list[Path]) -> Iterator[Log]:
    """All recordings with a truth, by name; the hard iron of translation trials from their unit's rotation trials."""
    truths = read_truths(folder / TRUTHS)
    files = {path.stem: path for path in folder.glob("*.npz")}
    for path in more:
        name = next((n for n in truths if n.startswith(path.name[:8])), path.stem)
        files.setdefault(name, path)
    for name in sorted(files):
        path = files[name]
        recording, attitude_time, attitude, device, moving = (
            read_npz(path) if path.suffix == ".npz" else read_mcap(path)
        )
        if len(attitude_time) < 2:
            continue
        truth = truths.get(name)
        if truth is None:
            print(f"{name}: no truth, left out")
            continue
        unit = unit_of(name)
        hard, covariance = np.array(truth["h"]), np.array(truth["cov"])
        scatter = SCATTER.get(unit, float(np.sqrt(np.mean(np.square(list(SCATTER.values())))))) ** 2 * np.eye(3)
        if not name.startswith("broad"):
            scatter = np.zeros((3, 3))
        if "translation" in name:
            same = [t for n, t in truths.items() if unit_of(n) == unit and "undisturbed" in n and "rotation" in n]
            if same:
                hard = np.mean([t["h"] for t in same], axis=0)
                covariance = np.mean([t["cov"] for t in same], axis=0) / len(same) + scatter / len(same)
        bias, bias_covariance, lag = bias_by_optics(recording, attitude_time, attitude)
        yield Log(
            name,
            unit,
            recording,
            attitude_time,
            attitude,
            device,
            hard * 1e-6,
            (covariance + scatter) * 1e-12,
            float(truth["delay"]),
            float(truth["delay"]) - lag,
            bias,
            bias_covariance,
            moving,
        )


def read_truths(path: Path) -> dict[str, Any]:
    """The truth of each recording.

    Raises:
        MagycError: there is no such file, or not of that form.
    """
    try:
        truths = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise mg.MagycError(
            f"{path}: cannot be read ({error}); the folder needs this file beside its recordings (*.npz), see --help"
        ) from error
    shapes = {"h": (3,), "cov": (3, 3), "delay": ()}
    for name, truth in truths.items() if isinstance(truths, dict) else [("all", None)]:
        for key, shape in shapes.items():
            if not isinstance(truth, dict) or np.shape(truth.get(key, "missing")) != shape or key not in truth:
                raise mg.MagycError(
                    f"{path}: {name}: {key!r} must be there with shape {shape}: {', '.join(shapes)} of each recording"
                )
    return dict(truths)


def unit_of(name: str) -> str:
    """The instrument: clusters of BROAD's trials; of the phones person and model."""
    number = re.match(r"broad_(\d+)_", name)
    if number is None:
        return "_".join(name.split("_")[:2])
    trial = int(number.group(1))
    return next((unit for unit, trials in UNITS.items() if trial in trials), f"trial {trial}")


def read_npz(path: Path) -> tuple[mg.Recording, Array, Rotation, Array | None, tuple[float, float] | None]:
    try:
        with np.load(path, allow_pickle=False) as arrays:
            data = {name: value.astype(float) for name, value in arrays.items()}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise mg.MagycError(f"{path}: no arrays of numbers can be read from it ({error})") from error
    missing = sorted({"tm", "m", "w", "a", "tq", "q"} - data.keys())
    if missing:
        raise mg.MagycError(f"{path}: the arrays {', '.join(missing)} are missing, see --help")
    tm = data["tm"]
    if "tg" in data:
        recording = mg.Recording.from_streams(
            (tm, data["m"]), (data["tg"], data["w"]), acceleration=(data.get("ta", tm), data["a"]), name=path.stem
        )
    else:
        recording = mg.Recording(tm, data["m"], data["w"], acceleration=data["a"], name=path.stem)
    moved = data.get("move")
    moving = (
        None if moved is None else (float(tm[np.argmax(moved)]), float(tm[len(tm) - 1 - np.argmax(moved[::-1])]))
    )
    device = data["dev"] if len(data.get("dev", ())) else None
    seen = np.linalg.norm(data["q"], axis=1) > 0.5  # where the cameras lost it the rows are zero or not a number
    attitude = Rotation.from_quat(data["q"][seen]) if seen.any() else Rotation.identity(0)
    return recording, data["tq"][seen], attitude, device, moving


def read_mcap(path: Path) -> tuple[mg.Recording, Array, Rotation, Array | None, tuple[float, float] | None]:
    recording = mg.read(path)
    known = np.isfinite(recording.attitude[:, 0])
    moving = MOVING.get(int(path.name[6:8]))
    return recording, recording.time[known], Rotation.from_quat(recording.attitude[known]), None, moving


def bias_by_optics(
    recording: mg.Recording, attitude_time: Array, attitude: Rotation
) -> tuple[Array, Array, float]:
    """(3,) rad/s, covariance, and the gyroscope's own lag behind the cameras, s.

    −Log(ΔR_gyroᵀ ΔR_optical) = (b + E ω) Δt − τ Δω over half a second, E and τ free (3, 3). The covariance is a
    sandwich over blocks of 5 s.
    """
    gyro_time, rate = recording.gyroscope
    edges = np.arange(max(attitude_time[0], gyro_time[0]), min(attitude_time[-1], gyro_time[-1]), 0.5)
    at = np.searchsorted(attitude_time, edges)
    holes = np.array([np.max(np.diff(attitude_time[a : b + 2]), initial=0.0) for a, b in itertools.pairwise(at)])
    optical = Slerp(attitude_time, attitude)(np.clip(edges, attitude_time[0], attitude_time[-1]))
    fine = np.unique(np.concatenate([gyro_time, edges]))
    value = np.stack([np.interp(fine, gyro_time, column) for column in rate.T], axis=1)
    steps = Rotation.from_rotvec(0.5 * (value[1:] + value[:-1]) * np.diff(fine)[:, None])
    cuts = np.searchsorted(fine, edges)
    turned = Rotation.concatenate([product(steps[a:b]) for a, b in itertools.pairwise(cuts)])
    left = -(turned.inv() * (optical[:-1].inv() * optical[1:])).as_rotvec()
    smooth = np.stack([np.convolve(column, np.full(9, 1 / 9), "same") for column in rate.T], axis=1)
    at_edge = np.stack([np.interp(edges, gyro_time, column) for column in smooth.T], axis=1)
    design = np.concatenate([np.full((len(left), 1), 0.5), turned.as_rotvec(), -np.diff(at_edge, axis=0)], axis=1)
    good = (np.linalg.norm(left, axis=1) < 0.2) & (holes < 0.1)
    weight = good.astype(float)
    for _ in range(5):
        solution = np.linalg.lstsq(design * np.sqrt(weight)[:, None], left * np.sqrt(weight)[:, None], rcond=None)[
            0
        ]
        residual = left - design @ solution
        scale = np.median(np.linalg.norm(residual[good], axis=1))
        weight = good / (1 + (residual**2).sum(1) / (2 * scale) ** 2)
    inverse = np.linalg.inv(design.T @ (design * weight[:, None]))
    block = ((edges[:-1] - edges[0]) // 5).astype(int)
    score = np.einsum("n,na,ni->nai", weight, design, residual)
    summed = np.zeros((block.max() + 1, 7, 3))
    np.add.at(summed, block, score)
    influence = np.einsum("ab,kbi->kai", inverse, summed)[:, 0]
    return solution[0], influence.T @ influence, float(np.trace(solution[4:]) / 3)


def product(steps: Rotation) -> Rotation:
    """Of rotations in order, by halves."""
    while len(steps) > 1:
        rest = steps[-1:] if len(steps) % 2 else None
        joined = steps[: len(steps) - len(steps) % 2 : 2] * steps[1::2]
        steps = joined if rest is None else Rotation.concatenate([joined, rest])
    return steps[0]


if __name__ == "__main__":
    sys.exit(main())
