"""Attitude of a phone from gyroscope, accelerometer and an uncalibrated magnetometer, against optical reference.

    python benchmarks/slam_phone.py FOLDER

FOLDER holds nexus5_augmented_reality.mcap (datasets/README.md). Batch graph of `Rot3` keyframes: GTSAM's own
`AHRSFactor` and `AttitudeFactorRot3`, and the magnetometer's blocks with soft iron, hard iron and the world's
field as variables, all of unknown start. Next to it the same graph without the calibration, without the
magnetometer, and the filter VQF (`pip install vqf`), forward and offline. A constant heading between the
optical and the magnetic north is taken out of each; all of them get the same delay of the magnetometer.
"""

import argparse
from pathlib import Path

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, F, H, R
from scipy.spatial.transform import Rotation, Slerp
from vqf import VQF, offlineVQF

import magyc_gtsam as mg
from magyc_gtsam.factors import KeyframeField, keyframe_field_factor, world_field_prior

KEYFRAME = 0.2  # s
NO_IRON = np.array([1.0, 0, 0, 1, 0, 1])
FIELD = np.array([0.0, 22.4, -41.5]) * 1e-6  # T, east of magnetic north, north, up: the model at Grenoble, 2015
FIELD_SIGMA = np.array([0.05, 8.0, 8.0]) * 1e-6  # a building's; the first one says where north is
ISOTROPIC = gtsam.noiseModel.Isotropic.Sigma


def graph_attitude(
    recording: mg.Recording, delay: float, free: bool, magnetometer: bool = True
) -> tuple[np.ndarray, Rotation, gtsam.Values]:
    """Keyframe times and attitudes of the graph, and its values."""
    (mag_time, field), (time, rate) = recording.magnetometer, recording.gyroscope
    mag_time = mag_time - delay
    frames = np.arange(time[2], time[-3], KEYFRAME)
    params = gtsam.PreintegratedRotationParams()
    params.setGyroscopeCovariance(np.eye(3) * 4e-3**2 / 200)
    gravity = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(1.345), ISOTROPIC(2, 0.05))
    up = gtsam.Unit3(np.array([0.0, 0, 1]))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.addPriorPoint3(B(0), np.zeros(3), ISOTROPIC(3, 0.1))
    values.insert(B(0), np.zeros(3))
    centre = 0.5 * (field.max(axis=0) + field.min(axis=0)) * 1e6 if free else np.zeros(3)
    if magnetometer:
        graph.addPriorVector(A(0), NO_IRON, ISOTROPIC(6, 0.3 if free else 1e-4))
        graph.addPriorPoint3(H(0), centre, ISOTROPIC(3, 100.0 if free else 1e-3))
        graph.push_back(world_field_prior(F(0), FIELD, FIELD_SIGMA))
        for key, value in ((A(0), NO_IRON), (H(0), centre), (F(0), FIELD * 1e6)):
            values.insert(key, value)
    force = recording.acceleration

    def direction(k: int) -> gtsam.Unit3:
        near = np.abs(recording.time - frames[k]) < KEYFRAME / 2
        return gtsam.Unit3(force[near].mean(axis=0))

    first = Rotation.align_vectors([[0, 0, 1.0]], [direction(0).point3()])[0]
    values.insert(R(0), gtsam.Rot3(first.as_matrix()))
    graph.addPriorRot3(R(0), gtsam.Rot3(first.as_matrix()), gtsam.noiseModel.Diagonal.Sigmas([1.0, 1.0, 3.0]))
    for k in range(1, len(frames)):
        # A horizon that grows keeps the start close: the bias is far off and the heading unknown.
        inside = (time >= frames[k - 1]) & (time < frames[k])
        bias = values.atPoint3(B(0))
        turn = gtsam.PreintegratedAhrsMeasurements(params, bias)
        stamps = np.r_[frames[k - 1], time[inside], frames[k]]
        rates = np.stack([np.interp(stamps, time, axis) for axis in rate.T], axis=1)
        for step, mean in zip(np.diff(stamps), 0.5 * (rates[1:] + rates[:-1]), strict=True):
            if step > 0:
                turn.integrateMeasurement(mean, step)
        graph.push_back(gtsam.AHRSFactor(R(k - 1), R(k), B(0), turn))
        graph.push_back(gtsam.AttitudeFactorRot3(R(k), up, gravity, direction(k)))
        values.insert(R(k), values.atRot3(R(k - 1)).compose(turn.deltaRij()))
        rows = (mag_time > frames[k - 1]) & (mag_time <= frames[k])
        if magnetometer and rows.any():
            block = KeyframeField.from_samples((mag_time[rows], field[rows]), (time, rate), frames[k], bias=bias)
            keys = (R(k), A(0), H(0))
            graph.push_back(
                keyframe_field_factor(*keys, block, 2.4e-6, gyro_bias_key=B(0), field_key=F(0), robust="huber")
            )
        if k in (25, 50, 100, 200, 400, len(frames) - 1):
            values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    quaternions = [values.atRot3(R(k)).toQuaternion() for k in range(len(frames))]
    return frames, Rotation.from_quat([[q.x(), q.y(), q.z(), q.w()] for q in quaternions]), values


