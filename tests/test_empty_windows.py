"""Gaps in the magnetometer while the gyroscope goes on: what an error of the gyroscope makes of links across them."""

from dataclasses import replace

import numpy as np
import pytest

from magyc_gtsam import OnlineCalibrator, Recording, calibrate, simulate
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.smoother.beside import ColumnProducts
from magyc_gtsam.estimators.smoother.fit import descend
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.field_windows import joined_between
from magyc_gtsam.factors.chain.preintegration import Preintegration
from magyc_gtsam.factors.chain.rotations import Array

GAPS = (60.0, 150.0)  # s, their begins
LASTS = 20.0  # s


def with_gaps(recording: Recording, rate: Array | None = None) -> Recording:
    """The recording without the magnetometer's samples in two gaps."""
    time, field = recording.magnetometer
    kept = ~np.any([(time > begin) & (time < begin + LASTS) for begin in GAPS], axis=0)
    gyroscope = recording.gyroscope if rate is None else (recording.gyroscope.time, rate)
    return Recording.from_streams((time[kept], field[kept]), gyroscope)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("wide", duration=240, seed=3).recording


def test_a_scale_moves_the_parameters_across_gaps_as_a_new_fit_does(recording) -> None:
    fit = descend(fit_field_chain(with_gaps(recording)), settled=1e-10)
    motion, beside, scale = WindowMotion.of(fit), ColumnProducts(fit), np.array([1e-3, 0.0, 0.0])
    assert len(motion.between) > 10
    sigma = np.sqrt(np.diag(fit.covariance))
    expected = beside.moves([beside.of(motion.along_links.gyroscope_scales())])[0] @ scale / sigma
    bias = fit.state.parameters[9:12]
    wrong = with_gaps(recording, bias + (recording.gyroscope.value - bias) * (1 + scale))
    again = descend(fit_field_chain(wrong), settled=1e-10)
    moved = (again.state.parameters - fit.state.parameters) / sigma
    assert np.abs(expected).max() > 0.3
    np.testing.assert_allclose(moved, expected, atol=0.06)  # without what happens in the gaps 0.12


def test_gaps_say_nothing_of_a_gyroscopes_scale(recording) -> None:
    """Columns through the windows alone would fix the scales to a tenth of this, and the hard iron with them."""
    whole, gapped = (calibrate(each, gyroscope_scale=0.01) for each in (recording, with_gaps(recording)))
    scales = [next(t.covariance for t in c.terms if t.name == "gyro-scale") for c in (whole, gapped)]
    for before, after in (scales, [c.covariance[6:9, 6:9] for c in (whole, gapped)]):
        ratio = np.sqrt(np.diag(after) / np.diag(before))
        assert np.all((ratio > 0.9) & (ratio < 2.0)), ratio


def test_rotation_and_rate_of_empty_windows_are_those_of_the_whole_log(recording) -> None:
    """A window that is empty in the log with gaps has samples in the log without them."""
    chunked, whole = (
        Preintegration(*each.magnetometer, *each.gyroscope) for each in (with_gaps(recording), recording)
    )
    windows, full = chunked.integrate(), whole.integrate()
    between = windows.between
    assert np.all(np.diff(between.time) > 0)
    for begin in GAPS:
        own = (between.time > begin) & (between.time < begin + LASTS)
        assert own.sum() > 8
        assert np.all(np.diff(between.time[own]) < 2.2)
    at = np.abs(full.time[:, None] - between.time).argmin(axis=0)
    near = np.abs(full.time[at] - between.time) < 0.05
    assert near.sum() > 5
    np.testing.assert_allclose(between.rotation[:, :, near], full.rotation[:, :, at[near]], atol=0.03)
    turning = np.einsum("ijn,kjn->ikn", full.rotation_rate, full.rotation)[:, :, at[near]]
    np.testing.assert_allclose(between.rate[2, near], turning[1, 0], atol=0.05)
    first = int(np.flatnonzero(np.diff(windows.time) > LASTS)[0])
    part = windows.part(first, len(windows))
    assert len(part.between) == len(between)
    assert part.between.link[0] == 0
    again = joined_between([windows.part(0, first + 1).between, part.between], [first, len(part.linked)])
    np.testing.assert_array_equal(again.link, between.link)


def test_online_knows_the_motion_in_gaps(recording) -> None:
    gapped = with_gaps(recording)
    online = OnlineCalibrator()
    (when, field), (gyro_when, rate) = gapped.magnetometer, gapped.gyroscope
    for begin in np.arange(0.0, 240.0, 10.0):
        own, there = ((each >= begin) & (each < begin + 10.0) for each in (gyro_when, when))
        online.update(gyro_when[own], angular_rate=rate[own])
        if there.any():
            online.update(when[there], field[there])
    batch = calibrate(gapped)
    ratio = np.sqrt(np.diag(online.calibration.covariance)[6:12] / np.diag(batch.covariance)[6:12])
    np.testing.assert_allclose(ratio, 1, atol=0.2)


def test_a_log_without_gaps_has_no_empty_windows(recording) -> None:
    assert len(Preintegration(*recording.magnetometer, *recording.gyroscope).empty.link) == 0
    # Windows of single samples, and a magnetometer slower than they are long.
    time, field = (each[::25] for each in recording.magnetometer)
    assert len(Preintegration(time, field, *recording.gyroscope).empty.link) == 0
    single = replace(Preintegration(*recording.magnetometer, *recording.gyroscope), turn=1e-12)
    assert len(single.empty.link) == 0
