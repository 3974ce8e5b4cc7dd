"""Blocks of samples at keyframes, Python and native, in every solver that a SLAM graph may use."""

import pickle

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, B, F, H, X
from test_factors_jacobians import derivative

from magyc_gtsam import simulate
from magyc_gtsam.factors import (
    KeyframeBuffer,
    KeyframeField,
    MagycError,
    NativeFactors,
    Preintegration,
    SensorNoise,
    calibration_prior,
    field_chain_factor,
    hard_iron_walk,
    keyframe_field_factor,
    magnetometer_factor,
    native_factor,
    robust_noise,
    soft_iron_walk,
    unvech,
    vech,
)
from magyc_gtsam.factors.guard import factor_details

FIELD = np.array([22.7, 5.2, 41.2]) * 1e-6
IDENTITY = np.array([1.0, 0, 0, 1, 0, 1])
MOUNTING = gtsam.Rot3.RzRyRx(0.1, 0.5, -0.7)
ROTATION = gtsam.Rot3.RzRyRx(0.3, -0.4, 2.0)
ATTITUDES = {
    "Pose3": gtsam.Pose3(ROTATION, np.array([1.0, 2, 3])),
    "Rot3": ROTATION,
    "Rot2": gtsam.Rot2(0.7),
    "Unit3": gtsam.Unit3(FIELD),
}


def block(samples=60, bias=(0.01, 0.02, 0.03), seed=0):
    random = np.random.default_rng(seed)
    time = np.linspace(0, 1, 101)
    rate = 0.3 * random.normal(size=(101, 3))
    field = 3e-5 * random.normal(size=(samples, 3))
    return KeyframeField.from_samples(
        (np.linspace(0.02, 0.98, samples), field), (time, rate), 0.5, bias=bias, body_R_sensor=MOUNTING
    )


def point(attitude="Pose3", constant_bias=True):
    values, moved = gtsam.Values(), np.array([0.03, -0.02, 0.05])
    values.insert(X(0), ATTITUDES[attitude])
    values.insert(A(0), np.array([1.1, 0.1, -0.05, 0.9, 0.02, 1.2]))
    values.insert(H(0), np.array([10.0, -20, 30]))
    values.insert(B(0), gtsam.imuBias.ConstantBias(np.ones(3), moved) if constant_bias else moved)
    values.insert(F(0), FIELD * 1e6 + 1)
    return values


@pytest.mark.parametrize("robust", [None, "huber", "cauchy"])
@pytest.mark.parametrize("constant_bias", [True, False])
@pytest.mark.parametrize("attitude", ATTITUDES)
def test_jacobian_is_the_derivative(attitude, constant_bias, robust):
    field = {"field": 50e-6} if attitude == "Unit3" else {"field_key": F(0)}
    factor = keyframe_field_factor(X(0), A(0), H(0), block(), 1e-5, gyro_bias_key=B(0), robust=robust, **field)
    values = point(attitude, constant_bias)
    jacobian, right = factor.linearize(values).jacobian()
    numeric = derivative(factor.whitenedError, values, factor.keys())
    np.testing.assert_allclose(-right, factor.whitenedError(values), atol=1e-12)
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize("attitude", ["Pose3", "Unit3"])
@pytest.mark.parametrize("constant_bias", [True, False])
def test_the_bias_node_may_be_in_the_axes_of_the_gyroscope(constant_bias, attitude):
    """The same residual as with the node in body axes; Jacobians on every key; the quadratic follows."""
    turn = gtsam.Rot3.RzRyRx(3.0, -0.4, 1.5)
    field = {"field": 50e-6} if attitude == "Unit3" else {"field": FIELD, "mounting_key": 7}

    def factor(**options):
        return keyframe_field_factor(X(0), A(0), H(0), block(), 1e-5, gyro_bias_key=B(0), **field, **options)

    there, plain = factor(body_R_gyroscope=turn), factor()
    values = point(attitude, constant_bias)
    values.insert(7, MOUNTING)
    body, gyroscope = gtsam.Values(values), gtsam.Values(values)
    bias = np.array([0.03, -0.02, 0.05])  # rad/s, body axes
    gyroscope.erase(B(0))
    inner = turn.matrix().T @ bias
    gyroscope.insert(B(0), gtsam.imuBias.ConstantBias(np.ones(3), inner) if constant_bias else inner)
    np.testing.assert_allclose(there.whitenedError(gyroscope), plain.whitenedError(body), atol=1e-12)
    jacobian, right = there.linearize(gyroscope).jacobian()
    numeric = derivative(there.whitenedError, gyroscope, there.keys())
    np.testing.assert_allclose(-right, there.whitenedError(gyroscope), atol=1e-12)
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())
    np.testing.assert_allclose(factor_details(there).bias_at(gyroscope), bias, atol=1e-15)
    exact = there.linearize(gyroscope).augmentedInformation()
    native = native_factor(there, gyroscope).linearize(gyroscope).augmentedInformation()
    np.testing.assert_allclose(native, exact, atol=1e-12 * np.abs(exact).max())


