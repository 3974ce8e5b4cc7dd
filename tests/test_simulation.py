"""Simulated recordings: the paper's motions, values AT their stamps, and the truth behind them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam import MagycError, Recording
from magyc_gtsam.simulation import (
    AMPLITUDES,
    FIELD,
    GYRO_BIAS,
    HARD_IRON,
    MILLIGAUSS,
    MOTIONS,
    RATES,
    SOFT_IRON,
    disturb,
    simulate,
)

EXACT = {"magnetometer_noise": 0.0, "gyroscope_noise": 0.0}


def euler(simulation):
    """Roll, pitch and heading (N, 3) in rad, heading unwrapped."""
    angles = Rotation.from_quat(simulation.recording.attitude).as_euler("ZYX")[:, ::-1]
    return np.unwrap(angles, axis=0)


@pytest.mark.parametrize("motion", MOTIONS)
def test_rates_are_the_derivative_of_the_attitude(motion):
    """Attitude differences over 2 ms give the rate in their middle, to the square of the step.

    To the step itself where the path between waypoints changes its acceleration at once.
    """
    simulation = simulate(motion, duration=20, rate=1000, seed=3, gyro_bias=np.zeros(3), **EXACT)
    attitude = Rotation.from_quat(simulation.recording.attitude)
    turned = (attitude[:-2].inv() * attitude[2:]).as_rotvec() / 2e-3
    np.testing.assert_allclose(
        simulation.recording.angular_rate[1:-1], turned, atol=2e-6 if motion in AMPLITUDES else 1e-4
    )


@pytest.mark.parametrize("motion", AMPLITUDES)
def test_the_papers_amplitudes_and_rates(motion):
    largest_rates = []
    for seed in range(5):
        simulation = simulate(motion, duration=600, rate=20, seed=seed)
        angles = euler(simulation)
        np.testing.assert_allclose(np.ptp(angles, axis=0) / 2, np.deg2rad(AMPLITUDES[motion]), rtol=2e-3)
        largest_rates.append(np.abs(np.gradient(angles, 1 / 20, axis=0)).max(axis=0))
    low, high = np.transpose(RATES)
    assert (np.array(largest_rates) > 0.97 * low).all()
    assert (np.array(largest_rates) < 1.01 * high).all()
    assert (np.ptp(largest_rates, axis=0) > 0.1 * (high - low)).all()  # drawn anew by every seed


@pytest.mark.parametrize("motion", ["dive", "survey"])
def test_dives_tilt_and_surveys_come_back(motion):
    angles = np.rad2deg(euler(simulate(motion, duration=900, rate=5)))
    roll, pitch, heading = np.ptp(angles, axis=0)
    if motion == "dive":
        assert heading > 360
        assert roll > 24
        assert pitch > 70
    else:  # legs there and back, nearly level
        assert 180 < heading < 190
        assert max(roll, pitch) < 15
    # Twenty hours of it, the last as the first.
    rates = np.abs(simulate(motion, duration=20 * 3600, rate=0.2).recording.angular_rate[:, 2])
    assert rates[-720:].max() == pytest.approx(rates[:720].max(), rel=0.5)


def test_noise_and_truth():
    noisy = simulate("wide", duration=1000, rate=20, seed=5, magnetometer_noise=3e-7, gyroscope_noise=2e-3)
    exact = simulate("wide", duration=1000, rate=20, seed=5, **EXACT)
    for name, sigma in (("magnetic_field", 3e-7), ("angular_rate", 2e-3)):
        noise = (getattr(noisy.recording, name) - getattr(exact.recording, name)) / sigma
        count = len(noise)
        np.testing.assert_allclose(noise.mean(axis=0), 0, atol=4 / np.sqrt(count))
        np.testing.assert_allclose(np.cov(noise.T), np.eye(3), atol=4 * np.sqrt(2 / count))
        assert noisy.truth.noise[name] == sigma
    assert np.linalg.det(noisy.truth.soft_iron) == pytest.approx(1)
    np.testing.assert_array_equal(noisy.truth.hard_iron, HARD_IRON)
    np.testing.assert_array_equal(noisy.truth.gyro_bias, GYRO_BIAS)
    # The scale of the soft iron has moved into the field strength.
    scale = noisy.truth.field_strength / np.linalg.norm(FIELD)
    np.testing.assert_allclose(noisy.truth.soft_iron * scale, SOFT_IRON)


def test_truth_applied_gives_the_field_in_the_sensor_and_still_in_the_world():
    simulation = simulate("wide", duration=60, rate=10, seed=1, **EXACT)
    recording, truth = simulation.recording, simulation.truth
    calibrated = truth.apply(recording.magnetic_field)
    world = Rotation.from_quat(recording.attitude).apply(calibrated)
    np.testing.assert_allclose(
        world, np.tile(FIELD / np.linalg.norm(FIELD) * truth.field_strength, (600, 1)), rtol=1e-12
    )
    # At rest an accelerometer reads −g, up, in the north-east-down world.
    up = Rotation.from_quat(recording.attitude).apply(recording.acceleration.copy())
    np.testing.assert_allclose(up, np.tile([0, 0, -9.80665], (600, 1)), atol=1e-12)


def test_the_papers_field_and_sensor():
    assert np.linalg.norm(FIELD) == pytest.approx(473.1 * MILLIGAUSS, rel=1e-3)
    recording = simulate("wide").recording
    assert len(recording.time) == 6000
    np.testing.assert_allclose(np.diff(recording.time), 0.1)
    assert recording.name == "wide-0"


@pytest.mark.parametrize("delay", [0.03, -0.02])
def test_a_delayed_magnetometer_shows_the_field_of_earlier(delay):
    late = simulate("wide", duration=30, rate=100, seed=2, delay=delay, **EXACT)
    prompt = simulate("wide", duration=30, rate=100, seed=2, **EXACT)
    steps = round(delay * 100)
    here, there = (
        (slice(steps, None), slice(None, -steps)) if steps > 0 else (slice(None, steps), slice(-steps, None))
    )
    np.testing.assert_allclose(
        late.recording.magnetic_field[here], prompt.recording.magnetic_field[there], atol=1e-16
    )
    np.testing.assert_array_equal(late.recording.angular_rate, prompt.recording.angular_rate)
    assert late.truth.delay == delay


def test_seeds():
    one, again, other = (simulate("low", duration=20, seed=seed).recording for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.magnetic_field, again.magnetic_field)
    np.testing.assert_array_equal(one.angular_rate, again.angular_rate)
    assert np.abs(one.attitude - other.attitude).max() > 0.01


def test_sensors_of_ones_own():
    soft_iron, field = np.diag([2.0, 1.0, 1.0]), [0.0, 0.0, 50e-6]
    simulation = simulate(
        "tiny",
        duration=10,
        field=field,
        soft_iron=soft_iron,
        hard_iron=[1e-6, 0, 0],
        gyro_bias=[0, 0, 1.0],
        **EXACT,
    )
    body = Rotation.from_quat(simulation.recording.attitude).inv().apply(field)
    np.testing.assert_allclose(simulation.recording.magnetic_field, body * [2, 1, 1] + [1e-6, 0, 0])
    assert simulation.truth.field_strength == pytest.approx(np.cbrt(2) * 50e-6)


def test_disturb_moves_the_share_it_says():
    recording = simulate("wide", duration=600, rate=10).recording
    disturbed = disturb(recording, share=0.2, largest=50e-6, stretch=1.0, seed=3)
    offset = disturbed.magnetic_field - recording.magnetic_field
    stretches = offset.reshape(600, 10, 3)
    np.testing.assert_allclose(stretches, np.broadcast_to(stretches[:, :1], stretches.shape), atol=1e-18)
    strength = np.linalg.norm(stretches[:, 0], axis=1)
    assert (strength > 1e-15).sum() == 120
    assert 40e-6 < strength.max() <= 50e-6
    # Directions all around, strengths all over.
    hit = stretches[strength > 1e-15, 0]
    assert np.linalg.norm((hit / np.linalg.norm(hit, axis=1)[:, None]).mean(axis=0)) < 0.25
    assert strength[strength > 1e-15].mean() == pytest.approx(25e-6, rel=0.2)
    np.testing.assert_array_equal(disturbed.angular_rate, recording.angular_rate)
    assert np.abs(disturb(recording, seed=4).magnetic_field - disturbed.magnetic_field).max() > 1e-6


def test_disturb_leaves_held_rows_held():
    """A mask once found must survive: held rows differ at a stretch's border."""
    held = simulate("wide", duration=60, rate=10).recording
    held = Recording(held.time, np.repeat(held.magnetic_field[::2], 2, axis=0), held.angular_rate)
    np.testing.assert_array_equal(disturb(held, stretch=0.7).magnetic_field_fresh, held.magnetic_field_fresh)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"motion": "wild"}, ["'wild'", "wide", "survey"]),
        ({"motion": "wide", "effects": ("wobble",)}, ["effects", "'wobble'", "spikes"]),
        ({"motion": "wide", "effects": (("tone", 0.0),)}, ["factor 0", "'tone'"]),
        ({"motion": "wide", "effects": ("tone", "tone")}, ["'tone'", "twice"]),
        ({"motion": "wide", "channels": ("pressure",)}, ["'pressure'", "depth"]),
        ({"motion": "wide", "duration": 0.2}, ["0.2 s at 10 Hz give 2 samples", "at least 3"]),
        ({"motion": "wide", "duration": float("inf")}, ["inf s", "at most 20,000,000"]),
        ({"motion": "wide", "rate": 1e12}, ["1e+12 Hz", "at most 20,000,000"]),
    ],
)
def test_refused(arguments, words):
    with pytest.raises(MagycError) as caught:
        simulate(**arguments)
    for word in words:
        assert word in str(caught.value)
