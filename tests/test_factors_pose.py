"""Magnetometer on an attitude: agreement with GTSAM's own factors, Jacobians, priors and random walks."""

import gtsam
import numpy as np
import pytest
from test_factors_jacobians import derivative

from magyc_gtsam.factors import (
    MagycError,
    calibration_prior,
    delay_prior,
    gyro_bias_walk,
    hard_iron_walk,
    magnetometer_factor,
    mounting_prior,
    robust_noise,
    scaled_magnetometer_factor,
    soft_iron_walk,
    unvech,
    world_field_prior,
)

R, A, H, F, S, D, B, M, T = (gtsam.symbol(c, 0) for c in "rahfsdbmt")
FIELD = np.array([22.7, 5.2, 41.2])  # µT
MEASURED = np.array([10.0, -30.0, 25.0])
MOUNTING = gtsam.Rot3.RzRyRx(0.4, -0.2, 1.9)
ROTATION = gtsam.Rot3.RzRyRx(0.3, -0.4, 2.0)
UNIT = gtsam.noiseModel.Isotropic.Sigma(3, 0.7)
IDENTITY = np.array([1.0, 0, 0, 1, 0, 1])
ATTITUDES = {
    "Rot3": ROTATION,
    "Pose3": gtsam.Pose3(ROTATION, np.array([1.0, 2.0, 3.0])),
    "Rot2": gtsam.Rot2(0.8),
    "NavState": gtsam.NavState(ROTATION, np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3])),
    "Pose2": gtsam.Pose2(1.0, 2.0, 0.8),
}


def point(attitude="Pose3", soft_iron=(1.1, 0.1, -0.2, 0.9, 0.3, 1.2), hard_iron=(3.0, -7.0, 11.0)):
    values = gtsam.Values()
    values.insert(R, ATTITUDES[attitude])
    values.insert(A, np.array(soft_iron, dtype=float))
    values.insert(H, np.array(hard_iron))
    values.insert(F, FIELD + 1.0)
    values.insert(D, gtsam.Unit3(FIELD))
    values.insert(S, 47.0)
    values.insert(M, MOUNTING)
    values.insert(T, 0.03)
    return values


def jacobian_on(factor, values, key):
    """Whitened residual and Jacobian on one key, through the linearised factor."""
    jacobian, right = factor.linearize(values).jacobian()
    first, keys = 0, factor.keys()
    for k in keys:
        size = values.zeroVectors().at(k).size
        if k == key:
            return -right, jacobian[:, first : first + size]
        first += size
    raise AssertionError


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_agrees_with_gtsam_where_the_models_overlap(attitude):
    hard_iron, unit = np.array([3.0, -7.0, 11.0]), FIELD / np.linalg.norm(FIELD)
    strength = float(np.linalg.norm(FIELD))
    turn = np.eye(3)
    if attitude == "Rot3":
        theirs = gtsam.MagFactor1(R, MEASURED, strength, gtsam.Unit3(FIELD), hard_iron, UNIT)
    elif attitude in ("Rot2", "Pose2", "NavState"):
        if attitude != "Rot2":
            pytest.skip("GTSAM wraps no magnetometer on it")
        theirs = gtsam.MagFactor(R, MEASURED, strength, gtsam.Unit3(FIELD), hard_iron, UNIT)
    else:  # its residual is in the body frame, ours in the sensor's, where the soft iron is
        mounted = gtsam.Pose3(MOUNTING, np.zeros(3))
        theirs = gtsam.MagPoseFactorPose3(R, MEASURED, strength, unit, hard_iron, UNIT, mounted)
        turn = MOUNTING.matrix()
    ours = magnetometer_factor(
        R,
        A,
        H,
        MEASURED * 1e-6,
        0.7e-6,
        field=FIELD * 1e-6,
        body_R_sensor=MOUNTING if attitude == "Pose3" else None,
    )
    values = point(attitude, IDENTITY, hard_iron)
    residual, jacobian = jacobian_on(ours, values, R)
    their_jacobian, their_right = theirs.linearize(values).jacobian()
    np.testing.assert_allclose(turn @ residual, -their_right, rtol=0, atol=1e-9)
    np.testing.assert_allclose(turn @ jacobian, their_jacobian, rtol=0, atol=1e-9)