@pytest.mark.parametrize("robust", [None, "cauchy"])
@pytest.mark.parametrize("optional", [("m",), ("t",), ("m", "t"), ("b", "f", "m", "t")], ids="".join)
def test_mounting_and_delay_are_variables(optional, robust):
    """Jacobians on every optional key; held at the block's own they change nothing."""
    names = {"b": "gyro_bias_key", "f": "field_key", "m": "mounting_key", "t": "delay_key"}
    keys = {names[letter]: gtsam.symbol(letter, 0) for letter in optional}
    options = {} if "f" in optional else {"field": FIELD}
    values = point()
    values.insert(gtsam.symbol("m", 0), MOUNTING.compose(gtsam.Rot3.Expmap(np.array([0.05, -0.1, 0.02]))))
    values.insert(gtsam.symbol("t", 0), 0.02)
    factor = keyframe_field_factor(X(0), A(0), H(0), block(), 1e-5, robust=robust, **options, **keys)
    jacobian, right = factor.linearize(values).jacobian()
    numeric = derivative(factor.whitenedError, values, factor.keys())
    np.testing.assert_allclose(-right, factor.whitenedError(values), atol=1e-12)
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())
    values.update(gtsam.symbol("m", 0), MOUNTING)
    values.update(gtsam.symbol("t", 0), 0.0)
    held = {name: key for name, key in keys.items() if name not in ("mounting_key", "delay_key")}
    plain = keyframe_field_factor(X(0), A(0), H(0), block(), 1e-5, robust=robust, **options, **held)
    assert factor.error(values) == pytest.approx(plain.error(values), rel=1e-10)


def test_a_delay_that_moves_is_followed_to_first_order():
    """A block integrated at no delay, evaluated at one, against the block that was moved by it."""
    time, random = np.linspace(0, 1, 101), np.random.default_rng(4)
    rate = 0.5 * np.sin(6 * time)[:, None] * np.array([1.0, -0.6, 0.8]) + 0.3
    when, field = np.linspace(0.1, 0.95, 50), 3e-5 * random.normal(size=(50, 3))
    v = np.array([20.0, -30, 25])
    plain, moved = (
        KeyframeField.from_samples((when, field), (time, rate), 0.5, body_R_sensor=MOUNTING, delay=delay)
        for delay in (0.0, 0.02)
    )
    expected, _ = moved.error(1e-6, v, np.eye(3), np.zeros(3), np.zeros(3))
    found, _ = plain.with_delay().error(1e-6, v, np.eye(3), np.zeros(3), np.zeros(3), 0.02)
    held, _ = plain.error(1e-6, v, np.eye(3), np.zeros(3), np.zeros(3))
    assert np.abs(held - expected).max() > 0.3
    assert np.abs(found - expected).max() < 0.03  # µT; (ω τ)²/2 of 44


@pytest.mark.parametrize("bias_key", [None, B(0)])
def test_compression_is_exact(bias_key):
    """120 samples in 40 rows: the same cost, gradient and information as their sum."""
    whole, values = block(120), point()
    assert len(whole.compressed().share) == 40
    make = {"gyro_bias_key": bias_key, "field_key": F(0)}
    compressed = keyframe_field_factor(X(0), A(0), H(0), whole, 1e-6, **make)
    graph = gtsam.NonlinearFactorGraph()
    for s in range(120):
        rows = slice(s, s + 1)
        sample = KeyframeField(whole.design[rows], whole.share[rows], whole.field[rows], whole.bias, 1, 0.0)
        graph.push_back(keyframe_field_factor(X(0), A(0), H(0), sample, 1e-6, **make))
    assert compressed.error(values) == pytest.approx(graph.error(values), rel=1e-12)
    summed = gtsam.HessianFactor(graph.linearize(values)).augmentedInformation()
    alone = gtsam.NonlinearFactorGraph()
    alone.push_back(compressed)
    found = gtsam.HessianFactor(alone.linearize(values)).augmentedInformation()
    np.testing.assert_allclose(found, summed, rtol=0, atol=1e-12 * np.abs(summed).max())


