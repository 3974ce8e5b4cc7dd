"""MAGYC-IFG: compressed as published, published as batch, and the paper's mean."""

from functools import partial
from itertools import pairwise

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.estimators.magyc import graph as graph_module
from magyc_gtsam.estimators.magyc.derivative_windows import GAUSS, derivative_windows, form_windows
from magyc_gtsam.estimators.magyc.graph import EstimateHistory, MagycGraph
from magyc_gtsam.estimators.magyc.options import IncrementalOptions
from magyc_gtsam.recording import Samples
from magyc_gtsam.runners import Status
from magyc_gtsam.simulation import disturb, simulate
from magyc_gtsam.study.rows import Cell, study_rows
from magyc_gtsam.study.settling import units, worked
from magyc_gtsam.study.table_one import PUBLISHED, table_one

MILLIGAUSS = 1e-7


@pytest.fixture(scope="module")
def wide():
    return simulate("wide", duration=100, rate=10, seed=0)


def windows_of(recording):
    return list(zip(*derivative_windows(recording).in_gauss(), strict=True))


@pytest.fixture
def renewed(monkeypatch):
    """After how many windows iSAM2 restarts, here a quarter: the published graph takes all windows at every step."""
    monkeypatch.setattr(graph_module, "_RENEWED", 16)
    return 16


@pytest.mark.parametrize(("optimizer", "prior"), [("dogleg", "norm"), ("gauss-newton", "determinant")])
def test_compressed_gives_every_estimate_of_the_published_graph(wide, renewed, optimizer, prior):
    """Over the renewals of iSAM2 and from the first window that determines anything."""
    compressed, published = (
        MagycGraph(IncrementalOptions(compressed=each, optimizer=optimizer, prior=prior)) for each in (True, False)
    )
    determined = 0
    for window in windows_of(wide.recording.between(0, 3 * renewed)):
        status = [graph.add(*window).status for graph in (compressed, published)]
        assert status[0] == status[1]
        one, other = compressed.state, published.state
        np.testing.assert_allclose(one.l, other.l, atol=1e-9)
        np.testing.assert_allclose(one.d, other.d, atol=1e-9)
        np.testing.assert_allclose(one.b, other.b, atol=1e-9)
        determined += compressed.result.updated
    assert determined > 2.5 * renewed
    np.testing.assert_allclose(compressed.mean(), published.mean(), atol=1e-9)


def test_a_step_to_where_nothing_is_determined_is_reported():
    """Undamped steps from a few windows lead there in a third of the logs, and the run goes on with a status."""
    ended = []
    for seed in range(5000, 5006):
        graph = MagycGraph(IncrementalOptions(optimizer="gauss-newton", prior="determinant"))
        statuses = [graph.add(*window).status for window in windows_of(simulate("wide", 60, seed=seed).recording)]
        assert len(statuses) == len(graph) == 60
        often = statuses.count(Status.INDETERMINATE) > 5  # before the fourth window nothing is determined
        assert graph.result.updated != often
        ended.append(often)
    assert 1 <= sum(ended) <= 3


@pytest.mark.parametrize("motion", ["wide", "tiny"])
def test_at_its_end_it_is_the_batch(motion):
    """One step per window ends a step short of the minimum: within a fiftieth of a batch's own error."""
    simulation = simulate(motion, duration=400, rate=10, seed=1)
    batch = mg.calibrate(simulation.recording, "magyc-bfg", tolerance=1e-12)
    current = mg.calibrate(simulation.recording, "magyc-ifg", estimate="current")
    for name in ("soft_iron", "hard_iron", "gyro_bias"):
        away = np.linalg.norm(getattr(current, name) - getattr(batch, name))
        assert away < 0.02 * np.linalg.norm(getattr(batch, name) - getattr(simulation.truth, name))
    assert current.converged
    assert current.covariance is None
    assert current.observability.observable
    assert current.field_strength == pytest.approx(batch.field_strength, rel=1e-3)
    assert 0 < current.diagnostics["settled_after"] < 0.9


def test_the_reported_estimate_is_the_mean_of_the_last_fifth(wide):
    graph, estimates = MagycGraph(), []
    for window in windows_of(wide.recording):
        graph.add(*window)
        estimates.append(graph.current())
    estimates = [estimate for estimate in estimates if estimate is not None]
    expected = np.mean(estimates[-int(0.2 * len(estimates)) :], axis=0)
    np.testing.assert_allclose(graph.mean(), expected, atol=1e-12)
    calibration = mg.calibrate(wide.recording, "magyc-ifg")
    np.testing.assert_allclose(calibration.hard_iron, expected[6:9], atol=1e-15)
    assert calibration.configuration["estimate"] == "mean"
    assert np.abs(calibration.hard_iron - graph.current()[6:9]).max() > 0.1 * MILLIGAUSS


