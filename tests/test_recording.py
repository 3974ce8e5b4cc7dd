"""Recording: validated once, never changed, every sample with its own stamp and its own bits."""

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from magyc_gtsam import MagycError, Recording
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.report.verdict import judged
from magyc_gtsam.simulation import simulate

COMPONENT = st.floats(-60e-6, 60e-6)
RATE = st.floats(-30, 30)


def field(n, seed=0):
    """Noisy samples of 50 µT; no two alike."""
    return np.random.default_rng(seed).normal([30e-6, 10e-6, 40e-6], 1e-6, (n, 3))


def rate(n, seed=1):
    return np.random.default_rng(seed).normal(0, 0.2, (n, 3))


def table(n=20, **more):
    return {"time": np.arange(n) / 10, "magnetic_field": field(n), "angular_rate": rate(n), **more}


@st.composite
def stamps(draw, least=3, most=40):
    """Strictly ascending stamps at irregular steps."""
    steps = draw(st.lists(st.floats(1e-3, 2.0), min_size=least, max_size=most))
    return draw(st.floats(-1e6, 1e6)) + np.cumsum(steps)


@st.composite
def recordings(draw):
    time = draw(stamps())
    n = len(time)
    # A ramp on top keeps the median norm plausible and every row different.
    magnetic_field = draw(hnp.arrays(float, (n, 3), elements=COMPONENT)) + 100e-6 + 1e-6 * np.arange(n)[:, None]
    return Recording(
        time,
        magnetic_field,
        draw(st.none() | hnp.arrays(float, (n, 3), elements=RATE)),
        acceleration=draw(st.none() | hnp.arrays(float, (n, 3), elements=RATE)),
        attitude=draw(st.none() | st.just(Rotation.random(n, random_state=0).as_quat())),
        channels={"current": np.arange(float(n)), "rpm": np.ones((n, 4))},
        name="made up",
        notes=("a note",),
    )


def arrays(recording):
    """Everything in a recording that has one row per instant."""
    found = {f.name: getattr(recording, f.name) for f in dataclasses.fields(recording)}
    found |= found.pop("channels")
    return {k: v for k, v in found.items() if isinstance(v, np.ndarray)}


# --- the value ---


@given(recordings())
def test_one_row_per_instant_and_read_only(recording):
    for name, value in arrays(recording).items():
        assert len(value) == len(recording.time), name
        with pytest.raises(ValueError, match="read-only"):
            value[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        recording.name = "other"
    with pytest.raises(TypeError):
        recording.channels["more"] = recording.time


def test_inputs_are_copied():
    given_arrays = table(channels={"depth": np.arange(20.0)}, magnetic_field_fresh=np.arange(20) % 2 == 0)
    recording = Recording(**given_arrays)
    before = {k: v.copy() for k, v in arrays(recording).items()}
    for value in [*given_arrays.values(), given_arrays["channels"]["depth"]]:
        if isinstance(value, np.ndarray):
            value[:] = 0
    given_arrays["channels"]["more"] = None
    assert list(recording.channels) == ["depth"]
    for name, value in arrays(recording).items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)


@given(recordings(), st.data())
def test_rows_take_all_columns_alike(recording, data):
    n = len(recording.time)
    rows = np.sort(data.draw(st.permutations(range(n)))[: data.draw(st.integers(3, n))])
    part = recording.rows(rows)
    for name, value in arrays(recording).items():
        np.testing.assert_array_equal(arrays(part)[name], value[rows], err_msg=name)
    assert (part.name, part.notes, part.angular_rate_is) == ("made up", ("a note",), "instant")


@given(recordings(), st.data())
def test_between_counts_from_the_first_row(recording, data):
    since = recording.time - recording.time[0]
    first, last = sorted(data.draw(st.lists(st.integers(0, len(since) - 1), min_size=2, max_size=2)))
    start, end = since[first], since[last]
    if last - first < 2:
        with pytest.raises(MagycError, match="start and end count from the first row"):
            recording.between(start, end)
        return
    np.testing.assert_array_equal(recording.between(start, end).time, recording.time[first : last + 1])
    np.testing.assert_array_equal(recording.between(start).time, recording.time[first:])
    np.testing.assert_array_equal(recording.between(end=end).time, recording.time[: last + 1])
    assert recording.between(start, end).duration == pytest.approx(end - start, abs=1e-9)


