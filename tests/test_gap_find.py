"""`find_gap` end to end, the effects written out here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import magyc_gtsam as mg
from magyc_gtsam.gap import isolability
from magyc_gtsam.gap.effects import LABELS, NAMES, TERMS
from magyc_gtsam.gap.evidence.posterior import NOTHING
from magyc_gtsam.gap.preparation.discrete import moving
from magyc_gtsam.gap.result import Gap
from magyc_gtsam.recording.turned import with_turned_gyroscope
from magyc_gtsam.report.gap_words import assumption_rows
from magyc_gtsam.simulation.environment import CHANNELS

OF_A_CHANNEL = (
    "motor-current",
    "current-squared",
    "temperature-hard-iron",
    "temperature-gain",
    "load-soft-iron",
    "temperature-gyro",
    "field-gradient",
)
CATALOGUE = [
    "motor-current",
    "current-squared",
    "temperature-hard-iron",
    "temperature-gain",
    "gain-drift",
    "load-soft-iron",
    "soft-iron-step",
    "gyro-bias-step",
    "gyro-bias-drift",
    "hard-iron-step",
    "hard-iron-drift",
    "misalignment",
    "timing",
    "axis-delays",
    "clock-drift",
    "eddy-plane",
    "gyro-scale",
    "gyro-quadratic",
    "temperature-gyro",
    "g-sensitivity",
    "field-gradient",
    "local-anomaly",
    "saturation",
    "cubic",
    "hysteresis",
    "coloured-noise",
    "spikes",
    "tone",
    "quantisation",
    "sample-hold",
    "axis-order",
]


def recording(seed: int = 0, motion: str = "wide", duration: float = 200.0, **sensor: float) -> mg.Recording:
    return mg.simulate(motion, duration, seed=seed, **sensor).recording


def with_field(base: mg.Recording, added: np.ndarray, **channels: np.ndarray) -> mg.Recording:
    return replace(base, magnetic_field=base.magnetic_field + added, channels={**base.channels, **channels})


@pytest.fixture(scope="module")
def late() -> mg.Recording:
    return recording(12, delay=0.08)


@pytest.fixture(scope="module")
def found_late(late: mg.Recording) -> Gap:
    return mg.find_gap(late)


def test_the_catalogue_is_complete() -> None:
    assert sorted(NAMES) == sorted(CATALOGUE)
    assert set(LABELS) == set(CATALOGUE)
    for term in TERMS.values():
        assert set(term.rivals) <= set(CATALOGUE)


def test_silent_where_nothing_is_hidden() -> None:
    gap = mg.find_gap(recording(11))
    assert gap.verdict == "none"
    assert gap.effects == ()
    assert gap.calibration.terms == ()
    assert gap.after is gap.before
    missing = {u.name for u in gap.untested}
    assert missing == set(OF_A_CHANNEL)
    assert gap.before.open_loop.rms == pytest.approx(gap.before.open_loop.floor, rel=0.1)
    assert {h.status for h in gap.hypotheses} <= {"rejected", "not enough information", "possible"}
    for each in gap.hypotheses:
        assert np.isfinite(each.evidence)
        assert np.isfinite([*each.expected, *each.sigma]).all()
        # Nothing is said of how large a family or an effect on the noise must be.
        assert np.isfinite([each.power, each.matters]).all() == (each.name in TERMS)


def test_a_late_magnetometer_is_found_with_its_delay_and_the_gap_shrinks(found_late: Gap) -> None:
    gap = found_late
    assert gap.verdict == "closed"
    assert gap.names == ("timing",)
    (effect,) = gap.effects
    assert effect.value[0] == pytest.approx(80, abs=4 * effect.sigma[0])
    assert effect.probability == gap.probabilities["timing"] > 0.9
    assert gap.probabilities[NOTHING] < 0.05
    assert "lags the gyroscope" in gap.sentence
    assert gap.calibration.delay == pytest.approx(effect.value[0] / 1e3)
    assert gap.after.open_loop.excess < 0.2 * gap.before.open_loop.excess
    assert gap.after.held_out > gap.before.held_out
    assert gap.after.heading is not None
    assert gap.before.heading is not None
    assert gap.after.heading < gap.before.heading


def test_a_current_needs_its_channel(tmp_path: Path) -> None:
    base = recording(13, duration=120)
    current = 4.0 * (np.sin(base.time / 13.0) > 0.2) + 0.3 * np.sin(2.1 * base.time)
    value = np.array([1e-7, -0.8e-7, 1.2e-7])
    candidates = ["motor-current", "hard-iron-step", "hard-iron-drift", "local-anomaly", "cubic"]
    gap = mg.find_gap(with_field(base, current[:, None] * value, current=current), candidates=candidates)
    assert gap.names == ("motor-current",)
    np.testing.assert_allclose(gap.effects[0].value, value * 1e6, atol=4 * gap.effects[0].sigma.max())
    # The term is saved with the calibration and applied to a recording that has the channel.
    gap.calibration.save(tmp_path / "cal.yaml")
    cal = mg.Calibration.load(tmp_path / "cal.yaml")
    other = recording(14, duration=120)
    both = with_field(other, current[:, None] * value, current=current)
    # A second after the current is switched they differ by what is not known of the field's lag.
    np.testing.assert_allclose(
        cal.apply(both), cal.apply(replace(other, channels={"current": 0 * current})), atol=5e-7
    )
    withheld = mg.find_gap(with_field(base, current[:, None] * value), candidates=candidates)
    assert "motor-current" in {u.name for u in withheld.untested}
    for effect in withheld.effects:
        assert "motor-current" in effect.ambiguous_with
    assert len(withheld.calibration.terms) == sum(effect.applied for effect in withheld.effects)


def test_two_steps_of_the_hard_iron_are_timed_and_sized() -> None:
    base = recording(15)
    jump = np.array([-2e-6, 1e-6, 4e-6])
    attached = (base.time > 60.0) & (base.time < 130.0)
    gap = mg.find_gap(with_field(base, attached[:, None] * jump))
    assert gap.names == ("hard-iron-step", "hard-iron-step")
    times = sorted(e.setting["time"] for e in gap.effects)
    np.testing.assert_allclose(times, [60.0, 130.0], atol=3.0)
    for effect in gap.effects:
        # Of these channels there is none; a bias that warms turns the field, it does not change it.
        assert effect.ambiguous_with == tuple(name for name in OF_A_CHANNEL if name != "temperature-gyro")
        sign = 1 if effect.setting["time"] < 100 else -1
        np.testing.assert_allclose(effect.value, sign * jump * 1e6, atol=5 * effect.sigma.max() + 0.1)


def test_exchanged_axes_are_named_first() -> None:
    base = recording(16)
    matrix = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    assert base.angular_rate is not None
    turned = with_turned_gyroscope(base, matrix)  # as read with gyroscope_axes="y,-x,z", which is wrong here
    gap = mg.find_gap(turned)
    assert gap.names == ("axis-order",)
    assert gap.verdict == "closed"
    np.testing.assert_array_equal(gap.effects[0].value.reshape(3, 3), matrix.T)
    assert gap.sentence.endswith("read the gyroscope as x ← x, y ← y, z ← z, without gyroscope_axes=")
    assert gap.calibration.configuration == gap.base.configuration == {"gyroscope_axes": "y,-x,z"}
    straight = mg.find_gap(base, candidates=["axis-order"])
    assert straight.base.gyro_bias is not None
    assert gap.calibration.gyro_bias is not None
    np.testing.assert_allclose(gap.calibration.hard_iron, straight.calibration.hard_iron, atol=5e-8)
    own = (yaml.safe_load(each.calibration.export("ros"))["/**"]["ros__parameters"] for each in (gap, straight))
    np.testing.assert_allclose(*(each["gyroscope_bias"] for each in own), atol=2e-5)


def test_what_is_in_no_catalogue_is_called_unknown_and_nothing_is_changed() -> None:
    """A magnet that a servo turns with the rudder, here with the product of two rates."""
    base = recording(17)
    assert base.angular_rate is not None
    product = base.angular_rate[:, 1] * base.angular_rate[:, 2]
    angle = 40.0 * product
    added = 1.5e-6 * np.stack([np.cos(angle) - 1, np.sin(angle), 0.3 * np.sin(2 * angle)], axis=1)
    gap = mg.find_gap(with_field(base, added))
    assert gap.verdict == "unknown"
    assert gap.effects == ()
    assert gap.calibration.terms == ()
    assert "nothing was changed" in gap.sentence


def test_candidates_restrict_the_names(late: mg.Recording) -> None:
    gap = mg.find_gap(late, candidates=["motor-current", "cubic"])
    assert "timing" not in gap.names
    with pytest.raises(mg.MagycError, match="candidates"):
        mg.find_gap(late, candidates=["gremlins"])


def test_a_calibration_with_the_effect_leaves_no_gap(late: mg.Recording, found_late: Gap) -> None:
    again = mg.find_gap(late, calibration=found_late.calibration)
    assert again.verdict == "none"


def test_the_users_simulator_is_compared() -> None:
    base = recording(18, delay=0.08, magnetometer_noise=1.5e-6)
    simulated = recording(19)
    gap = mg.find_gap(base, simulated=simulated, candidates=["timing", "misalignment", "gyro-scale"])
    rejected = {a.what for a in gap.assumptions if a.rejected}
    assert "magnetometer noise per sample" in rejected
    assert any("magnetometer delay" in what for what in rejected)
    assert not any(what.startswith("hard iron") for what in rejected)


SEARCHED = ["motor-current", "hard-iron-step", "spikes", "tone", "quantisation", "axis-order", "field-gradient"]


@pytest.mark.parametrize("effect", ["motor-current", "spikes", "tone", "axis-order"])
def test_what_the_users_simulator_lacks_is_said(effect: str) -> None:
    """Whatever was searched over to find it; and what the simulator alone has."""
    measured = mg.simulate("wide", 120, seed=5, channels=CHANNELS, effects=[(effect, 3.0)]).recording
    simulated = mg.simulate("wide", 90, seed=6, channels=("temperature",)).recording
    assumptions = mg.find_gap(measured, simulated=simulated, candidates=SEARCHED).assumptions
    lacking = [a for a in assumptions if a.sentence.startswith("the simulator lacks: ")]
    assert len(lacking) == 1
    assert lacking[0] is assumptions[0]
    assert lacking[0].rejected
    assert lacking[0].measured > 3 * lacking[0].sigma
    assert lacking[0].simulated == 0
    not_compared = {a.what for a in assumptions if not a.compared}
    current = {"magnetic field of a current"} - ({lacking[0].what})
    assert not_compared == {*current, "field strength that changes with depth or position"}
    if effect != "motor-current":
        return
    turned = mg.find_gap(simulated, simulated=measured, candidates=SEARCHED).assumptions
    (alone,) = (a for a in turned if "alone has" in a.sentence)
    assert alone.measured == 0
    assert alone.simulated == pytest.approx(lacking[0].measured, rel=0.05)


def test_that_something_without_a_name_is_missing_in_the_users_simulator() -> None:
    measured = mg.simulate("wide", 120, seed=5, effects=[("rate-product", 3.0)]).recording
    gap = mg.find_gap(measured, simulated=mg.simulate("wide", 90, seed=6).recording)
    assert gap.verdict == "unknown"
    first = gap.assumptions[0]
    assert first.rejected
    assert first.sentence == f"the simulator lacks: {gap.sentence}"
    assert next(row[1:] for row in assumption_rows(gap)) == ["0", f"{first.measured:.0f}", "rejected"]


def test_an_effect_in_data_and_simulator_is_compared_by_its_size() -> None:
    measured = mg.simulate("wide", 120, seed=5, effects=[("hard-iron-step", 4.0), ("timing", 3.0)]).recording
    simulated = mg.simulate("wide", 120, seed=6, effects=[("hard-iron-step", 2.0), ("timing", 3.0)]).recording
    candidates = ["hard-iron-step", "timing"]
    gap = mg.find_gap(measured, simulated=simulated, candidates=candidates)
    said = {a.what: a for a in gap.assumptions}
    assert said["jump of the hard iron"].rejected
    assert said["jump of the hard iron"].measured == pytest.approx(2.4, abs=0.2)
    assert said["jump of the hard iron"].simulated == pytest.approx(1.2, abs=0.2)
    assert not said["magnetometer delay"].rejected


def test_isolability_says_what_a_motion_can_tell() -> None:
    wide = {row.name: row for row in isolability(recording(20, duration=400))}
    level = {row.name: row for row in isolability(recording(20, "moderate", 400))}
    assert wide["misalignment"].smallest < 0.7 * level["misalignment"].smallest
    assert level["misalignment"].left < wide["misalignment"].left
    assert np.isinf(wide["motor-current"].smallest)
    # One sigma is 3.2 ms in such a recording, and the threshold of some hundred tests some four of them.
    assert 3 * 3.2 < wide["timing"].smallest < 8 * 3.2
    assert not wide["timing"].nameable
    assert "where 5 would matter; turn fast" in wide["timing"].sentence


def test_a_log_that_stands_still_is_refused_with_the_reason() -> None:
    base = recording(21)
    random = np.random.default_rng(21)
    still = replace(
        base,
        magnetic_field=base.magnetic_field[0] + 2e-7 * random.standard_normal((len(base.time), 3)),
        angular_rate=1e-3 * random.standard_normal((len(base.time), 3)),
        attitude=None,
    )
    # Three degrees to and fro about one axis are hardly more.
    nod = 0.05 * np.sin(0.5 * base.time)
    turn = np.zeros((len(base.time), 3))
    turn[:, 2] = nod
    nodding = replace(
        still,
        magnetic_field=still.magnetic_field + np.cross(still.magnetic_field, turn),
        angular_rate=still.angular_rate + np.gradient(turn, base.time, axis=0),
    )
    for log in (still, nodding):
        gap = mg.find_gap(log)
        assert gap.verdict == "not enough information"
        assert gap.sentence.startswith("not enough information: too little motion: ")
        assert "turn" in gap.sentence
        assert gap.names == ()
        assert gap.calibration.terms == ()
        assert not gap.calibration.converged
        assert gap.next_manoeuvre is not None


def test_a_rest_counts_for_what_it_says() -> None:
    """Another field where the sensor rests does not change the delay, and is seldom called iron that came."""
    stepped = 0
    for seed in (200, 201, 202, 203):
        base = recording(seed, duration=400, delay=0.04)
        rest = base.time > 300
        first = int(np.argmax(rest))
        assert base.angular_rate is not None
        random = np.random.default_rng(seed)
        field, rate = base.magnetic_field.copy(), base.angular_rate.copy()
        bias = mg.simulate("wide", duration=400, seed=seed).truth.gyro_bias
        assert bias is not None
        field[rest] = field[first] + [2e-6, -1e-6, 1e-6] + 3e-7 * random.standard_normal((rest.sum(), 3))
        rate[rest] = bias + 5e-3 * random.standard_normal((rest.sum(), 3))
        resting = replace(base, magnetic_field=field, angular_rate=rate, attitude=None)
        kept = moving(resting).magnetic_field_fresh
        assert kept[~rest].all()
        assert kept[rest].sum() == pytest.approx(100 / 5, abs=2)
        assert moving(base) is base
        gap = mg.find_gap(resting, candidates=["timing", "hard-iron-step", "hard-iron-drift", "local-anomaly"])
        stepped += "hard-iron-step" in gap.names
        (timing,) = (h for h in gap.hypotheses if h.name == "timing")
        assert timing.significant
        assert timing.expected[0] == pytest.approx(40, abs=4 * timing.sigma[0])
    assert stepped <= 1  # of four
    # Iron that comes while it rests is kept, and found.
    jump = np.where((base.time > 350)[:, None], [0.0, 3e-5, 0.0], 0.0)
    assert moving(replace(resting, magnetic_field=field + jump)).magnetic_field_fresh.all()