FACTORS = {
    "known field": lambda: magnetometer_factor(
        R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6, body_R_sensor=MOUNTING
    ),
    "unknown field": lambda: magnetometer_factor(
        R, A, H, MEASURED * 1e-6, 1e-6, field_key=F, body_R_sensor=MOUNTING
    ),
    "mounting and delay": lambda: magnetometer_factor(
        R, A, H, MEASURED * 1e-6, 1e-6, field_key=F, mounting_key=M, delay_key=T, angular_rate=[0.3, -0.8, 1.1]
    ),
    "another unit": lambda: magnetometer_factor(R, A, H, MEASURED * 1e-6, UNIT, field_key=F, field_unit=1e-3),
    "scaled": lambda: scaled_magnetometer_factor(D, S, H, MEASURED * 1e-6, ROTATION, 1e-6, body_R_sensor=MOUNTING),
}


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize("name", FACTORS)
def test_jacobian_is_the_derivative(name, attitude):
    factor, values = FACTORS[name](), point(attitude)
    jacobian, right = factor.linearize(values).jacobian()
    numeric = derivative(factor.whitenedError, values, factor.keys())
    np.testing.assert_allclose(-right, factor.whitenedError(values), atol=1e-12)
    np.testing.assert_allclose(jacobian, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())


def test_model_is_the_documented_one():
    values = point()
    soft_iron, hard_iron = unvech(values.atVector(A)), values.atPoint3(H)
    seen = MOUNTING.matrix().T @ ROTATION.matrix().T @ FIELD
    factor = magnetometer_factor(R, A, H, MEASURED * 1e-6, UNIT, field=FIELD * 1e-6, body_R_sensor=MOUNTING)
    expected = soft_iron @ seen + hard_iron - MEASURED
    np.testing.assert_allclose(factor.unwhitenedError(values), expected, atol=1e-12)


def test_scaled_factor_is_the_unscaled_one_at_its_scale():
    values = point("Rot3", IDENTITY)
    values.update(S, float(np.linalg.norm(FIELD)))
    plain = magnetometer_factor(R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6)
    scaled = scaled_magnetometer_factor(D, S, H, MEASURED * 1e-6, ROTATION, 1e-6)
    np.testing.assert_allclose(scaled.whitenedError(values), plain.whitenedError(values), atol=1e-12)


def test_robust_noise_weighs_the_sample():
    far = magnetometer_factor(R, A, H, MEASURED * 1e-6, robust_noise("cauchy", 1.0), field=FIELD * 1e-6)
    plain = magnetometer_factor(R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6)
    assert far.error(point()) < 0.1 * plain.error(point())


def test_world_field_prior_is_native_and_in_its_unit():
    prior, values = world_field_prior(F, FIELD * 1e-6, [0.2e-6, 0.2e-6, 0.4e-6]), point()
    assert isinstance(prior, gtsam.PriorFactorPoint3)
    np.testing.assert_allclose(prior.whitenedError(values), [5.0, 5.0, 2.5])


def test_random_walks_grow_with_the_square_root_of_time():
    values = gtsam.Values()
    for key, vector in ((0, IDENTITY), (1, IDENTITY + 1e-3), (2, np.zeros(3)), (3, np.full(3, 0.5))):
        values.insert(key, vector)
    np.testing.assert_allclose(soft_iron_walk(0, 1, 900.0, 1e-3).whitenedError(values), 2.0)  # σ/2 in a quarter
    np.testing.assert_allclose(hard_iron_walk(2, 3, 3600.0, 0.5e-6).whitenedError(values), 1.0)
    np.testing.assert_allclose(gyro_bias_walk(2, 3, 3600.0, [0.5, 1.0, 0.25]).whitenedError(values), [1, 0.5, 2])


