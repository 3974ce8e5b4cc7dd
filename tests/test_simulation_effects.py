"""The simulator's effects: each where it belongs, of the size it says, and the rest of the recording untouched."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam import MagycError, Recording, calibrate
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.simulation import FIELD, MILLIGAUSS, inject, simulate
from magyc_gtsam.simulation.effects import EFFECTS, FOREIGN, NAMED, STRENGTHS
from magyc_gtsam.simulation.environment import CHANNELS
from magyc_gtsam.simulation.scene import Stage, lagged

EXACT = {"magnetometer_noise": 0.0, "gyroscope_noise": 0.0}
GYROSCOPIC = {"gyro-scale", "gyro-quadratic", "temperature-gyro", "g-sensitivity", "axis-order"} | {
    "gyro-bias-step",
    "gyro-bias-drift",
    "rate-product",
    "vibration-bias",
}


@cache
def without(duration, **sensor):
    """The recording in which there is no effect."""
    return simulate("wide", duration, seed=4, channels=CHANNELS, **sensor).recording


def pair(name, factor=1.0, duration=200, **sensor):
    """The recording with the effect and without, and what was applied."""
    with_it = simulate("wide", duration, seed=4, effects=((name, factor),), channels=CHANNELS, **sensor)
    plain = without.__wrapped__ if any(map(np.ndim, sensor.values())) else without  # arrays are no keys
    return with_it.recording, plain(duration, **sensor), with_it.effects[0]


def rms(vectors):
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def test_the_names_are_those_of_the_catalogue():
    assert " ".join(NAMED) == (
        "motor-current temperature-hard-iron hard-iron-step hard-iron-drift misalignment timing eddy-plane "
        "gyro-scale gyro-quadratic temperature-gyro g-sensitivity field-gradient local-anomaly saturation cubic "
        "hysteresis coloured-noise spikes tone quantisation sample-hold axis-order current-squared load-soft-iron "
        "soft-iron-step temperature-gain gain-drift gyro-bias-step gyro-bias-drift axis-delays clock-drift"
    )
    assert len(FOREIGN) >= 4
    assert set(EFFECTS) == set(STRENGTHS) == {*NAMED, *FOREIGN}


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_changes_its_own_sensor_only(name):
    changed, plain, applied = pair(name, duration=100)
    rate, field = (changed.angular_rate - plain.angular_rate), (changed.magnetic_field - plain.magnetic_field)
    assert (np.abs(rate).max() > 1e-6) == (name in GYROSCOPIC)
    assert (np.abs(field).max() > 1e-9) == (name not in GYROSCOPIC)
    for channel in CHANNELS:
        np.testing.assert_array_equal(changed.channels[channel], plain.channels[channel])
    np.testing.assert_array_equal(changed.attitude, plain.attitude)
    np.testing.assert_array_equal(changed.acceleration, plain.acceleration)
    assert applied.name == name
    assert applied.size == STRENGTHS[name].size
    again, _, _ = pair(name, duration=100)
    np.testing.assert_array_equal(again.magnetic_field, changed.magnetic_field)


@pytest.mark.parametrize("name", [n for n in EFFECTS if n not in ("axis-order", "sample-hold", "quantisation")])
def test_twice_the_factor_is_about_twice_the_effect(name):
    single, double = (pair(name, factor, 100, **EXACT) for factor in (1.0, 2.0))
    attribute = "angular_rate" if name in GYROSCOPIC else "magnetic_field"
    small, large = (rms(getattr(a, attribute) - getattr(b, attribute)) for a, b, _ in (single, double))
    assert large / small == pytest.approx(2.0, rel=0.35 if name in ("saturation", "timing") else 0.05)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("motor-current", 3.0),
        ("temperature-hard-iron", 4.0),
        ("hard-iron-drift", 4.0),
        ("coloured-noise", 6.0 * np.sqrt(3)),
    ],
)
def test_sizes_in_milligauss(name, expected):
    changed, plain, _ = pair(name, duration=600)
    difference = (changed.magnetic_field - plain.magnetic_field) / MILLIGAUSS
    assert rms(difference - difference.mean(axis=0)) == pytest.approx(expected, rel=0.12)


def test_a_step_is_where_and_as_large_as_it_says():
    changed, plain, applied = pair("hard-iron-step", **EXACT)
    difference = (changed.magnetic_field - plain.magnetic_field) / MILLIGAUSS
    before, after = (changed.time < applied.drawn["time"] - 1), (changed.time > applied.drawn["time"] + 1)
    assert np.abs(difference[before]).max() < 0.01
    expected = np.tile(6.0 * applied.drawn["direction"], (after.sum(), 1))
    np.testing.assert_allclose(difference[after], expected, atol=0.01)


def test_a_filter_is_late_by_what_it_says_and_rounds_what_turns_fast():
    changed, plain, applied = pair("timing", **EXACT)
    assert applied.size == 0.04
    early = np.stack([np.interp(plain.time - 0.04, plain.time, axis) for axis in plain.magnetic_field.T], axis=1)
    inner = slice(10, -10)
    late = rms((changed.magnetic_field - plain.magnetic_field)[inner])
    assert rms((changed.magnetic_field - early)[inner]) < 0.05 * late
    step = np.zeros((2000, 1))
    step[1000:] = 1.0
    response = lagged(step, 0.01, 0.3)[:, 0]
    assert 0.01 * (1 - response[1000:]).sum() == pytest.approx(0.3, rel=0.001)  # mean delay
    assert (np.diff(response[1000:]) > 0)[:100].all()


def test_misalignment_turns_the_field_by_its_angle():
    changed, plain, applied = pair("misalignment", soft_iron=np.eye(3), hard_iron=np.zeros(3), **EXACT)
    turned = Rotation.from_rotvec(applied.drawn["rotation_vector"]).apply(plain.magnetic_field.copy())
    np.testing.assert_allclose(changed.magnetic_field, turned, atol=1e-18)
    assert np.linalg.norm(applied.drawn["rotation_vector"]) == pytest.approx(0.045)


def test_the_gradient_follows_the_depth_and_the_anomaly_passes_once():
    changed, plain, _ = pair("field-gradient", hard_iron=np.zeros(3), soft_iron=np.eye(3), **EXACT)
    ratio = np.linalg.norm(changed.magnetic_field, axis=1) / np.linalg.norm(plain.magnetic_field, axis=1) - 1
    depth = changed.channels["depth"]
    assert abs(np.corrcoef(ratio, depth)[0, 1]) > 0.98
    assert ratio.std() == pytest.approx(4e-3, rel=0.05)
    changed, plain, applied = pair("local-anomaly", soft_iron=np.eye(3), **EXACT)
    bump = np.linalg.norm(changed.magnetic_field - plain.magnetic_field, axis=1) / MILLIGAUSS
    assert bump.max() == pytest.approx(20.0, rel=0.01)
    assert abs(changed.time[bump.argmax()] - applied.drawn["time"]) < 10.0
    assert np.median(bump) < 1.0


def test_saturation_is_soft_and_hysteresis_has_a_loop():
    changed, plain, applied = pair("saturation", **EXACT)
    full = applied.drawn["full_scale"]
    assert np.abs(changed.magnetic_field).max() < full < np.abs(plain.magnetic_field).max()
    small = np.abs(plain.magnetic_field) < 0.84 * full
    np.testing.assert_array_equal(changed.magnetic_field[small], plain.magnetic_field[small])
    changed, plain, applied = pair("hysteresis", duration=600, **EXACT)
    along = plain.magnetic_field @ applied.drawn["bar"]
    loop = (changed.magnetic_field - plain.magnetic_field) @ applied.drawn["direction"] / MILLIGAUSS
    rising = np.gradient(along) > 0
    middle = np.abs(along - np.median(along)) < 0.1 * np.ptp(along)
    assert loop[middle & ~rising].mean() - loop[middle & rising].mean() > 3.0
    assert np.abs(loop).max() <= 5.0 * (1 + 1e-9)


def test_readings():
    changed, plain, _ = pair("quantisation", **EXACT)
    counts = (changed.magnetic_field - changed.magnetic_field[0]) / (30 * MILLIGAUSS)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    changed, plain, applied = pair("sample-hold", duration=400)
    assert changed.magnetic_field_fresh.mean() == pytest.approx(1 / 1.7, abs=0.01)
    assert applied.drawn["period"] == pytest.approx(0.17)
    changed, plain, _ = pair("spikes", duration=400)
    hit = (changed.magnetic_field != plain.magnetic_field).any(axis=1)
    assert hit.mean() == pytest.approx(0.01, abs=0.004)
    changed, plain, applied = pair("tone", duration=400)
    spectrum = np.abs(np.fft.rfft(changed.magnetic_field - plain.magnetic_field, axis=0)).sum(axis=1)
    frequency = np.fft.rfftfreq(len(changed.time), 0.1)
    assert frequency[spectrum.argmax()] == pytest.approx(applied.drawn["frequency"], abs=0.01)


def test_axis_order_is_a_signed_permutation():
    changed, plain, _ = pair("axis-order", **EXACT)
    matrix = np.linalg.lstsq(plain.angular_rate, changed.angular_rate, rcond=None)[0]
    np.testing.assert_allclose(np.abs(matrix).sum(axis=0), 1, atol=1e-9)
    assert np.abs(matrix - np.eye(3)).max() > 0.5


def test_channels_are_recorded_with_what_needs_them():
    assert set(simulate("wide", 20, effects=("motor-current",)).recording.channels) == {"current"}
    assert set(simulate("wide", 20, effects=("timing",)).recording.channels) == set()
    recording = simulate("wide", 300, channels=CHANNELS).recording
    assert recording.channels["position"].shape == (3000, 3)
    assert (recording.channels["current"] >= -0.2).all()
    assert np.ptp(recording.channels["depth"]) > 20
    assert np.ptp(recording.channels["temperature"]) > 2
    gravity = np.linalg.norm(recording.acceleration, axis=1)
    assert gravity.mean() == pytest.approx(9.8, abs=0.1)
    assert 0.05 < gravity.std() < 1.0


def test_two_effects_do_not_change_each_other():
    both = simulate("wide", 60, seed=2, effects=("motor-current", "temperature-gyro"), **EXACT)
    one = simulate("wide", 60, seed=2, effects=("motor-current",), **EXACT)
    np.testing.assert_array_equal(both.recording.magnetic_field, one.recording.magnetic_field)
    assert [e.name for e in both.effects] == ["motor-current", "temperature-gyro"]


@pytest.mark.parametrize("name", ["motor-current", "misalignment", "timing", "temperature-gyro", *FOREIGN])
def test_the_published_strength_can_be_seen(name):
    """The misfit that twelve parameters leave without noise, in sigmas: some ten at least, on the multi motion."""
    quiet = {"magnetometer_noise": 1e-9, "gyroscope_noise": 5e-6}
    recording = simulate("multi", 600, seed=1, effects=(name,), **quiet).recording
    fit = fit_field_chain(recording, noise=(1e-6, 5e-3), robust=False, delay=0.0, window=0.5)
    assert 8 < np.sqrt(2 * fit.reduced.cost) < 100


def test_injection_into_a_recording_is_what_simulation_gives():
    """Of effects that act on what is measured; noise passes through as it would."""
    plain = simulate("wide", 120, seed=6)
    for name in ("hard-iron-step", "misalignment", "motor-current", "gyro-scale", "local-anomaly"):
        direct = simulate("wide", 120, seed=6, effects=(name,))
        injected, applied = inject(plain.recording, plain.truth, (name,), seed=6)
        assert applied[0].name == name
        assert applied[0].size == direct.effects[0].size
        for attribute, scale in (("magnetic_field", 1e-7), ("angular_rate", 1e-4)):
            effect = getattr(direct.recording, attribute) - getattr(plain.recording, attribute)
            change = getattr(injected, attribute) - getattr(plain.recording, attribute)
            assert (np.abs(change).max() > scale) == (np.abs(effect).max() > scale)
    blind = simulate("wide", 60).recording
    with pytest.raises(MagycError, match="local-anomaly needs an attitude"):
        inject(type(blind)(blind.time, blind.magnetic_field, blind.angular_rate), plain.truth, ("local-anomaly",))


def test_injection_keeps_the_sensors_own_clocks():
    """What takes time takes the same time whatever the rows of the table are; the samples keep their stamps."""
    fast = simulate("wide", 120, rate=50.0, seed=4, magnetometer_noise=1e-9, gyroscope_noise=1e-5)
    time, field, rate = fast.recording.time, fast.recording.magnetic_field, fast.recording.angular_rate
    shown = Recording.from_streams((time[::3], field[::3]), (time[1::2], rate[1::2]))
    late, _ = inject(shown, fast.truth, ("timing",), seed=6)
    for sensor in ("magnetometer", "gyroscope"):
        kept, given = getattr(late, sensor).time, getattr(shown, sensor).time
        assert np.isin(kept, given).all()
        assert len(kept) >= len(given) - 1  # the rows begin and end where both sensors have been heard
    assert calibrate(shown).delay == pytest.approx(0.0, abs=2e-4)
    assert calibrate(late).delay == pytest.approx(0.04, abs=2e-3)


def test_stages_cover_all_effects():
    assert {effect.stage for effect in EFFECTS.values()} == set(Stage)
    assert np.linalg.norm(FIELD) > 0
