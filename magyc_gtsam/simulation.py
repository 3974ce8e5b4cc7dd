"""Simulated recordings with their truth: the motions, field and sensors of the MAGYC paper (section V).

The world frame is north-east-down, the attitude turns sensor→world, and all values are those AT their
time stamps: the body rates come from the analytic derivative of the Euler angles, not from differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording

MILLIGAUSS = 1e-7  # T
FIELD = np.array([227.207, 51.796, 411.731]) * MILLIGAUSS
SOFT_IRON = np.array([[1.10, 0.10, 0.04], [0.10, 0.88, 0.02], [0.04, 0.02, 1.22]])
HARD_IRON = np.array([20.0, 120.0, 90.0]) * MILLIGAUSS
GYRO_BIAS = np.array([4.0, -5.0, 2.0]) * 1e-3
GRAVITY = 9.80665

# Amplitude of roll, pitch and heading in degrees; the rate of each is drawn from RATES in rad/s.
AMPLITUDES = {"wide": (5, 45, 360), "moderate": (5, 5, 360), "low": (5, 45, 90), "tiny": (5, 5, 90)}
RATES = ((0.05, 0.08), (0.1, 0.3), (0.2, 0.4))

Angles = tuple[Array, Array]  # (N, 3) roll, pitch, heading in rad, and their time derivatives in rad/s


@dataclass(frozen=True, eq=False)
class Simulation:
    """What `simulate` returns: `recording` as the instrument would log it, and the `truth` behind it.

    `field` (3,) T is the world's field, north, east, down.
    """

    recording: Recording
    truth: Calibration
    field: Array


def simulate(
    motion: str,
    duration: float = 600.0,
    rate: float = 10.0,
    seed: int = 0,
    effects: tuple[str, ...] = (),
    *,
    field: ArrayLike = FIELD,
    soft_iron: ArrayLike = SOFT_IRON,
    hard_iron: ArrayLike = HARD_IRON,
    gyro_bias: ArrayLike = GYRO_BIAS,
    magnetometer_noise: float = 10 * MILLIGAUSS,
    gyroscope_noise: float = 5e-3,
    delay: float = 0.0,
) -> Simulation:
    """Simulate an instrument on a vehicle.

    Args:
        motion: "wide", "moderate", "low", "tiny" (sinusoids of the paper with random rates and
            phases), "dive" (a calibration dive: turns at several roll and pitch attitudes) or
            "survey" (lawn-mower legs, nearly level).
        duration, rate: s and Hz; duration·rate samples.
        seed: of motion and noise.
        effects: names of effects beyond the sensor model; none is known to this simulator yet.
        field: (3,) T, world (north, east, down).
        soft_iron, hard_iron, gyro_bias: (3, 3), (3,) T, (3,) rad/s: m = soft_iron u + hard_iron.
        magnetometer_noise, gyroscope_noise: standard deviation per sample and axis, T and rad/s.
        delay: s by which the magnetometer lags the gyroscope.

    Returns:
        The recording, with attitude and acceleration, and the truth (soft iron with det 1; its scale
        moved into `field_strength`).

    Raises:
        MagycError: unknown motion or effect, or too few samples.
    """
    if effects:
        raise MagycError(
            f"effects: {', '.join(map(repr, effects))} unknown; this simulator has the sensor model only"
        )
    if motion not in MOTIONS:
        raise MagycError(f"motion: {motion!r} is none of {', '.join(MOTIONS)}")
    samples = round(duration * rate)
    if samples < 3:
        raise MagycError(f"duration {duration:g} s at {rate:g} Hz gives {samples} samples, at least 3 are needed")
    random = np.random.default_rng(seed)
    time = np.arange(samples) / rate
    angles = MOTIONS[motion](random)
    attitude, angular_rate = _kinematics(*angles(time))
    then, _ = _kinematics(*angles(time - delay))
    soft_iron, hard_iron, gyro_bias = (np.asarray(v, dtype=float) for v in (soft_iron, hard_iron, gyro_bias))
    body_field = then.inv().apply(np.asarray(field, dtype=float))
    noise = random.standard_normal((2, samples, 3))
    recording = Recording(
        time,
        body_field @ soft_iron.T + hard_iron + magnetometer_noise * noise[0],
        angular_rate + gyro_bias + gyroscope_noise * noise[1],
        acceleration=attitude.inv().apply([0.0, 0.0, -GRAVITY]),
        attitude=attitude.as_quat(),
        name=f"{motion}-{seed}",
    )
    scale = float(np.cbrt(np.linalg.det(soft_iron)))
    truth = Calibration(
        soft_iron / scale,
        hard_iron,
        gyro_bias,
        delay=delay,
        method="truth",
        noise={"magnetic_field": magnetometer_noise, "angular_rate": gyroscope_noise},
        field_strength=scale * float(np.linalg.norm(field)),
    )
    return Simulation(recording, truth, np.array(field, dtype=float))


def disturb(
    recording: Recording, share: float = 0.2, largest: float = 50e-6, stretch: float = 1.0, seed: int = 0
) -> Recording:
    """Add a constant field of random direction and strength up to `largest` T to a `share` of all stretches."""
    random = np.random.default_rng(seed)
    index = ((recording.time - recording.time[0]) / stretch).astype(int)
    count = int(index[-1]) + 1
    hit = random.permutation(count)[: round(share * count)]
    direction = random.standard_normal((len(hit), 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    offset = np.zeros((count, 3))
    offset[hit] = direction * random.uniform(0, largest, len(hit))[:, None]
    return replace(recording, magnetic_field=recording.magnetic_field + offset[index])


def _kinematics(angle: Array, derivative: Array) -> tuple[Rotation, Array]:
    """Attitude sensor→world and angular rate in the sensor frame (N, 3) from Euler angles and their rates."""
    roll, pitch, _ = angle.T
    roll_rate, pitch_rate, heading_rate = derivative.T
    angular_rate = np.stack(
        [
            roll_rate - heading_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + heading_rate * np.sin(roll) * np.cos(pitch),
            -pitch_rate * np.sin(roll) + heading_rate * np.cos(roll) * np.cos(pitch),
        ],
        axis=1,
    )
    return Rotation.from_euler("ZYX", angle[:, ::-1]), angular_rate


def _sinusoids(motion: str) -> Callable[[np.random.Generator], Callable[[Array], Angles]]:
    """angle = A sin(w/A t + φ), so that w is the largest rate of each axis."""

    def draw(random: np.random.Generator) -> Callable[[Array], Angles]:
        amplitude = np.deg2rad(AMPLITUDES[motion])
        frequency = random.uniform(*np.transpose(RATES)) / amplitude
        phase = random.uniform(-np.pi, np.pi, 3)

        def angles(time: Array) -> Angles:
            argument = time[:, None] * frequency + phase
            return amplitude * np.sin(argument), amplitude * frequency * np.cos(argument)

        return angles

    return draw


def _waypoints(
    draw_points: Callable[[np.random.Generator], tuple[Array, Array]],
) -> Callable[[np.random.Generator], Callable[[Array], Angles]]:
    """A smooth path through waypoints (time, angles in degrees) with a little swell on top."""

    def draw(random: np.random.Generator) -> Callable[[Array], Angles]:
        path = PchipInterpolator(*draw_points(random), extrapolate=True)
        slope = path.derivative()
        swell = np.deg2rad([1.2, 0.8, 1.0])
        frequency = 2 * np.pi * random.uniform(0.08, 0.2, 3)
        phase = random.uniform(-np.pi, np.pi, 3)

        def angles(time: Array) -> Angles:
            argument = time[:, None] * frequency + phase
            angle = np.deg2rad(path(time)) + swell * np.sin(argument)
            return angle, np.deg2rad(slope(time)) + swell * frequency * np.cos(argument)

        return angles

    return draw


def _dive(random: np.random.Generator) -> tuple[Array, Array]:
    """Full turns one way and the other, each at another roll and pitch; a turn takes some 40 s."""
    tilts = [(0, 0), (0, 20), (0, -20), (12, 0), (-12, 0), (0, 35), (0, -35)]
    time, points = [0.0], [(0.0, 0.0, 0.0)]
    heading, way = 0.0, 1
    for roll, pitch in tilts * 250:  # twenty and more hours of it; `duration` says where to stop
        time.append(time[-1] + random.uniform(6, 10))
        points.append((roll, pitch, heading))
        heading += 360 * way
        way = -way
        time.append(time[-1] + random.uniform(35, 45))
        points.append((roll, pitch, heading))
    return np.array(time), np.array(points)


def _survey(random: np.random.Generator) -> tuple[Array, Array]:
    """Legs of 90 s joined by half turns of 20 s, right and left in turn."""
    time, points = [0.0], [(0.0, 0.0, 30.0)]
    way = 1
    for _ in range(700):
        _, _, heading = points[-1]
        time.append(time[-1] + random.uniform(80, 100))
        points.append((random.normal(0, 1), random.normal(-2, 1), heading))
        time.append(time[-1] + 20.0)
        points.append((random.normal(0, 1), random.normal(-2, 1), heading + 180 * way))
        way = -way
    return np.array(time), np.array(points)


MOTIONS: dict[str, Callable[[np.random.Generator], Callable[[Array], Angles]]] = {
    **{name: _sinusoids(name) for name in AMPLITUDES},
    "dive": _waypoints(_dive),
    "survey": _waypoints(_survey),
}