def test_rotations_and_their_bias_derivative_are_gtsams():
    random = np.random.default_rng(3)
    time, rate, bias = np.arange(11) / 10, random.normal(size=(11, 3)), np.array([0.1, -0.2, 0.05])
    params = gtsam.PreintegratedRotationParams()
    theirs = gtsam.PreintegratedRotation(params)
    for mean in rate[1:]:
        theirs.integrateGyroMeasurement(mean, bias, 0.1)
    ours = KeyframeField.from_samples(
        ([1.0], [[1e-5, 2e-5, 3e-5]]), (time, rate), 0.0, bias=bias, interval_mean=True
    )
    np.testing.assert_allclose(ours.design[0, :, :3], theirs.deltaRij().matrix().T, atol=1e-12)
    step, v = np.array([1e-5, -2e-5, 1.5e-5]), np.array([0.3, -0.5, 0.8])
    moved = ours.design[0, :, :12] @ np.concatenate([v, np.outer(step, v).ravel()])
    expected = theirs.biascorrectedDeltaRij(step).matrix().T @ v
    # Theirs integrates the lever by rectangles, ours by trapezoids: 5 % of a step of the bias at 10 Hz.
    np.testing.assert_allclose(moved, expected, atol=0.1 * np.abs(step).max())


def test_bias_is_followed_to_first_order():
    """A block integrated elsewhere differs in second order of the distance."""
    v, a, h = np.array([20.0, -30, 25]), np.eye(3), np.zeros(3)
    goal = np.array([0.013, 0.018, 0.033])
    differences = []
    for share in (1.0, 0.5):
        far = block(bias=goal + share * np.array([0.04, -0.03, 0.05]))
        here = block(bias=goal)
        differences.append(np.abs(far.error(1e-6, v, a, h, goal)[0] - here.error(1e-6, v, a, h, goal)[0]).max())
    assert differences[0] < 0.1  # µT of 44
    assert differences[0] / differences[1] > 3  # 4 but for the lever's trapezoids


def test_keyframe_anywhere_is_the_same_field():
    """Noise-free samples fit exactly whichever keyframe the block hangs on."""
    simulation = simulate("wide", 4.0, 50, 1, magnetometer_noise=0.0, gyroscope_noise=0.0)
    recording, truth = simulation.recording, simulation.truth
    for row in (0, 70, 199):
        rows = KeyframeField.from_samples(
            recording.magnetometer, recording.gyroscope, recording.time[row], bias=truth.gyro_bias
        )
        rotation = gtsam.Rot3.Quaternion(*recording.attitude[row][[3, 0, 1, 2]])
        v = rotation.matrix().T @ simulation.field * 1e6
        scale = truth.field_strength / np.linalg.norm(simulation.field)
        residual, _ = rows.error(
            1e-6, v, truth.soft_iron * scale, truth.hard_iron * 1e6, np.asarray(truth.gyro_bias)
        )
        assert np.abs(residual).max() < 1e-3  # µT


def test_spread_is_that_of_the_mean_of_a_random_walk():
    time = np.arange(1001) / 1000
    field = np.full((1001, 3), 3e-5)
    end, middle = (
        KeyframeField.from_samples((time, field), (time, np.zeros((1001, 3))), at).spread for at in (1.0, 0.5)
    )
    assert end == pytest.approx(1e-3 / 3, rel=5e-3)  # dt T / 3
    assert middle == pytest.approx(1e-3 / 12, rel=1e-2)
    whole = KeyframeField.from_samples((time, field), (time, np.zeros((1001, 3))), 1.0)
    plain, widened = (
        keyframe_field_factor(X(0), A(0), H(0), whole, 1e-6, field=FIELD, gyroscope_noise=noise).error(point())
        for noise in (0.0, 0.02)
    )
    ratio = 1 + 1001 * (0.02 * np.linalg.norm(FIELD)) ** 2 * end / 1e-12
    assert plain / widened == pytest.approx(ratio)


def test_robust_weights_are_per_sample():
    clean = block(30)
    field = np.array(clean.field)
    field[7] += 100e-6
    dirty = KeyframeField(clean.design, clean.share, field, clean.bias, 30, clean.spread)
    values = point()

    def cost(data, robust):
        factor = keyframe_field_factor(X(0), A(0), H(0), data, 1e-5, field=FIELD, robust=robust)
        return factor.error(values)

    assert cost(dirty, None) - cost(clean, None) > 27
    assert abs(cost(dirty, "geman-mcclure") - cost(clean, "geman-mcclure")) < 9.5  # at most k²/2 of one sample
    weighed = keyframe_field_factor(X(0), A(0), H(0), dirty, 1e-6, field=FIELD, robust="cauchy")
    assert weighed.dim() == 90