def test_the_history_of_a_long_mission_stays_small():
    history, series = EstimateHistory(1), []
    random = np.random.default_rng(0)
    for k in range(20_000):
        series.append(1e-3 * k + random.normal())
        history.add(np.array(series[-1:]))
        if k in (0, 3, 500, 1000, 5000, 19_999):
            exact = np.mean(series[-max(int(0.2 * len(series)), 1) :])
            assert history.mean()[0] == pytest.approx(exact, abs=1e-9 if k < 1000 else 0.02)
    assert sum(value.size for value in history.state().values()) < 3 * 1024


@pytest.mark.parametrize("compressed", [True, False])
def test_saved_at_any_window_it_goes_on_bit_for_bit(wide, renewed, compressed):
    windows = windows_of(wide.recording)[: 2 * renewed - 1]
    whole = MagycGraph(IncrementalOptions(compressed=compressed))
    for window in windows:
        whole.add(*window)
    for cut in (0, 2, 5, renewed - 1, renewed, renewed + 1, 2 * renewed - 1):
        first, second = (MagycGraph(IncrementalOptions(compressed=compressed)) for _ in range(2))
        for window in windows[:cut]:
            first.add(*window)
        second.restore({name: value.copy() for name, value in first.saved().items()})
        assert second.result.status is first.result.status
        for window in windows[cut:]:
            second.add(*window)
        for name in ("l", "d", "b"):
            np.testing.assert_array_equal(getattr(second.state, name), getattr(whole.state, name))
        np.testing.assert_array_equal(second.mean(), whole.mean())
    kept = renewed - 1 if compressed else len(windows)  # windows, of nine numbers each
    assert whole.saved()["windows"].size == 9 * kept


@pytest.fixture(scope="module")
def disturbed():
    """A recording in which a tenth of the windows is off, and how far off the hard iron is without a kernel."""
    simulation = simulate("wide", duration=60, rate=10, seed=2)
    recording = disturb(simulation.recording, share=0.1, largest=50e-6, seed=1)
    clean, plain = (
        mg.calibrate(each, "magyc-ifg", estimate="current").hard_iron for each in (simulation.recording, recording)
    )
    return recording, clean, np.linalg.norm(plain - clean)


@pytest.mark.parametrize("kernel", ["huber", "geman-mcclure"])  # the shapes of all are in `test_factors_robust`
def test_robust_kernels_hold_against_disturbed_windows(disturbed, kernel):
    """The kernel counts in residual_sigma, which must be the data's: 10 mG twice over 0.9 s."""
    recording, clean, off = disturbed
    options = {"compressed": False, "estimate": "current", "residual_sigma": 0.016, "robust": kernel}
    robust = mg.calibrate(recording, "magyc-ifg", **options)
    assert np.linalg.norm(robust.hard_iron - clean) < 0.6 * off


def test_a_rest_before_the_motion_does_not_spoil_it():
    """At rest nothing determines C; what iSAM2 made of the noise must not outlive the motion."""
    simulation = simulate("wide", duration=400, rate=10, seed=4)
    at = simulation.recording
    random = np.random.default_rng(0)
    rest = 1200
    field = at.magnetic_field[0] + 1e-6 * random.normal(size=(rest, 3))
    rate = simulation.truth.gyro_bias + 5e-3 * random.normal(size=(rest, 3))
    time = np.concatenate([at.time[0] - 0.1 * np.arange(rest, 0, -1), at.time])
    whole = mg.Recording(time, np.vstack([field, at.magnetic_field]), np.vstack([rate, at.angular_rate]))
    batch = mg.calibrate(whole, "magyc-bfg")
    current = mg.calibrate(whole, "magyc-ifg", estimate="current")
    np.testing.assert_allclose(current.hard_iron, batch.hard_iron, atol=0.5 * MILLIGAUSS)
    assert current.converged


