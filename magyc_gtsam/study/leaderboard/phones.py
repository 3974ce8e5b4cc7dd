"""The phone recordings of Michel et al. as published: a text file for each sensor, the optical attitude from Qualisys.

A walk is `android/NAME/` or `ios/NAME/` with its sensors, and `qualisys/NAME.mat` with the attitude.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.constants import g as standard_gravity
from scipy.io import loadmat
from scipy.io.matlab import MatReadError
from scipy.signal import correlate
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array
from magyc_gtsam.recording.time_base import interpolated

_PERSONS = ("Guillaume", "Jakob", "Thibaud")
_PHONES = ("Nexus5", "iPhone4S", "iPhone5")
_MOTIONS = ("AR", "BackPocket", "FrontPocket", "Phoning", "Swinging", "Texting")
_RUNNING = ("RunningHand", "RunningPocket")  # only the undisturbed ones
WALKS = tuple(
    f"{person}_{phone}_{disturbed}_{motion}"
    for person in _PERSONS
    for phone in _PHONES
    for disturbed, motions in (("Dist", _MOTIONS), ("NoDist", _MOTIONS + _RUNNING))
    for motion in motions
)
# Intervals, in s of the cameras' time, in which their attitude is wrong, as the authors state.
_WRONG_OPTICS = {
    "Guillaume_iPhone4S_NoDist_BackPocket": ((21.1, 21.5), (23.6, 24.0)),
    "Guillaume_iPhone5_Dist_FrontPocket": ((65.6, 67.2), (100.4, 102.0)),
    "Guillaume_iPhone5_Dist_Swinging": ((103.5, 104.5),),
    "Guillaume_iPhone5_NoDist_BackPocket": (
        (5.7, 6.1), (7.9, 8.5), (9.1, 9.6), (24.7, 25.3), (26.0, 26.5), (76.4, 77.3),
    ),
    "Guillaume_Nexus5_Dist_FrontPocket": ((21.2, 21.6),),
    "Guillaume_Nexus5_Dist_Phoning": ((40.5, 40.8),),
    "Guillaume_Nexus5_Dist_Swinging": ((59.7, 60.5), (73.1, 73.5)),
    "Guillaume_Nexus5_NoDist_AR": ((64.0, 120.0),),
    "Jakob_iPhone4S_NoDist_RunningHand": ((34.8, 49.2),),
    "Jakob_iPhone5_NoDist_RunningHand": ((16.0, 17.0), (30.0, 37.5), (39.8, 40.2)),
    "Jakob_Nexus5_Dist_Phoning": ((4.7, 5.6), (91.95, 93.2)),
    "Jakob_Nexus5_Dist_Swinging": ((96.2, 97.5),),
    "Jakob_Nexus5_NoDist_RunningHand": ((36.0, 47.5),),
    "Thibaud_iPhone4S_NoDist_Texting": ((51.4, 51.8),),
    "Thibaud_iPhone5_Dist_AR": ((0.0, 2.5), (65.8, 66.5), (87.1, 87.6)),
    "Thibaud_iPhone5_Dist_FrontPocket": ((52.3, 52.8), (61.2, 61.7)),
    "Thibaud_Nexus5_Dist_FrontPocket": ((40.0, 52.6),),
    "Thibaud_Nexus5_Dist_Phoning": ((10.8, 14.0), (18.0, 19.6), (44.8, 46.4), (87.0, 88.0), (90.4, 91.0)),
    "Thibaud_Nexus5_Dist_Swinging": ((105.45, 105.5),),
    "Thibaud_Nexus5_NoDist_Swinging": ((36.8, 37.2),),
}  # fmt: skip
MICROTESLA = 1e-6
_GRID = 0.01  # s, sampling interval of the rates by which phone and cameras are aligned
_LATEST = 8.0  # s, largest difference between the starts of phone and cameras; the published ones reach 4 s


def parts_of(walk: str) -> tuple[str, ...]:
    """Return the files of a walk, relative to the address of the collection."""
    sensors = ("magnetometer", "gyroscope", "accelerometer")
    folder = f"android/{walk}" if "Nexus" in walk else f"ios/{walk}"
    texts = sensors if "Nexus" in walk else (*sensors, "description")
    return (*(f"{folder}/{name}.txt" for name in texts), f"qualisys/{walk}.mat")


def arrays_of(folder: Path, walk: str) -> dict[str, Array]:
    """Read the files of a walk as the arrays that `reading.read_public` takes.

    Android: s, µT with the system's own hard iron in the last three columns, rad/s and m/s². iOS: s since the phone was
    started, µT, rad/s, and −g. The attitude is moved to the phone's time, by the rates of turn of both.

    Args:
        folder: folder with the files, without the folders they were published in.
        walk: name of the walk.

    Raises:
        MagycError: a file is not of this form.
    """
    try:
        magnetometer, gyroscope, accelerometer = (
            np.loadtxt(folder / f"{name}.txt", ndmin=2) for name in ("magnetometer", "gyroscope", "accelerometer")
        )
        start, gravity = 0.0, 1.0
        if "Nexus" not in walk:
            start = float((folder / "description.txt").read_text(encoding="utf-8").split("BootTime =")[1])
            gravity = -standard_gravity
        time, quaternion = _optics(folder / f"{walk}.mat")
    except (OSError, ValueError, IndexError, KeyError, MatReadError) as error:
        raise MagycError(f"{walk}: its published files cannot be read ({error}); fetch them again") from None
    for wrong in _WRONG_OPTICS.get(walk, ()):
        right = (time < wrong[0]) | (time > wrong[1])
        time, quaternion = time[right], quaternion[right]
    arrays = {
        "tm": magnetometer[:, 0] - start,
        "m": magnetometer[:, 1:4] * MICROTESLA,
        "tg": gyroscope[:, 0] - start,
        "w": gyroscope[:, 1:4],
        "ta": accelerometer[:, 0] - start,
        "a": accelerometer[:, 1:4] * gravity,
        "dev": np.median(magnetometer[:, 4:7], axis=0) * MICROTESLA,
    }
    later = _later(time, quaternion, arrays["tg"], arrays["w"])
    return arrays | {"tq": time + later, "q": quaternion}


def _optics(file: Path) -> tuple[Array, Array]:
    """Return time (n,) s and attitude (n, 4) (x, y, z, w; sensor to world) where the cameras saw the phone."""
    content = loadmat(file)
    capture = next(value for name, value in content.items() if not name.startswith("__"))[0, 0]
    rate = float(capture["FrameRate"][0, 0])
    rotations = np.asarray(capture["RigidBodies"][0, 0]["Rotations"], dtype=np.float64)
    columns = rotations.reshape((9, -1), order="F")  # (9, n), the rotation's columns one after the other
    seen = np.isfinite(columns).all(axis=0)
    matrices = columns[:, seen].reshape((3, 3, -1), order="F").transpose(2, 0, 1)
    return np.flatnonzero(seen) / rate, Rotation.from_matrix(matrices).as_quat()


def _later(time: Array, quaternion: Array, rate_time: Array, angular_rate: Array) -> float:
    """Return the offset, in s, by which the phone's clock is ahead of the cameras'.

    It minimises the squared difference of the rates of turn of both, up to the gyroscope's bias and a constant
    rotation between the frames: |ω₁|² + |ω₂|² − 2 Σσ, with σ the singular values of Σ ω₁ ω₂ᵀ, of rates less their
    means.
    """
    turn = Rotation.from_quat(quaternion)
    step = np.diff(time)
    steady = step < 1.5 * np.median(step)
    optical = ((turn[:-1].inv() * turn[1:]).as_rotvec() / step[:, None])[steady]
    middle = (time[:-1] + step / 2)[steady]
    first = interpolated(np.arange(middle[0], middle[-1], _GRID), middle, optical)
    lags = int(_LATEST / _GRID)
    second = interpolated(middle[0] + np.arange(-lags, len(first) + lags) * _GRID, rate_time, angular_rate)
    first = first - first.mean(axis=0)
    product = np.array([[correlate(b, a, "valid", "fft") for b in second.T] for a in first.T])  # (3, 3, lags)
    rows = len(first)
    sums, squares = (correlate(each, np.ones((rows, 1)), "valid", "fft") for each in (second, second**2))
    size = (squares - sums**2 / rows).sum(axis=1)
    cost = size - 2 * np.linalg.svd(product.transpose(2, 0, 1), compute_uv=False).sum(axis=1)
    best = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    left, lowest, right = cost[best - 1 : best + 2]
    return float((best + 0.5 * (left - right) / (left - 2 * lowest + right) - lags) * _GRID)