def test_a_part_keeps_what_is_fresh():
    """The first row of a part may be a held one: it must not turn into a sample."""
    held = np.repeat(field(6), 2, axis=0)
    part = Recording(np.arange(12.0), held).rows(slice(1, None))
    np.testing.assert_array_equal(part.magnetometer.time, [2, 4, 6, 8, 10])
    assert part.magnetic_field_stamped.all()
    slow = Recording.from_streams((np.arange(0, 12, 2.0), field(6)), (np.arange(12.0), rate(12)))
    np.testing.assert_array_equal(slow.rows(slice(1, None)).magnetic_field_stamped, np.arange(1, 11) % 2 == 0)


def test_repr_names_rows_duration_and_rates():
    held = np.repeat(field(11), 2, axis=0)[:21]
    recording = Recording(np.arange(21) / 10, held, rate(21), name="dive 3")
    assert repr(recording) == "Recording('dive 3', 21 rows, 2.0 s, magnetometer 5.0 Hz, gyroscope 10.0 Hz)"
    assert "gyroscope" not in repr(Recording(np.arange(21) / 10, held))


# --- fresh samples ---


@given(st.lists(st.integers(1, 4), min_size=3, max_size=20))
def test_repeats_of_a_held_magnetometer_are_not_samples(holds):
    values = np.repeat(field(len(holds)), holds, axis=0)
    recording = Recording(np.arange(len(values)) / 100, values)
    firsts = np.cumsum([0, *holds[:-1]])
    np.testing.assert_array_equal(np.flatnonzero(recording.magnetic_field_fresh), firsts)
    np.testing.assert_array_equal(recording.magnetometer.time, firsts / 100)
    np.testing.assert_array_equal(recording.magnetometer.value, field(len(holds)))


def test_a_gyroscope_may_repeat_itself_now_and_then():
    """Quantised rates repeat by chance; only many repeats are a hold."""
    seldom, often = rate(100), np.repeat(rate(50), 2, axis=0)
    seldom[1::5] = seldom[::5]
    assert Recording(**table(100) | {"angular_rate": seldom}).angular_rate_fresh.all()
    assert len(Recording(**table(100) | {"angular_rate": often}).gyroscope.time) == 50


@pytest.mark.parametrize("still", [slice(0, 200), slice(40, 160)])
def test_a_rate_that_stands_still_is_no_gap(still):
    """A quantised gyroscope at rest repeats itself; its samples must cover the recording all the same."""
    recording = Recording(**table(200) | {"angular_rate": put(rate(200), still, 0)})
    assert recording.gaps == ()
    np.testing.assert_array_equal(recording.gyroscope.time[[0, -1]], recording.time[[0, -1]])
    assert np.diff(recording.gyroscope.time).max() < 0.35


def test_masks_may_be_given():
    mask = np.arange(20) % 4 == 0
    recording = Recording(**table(magnetic_field_fresh=mask, angular_rate_fresh=~mask))
    np.testing.assert_array_equal(recording.magnetometer.value, recording.magnetic_field[mask])
    np.testing.assert_array_equal(recording.gyroscope.value, recording.angular_rate[~mask])


def test_gaps_are_those_of_the_gyroscope():
    time = np.concatenate([np.arange(50) / 10, 9 + np.arange(50) / 10, 30 + np.arange(10) / 10])
    n = len(time)
    (first, second) = Recording(time, field(n), rate(n)).gaps
    assert first == pytest.approx((4.9, 4.1))
    assert second == pytest.approx((13.9, 16.1))
    assert Recording(time, field(n)).gaps == (first, second)
    # 0.4 s is no hole, however regular the rest.
    assert Recording(np.concatenate([np.arange(50), 90 + np.arange(50)]) / 100, field(100), rate(100)).gaps == ()


