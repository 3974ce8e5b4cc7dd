"""The online smoother against the batch method, however its data come in and wherever it is interrupted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magyc_gtsam import MagycError, OnlineCalibrator, Recording, calibrate, read, simulate
from magyc_gtsam.estimators.smoother.fit import begin, descend
from magyc_gtsam.estimators.smoother.marginal import BIAS, HARD_IRON, ContinuedChain, Marginal
from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.recording import Samples


def feed(online, recording, step=20.0, start=-np.inf, end=np.inf, after=None):
    """Each sensor's own samples, `step` seconds at a time."""
    mag, gyro = recording.magnetometer, recording.gyroscope
    for edge in np.arange(recording.time[0], recording.time[-1] + step, step):
        if start <= edge < end:
            rows = slice(*np.searchsorted(mag.time, [edge, edge + step]))
            online.update(mag.time[rows], mag.value[rows])
            rows = slice(*np.searchsorted(gyro.time, [edge, edge + step]))
            online.update(gyro.time[rows], angular_rate=gyro.value[rows])
            if after is not None:
                after(edge)
    return online


def vector(calibration):
    return np.concatenate([vech(calibration.soft_iron), calibration.hard_iron, calibration.gyro_bias])


def distance(calibration, batch):
    """Largest difference in posterior sigmas of the batch result."""
    return np.abs((vector(calibration) - vector(batch)) / np.sqrt(np.diag(batch.covariance))).max()


@pytest.mark.parametrize("motion", ["wide", "moderate", "tiny"])
def test_the_end_result_is_that_of_the_batch(motion, monkeypatch):
    recording = simulate(motion, duration=200, seed=3).recording
    online, batch = feed(OnlineCalibrator(), recording), calibrate(recording)
    calibration = online.calibration
    assert online.converged
    assert calibration.converged
    assert distance(calibration, batch) < 0.05
    np.testing.assert_allclose(np.diag(calibration.covariance), np.diag(batch.covariance), rtol=0.25)
    assert online.changes == ()
    assert online.progress.sentence == "converged"
    untrusted = replace(calibration, converged=False, message="in doubt")
    monkeypatch.setattr(online._engine, "_of_samples_so_far", lambda: untrusted)
    online.update(recording.time[-1:] + 0.1, recording.magnetic_field[-1:], recording.angular_rate[-1:])
    assert (online.progress.converged, online.progress.sentence) == (False, "in doubt")


def test_how_the_samples_are_cut_does_not_matter():
    recording = simulate("low", duration=100, seed=1).recording
    single, table = OnlineCalibrator(), OnlineCalibrator()
    for time, field, rate in zip(recording.time, recording.magnetic_field, recording.angular_rate, strict=True):
        single.update(time, field, rate)
    table.update(recording.time, recording.magnetic_field, recording.angular_rate)
    streams = feed(OnlineCalibrator(), recording, step=7.3)
    rows = OnlineCalibrator()
    nothing = np.full((500, 3), np.nan)
    for i in range(0, len(recording.time), 500):
        part = slice(i, i + 500)
        rows.update(recording.time[part], recording.magnetic_field[part], nothing)
        rows.update(recording.time[part], nothing, recording.angular_rate[part])
    for other in (table, streams, rows):
        assert other.converged == single.converged
        np.testing.assert_array_equal(vector(other.calibration), vector(single.calibration))
        np.testing.assert_array_equal(other.calibration.covariance, single.calibration.covariance)


@pytest.mark.parametrize("options", [{}, {"horizon": 120.0, "hard_iron_drift": 1e-7}])
def test_a_resumed_run_continues_bit_for_bit(tmp_path, options):
    recording = simulate("wide", duration=240, seed=2).recording
    stepped = np.where(recording.time[:, None] > 150, [3e-6, 0, 1e-6], 0.0)
    recording = replace(recording, magnetic_field=recording.magnetic_field + stepped)
    expected = feed(OnlineCalibrator(**options), recording)
    path = tmp_path / "online.npz"
    online = OnlineCalibrator(**options)
    for rows in np.array_split(np.arange(len(recording.time)), 9):
        online.update(recording.time[rows], recording.magnetic_field[rows], recording.angular_rate[rows])
        online.save(path)
        online = OnlineCalibrator.load(path)
    assert not path.with_name("online.npz.part").exists()
    assert [change.time for change in online.changes] == [change.time for change in expected.changes]
    assert len(online.changes) == 1
    assert online.calibration.to_dict() == expected.calibration.to_dict()


