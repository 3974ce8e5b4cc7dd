"""Effects at known strength on a real recording, in which they are not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation.effects import chosen
from magyc_gtsam.simulation.environment import CHANNELS, measured
from magyc_gtsam.simulation.scene import Applied, Chain, Scene, Stage


def inject(
    recording: Recording,
    calibration: Calibration,
    effects: Sequence[str | tuple[str, float]] = (),
    seed: int = 0,
    channels: Sequence[str] = (),
) -> tuple[Recording, tuple[Applied, ...]]:
    """A recording as it would have been with these effects.

    Args:
        recording: with a gyroscope; its rows keep their stamps and masks.
        calibration: of it, which says what of the measured field is iron and what is Earth.
        effects, seed: as in `simulate`.
        channels: simulated surroundings to record beside; "current", "temperature", "depth", "position".

    Raises:
        MagycError: an effect needs the attitude and the recording has none (or not everywhere).
    """
    wanted = chosen(effects, seed)
    if recording.angular_rate is None or calibration.gyro_bias is None:
        raise MagycError("effects are put into recordings with a gyroscope and a calibration of its bias")
    time = recording.time - recording.time[0]
    rows = np.arange(len(time))
    attitude = None
    if recording.attitude is not None and np.isfinite(recording.attitude).all():
        attitude = Rotation.from_quat(recording.attitude)
    angular_rate = recording.angular_rate - calibration.gyro_bias
    lacking = [w.name for w in wanted if attitude is None and (w.effect.attitude or w.effect.stage is Stage.WORLD)]
    if lacking:
        raise MagycError(f"effects: {', '.join(lacking)} needs the attitude at every row of {recording.name!r}")
    body = calibration.apply(recording.magnetic_field)
    field = np.zeros(3) if attitude is None else np.median(attitude.apply(body), axis=0)
    scene = Scene(time, attitude, angular_rate, field, rows, seed)
    chain = Chain(wanted, scene)

    if attitude is not None:
        world = np.tile(field, (len(time), 1))
        body = body + attitude.inv().apply(chain.pass_through(Stage.WORLD, world) - world)
    iron = chain.pass_through(Stage.BODY, body) @ calibration.soft_iron.T + calibration.hard_iron
    seen = chain.pass_through(Stage.ELECTRONICS, chain.pass_through(Stage.IRON, iron))
    shown = chain.pass_through(Stage.SAMPLING, rows)
    _, first, again = np.unique(shown, return_index=True, return_inverse=True)
    reading = chain.pass_through(Stage.READING, seen[shown])
    magnetic_field = chain.pass_through(Stage.QUANTISED, reading[first[again]])
    felt = chain.pass_through(Stage.GYROSCOPE, angular_rate) + calibration.gyro_bias
    fresh = recording.magnetic_field_fresh.copy()
    fresh[1:] &= (magnetic_field[1:] != magnetic_field[:-1]).any(axis=1)
    recorded = [name for name in CHANNELS if name in {*channels, *(n for w in wanted for n in w.effect.needs)}]
    changed = replace(
        recording,
        magnetic_field=magnetic_field,
        magnetic_field_fresh=fresh,
        angular_rate=chain.pass_through(Stage.AXES, felt),
        channels={
            **recording.channels,
            **{name: measured(scene.environment, name, rows, seed) for name in recorded},
        },
    )
    return changed, tuple(chain.applied)
