"""Injection of effects of known strength into a real recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.recording.time_base import interpolated
from magyc_gtsam.simulation.effects import chosen
from magyc_gtsam.simulation.environment import CHANNELS, measured
from magyc_gtsam.simulation.scene import Applied, Chain, Scene, Stage

_FINER = 2  # number of grid points between two samples of the faster sensor


def inject(
    recording: Recording,
    calibration: Calibration,
    effects: Sequence[str | tuple[str, float]] = (),
    seed: int = 0,
    channels: Sequence[str] = (),
) -> tuple[Recording, tuple[Applied, ...]]:
    """Return the recording as it would have been with the effects, and the effects applied.

    Args:
        recording: a recording with a gyroscope; its samples keep their stamps.
        calibration: calibration of the recording, which separates the Earth's field from the iron's.
        effects, seed: as in `simulate`.
        channels: simulated channels to add: "current", "temperature", "depth", "position".

    Raises:
        MagycError: there is no gyroscope or no calibration of its bias, or an effect needs an attitude at every row and
            the recording has none.
    """
    wanted = chosen(effects, seed)
    if recording.angular_rate is None or calibration.gyro_bias is None:
        raise MagycError(
            "effects can only be injected into a recording with a gyroscope and a calibration of its bias"
        )
    attitude = None
    if recording.attitude is not None and np.isfinite(recording.attitude).all():
        attitude = Slerp(recording.time, Rotation.from_quat(recording.attitude))
    lacking = [w.name for w in wanted if attitude is None and (w.effect.attitude or w.effect.stage is Stage.WORLD)]
    if lacking:
        raise MagycError(f"effects: {', '.join(lacking)} needs an attitude at every row of {recording.name!r}")

    # The effects act continuously, so they are simulated on a finer grid and their changes added to the samples.
    when, reading = recording.magnetometer
    turned, rates = recording.gyroscope
    grid = _grid(recording, min(float(np.median(np.diff(t))) for t in (when, turned)) / _FINER)
    rate = interpolated(grid, turned, rates) - calibration.gyro_bias
    before = interpolated(grid, when, reading)
    body = calibration.apply(before)
    turn = None if attitude is None else attitude(grid)
    field = np.zeros(3) if turn is None else np.median(turn.apply(body), axis=0)
    rows = np.clip(np.searchsorted(grid, when), 0, len(grid) - 1)
    scene = Scene(grid - grid[0], turn, rate, field, rows, seed)
    chain = Chain(wanted, scene)
    if turn is not None:
        world = np.tile(field, (len(grid), 1))
        body = body + turn.inv().apply(chain.pass_through(Stage.WORLD, world) - world)
    iron = chain.pass_through(Stage.BODY, body) @ calibration.soft_iron.T + calibration.hard_iron
    seen = chain.pass_through(Stage.ELECTRONICS, chain.pass_through(Stage.IRON, iron))
    felt = chain.pass_through(Stage.GYROSCOPE, rate)

    sampling = Chain(wanted, replace(scene, time=when - grid[0], rows=np.arange(len(when))))
    shown = sampling.pass_through(Stage.SAMPLING, np.arange(len(when)))
    _, first, again = np.unique(shown, return_index=True, return_inverse=True)
    sample = (reading + interpolated(when, grid, seen - before))[shown]
    sample = sampling.pass_through(Stage.READING, sample)
    sample = sampling.pass_through(Stage.QUANTISED, sample[first[again]])
    rates = sampling.pass_through(Stage.AXES, rates + interpolated(turned, grid, felt - rate))
    changed = recording.with_samples((when, sample), (turned, rates))

    recorded = [name for name in CHANNELS if name in {*channels, *(n for w in wanted for n in w.effect.needs)}]
    every = np.clip(np.searchsorted(grid, changed.time), 0, len(grid) - 1)
    simulated = {name: measured(scene.environment, name, every, seed) for name in recorded}
    changed = replace(changed, channels={**changed.channels, **simulated})
    return changed, (*chain.applied, *sampling.applied)


def _grid(recording: Recording, step: float) -> Array:
    """Return evenly spaced times from the first row to the last, about `step` s apart."""
    return np.linspace(recording.time[0], recording.time[-1], 1 + int(np.ceil(recording.duration / step)))


def disturb(
    recording: Recording, share: float = 0.2, largest: float = 50e-6, stretch: float = 1.0, seed: int = 0
) -> Recording:
    """Return the recording with a constant disturbance on a share of its stretches.

    Args:
        recording: the recording to disturb.
        share: share of the stretches that are disturbed.
        largest: largest strength of a disturbance, T; direction and strength are random.
        stretch: duration of a stretch, s.
        seed: seed of the random numbers.
    """
    random = np.random.default_rng(seed)
    index = ((recording.time - recording.time[0]) / stretch).astype(int)
    count = int(index[-1]) + 1
    disturbed = random.permutation(count)[: round(share * count)]
    direction = random.standard_normal((len(disturbed), 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    offset = np.zeros((count, 3))
    offset[disturbed] = direction * random.uniform(0, largest, len(disturbed))[:, None]
    return replace(recording, magnetic_field=recording.magnetic_field + offset[index])
