"""Table I of the MAGYC paper: calibrate on one motion, judge heading and field on another, wide one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation import Simulation, simulate

# Mean heading RMSE in degrees and standard deviation of the field's norm in mG, as printed.
PUBLISHED = {
    "raw": {"wide": (28.864, 60.330), "moderate": (28.864, 60.330), "low": (28.864, 60.330)},
    "magyc-bfg": {"wide": (2.659, 9.794), "moderate": (2.735, 9.875), "low": (3.812, 16.016)},
}
SAMPLES, RATE = 10_000, 25.0


@dataclass(frozen=True)
class Row:
    """One method on one motion: medians and 5–95 % ranges over the runs.

    heading: deg, root-mean-square error; spread: mG, standard deviation of the calibrated field's norm;
    systematic: deg, heading error of the noise-free field, which the sensor's noise does not hide.
    """

    method: str
    motion: str
    heading: tuple[float, float, float]
    spread: tuple[float, float, float]
    systematic: tuple[float, float, float]


def heading_error(calibrated: Array, simulation: Simulation) -> Array:
    """(N,) rad: magnetic heading from a calibrated field, levelled by the true roll and pitch, less the true one."""
    attitude = simulation.recording.attitude
    assert attitude is not None
    heading, pitch, roll = Rotation.from_quat(attitude).as_euler("ZYX").T
    level = Rotation.from_euler("YX", np.stack([pitch, roll], axis=1)).apply(calibrated)
    declination = np.arctan2(simulation.field[1], simulation.field[0])
    error = declination - np.arctan2(level[:, 1], level[:, 0]) - heading
    wrapped: Array = np.angle(np.exp(1j * error))
    return wrapped


def table_one(
    runs: int = 20,
    *,
    methods: tuple[str, ...] = ("magyc-bfg", "smoother"),
    gyroscope_noise: float = 5e-3,
    samples: int = SAMPLES,
    progress: Callable[[float], None] | None = None,
) -> list[Row]:
    """Calibrate `runs` recordings of each motion with each method.

    Args:
        runs: random motions and noises, seeds 0 to runs − 1.
        methods: names in `methods()`.
        gyroscope_noise: rad/s; the formulas of the paper's text are lost, 5 and 10 mrad/s are both cited.
        samples: of each recording, at RATE.
        progress: called with the share done.
    """
    duration = samples / RATE
    judge = simulate("wide", duration, RATE, seed=1_000_000, gyroscope_noise=gyroscope_noise)
    quiet = simulate(
        "wide", duration, RATE, seed=1_000_000, gyroscope_noise=gyroscope_noise, magnetometer_noise=0.0
    )
    names = ("raw", *methods)
    scores: dict[tuple[str, str], list[tuple[float, float, float]]] = {
        (name, motion): [] for name in names for motion in PUBLISHED["raw"]
    }
    done = 0
    for motion in PUBLISHED["raw"]:
        for seed in range(runs):
            recording = simulate(motion, duration, RATE, seed, gyroscope_noise=gyroscope_noise).recording
            for name in names:
                estimate = Calibration(np.eye(3), np.zeros(3)) if name == "raw" else calibrate(recording, name)
                scores[name, motion].append(_score(estimate, judge, quiet))
            done += 1
            if progress:
                progress(done / (3 * runs))
    return [Row(name, motion, *_ranges(values)) for (name, motion), values in scores.items()]


def _score(estimate: Calibration, judge: Simulation, quiet: Simulation) -> tuple[float, float, float]:
    field = estimate.apply(judge.recording.magnetic_field)
    error = heading_error(field, judge)
    systematic = heading_error(estimate.apply(quiet.recording.magnetic_field), quiet)
    return (
        float(np.rad2deg(np.sqrt(np.mean(error**2)))),
        float(np.linalg.norm(field, axis=1).std() * 1e7),
        float(np.rad2deg(np.sqrt(np.mean(systematic**2)))),
    )


def _ranges(values: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    middle, low, high = np.percentile(values, [50, 5, 95], axis=0)
    return [(float(m), float(a), float(b)) for m, a, b in zip(middle, low, high, strict=True)]