def test_windows_that_are_formed_in_parts_are_those_of_the_whole():
    random = np.random.default_rng(0)
    mag_time, gyro_time = np.sort(random.uniform(0, 30, 900)), np.sort(random.uniform(0.4, 30, 2000))
    mag = Samples(mag_time[(mag_time < 12) | (mag_time > 14.3)], 0)
    mag = Samples(mag.time, 3e-5 + 1e-6 * random.normal(size=(len(mag.time), 3)))
    gyro = Samples(gyro_time, random.normal(size=(len(gyro_time), 3)))
    start = gyro.time[0]
    whole = form_windows(mag, gyro, start, 1.0)
    assert 25 <= len(whole.time) <= 28
    cut = start + 13.0
    parts = [
        form_windows(*(Samples(s.time[inside(s)], s.value[inside(s)]) for s in (mag, gyro)), start, 1.0)
        for inside in (lambda s: s.time < cut, lambda s: s.time >= cut)
    ]
    for name, value in whole._asdict().items():
        np.testing.assert_array_equal(value, np.concatenate([getattr(part, name) for part in parts]))


def test_what_it_cannot_do_is_said(wide):
    with pytest.raises(mg.MagycError, match="no angular rate"):
        mg.calibrate(mg.Recording(wide.recording.time, wide.recording.magnetic_field), "magyc-ifg")
    with pytest.raises(mg.MagycError, match="compressed=False"):
        mg.calibrate(wide.recording, "magyc-ifg", robust="huber")
    with pytest.raises(mg.MagycError, match="kernel 'tukey' unknown"):
        mg.calibrate(wide.recording, "magyc-ifg", robust="tukey", compressed=False)
    with pytest.raises(mg.MagycError, match="estimate 'median' unknown"):
        mg.calibrate(wide.recording, "magyc-ifg", estimate="median")
    with pytest.raises(mg.MagycError, match="prior 'trace' unknown"):
        mg.calibrate(wide.recording, "magyc-ifg", prior="trace")
    with pytest.raises(mg.MagycError, match="3 windows of 1 s"):
        mg.calibrate(wide.recording.between(0, 2.9), "magyc-ifg")


def test_motion_that_determines_too_little_is_not_called_converged():
    rng = np.random.default_rng(0)
    time = np.arange(0, 120, 0.1)
    level = np.stack([2e-5 * np.cos(0.5 * time), -2e-5 * np.sin(0.5 * time), np.full(len(time), 4e-5)], axis=1)
    rate = np.tile([0.0, 0.0, 0.5], (len(time), 1)) + 5e-3 * rng.normal(size=level.shape)
    calibration = mg.calibrate(mg.Recording(time, level + 1e-6 * rng.normal(size=level.shape), rate), "magyc-ifg")
    assert not calibration.converged
    assert "not observable" in calibration.message


def test_nothing_that_moves_at_all():
    """Without noise and motion a variable is not determined: the graph waits, and says for what."""
    graph = MagycGraph()
    for _ in range(70):
        result = graph.add(np.array([0.2, 0.0, 0.4]), np.zeros(3), np.zeros(3))
    assert result.status is Status.INDETERMINATE
    assert "is not determined" in result.message
    assert graph.current() is None
    for window in windows_of(simulate("wide", duration=200, rate=10, seed=3).recording):
        graph.add(*window)
    assert graph.result.updated
    assert np.linalg.norm(graph.current()[6:9] / GAUSS - [0.02, 0.12, 0.09]) < 0.05


def samples_of(recording):
    return recording.magnetometer, recording.gyroscope


@pytest.mark.parametrize("estimate", ["mean", "current"])
def test_online_is_the_method_run_over_the_recording(wide, estimate):
    """One sample at a time; the last window is not complete, and so not in it."""
    online = mg.OnlineCalibrator("magyc-ifg", estimate=estimate)
    at = wide.recording
    for row in range(len(at.time)):
        online.update(at.time[row], at.magnetic_field[row], at.angular_rate[row])
        if row == 30:
            assert online.calibration is None
            assert not online.converged
            assert "fewer than 4 windows" in online.progress.sentence
    whole = mg.calibrate(at.between(0, 98.95), "magyc-ifg", estimate=estimate)
    found = online.calibration
    np.testing.assert_array_equal(found.soft_iron, whole.soft_iron)
    np.testing.assert_array_equal(found.hard_iron, whole.hard_iron)
    np.testing.assert_array_equal(found.gyro_bias, whole.gyro_bias)
    assert found.field_strength == pytest.approx(whole.field_strength, rel=5e-3)
    assert found.diagnostics["windows"] == online.progress.windows == 99
    assert 0.1 < online.progress.coverage < 1
    assert online.changes == ()