@pytest.mark.parametrize(
    "call",
    [
        lambda: magnetometer_factor(R, A, H, MEASURED * 1e-6, 1e-6),
        lambda: magnetometer_factor(R, A, H, MEASURED * 1e-6, 1e-6, field_key=F, field=FIELD * 1e-6),
        lambda: magnetometer_factor(R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6, field_unit=0.0),
        lambda: magnetometer_factor(R, A, H, [1e-6, np.nan, 0.0], 1e-6, field=FIELD * 1e-6),
        lambda: scaled_magnetometer_factor(D, D, H, MEASURED * 1e-6, ROTATION, 1e-6),
        lambda: world_field_prior(F, FIELD, 0.1e-6),
        lambda: mounting_prior(M, sigma=0.0),
        lambda: delay_prior(T, np.nan),
        lambda: magnetometer_factor(R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6, delay_key=T),
        lambda: world_field_prior(F, FIELD * 1e-6, 0.0),
        lambda: soft_iron_walk(0, 1, 0.0, 1e-3),
        lambda: hard_iron_walk(0, 1, 10.0, -1.0),
        lambda: hard_iron_walk(0, 1, 10.0, 0.5),
        lambda: calibration_prior(0, 1, np.eye(3), [20.0, 0.0, 5.0], np.eye(9)),
        lambda: calibration_prior(0, 1, np.eye(3), np.zeros(3), None),
    ],
)
def test_wrong_arguments_are_refused(call):
    with pytest.raises(MagycError):
        call()


def test_a_key_of_another_type_is_named():
    values = point()
    factor = magnetometer_factor(A, R, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6)
    with pytest.raises(MagycError, match="a0 holds a vector; accepted: Pose3, Rot3, NavState, Pose2, Rot2"):
        factor.error(values)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"field": FIELD}, "8 and 175 µT; likely unit: µT"),
        ({"field": FIELD * 1e-2}, "likely unit: gauss"),
        ({"measurement": MEASURED}, "below 10 mT; likely unit: µT"),
        ({"noise": 1.0}, "1 nT and 10 µT; likely unit: µT"),
        ({"noise": 1e-10}, "between 1 nT"),
        ({"angular_rate": [90.0, 0, 0], "delay": 0.01}, "likely unit: deg/s"),
    ],
)
def test_units_are_checked(options, message):
    arguments = {"measurement": MEASURED * 1e-6, "noise": 1e-6, "field": FIELD * 1e-6} | options
    with pytest.raises(MagycError, match=message):
        magnetometer_factor(R, A, H, arguments.pop("measurement"), arguments.pop("noise"), **arguments)


def test_held_and_free_mounting_and_delay_are_the_same_model():
    values = point()
    rate = np.array([0.3, -0.8, 1.1])
    held = magnetometer_factor(
        R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6, body_R_sensor=MOUNTING, delay=0.03, angular_rate=rate
    )
    free = magnetometer_factor(
        R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6, mounting_key=M, delay_key=T, angular_rate=rate
    )
    np.testing.assert_allclose(free.whitenedError(values), held.whitenedError(values), atol=1e-12)
    earlier = values.atPose3(R).compose(gtsam.Pose3(gtsam.Rot3.Expmap(-0.03 * rate), np.zeros(3)))
    plain = magnetometer_factor(R, A, H, MEASURED * 1e-6, 1e-6, field=FIELD * 1e-6, body_R_sensor=MOUNTING)
    values.update(R, earlier)
    now = plain.whitenedError(values)
    np.testing.assert_allclose(now, held.whitenedError(point()), atol=1e-9)


def test_priors_hold_by_default():
    values = point()
    assert mounting_prior(M, MOUNTING).error(values) == pytest.approx(0.0, abs=1e-12)
    assert delay_prior(T, 0.02).error(values) == pytest.approx(0.5 * 1e8)
    assert delay_prior(T, 0.02, 0.01).error(values) == pytest.approx(0.5)
