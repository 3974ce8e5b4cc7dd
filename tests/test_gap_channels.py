"""The gap workflow's channels: what agrees by chance is no name, what hardly moves the iron leaves it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.blindtest.generator import generate
from magyc_gtsam.blindtest.scenarios import Scenario
from magyc_gtsam.gap import isolability
from magyc_gtsam.gap.outcome.corrected import unmoved
from magyc_gtsam.gap.result import Gap, Isolability
from magyc_gtsam.recording import Array
from magyc_gtsam.recording.checks import no_values
from magyc_gtsam.simulation.environment import CHANNELS

TERMS_OF_CHANNELS = [
    "motor-current",
    "current-squared",
    "temperature-hard-iron",
    "temperature-gain",
    "load-soft-iron",
    "temperature-gyro",
    "field-gradient",
]
_DEPTH = "depth"


def _wandering(seed: int, count: int) -> Array:
    """(count,) a slow signal of unit deviation that comes of nothing here."""
    steps = np.random.default_rng(seed).standard_normal(count)
    walk = np.cumsum(steps - steps.mean())
    result: Array = (walk - walk.mean()) / walk.std()
    return result


def _in_a_room(seed: int, depth: Array | None = None) -> mg.Recording:
    """A room whose field grows by 2 % along a way that a wandering vehicle takes; `depth` may be another way."""
    simulation = mg.simulate("wide", 200, seed=seed)
    recording, iron = simulation.recording, simulation.truth.hard_iron
    way = _wandering(100 + seed, len(recording.time))
    field = iron + (recording.magnetic_field - iron) * (1 + 0.02 * way[:, None])
    return replace(recording, magnetic_field=field, channels={_DEPTH: way if depth is None else depth})


def _standing(recording: mg.Recording) -> str:
    """Of the gradient among the hypotheses of a search for it and for a drift, which takes most of what is slow."""
    gap = mg.find_gap(recording, candidates=["field-gradient", "hard-iron-drift"])
    return next(h.status for h in gap.hypotheses if h.name == "field-gradient")


def test_what_was_passed_is_named_and_corrected_without_a_channel_that_it_resembles() -> None:
    """Depth and temperature are not in the log: they are named as well, but the form is that of something passed."""
    changes = ["local-anomaly", "hard-iron-step", "hard-iron-drift", *TERMS_OF_CHANNELS]
    hidden = Scenario("x", "single", "moderate", 2, (("local-anomaly", 2.0),), (), 200.0)
    recording = generate(hidden).recording
    kept = {k: v for k, v in recording.channels.items() if k.startswith("current")}
    assert 0 < len(kept) < len(recording.channels)
    gap = mg.find_gap(replace(recording, channels=kept), candidates=changes)
    (passed,) = gap.effects
    assert passed.name == "local-anomaly"
    assert passed.applied
    assert {"field-gradient", "temperature-hard-iron"} <= set(passed.ambiguous_with)


def test_a_stay_beside_steel_is_no_hard_iron_that_comes_and_goes() -> None:
    """Mostly vertical, which a vehicle that hardly tilts tells from one of its own by its soft iron and heading."""
    simulated = mg.simulate("moderate", duration=200, seed=2)
    recording, truth = simulated.recording, simulated.truth
    assert recording.attitude is not None
    beside = Rotation.from_quat(recording.attitude).inv().apply([1e-6, -1.5e-6, 5e-6]) @ truth.soft_iron
    stay = (recording.time > 60) & (recording.time <= 130)
    field = recording.magnetic_field + stay[:, None] * beside
    log = replace(recording, magnetic_field=field, attitude=None)
    gap = mg.find_gap(log, candidates=["hard-iron-step", "hard-iron-drift", "local-anomaly"])
    (found,) = gap.effects
    assert found.name == "local-anomaly"
    assert "was another one from 6" in found.sentence
    assert [found.setting["time"], found.setting["until"]] == pytest.approx([60, 130], abs=1)
    assert np.linalg.norm(found.value) == pytest.approx(np.sqrt(1 + 1.5**2 + 5**2), abs=0.5)
    assert gap.calibration.covariance is not None
    sigma = np.sqrt(np.diag(gap.calibration.covariance))[6:9]
    assert np.all(np.abs(gap.calibration.hard_iron - truth.hard_iron) < 3 * sigma)


def _without_channels(name: str, motion: str, strength: float = 1.0, duration: float = 300.0) -> Gap:
    hidden = Scenario("x", "single", motion, 2, ((name, strength),), (), duration)
    return mg.find_gap(replace(generate(hidden).recording, channels={}))


def test_what_a_missing_channel_did_changes_nothing() -> None:
    gap = _without_channels("motor-current", "multi")
    assert gap.verdict == "unknown"
    assert not gap.calibration.terms
    assert "motor-current" in {untested.name for untested in gap.untested}


@pytest.mark.parametrize(
    ("warms", "drifts", "strength", "duration"),
    [
        ("temperature-gyro", "gyro-bias-drift", 1.6, 120.0),
        ("temperature-hard-iron", "hard-iron-drift", 1.0, 300.0),
    ],
)
def test_what_warms_without_a_thermometer_is_a_drift_that_may_be_that(
    warms: str, drifts: str, strength: float, duration: float
) -> None:
    (effect,) = _without_channels(warms, "moderate", strength, duration).effects
    assert effect.name == drifts
    assert warms in effect.ambiguous_with


def test_a_channel_that_agrees_by_chance_is_no_name() -> None:
    """Of ways that have nothing to do with the field some explain much of it: that is the room's."""
    assert _standing(_in_a_room(1)) == "named"
    others = [_standing(_in_a_room(1, _wandering(200 + k, 2000))) for k in range(2)]
    assert not {"named", "ambiguous"}.intersection(others)


