"""The compiled passes over samples, and over what a calibration averages, give the numbers of numpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_compiled import both, close

import magyc_gtsam as mg
from magyc_gtsam.estimators.model_error import alternating, samples
from magyc_gtsam.estimators.model_error.components import log_likelihoods, principal
from magyc_gtsam.estimators.model_error.moments import averaged_moments, propagated
from magyc_gtsam.estimators.model_error.rest import moving
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.estimators.smoother.starts import from_gyroscope
from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.rate_columns import RateDerivatives
from magyc_gtsam.factors.chain.rotations import chained
from magyc_gtsam.factors.chain.turning import aligned, turn_rates
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.fingerprint import fingerprint
from magyc_gtsam.sensor_faults.screen import _seen
from magyc_gtsam.sensor_faults.spikes import _may_stand_out

pytestmark = pytest.mark.skipif(compiled.loops is None, reason="the inner loops were not compiled")


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Four minutes of wide motion."""
    return mg.simulate("wide", duration=240, seed=11).recording


@pytest.mark.parametrize("rounded", [0.0, 3e-7])
@pytest.mark.parametrize("rest", [0, 700])
def test_a_fingerprint_is_the_same(
    recording: Recording, rounded: float, rest: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of fine and of coarse readings, with a stretch that returns to the same few cells."""
    field = recording.magnetic_field.copy()
    field[:rest] = field[np.arange(rest) % 3]
    if rounded:
        field = np.round(field / rounded) * rounded
    log = Recording(time=recording.time, magnetic_field=field)
    fast, numpy = both(lambda: fingerprint(log), monkeypatch)
    assert fast == numpy
    assert len(fast) > 100


@pytest.mark.parametrize(
    "compute",
    [
        lambda log: short_term_noise(log),
        lambda log: samples._roughness(log.angular_rate),
        lambda log: np.concatenate(samples._beside_medians(log.magnetic_field)),
        lambda log: np.concatenate(alternating._of_blocks(log.magnetic_field, np.array([0, 64, 640]))),
        lambda log: from_gyroscope(preintegrate(log).integrate()),
    ],
)
def test_passes_over_samples(
    recording: Recording, compute: Callable[[Recording], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The noise by second differences, medians of five, alternations, and the linear start."""
    fast, numpy = both(lambda: compute(recording), monkeypatch)
    np.testing.assert_allclose(fast, numpy, rtol=1e-8)


@pytest.mark.parametrize("averaged", [False, True])
def test_what_an_error_of_the_rate_does(averaged: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """To windows and links, with samples of both sensors at different times."""
    log = mg.simulate("wide", duration=60, rate=50, seed=3, delay=0.013).recording
    samples = preintegrate(replace(log, angular_rate_is="interval-mean") if averaged else log)
    windows, random = samples.integrate(), np.random.default_rng(1)
    derivatives = RateDerivatives.of(samples, log.gyroscope.value.T, 0.004)
    error, direction = random.normal(size=(4, 3, len(log.time))), random.normal(size=(3, len(windows)))
    soft_iron = np.eye(3) + 0.1 * random.normal(size=(3, 3))
    fast, numpy = both(lambda: derivatives.columns(windows, soft_iron, direction, error), monkeypatch)
    for one, other in zip(fast, numpy, strict=True):
        close(one, other)


@pytest.mark.parametrize("height", [1.0, 1e3])
def test_the_screen_for_spikes(recording: Recording, height: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a spike and with one."""
    rate = recording.angular_rate.copy()  # type: ignore[union-attr]
    rate[777] *= height
    fast, numpy = both(lambda: _may_stand_out(rate), monkeypatch)
    assert fast is numpy is (height > 1)


def test_the_motion_at_windows(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rates of turn, the world in which the field has one direction, and windows at rest."""
    windows = preintegrate(recording).integrate()
    direction = np.random.default_rng(1).normal([1.0, 0.2, -0.5], 0.05, (len(windows), 3)).T
    direction /= np.linalg.norm(direction, axis=0)
    rates = both(lambda: turn_rates(windows.rotation, windows.rotation_rate, direction), monkeypatch)
    for one, other in zip(*rates, strict=True):
        close(one, other)
    drift = np.random.default_rng(2).normal(0, 1e-3, (len(windows) - 1, 3))
    close(*both(lambda: aligned(chained(drift), direction), monkeypatch))
    np.testing.assert_array_equal(*both(lambda: moving(windows.time, windows.rotation), monkeypatch))


def test_moments_of_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one column and of several, and what they move."""
    random = np.random.default_rng(3)
    roots = [random.normal(size=(k, k + 2)) for k in (1, 3, 18)]
    groups = [principal(root @ root.T, random.normal(size=len(root))) for root in roots]
    inputs = random.uniform(0.1, 2, (3, 3, 6))
    moves = [random.normal(size=(13, len(root))) for root in roots]
    fast, numpy = both(lambda: averaged_moments(groups, *inputs), monkeypatch)
    for one, other in zip(fast, numpy, strict=True):
        close(one, other)
    fast, numpy = both(lambda: propagated(moves, numpy), monkeypatch)
    for one, other in zip(fast, numpy, strict=True):
        close(one, other)


def test_likelihoods_of_amplitudes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of groups that explain little and more than all, with products beyond the range of numbers."""
    random = np.random.default_rng(5)
    roots = [random.normal(size=(k, k + 2)) * 1e9 for k in (1, 3, 18)]
    groups = [principal(root @ root.T, 1e9 * random.normal(size=len(root))) for root in roots]
    variance = np.geomspace(1e-24, 1e10, 48) * np.ones((3, 1))
    for one, other in zip(*both(lambda: log_likelihoods(groups, 5.0, 900.0, variance), monkeypatch), strict=True):
        close(one, other)


@pytest.mark.parametrize("seed", range(12))
def test_what_samples_have_that_faults_have(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of few and many coarse samples, with a stretch of one value and rows of zeros."""
    random = np.random.default_rng(seed)
    value = np.round(random.normal(size=(random.integers(3, 400), 3)), seed % 3)
    first, axis = random.integers(len(value), size=2)
    value[first : first + random.integers(40, 120), axis % 3] = 1.0
    if seed % 2:
        value[first] = 0.0
    fast, numpy = both(lambda: _seen(value), monkeypatch)
    assert fast == numpy