def test_buffer_cuts_the_same_blocks():
    recording = simulate("wide", 6.0, 20, 2).recording
    buffer, keyframes = KeyframeBuffer(body_R_sensor=MOUNTING, delay=0.01), (2.0, 4.0)
    found = []
    for time, field, rate in zip(recording.time, recording.magnetic_field, recording.angular_rate, strict=True):
        buffer.add_rate(time, rate)
        buffer.add_field(time, field)
        if any(abs(time - keyframe) < 1e-9 for keyframe in keyframes):
            found.append(buffer.close(time, bias=[1e-3, 0, 0]))
    first = recording.time - 0.01
    for cut, low, high in zip(found, (0.0, 2.0), keyframes, strict=True):
        rows = (first >= low) & (first <= high)
        assert cut.samples == rows.sum() > 35
        again = KeyframeField.from_samples(
            (first[rows], recording.magnetic_field[rows]),
            (recording.time, recording.angular_rate),
            high,
            bias=[1e-3, 0, 0],
            body_R_sensor=MOUNTING,
        )
        np.testing.assert_allclose(cut.design, again.design, atol=1e-5)  # slopes at the cut are one-sided


def test_buffer_takes_samples_in_blocks():
    recording = simulate("wide", 4.0, 20, 2).recording
    single, together = KeyframeBuffer(), KeyframeBuffer()
    for time, field, rate in zip(recording.time, recording.magnetic_field, recording.angular_rate, strict=True):
        single.add_rate(time, rate)
        single.add_field(time, field)
    together.add_rate(recording.time, recording.angular_rate)
    together.add_field(recording.time, recording.magnetic_field)
    np.testing.assert_array_equal(together.close(2.0).design, single.close(2.0).design)
    with pytest.raises(MagycError, match=r"add_field: samples of shape \(2, 3\) for stamps of shape \(3,\)"):
        together.add_field(recording.time[:3], recording.magnetic_field[:2])


def test_buffer_goes_on_after_a_sample_that_is_refused():
    recording = simulate("wide", 4.0, 20, 2).recording
    time, field, rate = recording.time, recording.magnetic_field, recording.angular_rate
    whole, disturbed = KeyframeBuffer(), KeyframeBuffer()
    for rows in (slice(0, 40), slice(40, 80)):
        for buffer in (whole, disturbed):
            buffer.add_rate(time[rows], rate[rows])
            buffer.add_field(time[rows], field[rows])
        for late, wrong, message in (
            (time[rows][-1] + 0.01, [np.nan, 0, 0], "not finite"),
            (time[rows][-1] + 0.01, [80.0, 0, 0], "likely unit"),
            (time[rows][0], [0, 0, 0], "in the order"),
        ):
            with pytest.raises(MagycError, match=message):
                disturbed.add_rate(late, wrong)
            with pytest.raises(MagycError, match=message):
                disturbed.add_field(late, wrong)
        end = time[rows][-1]
        np.testing.assert_array_equal(disturbed.close(end).design, whole.close(end).design)


def test_a_late_sample_is_named_by_its_own_stamp():
    """In s since 1970, with a delay that the buffer takes off."""
    buffer = KeyframeBuffer(delay=0.25)
    buffer.add_field([1.7e9, 1.7e9 + 0.5], np.full((2, 3), 3e-5))
    for late in (1.7e9 + 0.125, [1.7e9 + 0.125]):
        with pytest.raises(MagycError, match=r"sample at 1700000000\.125 s comes after one at 1700000000\.500 s"):
            buffer.add_field(late, np.full((*np.shape(late), 3), 3e-5))


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e9], ids=["ms", "µs", "ns"])
def test_stamps_in_another_unit_are_refused(scale):
    time, field = np.linspace(0.0, 1.0, 21) * scale, np.full((21, 3), 3e-5)
    message = "closest gyroscope samples .* s apart; it must be at most 0.5 s; likely unit: ms"
    with pytest.raises(MagycError, match=message):
        KeyframeField.from_samples((time, field), (time, np.zeros((21, 3))), time[10])
    buffer = KeyframeBuffer()
    buffer.add_rate(time, np.zeros((21, 3)))
    buffer.add_field(time, field)
    with pytest.raises(MagycError, match=message):
        buffer.close(time[10])


@pytest.mark.parametrize(
    "call",
    [
        lambda: KeyframeBuffer(delay=25.0),
        lambda: KeyframeField.from_samples(
            ([25.5], np.full((1, 3), 3e-5)), ([0, 0.5, 1], np.zeros((3, 3))), 0.5, delay=25.0
        ),
        lambda: magnetometer_factor(
            X(0), A(0), H(0), FIELD, 1e-6, field=FIELD, delay=25.0, angular_rate=np.zeros(3)
        ),
    ],
)
def test_a_delay_in_ms_is_refused(call):
    with pytest.raises(MagycError, match="delay of 25 s; it must be at most 10 s; likely unit: ms; give it in s"):
        call()


