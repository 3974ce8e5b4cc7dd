"""Readers of the recordings of the public collections in their published formats."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from scipy.io import loadmat

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.study.leaderboard.phones import MICROTESLA

Reader = Callable[[Path], Recording]
ARRAYS = (".npz", ".mat")
FORMS = (*ARRAYS, ".mcap")
_NEEDED = {".npz": ("tm", "m", "w"), ".mat": ("imu_gyr", "imu_acc", "imu_mag", "opt_quat", "sampling_rate")}


def read_public(path: Path, reader: Reader) -> tuple[Recording, Array]:
    """Return a recording with its optical attitude, and the device's own hard iron (3,) in T; zero for none.

    Args:
        path: arrays (.npz: tm, m, tg, w, ta, a, tq, q (x, y, z, w; sensor to world), dev in SI units; where tg and ta
            are missing they equal tm), a trial of BROAD (.mat) or a log (.mcap).
        reader: reader of logs, as `mg.read`.

    Raises:
        MagycError: another form of file, or required data are missing.
    """
    if path.suffix == ".mcap":
        return reader(path), np.zeros(3)
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                values: Mapping[str, Any] = dict(file.items())
        else:
            values = loadmat(path, squeeze_me=True)
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise MagycError(f"{path}: is not a {path.suffix} file of arrays ({error}); fetch it again") from None
    missing = [name for name in _NEEDED[path.suffix] if name not in values]
    if missing:
        raise MagycError(f"{path}: has no {', '.join(missing)}; a recording needs {_NEEDED[path.suffix]}")
    return (_of_arrays if path.suffix == ".npz" else _of_broad)(values, path.stem)


def _of_arrays(values: Mapping[str, Any], name: str) -> tuple[Recording, Array]:
    data = {key: np.asarray(value, dtype=np.float64) for key, value in values.items() if key != "move"}
    time = data["tm"]
    attitude = _attitude(data["tq"], data["q"]) if len(data.get("q", ())) else None
    recording = Recording.from_streams(
        (time, data["m"]),
        (data.get("tg", time), data["w"]),
        acceleration=(data.get("ta", time), data["a"]) if "a" in data else None,
        attitude=attitude,
        name=name,
    )
    device = data.get("dev", np.zeros(0))
    return recording, device if len(device) else np.zeros(3)


def _of_broad(values: Mapping[str, Any], name: str) -> tuple[Recording, Array]:
    """Return a trial of BROAD from its arrays: µT, rad/s, m/s², quaternions w first, one rate for all."""
    field = np.asarray(values["imu_mag"], dtype=np.float64) * MICROTESLA
    time = np.arange(len(field)) / float(values["sampling_rate"])
    whole = np.isfinite(field).all(axis=1)
    rate, force = (np.asarray(values[key], dtype=np.float64) for key in ("imu_gyr", "imu_acc"))
    quaternion = np.asarray(values["opt_quat"], dtype=np.float64)[:, [1, 2, 3, 0]]
    recording = Recording.from_streams(
        (time[whole], field[whole]),
        (time, rate),
        acceleration=(time, force),
        attitude=_attitude(time, quaternion),
        name=name,
    )
    return recording, np.zeros(3)


def _attitude(time: Array, quaternion: Array) -> tuple[Array, Array]:
    """Return attitude rows without those in which the cameras lost the sensor (zero or NaN)."""
    seen = np.linalg.norm(quaternion, axis=1) > 0.5
    return time[seen], quaternion[seen]
