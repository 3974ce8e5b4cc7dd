"""The verdict of a gap that is judged on another recording: the correction and the noise are two statements."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.foreign_text import MOST_WORDS, cause_and_action
from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.evidence.posterior import UNKNOWN
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.outcome.agreement import GapMap, Metrics, OpenLoop
from magyc_gtsam.gap.outcome.doubt import left_open
from magyc_gtsam.gap.outcome.unsure import doubt_whether, in_brief
from magyc_gtsam.gap.outcome.verdict import manoeuvre
from magyc_gtsam.gap.result import Effect, Gap, Hypothesis, Manoeuvre, Status
from magyc_gtsam.report.gap_page import render_gap
from magyc_gtsam.report.gap_verdict import Validation, as_judged, judged_gap
from magyc_gtsam.simulation.sensor import Simulation
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.scoring import score
from magyc_gtsam.study.faults.signals import record

CALIBRATION = Calibration(np.eye(3), np.zeros(3), np.zeros(3), np.eye(12) * 1e-14, field_strength=50e-6)


def metrics(held_out: float, rms: float, level: float = 1.0) -> Metrics:
    """Of a prediction off by `rms` T, with innovations of `level` sigmas over time."""
    loop = OpenLoop(20.0, np.arange(9.0), np.full((9, 3), rms), np.full((9, 3), 1e-7), rms, 1e-7)
    over = GapMap("time", "s", np.arange(9.0), np.full(9, level), np.ones((9, 2)), np.full(9, 1 / 9))
    return Metrics(held_out, loop, 1.0, (), None, {}, (over,))


def closed() -> Gap:
    before, after = metrics(10.0, 2e-6), metrics(12.0, 5e-7)
    return Gap("closed", "the magnetometer is late", (), (), (), before, after, (), CALIBRATION, CALIBRATION)


def test_a_correction_that_helps_on_a_noisier_log_holds() -> None:
    """The likelihood falls by the noise alone; the prediction gets better."""
    validation = Validation("other.mcap", 60e-6, metrics(9.0, 2e-6), metrics(8.0, 6e-7, level=2.0))
    verdict = judged_gap(closed(), validation)
    assert verdict.trusted
    assert verdict.title == "Gap found and closed"
    assert "The noise level differs on other.mcap: 2.0 times that of this log." in verdict.details


def test_a_correction_that_does_not_help_is_the_banner() -> None:
    validation = Validation("other.mcap", 60e-6, metrics(9.0, 2e-6), metrics(8.0, 2.1e-6))
    verdict = judged_gap(closed(), validation)
    assert not verdict.trusted
    assert verdict.title == "The result does not hold on other.mcap"
    assert verdict.sentence.startswith("✘ The result does not hold on other.mcap: ")
    assert not [detail for detail in verdict.details if "noise level" in detail]
    assert any("Gap found and closed" in detail for detail in verdict.details)
    judged = as_judged(closed(), verdict)
    assert not judged.calibration.trusted
    with pytest.raises(mg.MagycError, match=r"does not hold on other\.mcap"):
        judged.calibration.export("px4")
    shown = replace(judged, diagnostics={"left_out": ()})
    page = render_gap(mg.simulate("wide", 20).recording, shown, validation, verdict)
    assert "Use the correction on this log only, with <code>magyc-gtsam apply --force</code>." in page
    assert "Do not use this calibration" not in page
    assert "Use the correction only after" not in page
    assert "rms per axis; " in page


def test_cause_and_action_are_thirty_words_at_most() -> None:
    """Whatever was named, and whatever is left beside it."""
    places = [
        "the rate of turn, on the gyroscope",
        "a lag that depends on the rate of turn",
        "products of rates of turn, on the gyroscope",
        "the channel temperature times the field",
    ]
    effects = {name: effect(name) for name in TERMS}
    for name, one in effects.items():
        motion = Manoeuvre((name,), TERMS[name].motion, "")
        doubts = [left_open((one,), [0], "", motion), left_open((one, one), [0, 1], "", motion)]
        doubts += [
            left_open((one, one), (), f"something that lives in {place} is missing", motion) for place in places
        ]
        doubts += [left_open((one,), (), f"something like “{LABELS[name]}, times the reading” is missing", motion)]
        for doubt in doubts:
            assert len(doubt.sentence.split()) <= MOST_WORDS, doubt.sentence
        for some in ([one], [one] * 3, list(effects.values())):
            gap = replace(closed(), effects=tuple(some))
            assert len(judged_gap(gap).reason.split()) <= MOST_WORDS


def test_doubts_about_several_effects_are_thirty_words_at_most() -> None:
    for first, second in permutations(TERMS, 2):
        unsure = {first: 0.64, second: 0.15, UNKNOWN: 0.1}
        doubts = [doubt_whether(unsure), doubt_whether({UNKNOWN: 0.7, first: 0.2})]
        doubts += [left_open((effect(first),) * n, (), in_brief(unsure), None) for n in (1, 2)]
        assert all(len(doubt.sentence.split()) <= MOST_WORDS for doubt in doubts), doubts
        assert all(LABELS[first] in doubt.cause for doubt in doubts)


def effect(name: str) -> Effect:
    setting = {"time": 41.0, "time_sigma": 1.0}
    value = np.array([0.5, 0.25, 0.125])
    return Effect(
        name, LABELS[name], value, value / 9, ("x", "y", "z"), "µT", setting, (), 9.0, True, "word " * 40
    )


def test_without_another_log_the_gap_speaks_for_itself() -> None:
    verdict = judged_gap(closed())
    assert verdict.sentence == "✔ Gap found and closed: the magnetometer is late"
    unjudged = judged_gap(closed(), None, "brief.mcap: 2 windows")
    assert not unjudged.trusted
    assert unjudged.title == "The result could not be judged on the other log"


def _unsure(name: str, power: float) -> Hypothesis:
    one = np.ones(1)
    status: Status = "not enough information"
    return Hypothesis(name, name, False, 0.0, False, 1, one, one, "", {}, power, 1.0, 0.01, status, "")


def test_the_next_manoeuvre_is_one_that_helps() -> None:
    """For what is missing, its channels; else the motion for the effect that is hardest to see, unless of a moment."""
    twin = base_model(recording := mg.simulate("wide", 60).recording, None, short_term_noise(recording)).twin
    unsure = [
        _unsure("local-anomaly", 0.0),
        _unsure("timing", 0.5),
        _unsure("cubic", 0.1),
        _unsure("tone", np.nan),
    ]
    lost = manoeuvre(unsure, twin, (), ["field:quadratic"], ())
    assert lost is not None
    assert "every channel logged" in lost.sentence
    seen = manoeuvre(unsure, twin, (), [], ())
    assert seen is not None
    assert seen.separates == ("cubic", "timing")
    assert seen.motion == TERMS["cubic"].motion
    assert manoeuvre(unsure[:1], twin, (), [], ()) is None


def _put_down(simulation: Simulation, field: np.ndarray, change: np.ndarray) -> mg.Recording:
    """The recording with another field (n, 3), then eight seconds of rest in one that differs by `change`, T."""
    random, recording = np.random.default_rng(0), simulation.recording
    time = np.append(recording.time, recording.time[-1] + 0.1 * np.arange(1, 81))
    rest = field[-1] + change + 1e-6 * random.standard_normal((80, 3))
    rate = simulation.truth.gyro_bias + 5e-3 * random.standard_normal((80, 3))
    return mg.Recording(time, np.concatenate([field, rest]), np.concatenate([recording.angular_rate, rate]))


def test_a_vehicle_that_is_put_down_comes_to_another_place() -> None:
    """Its field changes while the vehicle moves; at rest it is a magnet that is attached."""
    simulation = mg.simulate("wide", 120, seed=7)
    change, field = np.array([4e-6, -3e-6, 5e-6]), simulation.recording.magnetic_field
    names = ["hard-iron-step", "local-anomaly"]
    to_sensor = Rotation.from_quat(simulation.recording.attitude).inv()
    near = to_sensor.apply(change) * (simulation.recording.time > 118)[:, None]  # while it still turns
    recording = _put_down(simulation, field + near, np.zeros(3))
    put_down = mg.find_gap(recording, candidates=names)
    assert [effect.name for effect in put_down.effects] == ["local-anomaly"]
    assert put_down.calibration.trusted, put_down.calibration.message
    twin = base_model(recording, None, short_term_noise(recording)).twin
    stays = [each for each in TERMS["local-anomaly"].settings(twin) if "width" not in each]
    times = [each["time"] for each in stays if "time" in each]
    assert 100 < max(times) < 121  # not at rest, where an iron was attached or nothing changed


def test_a_jump_after_which_the_vehicle_rests_may_be_of_the_place() -> None:
    """As where a recording is not stopped before the vehicle is put on a table; what is taken off again is no doubt."""
    simulation = mg.simulate("wide", 120, seed=4)
    change, field = np.array([4e-6, -3e-6, 5e-6]), simulation.recording.magnetic_field
    gap = mg.find_gap(_put_down(simulation, field, change), candidates=["hard-iron-step"])
    assert [effect.name for effect in gap.effects] == ["hard-iron-step"]
    assert not gap.calibration.trusted
    assert "or the field of the place changed" in gap.calibration.message
    assert gap.doubt is not None
    assert gap.doubt.action == "turn a full circle after it, or choose an interval without it (start=, end=)"
    carried = field + change * (simulation.recording.time > 40)[:, None]
    taken_off = mg.find_gap(_put_down(simulation, carried, -change), candidates=["hard-iron-step"])
    assert [effect.name for effect in taken_off.effects] == ["hard-iron-step", "hard-iron-step"]
    assert taken_off.calibration.trusted, taken_off.calibration.message


def test_a_mirrored_field_is_turned_back() -> None:
    """A stay beside steel whose field is as large as the horizontal one: the heading was 180° off."""
    fault = FAULTS["stay-beside-steel"]
    log = record("moderate", 35067, fault, fault.strong, "stay-beside-steel")
    calibration = mg.find_gap(log.recording("steel"), candidates=["local-anomaly"]).calibration
    result = score(calibration, "", log.body_R_sensor, float(log.field_time[-1]))
    assert (np.linalg.eigvalsh(calibration.soft_iron) > 0).all()
    assert result.outcome == "right and trusted"
    assert result.heading < 0.5


def test_the_world_beside_steel_does_not_drift_with_the_gyroscope() -> None:
    """Beside 20 µT for four minutes: the refit converged seldom, and the corrected strength varied by 0.6 µT."""
    fault = FAULTS["stay-beside-steel"]
    log = record("wide", 35068, fault, fault.strong, "stay-beside-steel").recording("steel")
    gap = mg.find_gap(log, candidates=["local-anomaly"])
    assert gap.calibration.trusted, gap.calibration.message
    assert gap.names == ("local-anomaly",)
    strength = np.linalg.norm(gap.calibration.apply(log), axis=1)
    minutes = strength[: len(strength) // 600 * 600].reshape(-1, 600).mean(axis=1)
    assert np.ptp(minutes) < 0.2e-6


def test_a_verdict_is_not_cut_within_a_clause() -> None:
    """It ended with "pitch or roll by 20° or more …"; the cause gives way, which the details have in full."""
    cause = "the reading's error follows pitch and roll, by an unknown amount, "
    cause += "which may move the soft iron along z by ±12 %"
    remedy = "pitch or roll by 20° or more while turning"
    assert cause_and_action(f"{cause} (limit 10): {remedy}") == (cause.rpartition(", ")[0], remedy)
    assert cause_and_action(f"hard iron ±1.3 µT (limit 2.2): {remedy}") == (
        "hard iron ±1.3 µT (limit 2.2)",
        remedy,
    )
    words = " ".join(["word"] * 40)
    assert cause_and_action(f"short: {words}") == ("short", " ".join(["word"] * 28) + " …")  # of a single clause


def test_sizes_in_the_headline_are_those_of_the_details() -> None:
    """It said "unequal delays (67 ms)", the norm, of delays of 39, 50 and 20 ms."""
    values = np.array([39.0, -50.0, 20.0])
    delays = Effect(
        "axis-delays", "unequal delays", values, values / 9, tuple("xyz"), "ms", {}, (), 9.0, True, "late"
    )
    other = replace(delays, name="iron", label="iron", value=values / 1e3, unit="µT")
    gap = replace(closed(), effects=(delays, other))
    assert judged_gap(gap).sentence == "✔ Gap found and closed: unequal delays (50 ms), iron (0.05 µT)"
    passed = {"time": 39.0, "width": 0.43, "passing": 1.0}
    assert "(0.43 s wide, " in TERMS["local-anomaly"].say(np.ones(6), np.ones(6), passed)