def test_what_is_given_up_is_not_lost():
    """Beyond the horizon only a summary is kept: same result, bounded memory."""
    recording = simulate("wide", duration=900, seed=0).recording
    kept = []
    online = OnlineCalibrator(horizon=480.0)
    feed(
        online,
        recording,
        step=5.0,
        after=lambda _: kept.append(len(online._engine._online.buffer.magnetometer.time)),
    )
    assert max(kept) < 5000
    assert max(kept[110:]) < 1100
    batch = calibrate(recording)
    assert distance(online.calibration, batch) < 0.15  # the noise levels are those of the first eight minutes
    # The part that is still kept excludes fewer effects than the log as a whole: that is in the model error.
    stated, whole = (np.diag(c.noise_covariance) for c in (online.calibration, batch))
    np.testing.assert_allclose(stated, whole, rtol=0.25)
    assert (online.calibration.sigma["hard_iron"] < 1.6 * batch.sigma["hard_iron"]).all()
    assert online.calibration.diagnostics["windows"] == pytest.approx(batch.diagnostics["windows"], abs=2)


def test_early_estimates_do_not_poison_later_ones():
    """A hard iron ten times the field, first nearly at rest, so that early fits say nothing."""
    hard_iron = np.array([59e-6, -74e-6, 450e-6])
    simulation = simulate("moderate", duration=240, seed=4, hard_iron=hard_iron)
    recording = simulation.recording
    early = []
    online = OnlineCalibrator()
    feed(online, recording, after=lambda _: early.append(online.converged))
    assert not early[0]
    assert distance(online.calibration, calibrate(recording)) < 0.05
    assert (np.abs(online.calibration.hard_iron - hard_iron) < 5 * online.calibration.sigma["hard_iron"]).all()


def test_at_rest_it_says_that_nothing_turned():
    random = np.random.default_rng(0)
    time = np.arange(1000) / 10
    field = np.array([20e-6, 5e-6, 40e-6]) + 1e-6 * random.standard_normal((1000, 3))
    online = OnlineCalibrator()
    online.update(time, field, 5e-3 * random.standard_normal((1000, 3)))
    assert online.calibration is None
    assert not online.converged
    assert "nothing turned" in online.progress.sentence
    assert online.progress.duration == pytest.approx(99.9)


def test_a_motion_that_is_too_small_is_named():
    recording = simulate("survey", duration=130, seed=0).recording
    online = feed(OnlineCalibrator(), recording)
    assert not online.converged
    assert "turn" in online.progress.sentence
    assert online.progress.weak[0].remedy


@pytest.mark.parametrize(
    ("axes", "given", "option"), [((0, 1, -2), "x,y,z", "x,y,-z"), ((1, 0, -2), "-y,x,z", "y,x,-z")]
)
def test_axes_that_disagree_are_named_as_in_the_batch(axes, given, option):
    """Of a sensor that turned little at first, so that the first fits explain it; whatever axes it was given."""
    recording = simulate("wide", duration=120, seed=0).recording
    rate = np.stack([np.copysign(1, a) * recording.angular_rate[:, abs(a)] for a in axes], axis=1)
    online = OnlineCalibrator(gyroscope_axes=given)
    online.update(recording.time, recording.magnetic_field, rate)
    assert online.calibration is None
    assert f"gyroscope_axes='{option}'" in online.progress.sentence
    assert online.progress.disagree


def test_a_late_sensor_and_holes():
    """The magnetometer begins late; the gyroscope falls silent for a while; some magnetometer samples are lost."""
    recording = simulate("wide", duration=300, seed=5).recording
    mag, gyro = recording.magnetometer, recording.gyroscope
    heard = (gyro.time < 120) | (gyro.time > 130)
    seen = (mag.time > 20) & ((mag.time < 200) | (mag.time > 203))
    streams = (mag.time[seen], mag.value[seen]), (gyro.time[heard], gyro.value[heard])
    online = OnlineCalibrator()
    for edge in range(0, 300, 10):
        for (time, value), name in zip(streams, ("magnetic_field", "angular_rate"), strict=True):
            rows = (time >= edge) & (time < edge + 10)
            online.update(time[rows], **{name: value[rows]})
    batch = calibrate(Recording.from_streams(*streams))
    assert online.calibration.diagnostics["windows"] == batch.diagnostics["windows"]
    assert distance(online.calibration, batch) < 0.05


