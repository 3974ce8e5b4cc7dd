"""Random motions of a vehicle: Euler angles and their analytic derivatives.

The world frame is north-east-down, and the attitude rotates from sensor to world. The motions "wide", "moderate", "low"
and "tiny" are those of the MAGYC paper (section V).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from magyc_gtsam.recording import Array

# Amplitude of roll, pitch and heading in degrees; the rate of each is drawn from RATES in rad/s.
AMPLITUDES = {"wide": (5, 45, 360), "moderate": (5, 5, 360), "low": (5, 45, 90), "tiny": (5, 5, 90)}
RATES = ((0.05, 0.08), (0.1, 0.3), (0.2, 0.4))

Angles = tuple[Array, Array]  # (N, 3) roll, pitch, heading in rad, and their time derivatives in rad/s
Path = Callable[[Array], Angles]
Motion = Callable[[np.random.Generator], Path]


def kinematics(angle: Array, derivative: Array) -> tuple[Rotation, Array]:
    """Return the attitude sensor→world and the angular rate (N, 3) in the sensor frame from Euler angles and rates."""
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


def _waves(amplitude: Array, frequency: Array, random: np.random.Generator) -> Path:
    """Return the path of angles that are sums of waves: amplitudes, rad, and frequencies, rad/s, (3,) or (3, waves)."""
    amplitude, frequency = (each.reshape(3, -1) for each in (amplitude, frequency))
    phase = random.uniform(-np.pi, np.pi, amplitude.shape)

    def angles(time: Array) -> Angles:
        argument = time[:, None, None] * frequency + phase
        return (amplitude * np.sin(argument)).sum(axis=2), (amplitude * frequency * np.cos(argument)).sum(axis=2)

    return angles


def sinusoids(amplitude: Sequence[float]) -> Motion:
    """Return the motion A sin(w/A t + φ) of each angle, with largest rate w; `amplitude` (3,) in degrees."""

    def draw(random: np.random.Generator) -> Path:
        largest = np.deg2rad(amplitude)
        return _waves(largest, random.uniform(*np.transpose(RATES)) / largest, random)

    return draw


# Motion "multi", per angle: amplitudes of its waves in degrees, and the ranges of their periods in s.
_WAVES = {
    "roll": ((7.0, 4.0, 1.5), ((9, 14), (5, 8), (3, 4))),
    "pitch": ((18.0, 8.0, 2.0), ((40, 70), (15, 25), (4, 7))),
    "heading": ((300.0, 60.0, 3.0), ((100, 160), (30, 50), (4, 7))),
}


def _multi(random: np.random.Generator) -> Path:
    """Return a path with three waves of random period per angle, as of a vehicle that turns in a swell."""
    amplitude = np.deg2rad([waves for waves, _ in _WAVES.values()])  # (3, waves)
    period = np.array([random.uniform(*np.transpose(ranges)) for _, ranges in _WAVES.values()])
    return _waves(amplitude, 2 * np.pi / period, random)


def _level(roll: float, pitch: float, turn_rate: tuple[float, float]) -> Motion:
    """Return the motion of a vehicle that cannot tilt.

    It turns to and fro by 360° at a largest rate from the range `turn_rate`, rad/s, and rolls and pitches with the
    waves by `roll` and `pitch` degrees.
    """

    def draw(random: np.random.Generator) -> Path:
        amplitude = np.deg2rad([roll, pitch, 360.0])
        waves = 2 * np.pi / random.uniform((5, 6), (12, 14))
        return _waves(amplitude, np.append(waves, random.uniform(*turn_rate) / amplitude[2]), random)

    return draw


def _waypoints(draw_points: Callable[[np.random.Generator], tuple[Array, Array]]) -> Motion:
    """Return a smooth motion through waypoints (time, angles in degrees), with a small swell added."""

    def draw(random: np.random.Generator) -> Path:
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
    """Return waypoints of full turns in alternating directions, each at another tilt, of some 40 s each."""
    tilts = [(0, 0), (0, 20), (0, -20), (12, 0), (-12, 0), (0, 35), (0, -35)]
    time, points = [0.0], [(0.0, 0.0, 0.0)]
    heading, direction = 0.0, 1
    for roll, pitch in tilts * 250:  # more than twenty hours; the caller's duration ends it
        time.append(time[-1] + random.uniform(6, 10))
        points.append((roll, pitch, heading))
        heading += 360 * direction
        direction = -direction
        time.append(time[-1] + random.uniform(35, 45))
        points.append((roll, pitch, heading))
    return np.array(time), np.array(points)


def _survey(random: np.random.Generator) -> tuple[Array, Array]:
    """Return waypoints of legs of 90 s joined by half turns of 20 s, alternately right and left."""
    time, points = [0.0], [(0.0, 0.0, 30.0)]
    direction = 1
    for _ in range(700):
        _, _, heading = points[-1]
        time.append(time[-1] + random.uniform(80, 100))
        points.append((random.normal(0, 1), random.normal(-2, 1), heading))
        time.append(time[-1] + 20.0)
        points.append((random.normal(0, 1), random.normal(-2, 1), heading + 180 * direction))
        direction = -direction
    return np.array(time), np.array(points)


MOTIONS: dict[str, Motion] = {
    **{name: sinusoids(amplitude) for name, amplitude in AMPLITUDES.items()},
    "level": _level(1.0, 1.0, RATES[2]),
    "ship": _level(2.0, 1.0, (0.03, 0.03)),
    "multi": _multi,
    "dive": _waypoints(_dive),
    "survey": _waypoints(_survey),
}