def test_what_hardly_moves_the_iron_leaves_it() -> None:
    """By 0.1 sigma it stays, terms and bias are the new ones; by one sigma all is new."""
    before = mg.calibrate(mg.simulate("wide", seed=1).recording)
    for share, stays in ((0.1, True), (1.0, False)):
        after = replace(
            before,
            soft_iron=before.soft_iron + share * before.sigma["soft_iron"],
            hard_iron=before.hard_iron + share * before.sigma["hard_iron"],
            gyro_bias=before.gyro_bias + 1e-3,
        )
        result = unmoved(before, after)
        expected = before if stays else after
        np.testing.assert_array_equal(result.soft_iron, expected.soft_iron)
        np.testing.assert_array_equal(result.hard_iron, expected.hard_iron)
        np.testing.assert_array_equal(result.gyro_bias, after.gyro_bias)


def _with_unit(recording: mg.Recording, scale: float, offset: float) -> mg.Recording:
    """With its channels in another unit, and an offset in their deviations."""
    channels = {k: scale * (v + offset * v.std(axis=0)) for k, v in recording.channels.items()}
    return replace(recording, channels=channels)


@pytest.mark.parametrize(
    ("name", "scale", "offset"),
    [
        ("motor-current", 1e-4, 1e3),
        ("temperature-hard-iron", 1e4, 0.0),
        ("field-gradient", 1e4, 0.0),
        ("temperature-gyro", 1e-4, 1e3),
    ],
)
def test_the_unit_of_a_channel_is_of_no_matter(name: str, scale: float, offset: float) -> None:
    """In thousands of it and far from 0, or in small counts: the same name, evidence, power and value."""
    recording = mg.simulate("wide", 120, seed=3, effects=[(name, 4.0)], channels=CHANNELS).recording
    plain = mg.find_gap(recording, candidates=[name])
    gap = mg.find_gap(_with_unit(recording, scale, offset), candidates=[name])
    assert gap.names == plain.names == (name,)
    np.testing.assert_allclose(gap.effects[0].value * scale, plain.effects[0].value, rtol=1e-4)
    np.testing.assert_allclose(gap.effects[0].sigma * scale, plain.effects[0].sigma, rtol=3e-3)
    mine, other = (next(h for h in g.hypotheses if h.name == name) for g in (gap, plain))
    assert mine.evidence == pytest.approx(other.evidence, rel=1e-4)
    assert mine.power == pytest.approx(other.power, abs=1e-3)
    assert mine.matters * scale == pytest.approx(other.matters, rel=1e-6)


@pytest.fixture(scope="module")
def current_logged() -> mg.Recording:
    return mg.simulate("wide", 200, seed=3, channels=["current"]).recording


@pytest.fixture(scope="module")
def isolable_current(current_logged: mg.Recording) -> Isolability:
    return next(row for row in isolability(current_logged) if row.name == "motor-current")


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_no_current_effect_is_rejected_in_any_unit(
    current_logged: mg.Recording, isolable_current: Isolability, scale: float
) -> None:
    recording, same = _with_unit(current_logged, scale, 0.0), isolable_current
    gap = mg.find_gap(recording, candidates=["motor-current"])
    assert gap.verdict == "none"
    assert next(h.status for h in gap.hypotheses if h.name == "motor-current") == "rejected"
    row = next(row for row in isolability(recording) if row.name == "motor-current")
    assert row.nameable == same.nameable
    assert row.smallest * scale == pytest.approx(same.smallest, rel=1e-3)
    assert 0.015 < same.smallest < 0.06