def test_a_sensor_that_stays_silent_costs_no_memory():
    buffer = SampleBuffer(1.5, 0.4, False)
    for edge in range(0, 3600, 10):
        time = edge + np.arange(0, 10, 0.1)
        values = np.ones((100, 3))
        nothing = Samples(np.empty(0), np.empty((0, 3)))
        buffer.append(Samples(time, values) if edge < 600 else nothing, Samples(time, values))
    assert len(buffer.gyroscope.time) < 6000 + 10 * 250


def test_windows_are_those_of_the_batch():
    recording = simulate("tiny", duration=200, seed=0).recording
    samples = preintegrate(recording)
    buffer = SampleBuffer(samples.length, samples.turn, False)
    for i in range(0, 2000, 137):
        rows = slice(i, i + 137)
        buffer.append(
            *(Samples(s.time[rows], s.value[rows]) for s in (recording.magnetometer, recording.gyroscope))
        )
    numbers, starts = np.unique(buffer.numbers, return_index=True)
    np.testing.assert_array_equal(starts, samples.starts)
    part = buffer.windows(int(numbers[40]), int(numbers[60]), 0.0).integrate()
    np.testing.assert_array_equal(part.time, samples.integrate().time[40:60])


def test_a_continued_chain_is_the_whole_chain():
    recording = simulate("wide", duration=200, seed=1).recording
    fit = fit_field_chain(recording, delay=0.0)
    fit = descend(fit, 1e-12)
    samples, middle = preintegrate(recording), len(fit.chain.windows) // 2
    past = ContinuedChain(fit.chain.windows, fit.chain.noise).marginalise(fit.state, fit.weights, middle)
    first = int(samples.starts[middle]) - 5
    # The rest, integrated in a world frame of its own.
    buffer = SampleBuffer(samples.length, samples.turn, False)
    buffer.append(recording.magnetometer, recording.gyroscope)
    numbers = np.unique(buffer.numbers)
    rest = buffer.windows(int(numbers[middle]), int(numbers[-1]) + 1, 0.0)
    assert rest.gyroscope_time[0] <= recording.time[first]
    chain = ContinuedChain(rest.integrate(fit.chain.windows.bias), fit.chain.noise, past)
    start = fit.state.parameters.copy()
    start[HARD_IRON] += 1e-7
    continued = descend(begin(chain, start, fit.free), 1e-12)
    sigma = np.sqrt(np.diag(fit.covariance))[:12]
    moved = (continued.state.parameters - fit.state.parameters)[:12]
    assert (np.abs(moved) < 5e-3 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(continued.covariance))[:12], sigma, rtol=1e-3)
    same = fit.chain.windows.part(middle, len(fit.chain.windows))
    np.testing.assert_array_equal(same.time, chain.windows.time)


def test_walking_parameters_lose_information_as_they_should():
    random = np.random.default_rng(0)
    root = random.standard_normal((18, 18)) * np.r_[np.full(9, 1e8), np.full(3, 1e4), 1e2, np.full(5, 1e3)]
    summary = Marginal(
        np.zeros(16), np.zeros(3), np.zeros((3, 2)), root.T @ root, root.T @ random.standard_normal(18)
    )
    minimum = -np.linalg.solve(summary.information, summary.gradient)
    for rows, sigma in ((HARD_IRON, 1e-8), (BIAS, 1e-4)):
        wider = summary.widen(rows, sigma)
        expected = np.linalg.inv(summary.information)
        expected[rows, rows] += sigma**2 * np.eye(3)
        scale = np.sqrt(np.diag(expected))
        np.testing.assert_allclose(
            np.linalg.inv(wider.information) / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5
        )
        np.testing.assert_allclose(
            -np.linalg.solve(wider.information, wider.gradient) / scale, minimum / scale, atol=1e-4
        )
    forgotten = summary.forget(HARD_IRON).information
    assert np.abs(forgotten[HARD_IRON]).max() < 1e-6 * np.abs(summary.information[HARD_IRON]).max()


