"""Names that the gap workflow gives public recordings, against the same effects by the optical attitude.

    python benchmarks/names_by_optics.py LOG_OR_FOLDER...

Logs are MCAP with an optical attitude, or arrays (*.npz) as for `real_honesty.py`; BROAD is used while it moves.
The optical attitude is not derived from the gyroscope: what it shows of the magnetometer's delay, of eddy currents
and of the gyroscope's scale is independent of what was named. Prints, of each recording and name, the values of
`find_gap` and those by optics, in the same unit, and the mean square of their difference in joint standard deviations,
one if both are right.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from optical_bias import gyroscope_by_optics
from real_logs import read_mcap, read_npz
from scipy.spatial.transform import Rotation, Slerp

import magyc_gtsam as mg
from magyc_gtsam.gap.result import Effect
from magyc_gtsam.recording import Array
from magyc_gtsam.study.leaderboard.optics import reference_of

BLOCK = 5.0  # s, within which residuals count as one draw
STEP = 0.01  # s, on each side, over which the field's rate is differenced
KNOTS = 4.0  # s between knots of the room's field
HOLE = 0.1  # s, longest gap of the optical attitude that is interpolated


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", type=Path, nargs="+")
    for path in parser.parse_args().logs:
        logs = (
            [each for kind in ("*.mcap", "*.npz") for each in sorted(path.glob(kind))] if path.is_dir() else [path]
        )
        for log in logs:
            recording, time, attitude, _, moving = read_npz(log) if log.suffix == ".npz" else read_mcap(log)
            judge(log.stem, recording.between(*moving) if moving else recording, time, attitude)


def judge(name: str, recording: mg.Recording, time: Array, attitude: Rotation) -> None:
    """Print what was found of one recording beside what optics show."""
    print(name, flush=True)
    gyroscope = gyroscope_by_optics(recording, time, attitude)
    turned = Slerp(time, attitude)
    after = np.clip(np.searchsorted(time, recording.time), 1, len(time) - 1)
    inside = (recording.time > time[0]) & (recording.time < time[-1]) & (time[after] - time[after - 1] < HOLE)
    quaternion = np.full((len(recording.time), 4), np.nan)
    quaternion[inside] = turned(recording.time[inside]).as_quat()
    lag, of_lag = lag_by_optics(replace(recording, attitude=quaternion), turned)
    for effect in mg.find_gap(recording).effects:
        if effect.name == "timing":
            mean = np.eye(3).ravel() / 3
            compare(effect, mean @ lag - gyroscope.lag, mean @ of_lag @ mean, 1e3)
        elif effect.name == "eddy-plane" and "uneven" in effect.setting:
            rows = [3 * i + j for j in range(3) for i in range(3)][:8]  # column by column, of trace zero
            uneven = (np.eye(9) - np.outer(np.eye(3).ravel(), np.eye(3).ravel()) / 3)[rows]
            compare(effect, uneven @ lag, uneven @ of_lag @ uneven.T, 1e3)
        elif effect.name == "gyro-scale":
            pairs = {"x": (0, 0), "y": (1, 1), "z": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
            own = [pairs[each] for each in effect.setting if each in pairs] or list(pairs.values())
            halves = np.array([0.5 * (np.eye(9)[3 * i + j] + np.eye(9)[3 * j + i]) for i, j in own])
            compare(
                effect, halves @ gyroscope.matrix.ravel(), halves @ gyroscope.matrix_covariance @ halves.T, 1e3
            )


def lag_by_optics(recording: mg.Recording, attitude: Slerp) -> tuple[Array, Array]:
    """(9,) s, row by row, and covariance: m = A Rᵀ f + h − L d(A Rᵀ f)/dt, with the room's f and h along the way."""
    reference = reference_of(recording)
    calibration, time = reference.calibration, reference.time
    samples = recording.magnetometer
    read = samples.value[np.searchsorted(samples.time, time)]

    def turned(at: Array) -> Array:  # (n, 3, 3) A Rᵀ
        matrix = calibration.soft_iron * calibration.field_strength
        return np.einsum("ij,nkj->nik", matrix, attitude(at - reference.delay).as_matrix())

    around = turned(time)
    field = np.linalg.lstsq(around.reshape(-1, 3), (read - calibration.hard_iron).ravel(), rcond=None)[0]
    rate = (turned(time + STEP) - turned(time - STEP)) @ field / (2 * STEP)
    knots = np.arange(time[0], time[-1] + KNOTS, KNOTS)
    along = np.maximum(1 - np.abs(time[:, None] - knots) / KNOTS, 0.0)  # (n, k), linear between the knots
    by_axis = np.eye(3)
    design = np.concatenate(
        [
            -np.einsum("ia,nb->niab", by_axis, rate).reshape(len(time), 3, 9),
            np.einsum("ia,nb->niab", by_axis, around @ field).reshape(len(time), 3, 9),
            np.einsum("nij,nk->nijk", around, along).reshape(len(time), 3, -1),
            np.tile(by_axis, (len(time), 1, 1)),
        ],
        axis=2,
    )
    residual = read - calibration.hard_iron - around @ field
    flat, known = design.reshape(-1, design.shape[2]), residual.ravel()
    inverse = np.linalg.pinv(flat.T @ flat, hermitian=True)
    value = inverse @ (flat.T @ known)
    score = np.einsum("nip,ni->np", design, (known - flat @ value).reshape(-1, 3))
    summed = np.zeros((int((time[-1] - time[0]) / BLOCK) + 1, flat.shape[1]))
    np.add.at(summed, ((time - time[0]) / BLOCK).astype(int), score)
    influence = summed @ inverse[:, :9]
    return value[:9] + np.eye(3).ravel() * reference.delay, influence.T @ influence


def compare(effect: Effect, value: Array, covariance: Array, unit: float) -> None:
    """Print an effect beside its values by optics (k,), with their covariance, in units of 1 / unit."""
    value, own = np.atleast_1d(value) * unit, np.sqrt(np.diag(np.atleast_2d(covariance))) * unit
    square = float(np.mean((effect.value - value) ** 2 / (effect.sigma**2 + own**2)))
    print(f"    {effect.name} ({effect.unit}), {effect.probability:.2f}; mean square {square:.1f}")
    for label, values, sigmas in (("named", effect.value, effect.sigma), ("optics", value, own)):
        print(f"        {label:7}" + ", ".join(f"{v:.2f} ± {s:.2f}" for v, s in zip(values, sigmas, strict=True)))


if __name__ == "__main__":
    main()