def test_online_blocks_kills_and_late_sensors_change_nothing(wide, tmp_path):
    random = np.random.default_rng(0)
    mag, gyro = samples_of(wide.recording)
    late = gyro.time > 7.3
    gyro = Samples(gyro.time[late] + 0.013, gyro.value[late])  # in blocks of less than a minute
    whole = mg.OnlineCalibrator("magyc-ifg")
    for start in (0, 50):
        for samples, name in ((mag, "magnetic_field"), (gyro, "angular_rate")):
            rows = (samples.time >= start) & (samples.time < start + 50)
            whole.update(samples.time[rows], **{name: samples.value[rows]})
    parts = mg.OnlineCalibrator("magyc-ifg")
    for start, stop in pairwise(np.arange(0, 107, 6.7)):
        for samples, name in ((mag, "magnetic_field"), (gyro, "angular_rate")):
            rows = (samples.time >= start) & (samples.time < stop)
            cut = random.integers(0, rows.sum() + 1)
            for part in (np.flatnonzero(rows)[:cut], np.flatnonzero(rows)[cut:]):
                if len(part):
                    parts.update(samples.time[part], **{name: samples.value[part]})
        parts.save(tmp_path / "state")
        parts = mg.OnlineCalibrator.load(tmp_path / "state")
    np.testing.assert_array_equal(parts.calibration.soft_iron, whole.calibration.soft_iron)
    np.testing.assert_array_equal(parts.calibration.hard_iron, whole.calibration.hard_iron)
    assert parts.calibration.field_strength == whole.calibration.field_strength
    assert parts.progress == whole.progress
    assert parts.converged == whole.converged


def test_online_knows_when_it_has_converged():
    """Not before the motion determined everything; then within the limits of the truth."""
    simulation = simulate("wide", duration=210, rate=10, seed=5)
    at, online, first = simulation.recording, mg.OnlineCalibrator("magyc-ifg"), None
    for row in range(0, len(at.time), 10):
        rows = slice(row, row + 10)
        online.update(at.time[rows], at.magnetic_field[rows], at.angular_rate[rows])
        if online.converged and first is None:
            first = at.time[row]
            assert online.progress.sentence == "converged"
            assert np.linalg.norm(online.calibration.hard_iron - simulation.truth.hard_iron) < 5e-6
    assert first is not None
    assert 20 < first < 200
    still = mg.OnlineCalibrator("magyc-ifg")
    rest = np.arange(0, 60, 0.1)
    random = np.random.default_rng(0)
    still.update(rest, 1e-7 * random.normal(size=(600, 3)) + 4e-5, 1e-3 * random.normal(size=(600, 3)))
    assert not still.converged
    assert still.calibration is None or "±" in still.progress.sentence or "not" in still.progress.sentence


def test_online_a_pause_of_hours_and_a_clock_that_jumps_cost_nothing(wide):
    mag, gyro = samples_of(wide.recording)
    online = mg.OnlineCalibrator("magyc-ifg")
    for later in (0.0, 5e4, 1.7e9):
        online.update(mag.time + later, mag.value, gyro.value)
    assert online.progress.windows == pytest.approx(300, abs=3)
    alone = mg.OnlineCalibrator("magyc-ifg")
    for hour in range(4):  # no gyroscope: a minute is kept
        alone.update(
            np.arange(0, 3600, 0.1) + 3600 * hour, 1e-7 * np.random.default_rng(0).normal(size=(36000, 3))
        )
    assert sum(value.size for value in alone._engine.state().values()) < 5 * 600 + 1000


def test_table_one_of_the_paper(monkeypatch):
    """Each printed figure of the wider motions lies in the range of a few random draws, or at its edge."""
    monkeypatch.setitem(PUBLISHED, "raw", {motion: PUBLISHED["raw"][motion] for motion in ("wide", "moderate")})
    rows = {row.motion: row for row in table_one(3, methods=("magyc-ifg",)) if row.method == "magyc-ifg"}
    assert rows.keys() == {"wide", "moderate"}
    for motion in rows:
        heading, _ = PUBLISHED["magyc-ifg"][motion]
        assert rows[motion].heading[1] - 0.2 < heading < rows[motion].heading[2] + 0.4


def test_it_settles_within_the_recording():
    rows = study_rows("settling", partial(worked, samples=3000), units(2))
    for motion in PUBLISHED["raw"]:
        assert 0.05 < np.median(Cell(rows, motion=motion).column("share")) < 0.95
