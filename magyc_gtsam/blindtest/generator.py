"""Generation of recordings with hidden effects, and of the truth about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from magyc_gtsam.blindtest.from_outside import Function, changed
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.blindtest.visibility import factor_in
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation import MILLIGAUSS, inject, simulate
from magyc_gtsam.simulation.environment import CHANNELS
from magyc_gtsam.simulation.scene import Applied
from magyc_gtsam.storage.files import whole_file
from magyc_gtsam.storage.json_types import json_types

_NOISE = (10 * MILLIGAUSS, 5e-3)
_CUT = 0.03  # largest share of a real recording that is cut off at each end


@dataclass(frozen=True, eq=False)
class HiddenRecording:
    """A recording as the diagnosis sees it, and the truth for the scorer.

    Attributes:
        recording: the recording with all channels that are not withheld, without attitude.
        truth: the true calibration.
        applied: the effects as applied.
        attitude: (N, 4) reference that the diagnosis does not get; None without one.
    """

    recording: Recording
    truth: Calibration
    applied: tuple[Applied, ...]
    attitude: Array | None


def generate(
    scenario: Scenario, real: Recording | None = None, outside: Mapping[str, Function] | None = None
) -> HiddenRecording:
    """Return the recording of a scenario and its truth.

    Args:
        scenario: the scenario.
        real: the recording of a scenario of the set "real"; its factors are on the strength that stands out there as
            far as the published strength does in a simulated recording.
        outside: foreign effects by name; see `from_outside`.
    """
    if real is not None:
        if scenario.cut:
            real = _shortened(real, scenario.seed)
        calibration = _calibration(real)
        effects = [(n, f * factor_in(real, calibration, n, scenario.seed)) for n, f in scenario.effects]
        recording, applied = inject(real, calibration, effects, scenario.seed, CHANNELS)
        return HiddenRecording(_blinded(recording, scenario), calibration, applied, real.attitude)
    simulation = simulate(
        scenario.motion,
        scenario.duration,
        seed=scenario.seed,
        effects=[e for e in scenario.effects if e[0] not in (outside or {})],
        channels=CHANNELS,
        **sensors(scenario.seed),
    )
    recording = simulation.recording
    for name, factor in scenario.effects:
        if outside and name in outside:
            recording = changed(recording, name, outside[name], factor, scenario.seed)
    return HiddenRecording(_blinded(recording, scenario), simulation.truth, simulation.effects, recording.attitude)


@lru_cache(maxsize=1)
def noise_free(scenario: Scenario) -> Recording:
    """Return the simulated recording with its effects but without noise, on which the heading is judged."""
    sensor = sensors(scenario.seed) | {"magnetometer_noise": 0.0, "gyroscope_noise": 0.0}
    physical = tuple(e for e in scenario.effects if e[0] not in ("coloured-noise", "spikes"))
    recording = simulate(
        scenario.motion, scenario.duration, seed=scenario.seed, effects=physical, channels=CHANNELS, **sensor
    ).recording
    return _without_channels(recording, scenario)


def sensors(seed: int) -> dict[str, Any]:
    """Return a random place on Earth and a random instrument as arguments of `simulate`."""
    random = np.random.default_rng([seed, 1])
    dip, declination = np.radians(random.uniform(50, 68)), np.radians(random.uniform(-20, 20))
    north = np.cos(dip) * np.array([np.cos(declination), np.sin(declination), 0.0])
    bent = random.uniform(-0.12, 0.12, (3, 3))
    quality = random.uniform(0.8, 1.25, 2)
    return {
        "field": random.uniform(420, 520) * MILLIGAUSS * (north + [0.0, 0.0, np.sin(dip)]),
        "soft_iron": np.eye(3) + 0.5 * (bent + bent.T),
        "hard_iron": random.uniform(-150, 150, 3) * MILLIGAUSS,
        "gyro_bias": random.normal(0, 5e-3, 3),
        "magnetometer_noise": _NOISE[0] * quality[0],
        "gyroscope_noise": _NOISE[1] * quality[1],
    }


def truth_of(scenario: Scenario, hidden: HiddenRecording) -> dict[str, Any]:
    """Return the truth to seal, as JSON types."""
    return {
        "scenario": asdict(scenario),
        "effects": [json_types(applied) for applied in hidden.applied],
        "truth": hidden.truth.to_dict(),
    }


def write(path: Path, recording: Recording) -> None:
    """Write a recording as arrays for the diagnosing process, which reads it by `diagnosis.load`."""
    arrays: dict[str, Any] = {
        "time": recording.time,
        "magnetic_field": recording.magnetic_field,
        "angular_rate": recording.angular_rate,
        "magnetic_field_fresh": recording.magnetic_field_fresh,
        "angular_rate_fresh": recording.angular_rate_fresh,
        "magnetic_field_stamped": recording.magnetic_field_stamped,
        "angular_rate_is": np.array(recording.angular_rate_is),
    }
    if recording.acceleration is not None:
        arrays["acceleration"] = recording.acceleration
    arrays |= {f"channel {k}": v for k, v in recording.channels.items()}
    with whole_file(path) as part, part.open("wb") as file:
        np.savez(file, **arrays)


def _shortened(real: Recording, seed: int) -> Recording:
    """Cut up to `_CUT` off the start and the end."""
    duration = float(real.time[-1] - real.time[0])
    start, end = np.random.default_rng([seed, 2]).uniform(0, _CUT, 2) * duration
    return real.between(start, duration - end)


@lru_cache
def _calibration(real: Recording) -> Calibration:
    return calibrate(real)


def _blinded(recording: Recording, scenario: Scenario) -> Recording:
    return replace(_without_channels(recording, scenario), attitude=None, name="recording", notes=())


def _without_channels(recording: Recording, scenario: Scenario) -> Recording:
    """Remove the withheld channels, which the calibration to be judged did not have either."""
    return replace(
        recording,
        acceleration=None if "acceleration" in scenario.withheld else recording.acceleration,
        channels={k: v for k, v in recording.channels.items() if k not in scenario.withheld},
    )