def test_samples_that_cannot_be_used_are_left_out_and_counted():
    online = OnlineCalibrator()
    field, rate = np.full((4, 3), 3e-5), np.zeros((4, 3))
    online.update(np.arange(-1.8, -1.0, 0.1), np.tile(field, (2, 1)))
    assert online.progress.sentence == "collecting: no sample of angular_rate yet"
    online.update(np.arange(-0.8, 0.0, 0.1), np.tile(field, (2, 1)), np.tile(rate, (2, 1)))
    online.update([0.0, 0.1, 0.1, 0.05], field + np.arange(12).reshape(4, 3) * 1e-9, rate)
    assert online.progress.left_out == 4  # two stamps of two sensors
    online.update(0.2, [np.nan, 3e-5, 3e-5], [0.0, np.inf, 0.0])
    assert online.progress.left_out == 6
    online.update(0.3, [np.nan] * 3, [np.nan] * 3)  # absent, which is no fault
    assert online.progress.left_out == 6
    assert online.progress.time == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([0.5, 1.0, *np.arange(-3, -2.45, 0.1)], [[3e-5, 0, 4e-5]] * 8), "time goes back from 1.000 to -2.500 s"),
        (([1.0, 5.0], [[3e-5, 0, 4e-5]] * 3), "3 rows for 2 stamps"),
        (([1.0, 5.0], [[3e-5, 0]] * 2), r"magnetic_field: shape \(2, 2\)"),
        ((1.0, [3e-5, 0]), r"magnetic_field: shape \(2,\) for one stamp"),
    ],
)
def test_refused_samples_change_nothing(arguments, words):
    online = OnlineCalibrator()
    online.update(np.arange(-1.0, 0.01, 0.1), [[3e-5, 0, 4e-5]] * 11, [[0, 0, 0]] * 11)
    with pytest.raises(MagycError, match=words):
        online.update(*arguments)
    assert online.progress.time == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([5.0, 5.1], [[30.0, 0, 40.0]] * 2, [[0, 0, 0]] * 2), "magnetic_field: 40 at 5.000 s is beyond 0.003 T"),
        (([5.0, 5.1], [[3e-5, 0, 4e-5]] * 2, [[100.0, 0, 0]] * 2), "angular_rate: 100 .* beyond 70 rad/s"),
    ],
)
def test_refused_units(arguments, words):
    with pytest.raises(MagycError, match=words):
        OnlineCalibrator().update(*arguments)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "smother"}, "'smother' is not one of smoother, magyc-ifg"),
        ({"windows": 2}, "no option 'windows'; it has"),
        ({"hard_iron_drift": -1.0}, "hard_iron_drift"),
        ({"horizon": 1.0}, "horizon"),
        ({"noise": 3}, "noise"),
        ({"angular_rate_is": "mean"}, "angular_rate_is"),
    ],
)
def test_refused_options(options, words):
    with pytest.raises(MagycError, match=words):
        OnlineCalibrator(**options)


def test_files_that_hold_no_state(tmp_path):
    with pytest.raises(MagycError, match="no such file"):
        OnlineCalibrator.load(tmp_path / "none.npz")
    other = tmp_path / "other.npz"
    other.write_text("nothing of the kind")
    with pytest.raises(MagycError, match="not the state of an online calibration"):
        OnlineCalibrator.load(other)
    np.savez(other, header=np.array('{"format": "magyc-gtsam online state 0"}'))
    with pytest.raises(MagycError, match="format 'magyc-gtsam online state 0'"):
        OnlineCalibrator.load(other)
    with pytest.raises(MagycError, match="cannot be written"):
        OnlineCalibrator().save(other / "online.npz")  # a file where a folder is expected
    OnlineCalibrator().save(tmp_path / "created" / "online.npz")
    assert not OnlineCalibrator.load(tmp_path / "created" / "online.npz").converged
    OnlineCalibrator().save(other)
    with np.load(other) as file:
        arrays = {name: file[name] for name in file.files if name != "engine/belief"}
    np.savez(other, **arrays)
    with pytest.raises(MagycError, match="the state of method 'smoother' in it is incomplete or damaged"):
        OnlineCalibrator.load(other)


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "start", "end"),
    [
        ("nexus5_calibration_d1.mcap", None, None),
        ("nexus5_augmented_reality.mcap", None, None),
        ("broad_32_attached_magnet_1cm.mcap", 41.5, 92),
    ],
)
def test_real_recordings_end_as_in_the_batch(shared_data, name, start, end):
    """The phone's hard iron is ten times the field."""
    recording = read(shared_data / name).between(start, end)
    online = feed(OnlineCalibrator(), recording)
    assert online.calibration.converged
    assert online.changes == ()
    assert distance(online.calibration, calibrate(recording)) < 0.05