def test_a_noise_model_in_tesla_is_refused():
    def factor(sigma, unit=1e-6, robust=False):
        noise = robust_noise("huber", sigma) if robust else gtsam.noiseModel.Isotropic.Sigma(3, sigma)
        return magnetometer_factor(X(0), A(0), H(0), FIELD, noise, field=FIELD, field_unit=unit)

    for robust in (False, True):
        factor(0.5, robust=robust)
        with pytest.raises(MagycError, match="noise model of 5e-13 T; .* between 1 nT and 1 mT; .*`field_unit`"):
            factor(0.5e-6, robust=robust)
    factor(0.5e-6, unit=1.0)
    with pytest.raises(MagycError, match="noise model of 0.5 T"):
        factor(0.5, unit=1.0)
    exact = gtsam.noiseModel.Constrained.All(3)
    magnetometer_factor(X(0), A(0), H(0), FIELD, exact, field=FIELD)
    full = gtsam.noiseModel.Gaussian.Covariance(1e-12 * (np.eye(3) + 0.1))
    with pytest.raises(MagycError, match="noise model of 1.049e-12 T"):
        magnetometer_factor(X(0), A(0), H(0), FIELD, full, field=FIELD)


def test_buffer_stays_small_while_the_magnetometer_is_silent():
    buffer, step = KeyframeBuffer(), np.arange(1, 11) / 10
    for second in range(60):
        buffer.add_rate(second + step, np.zeros((10, 3)))
        with pytest.raises(MagycError, match="no magnetometer sample"):
            buffer.close(second + 1.0)
        assert len(buffer._rate_time) <= 112  # 10 s, and a second between two keyframes
    buffer.add_field(59.5, FIELD)
    assert buffer.close(60.0).samples == 1


def test_samples_beyond_a_pause_of_the_gyroscope_are_left_out():
    recording = simulate("wide", 10.0, 20, 2).recording
    time, field, rate = recording.time, recording.magnetic_field, recording.angular_rate
    kept = (time < 4.0) | (time > 5.0)
    for keyframe, rows in ((2.0, time < 4.0), (9.0, time > 5.0)):
        block = KeyframeField.from_samples((time, field), (time[kept], rate[kept]), keyframe)
        alone = KeyframeField.from_samples((time[rows], field[rows]), (time[rows], rate[rows]), keyframe)
        assert block.samples == rows.sum()
        np.testing.assert_allclose(block.design, alone.design, atol=1e-12)
    for keyframe, rows in ((4.5, slice(None)), (9.0, slice(0, 40))):
        with pytest.raises(MagycError, match="pauses between the keyframe"):
            KeyframeField.from_samples((time[rows], field[rows]), (time[kept], rate[kept]), keyframe)


def test_a_block_of_one_sample_at_its_keyframe_is_finite():
    recording = simulate("wide", 4.0, 20, 2).recording
    for row in (0, 3, 79):
        single = KeyframeField.from_samples(
            (recording.time[[row]], recording.magnetic_field[[row]]),
            (recording.time, recording.angular_rate),
            recording.time[row],
        )
        np.testing.assert_allclose(single.design[0, :, :3], np.eye(3), atol=1e-12)
        assert single.spread == 0.0


@pytest.mark.parametrize(
    "call",
    [
        lambda: KeyframeField.from_samples((np.zeros(0), np.zeros((0, 3))), ([0, 1], np.zeros((2, 3))), 0.5),
        lambda: KeyframeField.from_samples(([0.5], np.ones((1, 3))), ([0, 1], np.zeros((2, 3))), 1.5),
        lambda: KeyframeField.from_samples(([0.5], np.ones((1, 3))), ([1, 0], np.zeros((2, 3))), 0.5),
        lambda: keyframe_field_factor(X(0), A(0), H(0), block(), 1e-6),
        lambda: keyframe_field_factor(X(0), A(0), H(0), block(), 1e-6, field=FIELD, field_key=F(0)),
        lambda: keyframe_field_factor(X(0), A(0), H(0), block(), 0.0, field=FIELD),
        lambda: keyframe_field_factor(X(0), A(0), H(0), block(), 1e-6, field=FIELD, tuning=2.0),
        lambda: KeyframeBuffer(body_R_sensor=np.eye(3)),
        lambda: keyframe_field_factor(X(0), A(0), H(0), block(), 1e-6, field=FIELD[:2]),
        lambda: block().compressed().with_delay(),
        lambda: KeyframeBuffer().close(0.0),
        lambda: NativeFactors(tolerance=0.0),
        lambda: calibration_prior(A(0), H(0), np.eye(3), np.zeros(3), np.diag(np.r_[np.zeros(1), np.ones(8)])),
    ],
)
def test_wrong_arguments_are_refused(call):
    with pytest.raises(MagycError):
        call()