@pytest.mark.parametrize(("stand_in", "direct"), [(-99999.0, False), (1e30, True)])
def test_what_stands_for_no_value_hides_no_effect(stand_in: float, direct: bool) -> None:
    """Nor is it applied; the note says where it is. Direct, or in a stream that is interpolated."""
    recording = mg.simulate("wide", 200, seed=3, effects=["temperature-hard-iron"]).recording
    temperature = recording.channels["temperature"].copy()
    temperature[[700, 1200]] = stand_in
    if direct:
        spoilt = replace(recording, channels={"temperature": temperature})
    else:
        rate = recording.angular_rate
        assert rate is not None
        spoilt = mg.Recording.from_streams(
            (recording.time, recording.magnetic_field),
            (recording.time, rate),
            channels={"temperature": (recording.time[::2], temperature[::2])},
        )
    assert "channel 'temperature': 2 of" in spoilt.notes[-1]
    assert f"the first is {stand_in:g} in row {700 if direct else 350}" in spoilt.notes[-1]
    assert np.nanmax(np.abs(spoilt.channels["temperature"])) < 100
    gap = mg.find_gap(spoilt, candidates=["temperature-hard-iron"])
    assert gap.names == ("temperature-hard-iron",)
    corrected = gap.calibration.apply(spoilt)
    assert np.ptp(np.linalg.norm(corrected, axis=1)) < 0.3 * np.median(np.linalg.norm(corrected, axis=1))


@pytest.mark.parametrize(
    "name", ["on and off", "pulses", "surges", "dying away", "counts", "at full scale", "noise"]
)
def test_real_channels_hold_values_only(name: str) -> None:
    random, row = np.random.default_rng(0), np.arange(6000)
    noise = random.standard_normal(6000)
    column = {
        "on and off": np.where(row % 200 < 10, 10.0, 0.0),
        "pulses": np.where(row % 2000 < 5, 20.0, 0.0) + 2e-3 * noise,
        "surges": 2 + 0.05 * noise + np.where(row % 600 < 2, 80.0, 0.0),
        "dying away": 10 * np.exp(-(row % 3000) / 30),
        "counts": 32768 + np.round(20 * noise),
        "at full scale": np.clip(np.round(20000 * np.abs(noise)), 0, 32767),
        "noise": 1e3 * noise,
    }[name]
    assert not no_values(column).any()
    for stand_in in (-9999.0, 1e30, np.inf):
        spoilt = column.copy()
        spoilt[[7, 3000]] = stand_in
        expected = [7, 3000] if abs(stand_in) > 1e6 or name not in ("at full scale", "noise") else []
        assert np.flatnonzero(no_values(spoilt)).tolist() == expected


def test_the_lag_of_a_current_is_that_of_the_samples() -> None:
    """It is estimated on windows of a second."""
    base, random = mg.simulate("wide", 200, seed=1).recording, np.random.default_rng(1)
    current = 10.0 * np.repeat(random.integers(0, 4, 40), 50)[: len(base.time)]
    decay = np.exp(-0.1 / 2.0)
    late = lfilter([1 - decay], [1, -decay], current)
    added = late[:, None] * np.array([0.5e-7, -0.4e-7, 0.6e-7])
    recording = replace(base, magnetic_field=base.magnetic_field + added, channels={"current": current})
    gap = mg.find_gap(recording, candidates=["motor-current", "current-squared", "hard-iron-step"])
    (effect,) = gap.effects
    assert effect.name == "motor-current"
    assert effect.setting["lag"] == pytest.approx(2.0, abs=0.7)


@pytest.mark.parametrize(
    ("kind", "effect"),
    [("current", "motor-current"), ("temperature", "temperature-hard-iron"), ("depth", "field-gradient")],
)
def test_a_channel_whose_means_over_the_windows_are_equal_is_constant(kind: str, effect: str) -> None:
    """A relay that cycles at the sampling rate: nothing of it is left in a window."""
    recording = mg.simulate("wide", 120, seed=3).recording
    toggling = np.round(recording.time * 10) % 2
    gap = mg.find_gap(replace(recording, channels={kind: toggling}))
    assert "or it is constant" in next(untested.reason for untested in gap.untested if untested.name == effect)
