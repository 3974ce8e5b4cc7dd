"""Reading the online smoother: as the batch method, from windows that are integrated once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_online import distance, feed

from magyc_gtsam import OnlineCalibrator, calibrate, simulate
from magyc_gtsam.estimators.smoother.preparation import preintegrate, suitable_turn
from magyc_gtsam.factors.chain.field_windows import in_frame_of, joined
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.io import read
from magyc_gtsam.online import smoother


def test_blocks_joined_are_the_windows_of_the_whole():
    recording = simulate("tiny", duration=200, seed=4).recording
    samples = preintegrate(recording)
    whole = samples.integrate(np.array([3e-3, -2e-3, 1e-3]), 0.01)
    count = len(samples.starts)
    parts = []
    for first, last in ((0, 40), (40, 90), (90, count)):
        begin = int(samples.starts[max(first - 1, 0)])
        end = int(samples.starts[last]) if last < count else len(samples.magnetometer_time)
        gyro = slice(max(begin - 9, 0), end + 9)
        distance_before = _distance(samples)[gyro.start]
        part = Preintegration(
            samples.magnetometer_time[begin:end],
            samples.magnetic_field[begin:end],
            samples.gyroscope_time[gyro],
            samples.angular_rate[gyro],
            length=samples.length,
            turn=samples.turn,
            begun=distance_before,
        ).integrate(whole.bias, whole.delay)
        parts.append(in_frame_of(parts[-1], part) if parts else part)
    blocks = joined(parts)
    np.testing.assert_allclose(blocks.time, whole.time)
    turn = np.linalg.solve(whole.rotation[:, :, 0], blocks.rotation[:, :, 0])
    for name, same in (
        ("field", whole.field),
        ("rotation", np.einsum("ijn,jk->ikn", whole.rotation, turn)),
        ("rotation_rate", np.einsum("ijn,jk->ikn", whole.rotation_rate, turn)),
        ("rotation_bias", np.einsum("ijbn,jk->ikbn", whole.rotation_bias, turn)),
        ("lever", np.einsum("ji,jkn->ikn", turn, whole.lever)),
        ("link_time", whole.link_time),
    ):
        np.testing.assert_allclose(getattr(blocks, name), same, atol=1e-9 * np.abs(same).max(), err_msg=name)


def _distance(samples: Preintegration):
    speed = np.linalg.norm(samples.angular_rate, axis=1)
    progress = np.maximum(0.5 * (speed[1:] + speed[:-1]) / samples.turn, 1 / samples.length) * samples.step
    return np.concatenate([[0.0], np.cumsum(progress)])


def test_when_it_is_read_does_not_matter():
    recording = simulate("wide", duration=180, seed=8).recording
    often, once = OnlineCalibrator(), OnlineCalibrator()
    feed(often, recording, after=lambda _: often.progress)
    feed(once, recording)
    assert often.calibration.to_dict() == once.calibration.to_dict()
    assert once.calibration is once.calibration  # without new samples nothing is computed


@pytest.mark.parametrize("motion", ["wide", "moderate"])
def test_a_long_log_is_read_from_its_end(motion, monkeypatch):
    """Beyond some number of windows the tail is fitted, given all before it, with the last refit's noise levels."""
    recording = simulate(motion, duration=350, seed=9).recording
    online = feed(OnlineCalibrator(), recording)
    whole = online.calibration
    monkeypatch.setattr(smoother, "_MOST_REFITTED", 10)
    online.update(recording.time[-1] + 1e-3, recording.magnetic_field[-1] + 1e-9, recording.angular_rate[-1])
    ending = online.calibration
    assert ending.to_dict() != whole.to_dict()
    assert ending.diagnostics["windows"] == pytest.approx(whole.diagnostics["windows"], abs=1)
    # 0.05 where it applies, beyond six times as many windows.
    assert distance(ending, calibrate(recording)) < 0.15
    np.testing.assert_allclose(np.diag(ending.covariance), np.diag(whole.covariance), rtol=0.25)


def test_motion_that_has_become_enough_since_the_last_refit_is_read_as_by_the_batch():
    """The refit before found ±2.8 µT along z, beyond the limit of 2.5; the whole log has ±2.3 µT."""
    recording = read(Path(__file__).parents[1] / "datasets" / "lawn_mower_survey.mcap", channels=())
    online, batch = feed(OnlineCalibrator(), recording), calibrate(recording)
    assert batch.trusted
    assert online.calibration.trusted
    assert distance(online.calibration, batch) < 1e-6
    np.testing.assert_allclose(online.calibration.covariance, batch.covariance, rtol=1e-6)
    assert not online.converged
    assert online.progress.sentence.startswith("the estimate still changes: hard iron along z ±2.3 µT (limit 2.5)")


def test_windows_are_cut_alike_while_the_spread_changes_little():
    random = np.random.default_rng(0)
    field = random.standard_normal((4000, 3)) * [30e-6, 30e-6, 3e-6]
    assert len({suitable_turn(field[:n]) for n in range(3000, 4000, 50)}) == 1
    assert suitable_turn(field * [1, 1, 20]) == 0.4
    assert suitable_turn(field * [1, 1, 0.1]) == 0.15


def test_it_can_be_read_at_any_time_of_fast_turns() -> None:
    """Of windows with one sample each, one or two after each 64th were integrated alone, which needs three."""
    random = np.random.default_rng(1)
    time = np.arange(0, 60, 0.02)
    rate = np.radians(100) * np.column_stack([np.sin(0.9 * time), np.cos(0.7 * time), np.sin(1.3 * time + 1)])
    attitude = Rotation.identity()
    field = np.empty_like(rate)
    for k, turn in enumerate(Rotation.from_rotvec(0.02 * rate)):
        field[k] = attitude.inv().apply([20e-6, 0, 40e-6])
        attitude = attitude * turn
    field += random.normal(0, 3e-7, field.shape)
    online = OnlineCalibrator()
    for first in range(0, len(time), 10):
        part = slice(first, first + 10)
        online.update(time[part], angular_rate=rate[part] + random.normal(0, 2e-3, (10, 3)))
        online.update(time[first : first + 1], field[first : first + 1])
        if first > 1000:
            assert online.calibration is None or online.calibration.hard_iron is not None
    assert online.calibration is not None
