"""Simulation of the field and sensors of the MAGYC paper (section V) on a moving vehicle, with additional effects.

All values are exact at their time stamps: the body rates come from the analytic derivative of the Euler angles, not
from differences.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.numbers import numbers
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation.effects import chosen
from magyc_gtsam.simulation.environment import CHANNELS, GRAVITY, measured
from magyc_gtsam.simulation.motion import MOTIONS, Motion, kinematics, sinusoids
from magyc_gtsam.simulation.scene import MILLIGAUSS, Applied, Chain, Scene, Stage

FIELD = np.array([227.207, 51.796, 411.731]) * MILLIGAUSS
SOFT_IRON = np.array([[1.10, 0.10, 0.04], [0.10, 0.88, 0.02], [0.04, 0.02, 1.22]])
HARD_IRON = np.array([20.0, 120.0, 90.0]) * MILLIGAUSS
GYRO_BIAS = np.array([4.0, -5.0, 2.0]) * 1e-3
_GRID = 100.0  # Hz, lowest rate at which effects with memory are computed
_ACCELEROMETER_NOISE = 0.03  # m/s²
_MOST_SAMPLES = 20_000_000  # more would take several gigabytes


@dataclass(frozen=True, eq=False)
class Simulation:
    """The result of `simulate`.

    Attributes:
        recording: the recording as the instrument would log it.
        truth: the true calibration.
        field: (3,) T, the world's field, north, east, down.
        effects: the effects as applied, with their sizes and random parameters.
    """

    recording: Recording
    truth: Calibration
    field: Array
    effects: tuple[Applied, ...] = ()


def simulate(
    motion: str | tuple[float, float, float],
    duration: float = 600.0,
    rate: float = 10.0,
    seed: int = 0,
    effects: Sequence[str | tuple[str, float]] = (),
    *,
    field: ArrayLike = FIELD,
    soft_iron: ArrayLike = SOFT_IRON,
    hard_iron: ArrayLike = HARD_IRON,
    gyro_bias: ArrayLike = GYRO_BIAS,
    magnetometer_noise: float = 10 * MILLIGAUSS,
    gyroscope_noise: float = 5e-3,
    delay: float = 0.0,
    channels: Sequence[str] | None = None,
    effects_seed: int | None = None,
) -> Simulation:
    """Simulate an instrument on a vehicle.

    Args:
        motion: "wide", "moderate", "low", "tiny" (sinusoids of the paper with random rates and phases), "level" and
            "ship" (a vehicle that cannot tilt, turning at 0.2 to 0.4 or at 0.03 rad/s), "multi" (several frequencies on
            every angle), "dive" (a calibration dive: turns at several tilts) or "survey" (lawn-mower legs, nearly
            level). Three numbers are the amplitudes of roll, pitch and heading in degrees of a motion like "wide".
        duration, rate: s and Hz; the simulation has duration·rate samples.
        seed: seed of motion, noise, surroundings and effects.
        effects: effects beyond the sensor model: names from `simulation.effects.STRENGTHS`, or (name, factor) with a
            factor on the published strength.
        field: (3,) T, world (north, east, down).
        soft_iron, hard_iron, gyro_bias: (3, 3), (3,) T, (3,) rad/s: m = soft_iron u + hard_iron.
        magnetometer_noise, gyroscope_noise: standard deviation per sample and axis, T and rad/s.
        delay: s by which the magnetometer lags the gyroscope.
        channels: channels to record: "current" A, "temperature" °C, "depth" m, "position" (n, 3) m; None for those that
            the effects need. With any channel or effect the accelerometer measures the waves and has noise.
        effects_seed: seed of the effects' directions, shapes and times, so that several logs can share an instrument;
            None for `seed`.

    Returns:
        The recording, with attitude and acceleration, and the truth (soft iron with det 1, its scale moved into
        `field_strength`).

    Raises:
        MagycError: unknown motion, effect or channel, or too few or too many samples.
    """
    sizes = {"magnetometer_noise": magnetometer_noise, "gyroscope_noise": gyroscope_noise, "delay": delay}
    for name, value in {"duration": duration, "rate": rate, **sizes}.items():
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise MagycError(f"{name}: a number is needed, got {value!r:.40}")
    for name, number in (("seed", seed), ("effects_seed", effects_seed)):
        if number is not None and (not isinstance(number, int | np.integer) or number < 0):
            raise MagycError(f"{name}: an integer from 0 on is needed, got {number!r:.40}")
    field, hard_iron, gyro_bias = (
        _finite(name, value, (3,))
        for name, value in (("field", field), ("hard_iron", hard_iron), ("gyro_bias", gyro_bias))
    )
    soft_iron = _finite("soft_iron", soft_iron, (3, 3))
    path, called = _path(motion)
    wanted = chosen(effects, seed if effects_seed is None else effects_seed)
    recorded = _channels(channels, [need for w in wanted for need in w.effect.needs])
    samples = _samples(duration, rate)
    finer = max(1, int(np.ceil(_GRID / rate))) if wanted or recorded else 1
    time = np.arange(samples * finer) / (rate * finer)
    random = np.random.default_rng(seed)
    angles = path(random)  # drawn before the noise
    attitude, body_rate = kinematics(*angles(time))
    late = kinematics(*angles(time - delay))[0] if delay else attitude
    noise = random.standard_normal((2, samples, 3)) * np.reshape([magnetometer_noise, gyroscope_noise], (2, 1, 1))
    scene = Scene(time, attitude, body_rate, field, np.arange(samples) * finer, seed)
    chain = Chain(wanted, scene)
    recording = Recording(
        time[scene.rows],
        _magnetometer(chain, late, soft_iron, hard_iron, noise[0]),
        chain.pass_through(
            Stage.AXES, chain.pass_through(Stage.GYROSCOPE, body_rate)[scene.rows] + gyro_bias + noise[1]
        ),
        acceleration=_acceleration(scene, seed, dynamic=bool(wanted or recorded)),
        attitude=attitude[scene.rows].as_quat(),
        channels={name: measured(scene.environment, name, scene.rows, seed) for name in recorded},
        name="-".join([called, str(seed), *(w.name for w in wanted)]),
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
    return Simulation(recording, truth, field, tuple(chain.applied))


def _samples(duration: float, rate: float) -> int:
    """Return the number of samples."""
    for name, value in (("duration", duration), ("rate", rate)):
        if not value > 0:
            raise MagycError(f"{name}: must be above 0, got {value:g}")
    if not 2.5 < duration * rate <= _MOST_SAMPLES:
        raise MagycError(
            f"duration, rate: {duration:g} s at {rate:g} Hz give {duration * rate:.0f} samples, must be at least 3 and "
            f"at most {_MOST_SAMPLES:,}"
        )
    return round(duration * rate)


def _magnetometer(chain: Chain, attitude: Rotation, soft_iron: Array, hard_iron: Array, noise: Array) -> Array:
    """Return the readings (rows, 3) T at the `attitude` that the magnetometer sees, stage by stage."""
    scene = chain.scene
    world = chain.pass_through(Stage.WORLD, np.tile(scene.field, (len(scene.time), 1)))
    body = chain.pass_through(Stage.BODY, attitude.inv().apply(world))
    iron = chain.pass_through(Stage.IRON, body @ soft_iron.T + hard_iron)
    seen = chain.pass_through(Stage.ELECTRONICS, iron)
    shown = chain.pass_through(Stage.SAMPLING, scene.rows)
    _, first, again = np.unique(shown, return_index=True, return_inverse=True)
    reading = chain.pass_through(Stage.READING, seen[shown] + noise)
    return chain.pass_through(Stage.QUANTISED, reading[first[again]])


def _finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return an argument as an array of this shape, checked."""
    array = numbers(name, value)
    if array.shape != shape or not np.isfinite(array).all():
        raise MagycError(f"{name}: must be finite numbers of shape {shape}, got {reprlib.repr(value)}")
    return array