# --- sensors with clocks of their own ---


@given(stamps(least=4), stamps(least=4), st.integers(0, 2**32 - 1))
def test_streams_keep_every_stamp_and_bit(mag_time, gyro_time, seed):
    gyro_time = gyro_time - gyro_time[0] + mag_time[0] - 0.5
    mag, gyro = field(len(mag_time), seed), rate(len(gyro_time), seed)
    first, last = max(mag_time[0], gyro_time[0]), min(mag_time[-1], gyro_time[-1])
    both = [(t >= first) & (t <= last) for t in (mag_time, gyro_time)]
    if last <= first or both[0].sum() < 3:
        return
    recording = Recording.from_streams((mag_time, mag), (gyro_time, gyro))
    np.testing.assert_array_equal(recording.time, np.union1d(mag_time[both[0]], gyro_time[both[1]]))
    np.testing.assert_array_equal(recording.magnetometer.time, mag_time[both[0]])
    np.testing.assert_array_equal(recording.magnetometer.value, mag[both[0]])
    np.testing.assert_array_equal(recording.gyroscope.time, gyro_time[both[1]])
    np.testing.assert_array_equal(recording.gyroscope.value, gyro[both[1]])
    left_out = int(sum((~inside).sum() for inside in both))
    some = "1 sample" if left_out == 1 else f"{left_out} samples"
    note = f"{some} outside the time that both sensors cover {'was' if left_out == 1 else 'were'} left out"
    assert recording.notes == ((note,) if left_out else ())


@pytest.mark.parametrize(("offset", "noted"), [(0.0, False), (1.5, False), (-40.0, True), (60.0, True)])
def test_stamps_of_two_clocks_are_named(offset, noted):
    time = np.arange(600) * 0.2
    recording = Recording.from_streams((time + offset, field(600, 1)), (time, rate(600, 2)))
    said = f"begin and end {abs(offset):.0f} s apart (magnetometer {offset:.1f} to {offset + 119.8:.1f} s, "
    assert any(said in note for note in recording.notes) == noted
    inside = Recording.from_streams((time[100:200], field(100, 1)), (time, rate(600, 2)))
    assert not any("apart" in note for note in inside.notes)


def two_streams(**more):
    """Magnetometer at 2 Hz and gyroscope at 5 Hz on clocks that share 0 and 2 s."""
    mag_time, gyro_time = np.arange(5) / 2, np.arange(11) / 5
    gyro = np.outer(gyro_time, [1.0, 2.0, 3.0])
    return Recording.from_streams((mag_time, field(5)), (gyro_time, gyro), **more)


def test_rows_between_samples_hold_the_field_and_interpolate_the_rate():
    recording = two_streams()
    np.testing.assert_allclose(recording.time, np.union1d(np.arange(5) / 2, np.arange(11) / 5))
    np.testing.assert_array_equal(recording.magnetic_field, field(5)[(recording.time * 2).astype(int)])
    np.testing.assert_allclose(recording.angular_rate, np.outer(recording.time, [1, 2, 3]), atol=1e-15)


def test_an_interval_mean_holds_back_to_the_sample_before():
    """Splitting an interval must not change the rotation over it."""
    recording = two_streams(angular_rate_is="interval-mean")
    own = np.ceil(np.round(recording.time * 5, 9)).astype(int)
    np.testing.assert_allclose(recording.angular_rate, np.outer(own / 5, [1, 2, 3]))
    total = (recording.angular_rate[1:] * np.diff(recording.time)[:, None]).sum(axis=0)
    np.testing.assert_allclose(total, np.array([1, 2, 3]) * 0.2 * np.arange(1, 11).sum() * 0.2, rtol=1e-12)


def test_a_stream_that_holds_its_last_sample_repeats_no_information():
    mag = np.repeat(field(10), 3, axis=0)
    recording = Recording.from_streams((np.arange(30) / 30, mag), (np.arange(100) / 100, rate(100)))
    np.testing.assert_allclose(recording.magnetometer.time, np.arange(0, 30, 3) / 30)


