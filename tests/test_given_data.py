"""What people hand over: stamps of all kinds, tables, names of files; read right or refused with what to do."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.errors import MagycError

N = 50
RANDOM = np.random.default_rng(0)
FIELD, RATE = RANDOM.normal(0, 3e-5, (N, 3)), RANDOM.normal(0, 1, (N, 3))
STEPS = np.arange(N) * 10_000_001  # ns
CALENDAR = np.datetime64("2024-05-03T12:00:00.123456789") + STEPS.astype("timedelta64[ns]")
MOMENTS = [
    datetime(2024, 5, 3, tzinfo=timezone(timedelta(hours=2))) + timedelta(microseconds=10_000 * k)
    for k in range(N)
]


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        (CALENDAR, STEPS / 1e9),
        (STEPS.astype("timedelta64[ns]"), STEPS / 1e9),
        (MOMENTS, np.arange(N) / 100),
        ([m.replace(tzinfo=None) for m in MOMENTS], np.arange(N) / 100),
    ],
)
def test_calendar_stamps(time: object, expected: np.ndarray) -> None:
    recording = mg.Recording(time, FIELD, RATE)  # type: ignore[arg-type]
    np.testing.assert_allclose(recording.time, expected, rtol=0, atol=1e-15)


def test_streams_of_calendar_stamps_share_their_origin() -> None:
    late = CALENDAR + np.timedelta64(3, "ms")
    recording = mg.Recording.from_streams((CALENDAR, FIELD), (late, RATE))  # type: ignore[arg-type]
    np.testing.assert_allclose(recording.gyroscope.time[0], 0.003, atol=1e-12)
    assert recording.magnetometer.time[0] == pytest.approx(0.010000001, abs=1e-12)


def test_pandas_stamps_and_tables() -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame(FIELD, columns=["mx", "my", "mz"])
    for time in (pandas.Series(CALENDAR), pandas.DatetimeIndex(CALENDAR, tz="Europe/Paris")):
        np.testing.assert_array_equal(mg.Recording(time, table, RATE).time, STEPS / 1e9)
    with pytest.raises(MagycError, match=r"the columns mx, my, mz; name the columns"):
        mg.calibrate(table)  # type: ignore[arg-type]


def test_a_table_of_all_columns_says_which_it_has() -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame(np.c_[STEPS / 1e9, FIELD], columns=["t", "mx", "my", "mz"])
    calibration = mg.Calibration(np.eye(3), np.zeros(3))
    for call in (
        lambda: mg.Recording(table["t"], table, RATE),
        lambda: mg.find_gap(table),
        lambda: mg.compare(table),
        lambda: calibration.apply(table),
    ):
        with pytest.raises(MagycError, match="a table with the columns t, mx, my, mz"):
            call()


@pytest.mark.parametrize(("scale", "unit"), [(1e3, "ms"), (1e6, "µs"), (1e9, "ns")])
def test_numbers_of_another_unit_are_refused_with_its_name(scale: float, unit: str) -> None:
    with pytest.raises(MagycError, match=f"likely unit: {unit}; divide by"):
        mg.Recording(np.arange(N) * 0.1 * scale, FIELD, RATE)
    with pytest.raises(MagycError, match=f"likely unit: {unit}; divide by"):
        mg.OnlineCalibrator().update(np.arange(N) * 0.1 * scale, FIELD, RATE)


def test_missing_stamps() -> None:
    time = CALENDAR.copy()
    time[7] = np.datetime64("NaT")
    with pytest.raises(MagycError, match=r"1 of 50 stamps are missing \(NaT\), the first is row 7"):
        mg.Recording(time, FIELD, RATE)  # type: ignore[arg-type]


def test_a_file_or_an_array_in_place_of_a_recording() -> None:
    with pytest.raises(MagycError, match=r"'log\.mcap' is a file; read it first: mg\.calibrate\(mg\.read\('log"):
        mg.calibrate("log.mcap")  # type: ignore[arg-type]
    for function in (mg.find_gap, mg.compare):
        with pytest.raises(MagycError, match=r"is a file; read it first"):
            function("log.mcap")  # type: ignore[arg-type]
    with pytest.raises(MagycError, match=r"read_many\('season'\)"):
        mg.calibrate_many("season")  # type: ignore[arg-type]
    with pytest.raises(MagycError, match=r"mg\.read reads a log"):
        mg.Calibration(np.eye(3), np.zeros(3)).apply("log.mcap")
    with pytest.raises(MagycError, match=r"expected a Recording, got a ndarray"):
        mg.calibrate(FIELD)  # type: ignore[arg-type]


def test_a_calibrated_field_that_is_none_of_the_earths_is_warned_of() -> None:
    calibration = mg.Calibration(np.eye(3), np.zeros(3))
    with pytest.warns(
        UserWarning, match=r"apply: the calibrated field has a median strength of .* outside 8 to 175 µT"
    ):
        calibration.apply(FIELD * 1e4)  # gauss
    assert calibration.apply(FIELD).shape == FIELD.shape
