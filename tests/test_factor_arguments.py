"""Wrong arguments of the factors are named at once: kinds, keys, noise, units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.factors import (
    FieldLink,
    KeyframeBuffer,
    KeyframeField,
    MagycError,
    Preintegration,
    SensorNoise,
    calibration_prior,
    custom_factor,
    delay_prior,
    effect_chain_factor,
    effect_magnetometer_factor,
    field_chain_factor,
    field_link_factor,
    gyro_bias_walk,
    gyro_derivative_factor,
    hard_iron_walk,
    keyframe_field_factor,
    magnetometer_factor,
    mounting_prior,
    native_factor,
    preintegrate,
    robust_noise,
    scaled_magnetometer_factor,
    soft_iron_walk,
    sphere_factor,
    world_field_prior,
)
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.variables import vector
from magyc_gtsam.gap import term_factor

KEYS = [gtsam.symbol(c, 0) for c in "ahb"]
READING = np.array([10e-6, -30e-6, 25e-6])
WORLD = np.array([20e-6, 0.0, 40e-6])
TIME = 0.1 * np.arange(60)
RATE = np.column_stack([np.cos(TIME), np.sin(TIME), 0.5 * np.cos(2 * TIME)])
SAMPLES = Preintegration(TIME, 4e-5 * RATE, TIME, RATE)
NOISE = SensorNoise(1e-6, 5e-3)
LINK = FieldLink(np.eye(3), -np.eye(3), np.zeros(3), 0.01)
ROUND, SURE = np.eye(3), 1e-12 * np.eye(9)
COLUMNS = np.ones((3, 3, len(SAMPLES.starts)))
BLOCK = KeyframeField.from_samples((TIME, 4e-5 * RATE), (TIME, RATE), 3.0)


def magnetometer(noise: Any = 1e-6, **options: Any) -> Any:
    return magnetometer_factor(*KEYS, READING, noise, field=WORLD, **options)


def chain(samples: Any = SAMPLES, noise: Any = NOISE, **options: Any) -> Any:
    return field_chain_factor(*KEYS, samples, noise, **options)


def effects(samples: Any = SAMPLES, noise: Any = NOISE, **options: Any) -> Any:
    return effect_chain_factor(*KEYS, 7, samples, COLUMNS, noise, **options)


def link(noise: Any = 5e-3, given: Any = LINK) -> Any:
    return field_link_factor(*KEYS, given, noise)


def known(soft_iron: Any = ROUND, covariance: Any = SURE, **options: Any) -> Any:
    return calibration_prior(*KEYS[:2], soft_iron, np.zeros(3), covariance, **options)


def with_covariance() -> mg.Calibration:
    noise = {"magnetic_field": 1e-6, "angular_rate": 5e-3}
    return mg.Calibration(np.eye(3), np.zeros(3), np.zeros(3), field_strength=45e-6, noise=noise)


ONE_SKEW = np.eye(3) + np.diag([0.1], 2)
HOLE = np.diag([1.0, np.nan, 1.0])
CASES: dict[str, tuple[Callable[[Any], Any], tuple[Any, ...], str]] = {
    "magnetometer noise": (magnetometer, (None, "a", [1e-6] * 3, np.full(3, 1e-6), 0, np.nan), "noise of .* T; it"),
    "chain noise": (
        lambda sigma: chain(noise=SensorNoise(sigma, 5e-3)),
        (1.0, -1e-6, "a", 0, np.nan, None),
        "field chain: noise of .* T; it must be a number between 1 nT and 10 µT",
    ),
    "chain gyroscope noise": (
        lambda sigma: chain(noise=SensorNoise(1e-6, sigma)),
        (0, -1e-3, "a", np.nan, 30.0, None),
        "gyroscope",
    ),
    "effect chain noise": (lambda sigma: effects(noise=SensorNoise(sigma, 5e-3)), (1.0, 0, "a"), "effect chain: noise"),
    "noise of a chain": (lambda noise: chain(noise=noise), ((1e-6, 5e-3), 1e-6, None), "give SensorNoise"),
    "samples of a chain": (chain, (3, None, "a"), "field chain: `samples` is a .* give a Preintegration"),
    "samples of effects": (effects, (3, None), "effect chain: `samples` is a"),
    "readings of a chain": (
        lambda scale: chain(Preintegration(TIME, scale * RATE, TIME, RATE)),
        (45.0, 0.45),
        "below 10 mT",
    ),
    "rates of a chain": (lambda scale: chain(Preintegration(TIME, 4e-5 * RATE, TIME, scale * RATE)), (107.0,), "deg/s"),
    "delay of a chain": (lambda delay: chain(delay=delay), ("a", None, np.nan), "field chain: delay"),
    "delay of effects": (lambda delay: effects(delay=delay), ("a", None), "effect chain: delay"),
    "delay of a sample": (
        lambda delay: magnetometer(delay=delay, angular_rate=[0, 0, 1]),
        ("a", None, np.inf),
        "magnetometer: delay .*; it must be a finite number of s",
    ),
    "delay of a block": (
        lambda delay: KeyframeField.from_samples((TIME, 4e-5 * RATE), (TIME, RATE), 3.0, delay=delay),
        ("a", None),
        "keyframe field: delay",
    ),
    "noise of a block's gyroscope": (
        lambda sigma: keyframe_field_factor(*KEYS, BLOCK, 1e-6, field=WORLD, gyroscope_noise=sigma),
        ("a", None, np.nan, 30.0),
        "gyroscope noise of",
    ),
    "axes of a bias node": (
        lambda rotation: keyframe_field_factor(
            *KEYS, BLOCK, 1e-6, field=WORLD, gyro_bias_key=7, body_R_gyroscope=rotation
        ),
        (np.eye(3), gtsam.Pose3()),
        "keyframe field: body_R_gyroscope is a .*; give a gtsam",
    ),
    "axes of no bias node": (
        lambda rotation: keyframe_field_factor(*KEYS, BLOCK, 1e-6, field=WORLD, body_R_gyroscope=rotation),
        (gtsam.Rot3(),),
        "keyframe field: `body_R_gyroscope` without `gyro_bias_key`",
    ),
    "units of a chain": (lambda unit: chain(field_unit=unit), ("a", None, 0, -1e-6), "^field_unit"),
    "soft iron unit": (lambda unit: chain(soft_iron_unit=unit), ("a", 0), "^soft_iron_unit"),
    "unit of a world": (lambda unit: world_field_prior(1, WORLD, 1e-7, field_unit=unit), ("a", 0, -1.0), "^field_unit"),
    "unit of a walk": (lambda unit: hard_iron_walk(1, 2, 9.0, 1e-7, field_unit=unit), ("a", 0, -1.0), "^field_unit"),
    "unit of a prior": (lambda unit: known(field_unit=unit), ("a", 0), "^field_unit"),
    "link noise": (link, (None, "a", 30.0, 0, [1e-3] * 3), "gyroscope"),
    "link": (lambda given: link(given=given), (3, None), "field link: `link` is a .* what preintegrate returns"),
    "rates of a link": (lambda scale: preintegrate(TIME, scale * RATE, 1.0, 2.0), (107.0,), "field link: .* deg/s"),
    "start of a link": (lambda start: preintegrate(TIME, RATE, start, 2.0), (None, "a", np.nan), "link from .* both"),
    "end of a link": (lambda end: preintegrate(TIME, RATE, 1.0, end), (None, "a"), "link from .* both"),
    "rates of a derivative": (
        lambda scale: gyro_derivative_factor(*KEYS, RATE, RATE, scale * RATE, 1.0),
        (107.0,),
        "gyro derivative: .* deg/s",
    ),
    "reading beside an effect": (
        lambda scale: effect_magnetometer_factor(*KEYS, 7, scale * READING, np.ones((1, 3)), 1e-6, field=WORLD),
        (1e6,),
        "below 10 mT",
    ),
    "rotation": (
        lambda rotation: scaled_magnetometer_factor(*KEYS, READING, rotation, 1e-6),
        (np.eye(3), None),
        r"rotation is a .*; give a gtsam\.Rot3",
    ),
    "mounting": (lambda rotation: mounting_prior(1, rotation), (np.eye(3), 3), "body_R_sensor is a .*; give a gtsam"),
    "sigma of a mounting": (lambda sigma: mounting_prior(1, sigma=sigma), ("a", None, [0.1]), "of mounting prior; it"),
    "sigma of a world": (
        lambda sigma: world_field_prior(1, WORLD, sigma),
        ("a", None, [1e-7, 1e-7], ["a"] * 3, [1e-7, 1e-7, np.nan], 0.0),
        "world field prior: standard deviation",
    ),
    "sigma of a soft iron": (
        lambda sigma: soft_iron_walk(1, 2, 9.0, sigma),
        ("a", None, [1e-3] * 3, [1e-3] * 5 + ["a"], -1.0),
        "random walk per √hour: standard deviation",
    ),
    "sigma of a hard iron": (
        lambda sigma: hard_iron_walk(1, 2, 9.0, sigma),
        ("a", None, [1e-7] * 2, 0.0),
        "hard iron walk: standard deviation",
    ),
    "soft iron": (known, (ONE_SKEW, ONE_SKEW.T), "soft iron .* it must be symmetric"),
    "soft iron that is none": (known, (HOLE, "a", np.eye(2)), "calibration prior: soft iron"),
    "covariance": (lambda covariance: known(covariance=covariance), ("a", None, [["a"] * 9] * 9), "covariance"),
    "factor": (lambda factor: native_factor(factor, gtsam.Values()), (3, None), "native factor: `factor` is a"),
    "point": (lambda point: native_factor(link(), point), (3, None), "native factor: `point` is a"),
    "value of a key": (
        lambda key: native_factor(gtsam.PriorFactorDouble(key, 0.0, gtsam.noiseModel.Unit.Create(1)), gtsam.Values()),
        (KEYS[0],),
        "native factor: no value for a0",
    ),
    "triangle of a covariance": (
        lambda fill: known(covariance=1e-12 * fill(np.full((12, 12), 0.5) + 0.5 * np.eye(12))),
        (np.triu, np.tril),
        "calibration prior: a covariance that is not symmetric: .* in row 0, column 1, but .* fill both triangles",
    ),
    "unit of a covariance": (
        lambda sigma: known(covariance=np.diag(np.r_[np.full(6, 1e-6), np.full(3, sigma**2)])),
        (0.1, 1.0),
        "calibration prior: standard deviation of the hard iron: .* below 10 mT",
    ),
    "soft iron of no sensor": (
        known,
        (-np.eye(3), np.diag([1.0, 1.0, -1.0]), np.diag([1.0, 1.0, 0.0]), ROUND + 2 * (np.ones((3, 3)) - ROUND)),
        "calibration prior: soft iron with an eigenvalue of .*; it must be positive definite",
    ),
    "no rotation": (
        lambda diagonal: KeyframeBuffer(body_R_sensor=gtsam.Rot3(np.diag(diagonal))),
        ([1.0, 1.0, -1.0], [2.0, 1.0, 1.0], [1.0, 1.0, 0.99], [1.0, 1.0, np.nan]),
        r"body_R_sensor \[\[.*; it must be a rotation: .* gtsam\.Rot3\.ClosestTo",
    ),
    "unit in µT": (
        lambda unit: keyframe_field_factor(*KEYS, BLOCK, 1e-6, field=WORLD, field_unit=unit),
        (50, 50.0, 1e-15),
        "field_unit .*; it must be a number between 1e-12 and 1, in T per unit of the key",
    ),
    "degrees of a mounting": (
        lambda sigma: mounting_prior(1, sigma=sigma),
        (2, 3.0),
        "mounting prior: standard deviation of .* rad; it must be at most 1.571 rad; likely unit: degrees",
    ),
    "milliseconds of a delay": (
        lambda given: delay_prior(1, *given),
        ((20.0, 0.5), (-20.0, 0.5), (0.02, 5.0)),
        "delay prior: .* s; it must be at most .* s; likely unit: ms",
    ),
    "degrees of a bias": (
        lambda sigma: gyro_bias_walk(1, 2, 60.0, sigma),
        (500.0, [1e-3, 1e-3, 20.0]),
        "gyro bias walk of .* rad/s per √hour; it must be at most 10 rad/s per √hour; likely unit: deg",
    ),
    "nanoseconds of a walk": (
        lambda elapsed: hard_iron_walk(1, 2, elapsed, 1e-7),
        (60e9, 1.76e9),
        "random walk of .* s; it must be at most 1e[+]09 s; 32 years; likely in ns",
    ),
    "side": (lambda side: effects(side=side), (3, None, "left", ["left"]), "neither 'magnetometer' nor 'gyroscope'"),
    "shape": (lambda shape: sphere_factor(*KEYS, READING, 1.0, shape=shape), (["full"], 3), "shape .* unknown"),
    "kernel": (
        lambda robust: gyro_derivative_factor(*KEYS, RATE, RATE, RATE, 1.0, robust=robust),
        (["huber"], 3),
        "robust kernel .* unknown",
    ),
    "kernel of a noise": (lambda robust: robust_noise(robust, 1.0), (["huber"], None), "robust kernel .* unknown"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_argument_is_named(case: str) -> None:
    call, values, words = CASES[case]
    for value in values:
        with pytest.raises(MagycError, match=words):
            call(value)


def test_what_is_large_but_may_be_meant_is_taken() -> None:
    mounting_prior(1, sigma=np.pi / 2)
    delay_prior(1, -10.0, 1.0)
    gyro_bias_walk(1, 2, 1.0, 10.0)
    hard_iron_walk(1, 2, 1e9, 1e-7, field_unit=1.0)
    weak = np.diag(np.r_[np.ones(6), np.full(3, 1e-6)])
    weak[0, 1] = weak[1, 0] * (1 + 1e-6) + 1e-7  # a covariance from an inverse
    known(covariance=weak)
    KeyframeBuffer(body_R_sensor=gtsam.Rot3(np.round(gtsam.Rot3.RzRyRx(0.3, -0.4, 2.0).matrix(), 3)))


ON_ONE_KEY: dict[str, Callable[[Any], Any]] = {
    "world_field_prior": lambda key: world_field_prior(key, WORLD, 1e-7),
    "mounting_prior": mounting_prior,
    "delay_prior": delay_prior,
    "custom_factor": lambda key: custom_factor(
        "own", 1.0, [key], [vector(3)], 3, lambda x, want: (x, [np.eye(3)])
    ),
}
ON_TWO_KEYS: dict[str, Callable[[Any, Any], Any]] = {
    "soft_iron_walk": lambda a, b: soft_iron_walk(a, b, 9.0, 1e-3),
    "hard_iron_walk": lambda a, b: hard_iron_walk(a, b, 9.0, 1e-7),
    "gyro_bias_walk": lambda a, b: gyro_bias_walk(a, b, 9.0, 1e-4),
    "calibration_prior": lambda a, b: calibration_prior(a, b, np.eye(3), np.zeros(3), 1e-12 * np.eye(9)),
}


@pytest.mark.parametrize("key", ["a", -1, None, 1.5, 2**64, True, np.array([1, 2])])
def test_what_is_no_key_is_refused(key: Any) -> None:
    for one in ON_ONE_KEY.values():
        with pytest.raises(MagycError, match="is not a key"):
            one(key)
    for two in ON_TWO_KEYS.values():
        for pair in ((key, 3), (3, key)):
            with pytest.raises(MagycError, match="is not a key"):
                two(*pair)


def test_two_keys_are_two() -> None:
    for two in ON_TWO_KEYS.values():
        with pytest.raises(MagycError, match="both keys are the same|2 different keys"):
            two(3, np.int64(3))


def test_keys_may_be_integers_of_numpy_and_of_64_bits() -> None:
    largest = 2**64 - 1
    for one in ON_ONE_KEY.values():
        assert one(np.uint64(largest)).keys() == [largest]
    for two in ON_TWO_KEYS.values():
        assert two(np.int64(3), largest).keys() == [3, largest]


def test_term_factor_takes_one_key_of_any_integer_type_and_needs_a_term() -> None:
    recording = mg.Recording(TIME, 4e-5 * RATE, RATE)
    term = Term("hard-iron-step", [1e-6] * 3, 1e-14 * np.eye(3), {"time": 3.0})
    calibration = replace(with_covariance(), terms=(term,))
    for key in (7, np.int64(7), [np.int64(7)], np.array([7])):
        terms = term if np.ndim(key) == 0 else [term]
        assert term_factor(*KEYS, key, recording, calibration, terms).keys() == [*KEYS, 7]
    with pytest.raises(MagycError, match="at least one term is needed, got none"):
        term_factor(*KEYS, [], recording, calibration, [])


def test_a_soft_iron_is_symmetric_up_to_rounding() -> None:
    rounded = np.eye(3) + 1e-9 * np.arange(9).reshape(3, 3)
    assert known(rounded).keys() == KEYS[:2]
