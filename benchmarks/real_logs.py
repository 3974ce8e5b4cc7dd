"""Real recordings with their truth by optics, as `real_honesty.py` judges calibrations on them."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from optical_bias import gyroscope_by_optics
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.recording import Array
from magyc_gtsam.study.leaderboard.collections import BROAD_UNITS

UNITS = {unit: trials for unit, trials in BROAD_UNITS.items() if unit != "D"}  # magnets moved the hard iron of D
SCATTER = {"A": 0.3, "B": 0.06}  # µT an axis, of one unit's hard iron from trial to trial; else their rms
MOVING = {1: (34.0, 160.0), 6: (38.0, 160.0), 32: (41.5, 92.0)}  # s, of the MCAP files
TRUTHS = "truth_by_optics.json"


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

    @property
    def middle(self) -> float:
        """The middle of the motion, s."""
        return float(np.mean(self.moving or self.recording.time[[0, -1]]))


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
        gyroscope = gyroscope_by_optics(recording, attitude_time, attitude)
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
            float(truth["delay"]) - gyroscope.lag,
            gyroscope.bias,
            gyroscope.bias_covariance,
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
    trial = re.match(r"broad_(\d+)", path.name)
    moving = MOVING.get(int(trial.group(1))) if trial else None
    return recording, recording.time[known], Rotation.from_quat(recording.attitude[known]), None, moving