def test_references_and_channels_end_where_they_end():
    turn = Rotation.from_rotvec(np.outer(np.arange(4) / 2, [0, 0, 1.0]))
    recording = two_streams(
        attitude=(np.arange(4) / 2, turn.as_quat()),
        acceleration=([0.0, 2.0], [[0, 0, 9.0], [0, 0, 10.0]]),
        channels={"depth": ([0.5, 1.5], [10.0, 30.0]), "rpm": ([0, 2], [[0, 1], [2, 5]])},
    )
    t = recording.time
    known = t <= 1.5
    assert np.isnan(recording.attitude[~known]).all()
    angle = Rotation.from_quat(recording.attitude[known]).as_rotvec()
    np.testing.assert_allclose(angle, np.outer(t[known], [0, 0, 1.0]), atol=1e-12)
    np.testing.assert_allclose(recording.acceleration[:, 2], 9 + t / 2)
    depth = np.where((t >= 0.5) & known, 20 * t, np.nan)
    np.testing.assert_allclose(recording.channels["depth"], depth)
    np.testing.assert_allclose(recording.channels["rpm"], np.stack([t, 1 + 2 * t], axis=1))


def test_no_reference_inside_a_hole_of_the_reference():
    time = np.arange(200) / 100
    reference = np.concatenate([time[:50], time[150:]])
    recording = Recording.from_streams((time, field(200)), attitude=(reference, np.tile([0, 0, 0, 1.0], (100, 1))))
    np.testing.assert_array_equal(np.isnan(recording.attitude[:, 0]), (time > time[49]) & (time < time[150]))


def test_a_channel_is_not_known_in_its_long_pauses() -> None:
    """It was interpolated there, so that its absence did not show; a stream is slow only if all of it is."""
    time = np.arange(600) / 10
    current = np.where((time > 20) & (time < 35), np.nan, time)  # 15 s without a value
    logged, short = np.isfinite(current), (time <= 20) | (time >= 29)
    slow = np.arange(0, 60, 4.0)
    recording = Recording.from_streams(
        (time, field(600)),
        channels={
            "current": (time[logged], current[logged]),
            "depth": (time[short], np.stack([time[short], time[short]]).T),
            "temperature": (slow[slow != 20.0][:-1], slow[slow != 20.0][:-1]),
        },
    )
    np.testing.assert_allclose(recording.channels["current"], current)
    np.testing.assert_allclose(recording.channels["depth"], np.stack([time, time]).T)
    np.testing.assert_allclose(recording.channels["temperature"][:520], time[:520])


def test_streams_without_a_gyroscope():
    recording = Recording.from_streams((np.arange(10), field(10)))
    assert recording.angular_rate is None
    assert recording.angular_rate_fresh.all()


# --- what is refused, in words ---


def put(array, row, value):
    array = array.copy()
    array[row] = value
    return array


T, M, W = (table()[k] for k in ("time", "magnetic_field", "angular_rate"))
Q = np.tile([0.0, 0.0, 0.0, 1.0], (20, 1))

