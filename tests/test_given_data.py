"""What people hand over: stamps of all kinds, tables, names of files; read right or refused with what to do."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.errors import MagycError

N = 50
RANDOM = np.random.default_rng(0)
FIELD, RATE = RANDOM.normal(0, 3e-5, (N, 3)), RANDOM.normal(0, 1, (N, 3))
SAVED = mg.Calibration(np.eye(3), np.zeros(3)).to_dict()
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


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_calendar_stamps_online_are_seconds_since_1970(unit: str) -> None:
    """Singly and in blocks; a recording of the same stamps has the same steps."""
    stamps = (np.datetime64("2024-05-03T12:00:00") + np.arange(N).astype("timedelta64[s]")).astype(
        f"datetime64[{unit}]"
    )
    in_blocks, singly = mg.OnlineCalibrator(), mg.OnlineCalibrator()
    in_blocks.update(stamps, FIELD, RATE)
    for time, field, rate in zip(stamps, FIELD, RATE, strict=True):
        singly.update(time, field, rate)
    last = 1714737600.0 + N - 1
    assert in_blocks.taken_until == singly.taken_until == (last, last)
    moments = mg.OnlineCalibrator()
    for k in range(N):
        moments.update(datetime(2024, 5, 3, 12, 0, k, tzinfo=timezone.utc), FIELD[k], RATE[k])
    assert moments.taken_until == (last, last)


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


def test_numbers_that_numpy_would_change_silently_are_refused_or_left_out() -> None:
    """A masked array keeps its values under the mask, and a complex one loses half of them."""
    stamps, masked = STEPS / 1e9, np.ma.masked_array(FIELD, mask=np.tile(np.arange(N) % 7 == 3, (3, 1)).T)
    with pytest.raises(MagycError, match="magnetic_field: 7 of 50 rows are not finite, the first is row 3"):
        mg.Recording(stamps, masked, RATE)
    online = mg.OnlineCalibrator()
    online.update(stamps, masked, RATE)
    assert online.progress.left_out == 0  # rows of NaN stand for no sample
    assert np.isnan(mg.Calibration(np.eye(3), np.zeros(3)).apply(masked)).sum() == 21
    for call in (mg.Recording, online.update):
        with pytest.raises(MagycError, match="magnetic_field: not an array of numbers \\(complex"):
            call(stamps, FIELD * 1j, RATE)  # type: ignore[operator]


def from_streams(*streams: Any, **options: Any) -> mg.Recording:
    return mg.Recording.from_streams(*streams, **options)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda r: mg.read(None), "read: the path of a file is needed, got None"),
        (lambda r: mg.read_many(3), "read_many: the path of a file is needed, got 3"),
        (lambda r: mg.Calibration.load(b"x"), "Calibration.load: the path of a file is needed"),
        (lambda r: mg.OnlineCalibrator().save(""), "save: the path of a file is needed, got ''"),
        (lambda r: mg.calibrate(r, method=["smoother"]), r"method: \['smoother'\] is not one of"),
        (lambda r: mg.calibrate(r, robust=np.array([True, False])), "robust: .* is neither True nor False"),
        (lambda r: mg.calibrate(r, misalignment=np.zeros(3)), "misalignment must be at least 0 and below"),
        (lambda r: mg.calibrate(r, progress=3), "progress: a function of the share done is needed, got int"),
        (lambda r: mg.calibrate_many(r), "several recordings are needed, got a Recording; pass a list"),
        (lambda r: mg.calibrate_many([r, 3]), "mg.calibrate_many: expected a Recording, got a int"),
        (lambda r: mg.calibrate_accelerometer(3), "expected a Recording, got a int"),
        (lambda r: mg.simulate("wide", seed=-1), "seed: an integer from 0 on is needed, got -1"),
        (lambda r: mg.simulate("wide", duration="x"), "duration: a number is needed, got 'x'"),
        (lambda r: mg.simulate("wide", effects=3), "effects: a list of names is needed, got 3"),
        (lambda r: r.between("a"), "start: must be a number of seconds, got 'a'"),
        (lambda r: r.rows([1, 2, 99]), "rows: not a slice, mask or indices of 50 rows"),
        (lambda r: mg.Recording(r.time, FIELD, name=None), "name: a text is needed, got None"),
        (lambda r: mg.Recording(r.time, FIELD, channels=[1]), "channels: {name: .* is needed"),
        (lambda r: mg.Recording(r.time, FIELD, magnetic_field_fresh=np.arange(N)), "one flag per row is needed"),
        (lambda r: mg.Recording(r.time, FIELD, notes=3), "notes: a text or a list of texts is needed, got 3"),
        (lambda r: mg.Recording(r.time, FIELD, notes=[3]), r"notes: .* got \[3\]"),
        (
            lambda r: from_streams(r.magnetic_field),
            "magnetic_field: must be the pair .time, values., got a ndarray",
        ),
        (lambda r: from_streams(None), "magnetic_field: must be the pair .time, values., got a NoneType"),
        (lambda r: from_streams((r.time, FIELD, RATE)), "magnetic_field: must be the pair .*, got 3 things"),
        (lambda r: from_streams((r.time, FIELD), RATE), "angular_rate: must be the pair .*, got a ndarray"),
        (lambda r: from_streams((r.time, FIELD), acceleration=3), "acceleration: must be the pair .*, got a int"),
        (
            lambda r: from_streams((r.time, FIELD), channels={"current": np.ones(4)}),
            "channel 'current': must be the",
        ),
        (lambda r: from_streams((r.time, FIELD), channels=[1]), "channels: {name: .* is needed"),
        (lambda r: from_streams((r.time, FIELD), notes=3), "notes: a text or a list of texts"),
        (lambda r: from_streams((CALENDAR, FIELD), (r.time, RATE)), "angular_rate: must be calendar stamps"),
        (
            lambda r: from_streams((r.time, FIELD), (CALENDAR, RATE)),
            "angular_rate: must be numbers .* got calendar",
        ),
        (
            lambda r: from_streams((CALENDAR, FIELD), channels={"depth": (r.time, FIELD)}),
            "time of channel 'depth': must be calendar stamps",
        ),
        (lambda r: mg.Recording(CALENDAR[0], FIELD), r"time: shape \(\), expected"),
        (lambda r: mg.Calibration(np.eye(3), np.zeros(3)).plot(3), "recording: expected a Recording, got a int"),
        (lambda r: mg.Calibration(np.eye(3), np.zeros(3)).report("a.html", 3), "expected a Recording, got a int"),
        (lambda r: mg.Calibration.from_dict([]), "not a calibration: a mapping .* got a list"),
        (lambda r: mg.Calibration.from_dict(SAVED | {"observability": {}}), r"a damaged calibration \(KeyError"),
        (lambda r: mg.Calibration.from_dict(SAVED | {"terms": [1]}), r"a damaged calibration \(TypeError"),
        (lambda r: mg.calibrate(r, prior=SAVED | {"terms": [1]}), "a damaged calibration"),
        (lambda r: mg.OnlineCalibrator(prior=SAVED | {"observability": {}}), "a damaged calibration"),
        (lambda r: mg.OnlineCalibrator(["smoother"]), r"method: \['smoother'\] is not one of"),
        (lambda r: mg.OnlineCalibrator().update(MOMENTS[0].time(), FIELD[0]), "time: not a number"),
        (lambda r: mg.calibrate_many([r, r], foo=1), "^method 'smoother' has no option 'foo'; it has"),
        (lambda r: mg.calibrate_many([r, r], window=-1), "window must be above 0 and below 60 s, got -1"),
        (lambda r: mg.calibrate_many([r], method="autocal", foo=1), "^method 'autocal' has no option 'foo'"),
        (
            lambda r: mg.calibrate(r, field=((5e-5, 0), 1.0)),
            "sigma of the strength must be above 0 and below 0.0001",
        ),
        *(
            (lambda r, arguments=arguments: mg.simulate(**{"motion": "wide", "duration": 9.0} | arguments), said)
            for arguments, said in (
                ({"field": 5e-5}, r"field: must be finite numbers of shape \(3,\), got 5e-05"),
                ({"field": "a"}, "field must be numbers, got 'a'"),
                ({"field": [0, 0, np.nan]}, "field: must be finite numbers"),
                ({"soft_iron": np.ones(3)}, r"soft_iron: must be finite numbers of shape \(3, 3\)"),
                ({"hard_iron": [1, 2]}, r"hard_iron: must be finite numbers of shape \(3,\), got \[1, 2\]"),
                ({"gyro_bias": None}, "gyro_bias must be numbers, got None"),
                ({"motion": (1, 2, "a")}, "motion must be numbers"),
                ({"motion": {}}, "motion must be numbers, got {}"),
                ({"motion": (1, 2)}, r"motion: must be finite numbers of shape \(3,\)"),
                ({"effects": [3]}, r"effects: must be names or pairs \(name, factor\), got 3"),
                (
                    {"effects": [("timing", "a")]},
                    "effects: factor of 'timing' must be a number, .* got factor 'a'",
                ),
                ({"effects": [("timing",)]}, "effects: must be names or pairs"),
                ({"effects": None}, "effects: a list of names is needed, got None; leave it out"),
                ({"effects": "timing"}, r"give \['timing'\]"),
                ({"channels": 3}, "channels: a list of names is needed, got 3"),
                ({"channels": "current"}, "channels: a list of names is needed, got 'current'"),
                ({"channels": [3]}, "channels: a list of names"),
                ({"duration": -10, "rate": -10}, "duration: must be above 0, got -10"),
                ({"rate": 0}, "rate: must be above 0, got 0"),
            )
        ),
    ],
)
def test_arguments_of_a_wrong_kind_are_refused_in_one_sentence(call: Any, said: str) -> None:
    with pytest.raises(MagycError, match=said):
        call(mg.Recording(STEPS / 1e9, FIELD, RATE))


def test_numbers_of_numpy_as_options_can_be_saved(tmp_path: Path) -> None:
    sim = mg.simulate("wide", duration=60)
    options = {"noise": np.array([1e-6, 5e-3], np.float32), "delay": np.float32(0), "window": np.int64(1)}
    for name in ("cal.yaml", "cal.json"):
        mg.calibrate(sim.recording, **options).save(tmp_path / name)
        assert mg.Calibration.load(tmp_path / name).configuration["window"] == 1
    online = mg.OnlineCalibrator(**options)
    online.save(tmp_path / "state.npz")
    assert mg.OnlineCalibrator.load(tmp_path / "state.npz").options == online.options


def test_damaged_gyroscope_samples_are_not_taken_for_another_unit(tmp_path: Path) -> None:
    sim = mg.simulate("wide", duration=60).recording
    rate = np.array(sim.angular_rate)
    rate[[100, 400], [0, 2]] = 3e7, -90.0
    with pytest.raises(
        MagycError, match="2 of 600 rows are beyond 70 rad/s, which no gyroscope measures, the first is row 100"
    ):
        mg.Recording(sim.time, sim.magnetic_field, rate)
    log = tmp_path / "log.csv"
    np.savetxt(
        log, np.c_[sim.time, sim.magnetic_field, rate], delimiter=",", header="time,mx,my,mz,gx,gy,gz", comments=""
    )
    recording = mg.read(log)
    assert "g: 2 of 600 samples are beyond what gyroscopes measure and were left out" in recording.notes
    assert len(recording.gyroscope.time) == 598
    with pytest.raises(MagycError, match="likely unit: deg/s or mrad/s"):
        mg.Recording(sim.time, sim.magnetic_field, np.array(sim.angular_rate) * 1e3)
