"""Axes, signs and units of the gyroscope against the magnetometer's."""

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam import MagycError, Recording, simulate
from magyc_gtsam.estimators.smoother import axes
from magyc_gtsam.recording.axes import parse_axes
from magyc_gtsam.recording.turned import in_magnetometer_axes

MATRICES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]


@pytest.fixture(scope="module")
def tumbling():
    """A calibration dive of low noise: it turns about all axes."""
    return simulate("dive", duration=300, rate=20, seed=1, magnetometer_noise=1e-7).recording


def test_there_are_48_arrangements_of_three_units(tumbling):
    found = axes.arrangements(tumbling)
    assert len(found) == 3 * 48
    assert [a.unexplained for a in found] == sorted(a.unexplained for a in found)


@pytest.mark.parametrize("matrix", MATRICES, ids=lambda m: axes.Arrangement(m, "", 0.0).axes)
def test_every_signed_permutation_is_found(tumbling, matrix):
    """The log's gyroscope is given in other axes; `matrix` brings it back."""
    disguised = replace(tumbling, angular_rate=tumbling.angular_rate @ matrix)  # row vectors: matrixᵀ w
    best = axes.arrangements(disguised)[0]
    assert best.unit == ""
    np.testing.assert_array_equal(best.matrix, matrix)
    assert best.unexplained < 0.2
    if np.array_equal(matrix, np.eye(3)):
        axes.check(disguised)
    else:
        with pytest.raises(MagycError, match="axes of gyroscope and magnetometer disagree") as caught:
            axes.check(disguised)
        assert best.axes in str(caught.value)
        assert "gyroscope_axes=" in str(caught.value)


@pytest.mark.parametrize(("given", "own"), [("y,z,x", "z,x,y"), ("-x,y,z", "z,x,y"), ("y,-x,z", "x,y,z")])
def test_the_advice_is_on_the_sensor_and_not_on_what_was_made_of_it(tumbling, given, own):
    """Whoever follows it is done; it was relative to the axes given, and led from one wrong pair to the next."""
    sensor = replace(tumbling, angular_rate=tumbling.angular_rate @ parse_axes(own))
    wrong = in_magnetometer_axes(sensor, parse_axes(given))
    advice = "leave out gyroscope_axes=" if own == "x,y,z" else f"bring both to one frame (gyroscope_axes='{own}')"
    with pytest.raises(MagycError) as caught:
        axes.check(wrong)
    assert f" with {axes.axes_words(own)} " in str(caught.value)
    assert str(caught.value).endswith(f"; {advice}")
    axes.check(in_magnetometer_axes(sensor, parse_axes(own)))


def test_degrees_for_radians_are_named(tumbling):
    degrees = replace(tumbling, angular_rate=np.rad2deg(tumbling.angular_rate))
    with pytest.raises(MagycError, match=r"angular_rate: .*read as deg/s.*angular_unit="):
        axes.check(degrees)
    radians = replace(tumbling, angular_rate=np.deg2rad(tumbling.angular_rate))
    assert axes.arrangements(radians)[0].unit == "rad/s"


def test_words():
    assert axes.Arrangement(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), "", 0.0).axes == "x ← −y, y ← x, z ← z"


def test_a_large_hard_iron_and_bias_do_not_mislead(tumbling):
    log = replace(
        tumbling,
        magnetic_field=tumbling.magnetic_field + np.array([60e-6, -70e-6, 410e-6]),
        angular_rate=tumbling.angular_rate + np.array([0.05, 0.0, 0.075]),
    )
    axes.check(log)
    with pytest.raises(MagycError, match="x ← −x, y ← −y, z ← z"):
        axes.check(replace(log, angular_rate=log.angular_rate * [-1, -1, 1]))


def test_where_no_arrangement_explains_the_field_none_is_proposed(tumbling):
    shuffled = np.random.default_rng(0).permutation(tumbling.angular_rate)
    axes.check(replace(tumbling, angular_rate=shuffled))


@pytest.mark.parametrize("motion", ["wide", "moderate", "low"])
def test_the_papers_noise_does_not_hide_the_arrangement(motion):
    """10 Hz and 10 mG: the pairs compared must be far enough apart, also where the unit is wrong."""
    recording = simulate(motion, duration=300, rate=10, seed=3).recording
    axes.check(recording)
    with pytest.raises(MagycError, match="x ← y, y ← x, z ← z"):
        axes.check(replace(recording, angular_rate=recording.angular_rate[:, [1, 0, 2]]))
    with pytest.raises(MagycError, match="deg/s"):
        axes.check(replace(recording, angular_rate=np.rad2deg(recording.angular_rate)))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_field_that_varies_does_not_hide_the_arrangement(seed):
    """It leaves a quarter to a half of the changes unexplained, other arrangements leave more than all."""
    recording = simulate("wide", duration=120, seed=seed).recording
    random = np.random.default_rng(seed)
    waves = [
        random.standard_normal(3) * np.sin(2 * np.pi * hertz * recording.time[:, None] + random.uniform(0, 6))
        for hertz in random.uniform(0.1, 0.6, 12)
    ]
    varying = recording.magnetic_field + 3e-6 * sum(waves) / np.std(sum(waves))
    log = replace(recording, magnetic_field=varying)
    axes.check(log)
    exchanged = replace(log, angular_rate=log.angular_rate @ parse_axes("y,x,-z"))
    assert 0.25 < axes.arrangements(exchanged)[0].unexplained < 0.5
    with pytest.raises(MagycError, match="x ← y, y ← x, z ← −z"):
        axes.check(exchanged)


def test_an_arrangement_that_explains_most_is_not_accepted_where_another_explains_all(tumbling):
    """About x and y the sensor hardly turns: exchanged, its gyroscope still explains 98 % of the field's changes."""
    rate, time = tumbling.angular_rate * [0.2, 0.2, 1.0], tumbling.time
    steps = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * np.diff(time)[:, None])
    attitude = [Rotation.identity()]
    for step in steps:
        attitude.append(attitude[-1] * step)
    field = Rotation.concatenate(attitude).inv().apply([20e-6, 0.0, 40e-6]) + 30e-6
    log = replace(tumbling, angular_rate=rate, magnetic_field=field)
    axes.check(log)
    with pytest.raises(MagycError, match="as given the gyroscope explains 98%.*with x ← y, y ← x, z ← z 100%"):
        axes.check(replace(log, angular_rate=rate[:, [1, 0, 2]]))


def test_few_samples_say_nothing():
    """A sample every ten seconds follows no turn: some arrangement always fits by chance."""
    recording = simulate("wide", 300, seed=1).recording
    rare = Recording.from_streams(
        (recording.time[::100], recording.magnetic_field[::100]), (recording.time, recording.angular_rate)
    )
    axes.check(rare)