REFUSED = {
    "empty": ({"time": [], "magnetic_field": np.empty((0, 3)), "angular_rate": None}, ["0 rows", "at least 3"]),
    "NaN": ({"magnetic_field": put(M, 7, np.nan)}, ["magnetic_field: 1 of 20 rows", "row 7", "remove those"]),
    "infinite rate": ({"angular_rate": put(W, (9, 1), np.inf)}, ["angular_rate", "1 of 20 rows", "row 9"]),
    "infinite acceleration": ({"acceleration": put(W, 0, -np.inf)}, ["acceleration", "row 0"]),
    "NaN stamp": ({"time": put(T, 3, np.nan)}, ["time", "row 3"]),
    "repeated stamp": ({"time": put(T, 5, T[4])}, ["time: repeats at row 5", "0.400000 s", "remove repeats"]),
    "clock reset": ({"time": put(T, slice(10, 20), T[:10])}, ["time: goes back at row 10", "1 such rows", "cut"]),
    "transposed": ({"magnetic_field": M.T}, ["magnetic_field: shape (3, 20)", "expected (20, 3)", "transpose"]),
    "too short a field": ({"magnetic_field": M[:-1]}, ["magnetic_field: shape (19, 3)", "expected (20, 3)"]),
    "flat rate": ({"angular_rate": W.ravel()}, ["angular_rate: shape (60,)", "expected (20, 3)"]),
    "time as a column": ({"time": T[:, None]}, ["time: shape (20, 1)", "expected (N)"]),
    "text": ({"magnetic_field": [["a", "b", "c"]] * 20}, ["magnetic_field: not an array of numbers"]),
    "ragged": ({"magnetic_field": [[1.0], [1.0, 2.0]]}, ["magnetic_field: not an array of numbers"]),
    "µT": ({"magnetic_field": M * 1e6}, ["tesla", "likely unit: µT", "magnetic_unit="]),
    "gauss": ({"magnetic_field": M * 1e4}, ["likely unit: gauss"]),
    "milligauss": ({"magnetic_field": M * 1e7}, ["likely unit: milligauss"]),
    "nT": ({"magnetic_field": M * 1e9}, ["likely unit: nT"]),
    "mT": ({"magnetic_field": M * 1e3}, ["likely unit: mT"]),
    "counts": ({"magnetic_field": M * 1e13}, ["is not a field in tesla"]),
    "all zero": ({"magnetic_field": M * 0}, ["zero in 100% of 20 rows"]),
    "deg/s": ({"angular_rate": put(W, 6, [0, -200, 0])}, ["200 at row 6 (0.600 s)", "deg/s", "angular_unit="]),
    "quaternion of norm 2": ({"attitude": put(Q, 4, [0, 0, 0, 2])}, ["norm 2 at row 4", "x, y, z, w", "NaN"]),
    "quaternion of zeros": ({"attitude": put(Q, 4, 0)}, ["norm 0 at row 4"]),
    "channel": ({"channels": {"rpm": np.ones(19)}}, ["channel 'rpm': shape (19,)", "expected (20, k)"]),
    "attitude kind": ({"attitude_is": "EKF"}, ["attitude_is", "'EKF'", "estimate"]),
    "rate kind": ({"angular_rate_is": "mean"}, ["angular_rate_is", "'mean'", "interval-mean"]),
    "mask": ({"magnetic_field_fresh": [True] * 19}, ["magnetic_field_fresh: shape (19,)", "(20,)"]),
    "no entry": ({"magnetic_field_stamped": np.arange(20) != 7}, ["magnetic_field_stamped: row 7 is fresh"]),
    "stuck": ({"magnetic_field": np.tile(M[0], (20, 1))}, ["fewer than 3 different samples", "stuck"]),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_what_where_limit_and_remedy(case):
    change, words = REFUSED[case]
    with pytest.raises(MagycError) as caught:
        Recording(**table() | change)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("streams", "words"),
    [
        (
            [(T, M), (T + 100, W)],
            ["clocks do not overlap", "magnetic_field 0.000 to 1.900 s", "angular_rate 100.000"],
        ),
        ([(T, M), (T[:1], W[:1])], ["angular_rate: 1 sample, at least 2"]),
        ([(put(T, 5, T[4]), M), (T, W)], ["magnetic_field: time: repeats at row 5"]),
        ([(T, M), (T[::-1], W)], ["angular_rate: time: goes back at row 1"]),
        ([(T, M), (T[:-1], W)], ["angular_rate: shape (20, 3), expected (19, 3)"]),
    ],
)
def test_refused_streams(streams, words):
    with pytest.raises(MagycError) as caught:
        Recording.from_streams(*streams)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("norm", [0, 2])
def test_a_stream_of_attitudes_that_are_no_unit_quaternions_is_refused(norm):
    with pytest.raises(MagycError, match=f"quaternion of norm {norm} at row 3"):
        Recording.from_streams((T, M), (T, W), attitude=(T, put(Q, 3, [0, 0, 0, norm])))