def _path(motion: str | tuple[float, float, float]) -> tuple[Motion, str]:
    """Return the motion and its name."""
    if isinstance(motion, str):
        if motion not in MOTIONS:
            raise MagycError(f"motion: {motion!r} is not one of {', '.join(MOTIONS)}")
        return MOTIONS[motion], motion
    amplitude = _finite("motion", motion, (3,))
    if not ((amplitude > 0) & (amplitude <= 360)).all():
        raise MagycError(
            f"motion: amplitudes of roll, pitch and heading must be above 0 and at most 360 degrees, got {motion!r}"
        )
    return sinusoids(motion), " ".join(f"{each:g}°" for each in motion)


def _channels(requested: Sequence[str] | None, needed: Sequence[str]) -> tuple[str, ...]:
    names = needed if requested is None else requested
    if isinstance(names, str) or not isinstance(names, Iterable) or not all(isinstance(n, str) for n in names):
        raise MagycError(
            f"channels: a list of names is needed, got {names!r:.60}; there are {', '.join(CHANNELS)}"
        )
    unknown = sorted(set(names) - {*CHANNELS, "acceleration"})
    if unknown:
        raise MagycError(f"channels: {unknown[0]!r} is not one of {', '.join(CHANNELS)}")
    return tuple(name for name in CHANNELS if name in names)


def _acceleration(scene: Scene, seed: int, dynamic: bool) -> Array:
    """Return the specific force (rows, 3) m/s² at the logged rows."""
    assert scene.attitude is not None
    attitude = scene.attitude[scene.rows]
    if not dynamic:
        return np.asarray(attitude.inv().apply([0.0, 0.0, -GRAVITY]))
    random = np.random.default_rng([seed, crc32(b"accelerometer")])
    force = scene.environment.acceleration[scene.rows] - [0.0, 0.0, GRAVITY]
    return np.asarray(attitude.inv().apply(force) + _ACCELEROMETER_NOISE * random.standard_normal(force.shape))