def test_native_factor_is_the_linearisation_and_pickles():
    factor, values = keyframe_field_factor(X(0), A(0), H(0), block(), 1e-6, field=FIELD), point()
    native = native_factor(factor, values)
    assert isinstance(native, gtsam.LinearContainerFactor)
    assert native.error(values) == pytest.approx(factor.error(values), rel=1e-9)
    again = pickle.loads(pickle.dumps(native))
    np.testing.assert_allclose(
        again.linearize(values).augmentedInformation(),
        factor.linearize(values).augmentedInformation(),
        rtol=1e-7,
        atol=1e-6,
    )


@pytest.mark.parametrize("noise", [1e-9, 0.5e-6])
def test_every_block_has_a_quadratic(noise):
    """The information of these blocks is singular, and often indefinite by rounding: 1 in 20, and 1 in 2 at 1 nT."""
    random, time = np.random.default_rng(0), np.arange(-2.1, 0.1, 0.02)
    values = point()
    for samples in [4, 20] * 20:
        field = FIELD + noise * random.normal(size=(samples, 3))
        rates = 0.1 * random.normal(size=3) + 1e-5 * random.normal(size=(len(time), 3))
        of = KeyframeField.from_samples((np.linspace(-2, 0, samples), field), (time, rates), 0.0)
        factor = keyframe_field_factor(
            X(0), A(0), H(0), of, noise, gyro_bias_key=B(0), field=FIELD, field_unit=50e-6
        )
        values.update(X(0), gtsam.Pose3(gtsam.Rot3.Expmap(2 * random.normal(size=3)), np.zeros(3)))
        linear, native = factor.linearize(values), native_factor(factor, values)
        exact = linear.augmentedInformation()
        found = native.linearize(values)
        assert found.keys() == linear.keys()
        assert len(found.augmentedJacobian()) <= len(exact)
        assert np.abs(found.augmentedInformation() - exact).max() < 1e-13 * np.abs(exact).max()
        assert native.error(values) == pytest.approx(factor.error(values), rel=1e-12)


def test_native_factor_leaves_what_is_a_quadratic_or_holds_exactly():
    values = point()
    information = gtsam.HessianFactor(H(0), np.diag([1.0, 2.0, 0.0]), np.array([3.0, 4.0, 0.0]), 0.0)
    native = native_factor(gtsam.LinearContainerFactor(information, values.extract([H(0)])), values)
    np.testing.assert_array_equal(
        native.linearize(values).augmentedInformation(), information.augmentedInformation()
    )
    held = gtsam.PriorFactorPoint3(H(0), np.zeros(3), gtsam.noiseModel.Constrained.All(3))
    assert native_factor(held, values).linearize(values).isConstrained()


# --- a small SLAM graph in every solver ---------------------------------------------------------------


