"""A recording is looked at sample by sample only where a fault is possible, and then no fault may be missed."""

from __future__ import annotations

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.recording import Array
from magyc_gtsam.sensor_faults.faults import SensorFaults
from magyc_gtsam.sensor_faults.screen import may_be_faulty
from magyc_gtsam.sensor_faults.spikes import _BESIDE, _BLOCK, _PIECE, has_spikes
from magyc_gtsam.simulation import Simulation

SENSORS = ("magnetic_field", "angular_rate")


@pytest.fixture(scope="module")
def wide() -> Simulation:
    return mg.simulate("wide", seed=1, duration=120)


def damaged(value: Array, rng: np.random.Generator, steps: tuple[float, ...]) -> Array:
    """Rounded, and on two axes held for some 100 samples, cut off, or zero in one row."""
    step = rng.choice(steps)
    value = np.round(value / step) * step
    for axis in rng.integers(3, size=2):
        first, count = rng.integers(len(value) - 300), rng.integers(90, 300)
        match rng.integers(4):
            case 0:
                value[first : first + count, axis] = value[first, axis]
            case 1:
                most = np.quantile(np.abs(value[:, axis]), rng.choice([0.9, 0.97, 0.99]))
                value[:, axis] = np.clip(value[:, axis], -most, most)
            case 2:
                value[first : first + count] = value[first]
            case 3:
                value[first] = 0.0
    return value


@pytest.mark.parametrize("seed", range(12))
def test_what_a_detector_finds_is_looked_for(wide: Simulation, seed: int) -> None:
    rng, recording = np.random.default_rng(seed), wide.recording
    one, other = recording.magnetic_field, recording.angular_rate
    if seed % 2:
        one = damaged(one, rng, (5e-8, 6e-7))
    else:
        other = damaged(other, rng, (1e-3, 2e-2))
    faulty = mg.Recording(recording.time, one, other)
    faults = SensorFaults.of(faulty)
    found = [len(faults.cut_off.spans), faults.stuck(120.0), faults.zeros.finding(), faults.clipped_field]
    assert may_be_faulty(faulty, SENSORS) or not any(found)


def test_a_clean_recording_is_not_looked_at(wide: Simulation) -> None:
    assert not may_be_faulty(wide.recording, SENSORS)


def test_a_gyroscope_that_stays_at_its_full_scale(wide: Simulation) -> None:
    rate = wide.recording.angular_rate.copy()
    rate[:, 0] = np.minimum(rate[:, 0], 0.9 * rate[:, 0].max())
    rate[400:650, 0] = rate[:, 0].max()
    faults = SensorFaults.of(mg.Recording(wide.recording.time, wide.recording.magnetic_field, rate))
    finding = faults.cut_off.finding(0.1)
    assert finding is not None
    assert finding.axes == "x"
    assert finding.count > 250


@pytest.mark.parametrize("row", [_BLOCK, _PIECE + _BLOCK - 1, _PIECE + _BLOCK, 2 * _PIECE - _BESIDE - 1])
def test_a_spike_is_found_in_any_piece_of_a_recording(row: int) -> None:
    rate = np.random.default_rng(0).normal(0.0, 5e-3, (2 * _PIECE, 3))
    assert not has_spikes(rate)
    rate[row, 1] += 1.0
    assert has_spikes(rate)


def test_a_recording_shorter_than_a_block_has_no_spikes() -> None:
    assert not has_spikes(np.random.default_rng(0).normal(0.0, 5e-3, (_BLOCK - 1, 3)))
