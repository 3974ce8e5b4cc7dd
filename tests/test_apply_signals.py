"""The signals of `Calibration.apply`: of the length of the field, in the units of the calibration, none left out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors.effects.term import Term

N = 60
TIME = 0.1 * np.arange(N)
TURN = np.column_stack([np.cos(TIME), np.sin(TIME), 0.5 * np.cos(2 * TIME)])
CURRENT = 0.2 * np.arange(N)
REC = mg.Recording(TIME, 4e-5 * TURN, TURN, acceleration=9.8 * TURN, channels={"current": CURRENT})
COUNTS = replace(REC, magnetic_field=4e3 * TURN, magnetic_field_unit="counts")
PLAIN = mg.Calibration(np.eye(3), np.zeros(3), np.zeros(3))
IN_COUNTS = replace(PLAIN, hard_iron=[500.0, 0.0, -7.5], configuration={"magnetic_field_unit": "counts"})


def with_term(name: str, **setting: float) -> mg.Calibration:
    return replace(PLAIN, terms=(Term(name, [2e-6] * 3, 1e-14 * np.eye(3), setting),))


CURRENTS, STEP = with_term("motor-current"), with_term("hard-iron-step", time=3.0)


@pytest.mark.parametrize("current", [np.full(N, np.nan), np.full((N, 2), np.nan), np.empty((N, 0))])
def test_a_channel_without_a_value_is_a_channel_that_is_not_there(current: np.ndarray) -> None:
    with pytest.raises(mg.MagycError) as absent:
        CURRENTS.apply(replace(REC, channels={}))
    with pytest.raises(mg.MagycError) as empty:
        CURRENTS.apply(replace(REC, channels={"current": current}))
    assert str(empty.value) == str(absent.value)


def test_a_column_without_a_value_is_refused_where_a_term_reads_it() -> None:
    first = with_term("motor-current", reference_0=0.0)
    other = np.column_stack([CURRENT, np.full(N, np.nan)])
    with pytest.raises(mg.MagycError, match="channel 2 of its kind .* no value"):
        CURRENTS.apply(replace(REC, channels={"current": other}))
    np.testing.assert_array_equal(first.apply(replace(REC, channels={"current": other})), first.apply(REC))


@pytest.mark.parametrize("unit", ["s", "ms", "ns"])
def test_calendar_stamps_are_those_of_a_recording(unit: str) -> None:
    stamps = np.datetime64("2026-02-03T04:05:06", "ns") + (np.arange(N) * 10**9).astype("timedelta64[ns]")
    stamps = stamps.astype(f"datetime64[{unit}]")
    expected = STEP.apply(mg.Recording(stamps, REC.magnetic_field))
    assert np.ptp(expected - REC.magnetic_field) > 1e-6
    np.testing.assert_array_equal(STEP.apply(REC.magnetic_field, time=stamps), expected)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "time of one": ({"time": [0.0]}, rf"time: shape \(1,\), expected \({N}\)"),
    "time as a number": ({"time": 3.0}, rf"time: shape \(\), expected \({N}\)"),
    "time as text": ({"time": "a"}, "time: not an array of numbers"),
    "short time": ({"time": TIME[:-1]}, rf"time: shape \({N - 1},\), expected \({N}\)"),
    "rate of one": ({"angular_rate": TURN[:1]}, rf"angular_rate: shape \(1, 3\), expected \({N}, 3\)"),
    "long rate": ({"angular_rate": np.ones((N + 1, 3))}, "angular_rate: shape"),
    "short acceleration": ({"acceleration": TURN[:5]}, r"acceleration: shape \(5, 3\)"),
    "channel of one": ({"channels": {"current": [1.0]}}, rf"channel 'current': shape \(1,\), expected \({N}, k\)"),
    "channel of two": ({"channels": {"current": [1.0, 2.0]}}, r"channel 'current': shape \(2,\)"),
    "number for a channel": ({"channels": {"current": 1.0}}, r"channel 'current': shape \(\)"),
    "text for a channel": ({"channels": {"current": "a"}}, "channel 'current': not an array of numbers"),
    "list of channels": ({"channels": [CURRENT]}, "channels: {name"),
    "text for channels": ({"channels": "current"}, "channels: {name"),
    "unknown": ({"foo": 1}, "no signal 'foo'; there are time"),
}


@pytest.mark.parametrize("calibration", [PLAIN, CURRENTS, STEP], ids=["plain", "current", "step"])
@pytest.mark.parametrize("case", WRONG)
def test_signals_that_do_not_fit_are_refused_whether_a_term_reads_them_or_not(
    case: str, calibration: mg.Calibration
) -> None:
    signals, words = WRONG[case]
    for data in (REC, REC.magnetic_field):
        with pytest.raises(mg.MagycError, match=words):
            calibration.apply(data, **signals)
    if "angular_rate" not in signals:
        with pytest.raises(mg.MagycError, match=words):
            calibration.apply_gyroscope(REC.angular_rate, **signals)


def test_no_rows_are_no_data_for_a_term() -> None:
    none = {"time": TIME[:0], "channels": {"current": CURRENT[:0]}}
    for calibration in (CURRENTS, STEP):
        with pytest.raises(mg.MagycError, match="magnetic_field: 0 rows"):
            calibration.apply(REC.magnetic_field[:0], **none)
    turned = replace(PLAIN, terms=(Term("misalignment", [0.01, 0.0, 0.0], 1e-6 * np.eye(3)),))
    for calibration in (PLAIN, turned):
        assert calibration.apply(REC.magnetic_field[:0], **none).shape == (0, 3)


@pytest.mark.parametrize(
    ("name", "setting"),
    [
        ("motor-current", {"lag": 2.0}),
        ("hysteresis", {"coercive": 2e-5}),
        ("axis-delays", {}),
        ("local-anomaly", {"time": 3.0, "width": 1.0}),
    ],
)
def test_a_single_row_is_too_little_for_a_term_with_memory(name: str, setting: dict[str, float]) -> None:
    one = {
        "time": TIME[:1],
        "angular_rate": TURN[0],
        "acceleration": TURN[0],
        "channels": {"current": CURRENT[:1]},
    }
    calibration = with_term(name, **setting)
    for field in (REC.magnetic_field[0], REC.magnetic_field[:1]):
        with pytest.raises(mg.MagycError, match=f"1 row; {name} depends on what came before"):
            calibration.apply(field, **one)
    assert calibration.apply(REC).shape == (N, 3)
    assert CURRENTS.apply(REC.magnetic_field[0], **one).shape == (3,)


def test_counts_are_not_tesla() -> None:
    with pytest.raises(mg.MagycError, match="must be in counts, .* got a recording in T"):
        IN_COUNTS.apply(REC)
    with pytest.raises(mg.MagycError, match="must be in T, .* got a recording in counts"):
        PLAIN.apply(COUNTS)
    for show in (IN_COUNTS.plot, lambda recording: IN_COUNTS.report("page.html", recording)):
        with pytest.raises(mg.MagycError, match="must be in counts, .* got a recording in T"):
            show(REC)
    np.testing.assert_array_equal(IN_COUNTS.apply(COUNTS), COUNTS.magnetic_field - IN_COUNTS.hard_iron)
    assert repr(IN_COUNTS).endswith("hard iron (500.00, 0.00, -7.50) counts)")
    assert repr(replace(PLAIN, hard_iron=[5e-6, 0, 0])).endswith("hard iron (5.00, 0.00, 0.00) µT)")