class Survey:
    """60 keyframes a second apart with noisy odometry, and the magnetometer's blocks between them."""

    def __init__(self, keyframes=60, seed=5):
        self.simulation = simulate("wide", keyframes + 0.1, 10, seed)
        recording, random = self.simulation.recording, np.random.default_rng(seed)
        self.count = keyframes
        quaternions = recording.attitude[::10, [3, 0, 1, 2]]
        self.pose = [
            gtsam.Pose3(gtsam.Rot3.Quaternion(*q), np.array([k, 0.0, 0.0])) for k, q in enumerate(quaternions)
        ]
        self.odometry = gtsam.noiseModel.Diagonal.Sigmas(np.r_[[0.004] * 3, [0.02] * 3])
        self.measured = [
            a.between(b).compose(gtsam.Pose3.Expmap(random.normal(size=6) * self.odometry.sigmas()))
            for a, b in zip(self.pose[:-1], self.pose[1:], strict=True)
        ]
        bias = np.asarray(self.simulation.truth.gyro_bias)
        self.blocks = []
        for k in range(1, keyframes):
            rows = slice(10 * (k - 1), 10 * k + 1)
            self.blocks.append(
                KeyframeField.from_samples(
                    (recording.time[rows][1:], recording.magnetic_field[rows][1:]),
                    (recording.time[rows], recording.angular_rate[rows]),
                    recording.time[10 * k],
                    bias=bias,
                )
            )

    def start(self):
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        sigmas = gtsam.noiseModel.Diagonal.Sigmas(np.r_[0.02, 0.02, 0.3, 0.1, 0.1, 0.1])
        graph.addPriorPose3(X(0), self.pose[0], sigmas)
        graph.addPriorVector(A(0), IDENTITY, gtsam.noiseModel.Isotropic.Sigma(6, 0.3))
        graph.addPriorPoint3(H(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 0.6))
        for key, value in ((X(0), self.pose[0]), (A(0), IDENTITY), (H(0), np.zeros(3))):
            values.insert(key, value)
        return graph, values

    def step(self, k, previous):
        """Odometry to keyframe k, the block before it, and the new pose."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.push_back(gtsam.BetweenFactorPose3(X(k - 1), X(k), self.measured[k - 1], self.odometry))
        values.insert(X(k), previous.compose(self.measured[k - 1]))
        factor = keyframe_field_factor(
            X(k), A(0), H(0), self.blocks[k - 1], 1e-6, field=self.simulation.field, field_unit=50e-6
        )
        return graph, values, factor

    def python_graph(self):
        graph, values = self.start()
        for k in range(1, self.count):
            more, new, factor = self.step(k, values.atPose3(X(k - 1)))
            graph.push_back(more)
            graph.push_back(factor)
            values.insert(new)
        return graph, values


@pytest.fixture(scope="module")
def survey():
    return Survey()


@pytest.fixture(scope="module")
def batch(survey):
    """The solution by Python factors and Levenberg–Marquardt, and its covariance of A and h."""
    graph, values = survey.python_graph()
    solution = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    marginals = gtsam.Marginals(graph, solution)
    joint = marginals.jointMarginalCovariance([A(0), H(0)])
    return solution, joint.fullMatrix()


def calibration(values):
    return np.concatenate([values.atVector(A(0)), values.atPoint3(H(0))])


def distance(values, batch):
    """Largest difference from the batch, in its standard deviations."""
    solution, covariance = batch
    return np.abs((calibration(values) - calibration(solution)) / np.sqrt(np.diag(covariance))).max()


def test_batch_finds_the_truth(survey, batch):
    solution, covariance = batch
    truth, field = survey.simulation.truth, survey.simulation.field
    scale = truth.field_strength / np.linalg.norm(field)
    error = calibration(solution) - np.r_[vech(truth.soft_iron) * scale, truth.hard_iron / 50e-6]
    assert error @ np.linalg.solve(covariance, error) < 27.9  # χ² of 9, 99.9 %
    assert np.linalg.norm(error) < 0.1 * np.linalg.norm(calibration(solution) - np.r_[IDENTITY, 0, 0, 0])


def test_levenberg_marquardt_over_native_factors(survey, batch):
    native = NativeFactors(tolerance=0.01)
    graph, values = native.solve(*survey.python_graph(), examine=True)
    assert native.replaced > 0
    assert native.health.status == "consistent"
    assert len(native.fits) == survey.count - 1
    assert distance(values, batch) < 0.02
    covariance = gtsam.Marginals(graph, values).jointMarginalCovariance([A(0), H(0)]).fullMatrix()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(batch[1])), rtol=0.01)


@pytest.mark.parametrize("factorization", ["CHOLESKY", "QR"])
@pytest.mark.parametrize(
    "method", [gtsam.ISAM2GaussNewtonParams, gtsam.ISAM2DoglegParams], ids=["Gauss-Newton", "Dogleg"]
)
def test_isam2_with_native_factors(survey, batch, method, factorization):
    parameters = gtsam.ISAM2Params()
    parameters.setOptimizationParams(method())
    parameters.setFactorization(factorization)
    parameters.setRelinearizeThreshold(0.01)
    parameters.relinearizeSkip = 1
    isam, native = gtsam.ISAM2(parameters), NativeFactors(tolerance=0.02)
    isam.update(*survey.start())
    for k in range(1, survey.count):
        graph, new, factor = survey.step(k, isam.calculateEstimatePose3(X(k - 1)))
        graph.push_back(factor)
        native.update(isam, graph, new)
    assert native.settle(isam) < 10
    assert native.health.status == "consistent"
    assert native.replaced > 0
    assert distance(isam.calculateEstimate(), batch) < 0.05
    sigma = np.sqrt(np.diag(isam.marginalCovariance(H(0))))
    np.testing.assert_allclose(sigma, np.sqrt(np.diag(batch[1]))[6:], rtol=0.03)


def test_isam2_with_python_factors(survey, batch):
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.01)
    isam = gtsam.ISAM2(parameters)
    isam.update(*survey.start())
    for k in range(1, survey.count):
        graph, new, factor = survey.step(k, isam.calculateEstimatePose3(X(k - 1)))
        graph.push_back(factor)
        isam.update(graph, new)
    isam.update()
    assert distance(isam.calculateEstimate(), batch) < 0.05


@pytest.mark.parametrize("native", [True, False], ids=["native", "python"])
@pytest.mark.parametrize("smoother", ["incremental", "batch"])
def test_fixed_lag_smoothers(survey, batch, smoother, native):
    """A lag of 20 keyframes; the calibration stays in it by a fresh time stamp at each update."""
    if smoother == "incremental":
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(0.01)
        solver = gtsam.IncrementalFixedLagSmoother(20.0, parameters)
    else:
        solver = gtsam.BatchFixedLagSmoother(20.0)
    kept = NativeFactors()
    graph, values = survey.start()
    kept.update(solver, graph, values, {X(0): 0.0, A(0): 0.0, H(0): 0.0})
    for k in range(1, survey.count):
        graph, new, factor = survey.step(k, solver.calculateEstimatePose3(X(k - 1)))
        graph.push_back(factor)
        stamps = {X(k): float(k), A(0): float(k), H(0): float(k)}
        if native:
            kept.update(solver, graph, new, stamps)
        else:
            solver.update(graph, new, stamps)
    if native:  # the settling forgets blocks that have left the lag since the last update
        kept.update(solver, gtsam.NonlinearFactorGraph(), None, dict.fromkeys(stamps, survey.count + 18.0))
        assert not solver.calculateEstimate().exists(X(survey.count - 3))
        kept.settle(solver)
    found = solver.calculateEstimate()
    assert not found.exists(X(10))
    # What left the lag early was linearised far from the truth, native ones at once: within these sigmas.
    assert distance(found, batch) < 3.0


def test_nodes_joined_by_a_walk_too_small_to_matter_are_one_node(survey, batch):
    graph, values = survey.start()
    for k in range(1, survey.count):
        more, new, _ = survey.step(k, values.atPose3(X(k - 1)))
        node = k // 15
        if k % 15 == 0:
            graph.push_back(soft_iron_walk(A(node - 1), A(node), 15.0, 1e-3))
            graph.push_back(hard_iron_walk(H(node - 1), H(node), 15.0, 0.05e-6, field_unit=50e-6))
            new.insert(A(node), IDENTITY)
            new.insert(H(node), np.zeros(3))
        values.insert(new)
        graph.push_back(more)
        graph.push_back(
            keyframe_field_factor(
                X(k), A(node), H(node), survey.blocks[k - 1], 1e-6, field=survey.simulation.field, field_unit=50e-6
            )
        )
    assert distance(gtsam.LevenbergMarquardtOptimizer(graph, values).optimize(), batch) < 0.2


def test_what_a_solver_needs_is_said(survey):
    graph, values = survey.start()
    with pytest.raises(
        MagycError, match="new keys without a time stamp, .*first; a fixed-lag smoother needs `times"
    ):
        NativeFactors().update(gtsam.BatchFixedLagSmoother(20.0), graph, values)
    with pytest.raises(MagycError, match="solver is a NonlinearFactorGraph; accepted: ISAM2"):
        NativeFactors().update(graph, graph, values)


def test_calibration_prior_carries_all_correlations(batch):
    solution, covariance = batch
    unit = np.r_[np.ones(6), np.full(3, 50e-6)]
    soft_iron, hard_iron = unvech(solution.atVector(A(0))), solution.atPoint3(H(0)) * 50e-6
    prior = calibration_prior(
        A(0), H(0), soft_iron, hard_iron, covariance * unit * unit[:, None], field_unit=50e-6
    )
    values, step = gtsam.Values(), np.linspace(-0.01, 0.02, 9)
    values.insert(A(0), solution.atVector(A(0)) + step[:6])
    values.insert(H(0), solution.atPoint3(H(0)) + step[6:])
    assert prior.error(values) == pytest.approx(0.5 * step @ np.linalg.solve(covariance, step), rel=1e-6)


def test_the_field_chains_marginal_is_a_native_prior(survey):
    """A log's chain, linearised at the truth: the quadratic has the chain's cost and information there."""
    recording, truth = survey.simulation.recording, survey.simulation.truth
    strength = float(np.linalg.norm(survey.simulation.field))
    chain = field_chain_factor(
        A(0),
        H(0),
        B(0),
        Preintegration(*recording.magnetometer, *recording.gyroscope),
        SensorNoise(1e-6, 5e-3),
        soft_iron_unit=strength,
    )
    values = gtsam.Values()
    values.insert(A(0), vech(truth.soft_iron) * truth.field_strength / strength)
    values.insert(H(0), truth.hard_iron * 1e6)
    values.insert(B(0), np.asarray(truth.gyro_bias))
    native = native_factor(chain, values)
    assert native.error(values) == pytest.approx(chain.error(values), rel=1e-6)
    near = gtsam.Values(values)
    near.update(H(0), truth.hard_iron * 1e6 + 0.05)
    assert native.error(near) - native.error(values) == pytest.approx(
        chain.error(near) - chain.error(values), rel=0.05
    )