def test_nearly_unit_quaternions_are_normalised_and_missing_ones_stay_missing():
    recording = Recording(**table(attitude=put(Q * 1.005, 3, np.nan)))
    assert np.isnan(recording.attitude[3]).all()
    np.testing.assert_allclose(np.delete(recording.attitude, 3, axis=0), np.delete(Q, 3, axis=0))


def test_the_gyroscope_of_a_magnetometer_only_recording():
    with pytest.raises(MagycError, match=r"'bare' has no angular rate.*magnetometer alone"):
        _ = Recording(T, M, name="bare").gyroscope


def test_pickles():
    told = {"angular_rate_is": "interval-mean", "attitude_is": "estimate", "gyroscope_axes": "y,-x,z"}
    one = Recording(T, M, W, channels={"rpm": np.arange(len(T))}, name="dive", **told)
    two = pickle.loads(pickle.dumps(one))
    for name in ("time", "magnetic_field", "angular_rate", "magnetic_field_fresh"):
        np.testing.assert_array_equal(getattr(two, name), getattr(one, name))
    assert (two.name, list(two.channels)) == ("dive", ["rpm"])
    for other in (two, one.rows(slice(5, None)), one.with_samples((T, M), (T, W))):
        assert {name: getattr(other, name) for name in told} == told


@pytest.mark.parametrize("same", [True, False])
def test_what_a_log_holds_at_a_row_is_the_rows_to_the_last_bit(same: bool) -> None:
    """Sensors that share their stamps are taken as they are; between others only what lies between is made."""
    source = np.random.default_rng(4)
    time = np.cumsum(source.uniform(0.01, 0.1, 300))
    quaternion = Rotation.random(300, random_state=3).as_quat()
    values = {k: source.normal(0, 1, (300, 3)) for k in ("rate", "acceleration")}
    field_time = time if same else time + np.where(np.arange(300) % 3 == 0, 0.0, 1e-3)
    read = Recording.from_streams(
        (field_time, field(300)),
        (time, values["rate"]),
        acceleration=(time, values["acceleration"]),
        attitude=(time, quaternion),
        channels={"current": (time, values["rate"][:, 0])},
    )
    held = np.searchsorted(read.time, time)
    inside = held < len(read.time)
    inside[inside] = read.time[held[inside]] == time[inside]
    assert inside.sum() > 290
    rows = held[inside]
    np.testing.assert_array_equal(read.angular_rate[rows], values["rate"][inside])
    np.testing.assert_array_equal(read.acceleration[rows], values["acceleration"][inside])
    np.testing.assert_array_equal(read.channels["current"][rows], values["rate"][inside, 0])
    known = quaternion[inside] / np.linalg.norm(quaternion[inside], axis=1)[:, None]
    np.testing.assert_allclose(read.attitude[rows], known, rtol=0, atol=5e-16)
    unit = np.linalg.norm(quaternion[inside], axis=1) == 1.0
    np.testing.assert_array_equal(read.attitude[rows][unit], quaternion[inside][unit])
    if same:
        assert len(read.time) == 300
        np.testing.assert_array_equal(read.magnetic_field, field(300))


def test_arrays_that_are_given_stay_the_callers() -> None:
    """Read-only or not, a recording keeps a copy of its own."""
    given = field(50)
    made = Recording(np.arange(50) / 10, given)
    given[:] = 0.0
    assert (made.magnetic_field != 0).any()
    with pytest.raises(ValueError, match="read-only"):
        made.magnetic_field[0] = 0.0


def test_stamps_of_two_clocks_are_the_cause_of_an_untrusted_result():
    dive = simulate("wide", 120).recording
    shifted = Recording.from_streams((dive.time + 40, dive.magnetic_field), (dive.time, dive.angular_rate))
    untrusted = Calibration(np.eye(3), np.zeros(3), converged=False, message="too little motion: turn")
    verdict = judged(untrusted, shifted)
    assert verdict.cause == "the stamps of the two sensors begin and end 40 s apart"
    assert (
        verdict.action == "if their clocks differ, use the times of recording, if the log has them (stamps='log')"
    )
    assert judged(untrusted, dive).cause == "too little motion"