def errors(recording: mg.Recording, time: np.ndarray, attitude: Rotation) -> tuple[float, float]:
    """Root-mean-square heading and tilt error, degrees, a constant heading taken out."""
    known = np.isfinite(recording.attitude).all(axis=1)
    reference_time = recording.time[known]
    inside = (time > reference_time[0]) & (time < reference_time[-1])
    reference = Slerp(reference_time, Rotation.from_quat(recording.attitude[known]))(time[inside])
    difference = attitude[inside] * reference.inv()
    heading = 2 * np.arctan2(difference.as_quat()[:, 2], difference.as_quat()[:, 3])
    heading = np.angle(np.exp(1j * heading) / np.exp(1j * heading).mean())
    tilt = 2 * np.arccos(np.clip(np.hypot(*difference.as_quat()[:, 2:].T), 0, 1))
    return float(np.degrees(np.sqrt(np.mean(heading**2)))), float(np.degrees(np.sqrt(np.mean(tilt**2))))


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    recording = mg.read(parser.parse_args().folder / "nexus5_augmented_reality.mcap")
    calibrated = mg.calibrate(recording)
    delay = calibrated.delay
    settings = {
        "graph, no magnetometer": {"free": False, "magnetometer": False},
        "graph, magnetometer as it is": {"free": False},
        "graph, calibration on board": {"free": True},
    }
    for name, options in settings.items():
        time, attitude, values = graph_attitude(recording, delay, **options)
        heading, tilt = errors(recording, time, attitude)
        print(f"{name:38s} heading {heading:6.2f}°, tilt {tilt:6.2f}°")
        if options["free"]:
            for who, hard_iron, bias in (
                ("graph", values.atPoint3(H(0)), values.atPoint3(B(0))),
                ("`smoother`", calibrated.hard_iron * 1e6, calibrated.gyro_bias),
            ):
                print(f"    {who}: hard iron, µT {hard_iron.round(1)}, bias, mrad/s {(bias * 1e3).round(1)}")

    (mag_time, field), (time, rate) = recording.magnetometer, recording.gyroscope
    even = np.arange(time[0], time[-1], 1 / 200)
    gyr, acc, mag = (
        np.ascontiguousarray(np.stack([np.interp(even, t, axis) for axis in value.T], axis=1))
        for t, value in ((time, rate), (recording.time, recording.acceleration), (mag_time - delay, field))
    )
    fields = {"uncalibrated": mag, "calibrated by `smoother`": np.ascontiguousarray(calibrated.apply(mag))}
    for name, magnetic in fields.items():
        filters = {
            "VQF": VQF(1 / 200).updateBatch(gyr, acc, magnetic),
            "VQF offline": offlineVQF(gyr, acc, magnetic, 1 / 200),
        }
        for kind, result in filters.items():
            attitude = Rotation.from_quat(result["quat9D"][:, [1, 2, 3, 0]])
            heading, tilt = errors(recording, even, attitude)
            print(f"{kind + ', ' + name:38s} heading {heading:6.2f}°, tilt {tilt:6.2f}°")


if __name__ == "__main__":
    main()
