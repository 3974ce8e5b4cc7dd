"""Axes that stand still while a vehicle calibrates: noticed, said, and not learnt from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.online.chance_repeats import ChanceRepeats
from magyc_gtsam.online.intake import Intake
from magyc_gtsam.sensor_faults.faults import SensorFaults
from magyc_gtsam.simulation import AMPLITUDES
from magyc_gtsam.study.efficiency import error, nees

CHI2_11 = 31.3  # 99.9 % point of χ² of 11 degrees of freedom
ALL = slice(None)


def frozen(recording: mg.Recording, sensor: str, axis: Any, start: float, end: float = 1e9) -> mg.Recording:
    """The same with an axis that keeps the value it has at `start`."""
    value = getattr(recording, sensor).copy()
    rows = np.flatnonzero((recording.time >= start) & (recording.time <= end))
    value[rows, axis] = value[rows[0], axis]
    both = {"magnetic_field": recording.magnetic_field, "angular_rate": recording.angular_rate}
    return mg.Recording(recording.time, **both | {sensor: value})


def feed(online: mg.OnlineCalibrator, recording: mg.Recording, start: float = 0.0, end: float = 1e9) -> Any:
    """Every row, 20 s at a time."""
    time = recording.time
    for edge in np.arange(0.0, time[-1] + 20, 20.0):
        if start <= edge < end:
            rows = slice(*np.searchsorted(time, [edge, edge + 20]))
            online.update(time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
    return online


class Watch(SensorFaults):
    """The detectors behind what the online calibrator has before them."""

    def __init__(self) -> None:
        super().__init__()
        self._intake, self._repeats = Intake(), ChanceRepeats()

    def see(self, time: np.ndarray, field: np.ndarray | None, rate: np.ndarray | None) -> None:
        magnetometer, gyroscope = self._intake.take(time, field, rate)
        fresh, repeated = self._repeats.take(magnetometer)
        self.take(fresh, gyroscope, repeated)


def watched(recording: mg.Recording, field: np.ndarray | None = None, rate: np.ndarray | None = None) -> Watch:
    """A watch that has seen all rows, or those of other values."""
    watch = Watch()
    field = recording.magnetic_field if field is None else field
    rate = recording.angular_rate if rate is None else rate
    for i in range(0, len(recording.time), 365):
        rows = slice(i, i + 365)
        watch.see(recording.time[rows], field[rows], rate[rows])
    return watch


@pytest.mark.parametrize(
    ("motion", "sensor", "axis", "axes"),
    [
        ("moderate", "magnetic_field", 0, "x"),
        ("low", "magnetic_field", ALL, "xyz"),
        ("tiny", "angular_rate", 2, "z"),
        ("wide", "angular_rate", ALL, "xyz"),
    ],
)
def test_a_stretch_is_not_learnt_from(motion: str, sensor: str, axis: Any, axes: str) -> None:
    """Unnoticed, x of the magnetometer for three minutes put the hard iron of `moderate` 10 µT off, of `tiny` 6 µT, and
    was called a step in hard iron."""
    simulation = mg.simulate(motion, 400, seed=1)
    recording = frozen(simulation.recording, sensor, axis, 120.0, 240.0)
    online = feed(mg.OnlineCalibrator(), recording, end=200.0)
    during = online.progress.sentence
    assert during.startswith(f"{sensor}: ax")
    assert "stuck at " in during
    assert during.endswith("it is not used until it moves")
    feed(online, recording, start=200.0)
    assert online.converged
    assert online.progress.sentence == "converged"
    assert online.changes == ()
    (stuck,) = online.progress.stuck
    assert (stuck.sensor, stuck.axes) == (sensor, axes)
    assert stuck.stretches[0] == pytest.approx((120, 240), abs=0.2)
    assert stuck.share == pytest.approx(0.3, abs=0.01)
    calibration = online.calibration
    assert calibration.trusted
    assert calibration.message.endswith(stuck.where)
    assert calibration.diagnostics["left_out"] == [stuck.where]
    assert nees(error(calibration, simulation.truth), calibration.covariance) < CHI2_11


def test_until_the_end() -> None:
    simulation = mg.simulate("tiny", 400, seed=1)
    online = feed(mg.OnlineCalibrator(), frozen(simulation.recording, "magnetic_field", 1, 300.0))
    assert online.progress.sentence.startswith("magnetic_field: axis y of the magnetometer is stuck at ")
    assert online.progress.left_out > 990
    assert nees(error(online.calibration, simulation.truth), online.calibration.covariance) < CHI2_11


def test_a_dead_gyroscope() -> None:
    recording = mg.simulate("wide", duration=120, seed=1).recording
    dead = mg.Recording(recording.time, recording.magnetic_field, np.zeros((1200, 3)))
    online = feed(mg.OnlineCalibrator(), dead)
    assert online.calibration is None
    assert online.progress.sentence.startswith(
        "angular_rate: axes x, y, z are stuck at 0, 0, 0 mrad/s from 0.0 to "
    )
    assert "while the field turned" in online.progress.sentence


def test_magyc_ifg_is_watched_too() -> None:
    recording = mg.simulate("wide", 300, seed=1).recording
    part, whole = (
        feed(mg.OnlineCalibrator(method="magyc-ifg"), log).calibration
        for log in (frozen(recording, "magnetic_field", 0, 120.0, 220.0), recording)
    )
    assert "axis x of the magnetometer is stuck" in part.message
    np.testing.assert_allclose(part.hard_iron, whole.hard_iron, atol=3e-6)


def ways(log: mg.Recording) -> list[Callable[[mg.OnlineCalibrator], Any]]:
    """To hand a log over: sample by sample, at once, sensor by sensor in blocks."""
    columns = log.time, log.magnetic_field, log.angular_rate
    return [
        lambda online: [online.update(*row) for row in zip(*columns, strict=True)],
        lambda online: online.update(*columns),
        lambda online: [
            online.update(log.time[i : i + 73], **{name: getattr(log, name)[i : i + 73]})
            for i in range(0, len(log.time), 73)
            for name in ("angular_rate", "magnetic_field")
        ],
    ]


def test_how_the_samples_are_cut_does_not_matter() -> None:
    recording = mg.simulate("moderate", duration=180, seed=2).recording
    log = frozen(frozen(recording, "angular_rate", ALL, 60.0, 80.0), "magnetic_field", 1, 110.0, 150.0)
    results = []
    for way in ways(log):
        online = mg.OnlineCalibrator()
        way(online)
        assert [(s.sensor, s.axes) for s in online.progress.stuck] == [
            ("magnetic_field", "y"),
            ("angular_rate", "xyz"),
        ]
        results.append(online.calibration.to_dict())
    assert results[0] == results[1] == results[2]


def test_a_run_resumed_while_samples_are_held_back(tmp_path: Path) -> None:
    recording = mg.simulate("low", duration=180, seed=2).recording
    log = frozen(frozen(recording, "angular_rate", ALL, 60.0, 100.0), "magnetic_field", ALL, 120.0, 150.0)
    expected = feed(mg.OnlineCalibrator(), log)
    online = mg.OnlineCalibrator()
    for edge in range(0, 180, 20):
        feed(online, log, start=edge, end=edge + 20)
        online.save(tmp_path / "state.npz")
        online = mg.OnlineCalibrator.load(tmp_path / "state.npz")
    assert online.progress == expected.progress
    assert len(online.progress.stuck) == 2
    assert online.calibration.to_dict() == expected.calibration.to_dict()


@pytest.mark.parametrize("motion", [*AMPLITUDES, "dive", "survey"])
def test_what_may_repeat(motion: str) -> None:
    """Clean, held, and coarse sensors: nothing is called stuck, nothing dropped."""
    recording = mg.simulate(motion, 300, seed=sum(map(ord, motion))).recording
    field, rate = recording.magnetic_field, recording.angular_rate
    held = np.repeat(field[::3], 3, axis=0)
    for f, w in (
        (field, rate),
        (held, rate),
        (field, np.repeat(rate[::3], 3, axis=0)),
        (np.round(held / 3e-7) * 3e-7, np.round(rate / 1e-3) * 1e-3),
        (np.round(field / 3e-6) * 3e-6, np.round(rate / 15e-3) * 15e-3),
    ):
        watch = watched(recording, f, w)
        assert watch.stuck(300.0) == ()
        assert watch.dropped == 0


def test_a_vehicle_at_rest_with_coarse_sensors() -> None:
    """Rest between two turns; the field stays on its steps for minutes, exactly so for some of them."""
    recording = mg.simulate("wide", seed=3).recording
    random = np.random.default_rng(0)
    field, rate = recording.magnetic_field.copy(), recording.angular_rate.copy()
    rest = (recording.time > 200) & (recording.time < 400)
    field[rest] = field[rest][0] + random.normal(0, 0.05e-6, (rest.sum(), 3))
    rate[rest] = [1e-3, 0.0, 0.2e-3] + random.normal(0, 0.1e-3, (rest.sum(), 3))
    field, rate = np.round(field / 0.3e-6) * 0.3e-6, np.round(rate / 1e-3) * 1e-3
    assert (np.diff(rate[rest], axis=0) == 0).all(axis=1).mean() > 0.9
    watch = watched(recording, field, rate)
    assert watch.stuck(600.0) == ()
    assert watch.dropped == 0


@pytest.mark.real
def test_real_logs(shared_data: Path) -> None:
    """Nothing stands still or is cut off, but in one that was turned faster than ±250 °/s twice; the batch finds the
    same 22 samples."""
    for log in sorted(shared_data.glob("*.mcap")):
        recording = mg.read(log)
        watch = Watch()
        (time, field), (when, rate) = recording.magnetometer, recording.gyroscope
        for edge in np.arange(recording.time[0], recording.time[-1] + 20, 20.0):
            rows = slice(*np.searchsorted(time, [edge, edge + 20]))
            watch.see(time[rows], field[rows], None)
            rows = slice(*np.searchsorted(when, [edge, edge + 20]))
            watch.see(when[rows], None, rate[rows])
            assert watch.clipped_field is None, log.name
        assert watch.stuck(recording.duration) == (), log.name
        if log.stem == "breakout_boards_hand_rotation":
            assert watch.clipped.axes == "x"
            assert watch.clipped.count == pytest.approx(22, abs=5)  # the first ones, before it could be known
        else:
            assert watch.clipped is None, log.name
            assert watch.dropped == 0, log.name
