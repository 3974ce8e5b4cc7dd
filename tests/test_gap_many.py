"""The gap across logs: one value everywhere is the instrument's, one in each log is of the place or the day."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.cli.gap_many import value_of
from magyc_gtsam.gap.many.find import find_gap_of_many
from magyc_gtsam.gap.many.model import MODEL
from magyc_gtsam.gap.many.one_log import Test as OneTest
from magyc_gtsam.gap.many.weighing import mixture, weigh
from magyc_gtsam.io import write_mcap
from magyc_gtsam.recording.applied import CALIBRATED, as_calibrated

LOGS = 10


def _tests(values: np.ndarray, sigma: float = 1.0) -> list[dict[str, tuple[OneTest, ...]]]:
    """One test of a log each, of estimates (logs, k) with a deviation."""
    return [
        {"misalignment": (OneTest.of("misalignment", {}, np.eye(3) / sigma**2, v / sigma**2, np.full(3, 0.5)),)}
        for v in values
    ]


def test_one_value_everywhere_is_the_instruments() -> None:
    random = np.random.default_rng(0)
    told, sure = [], []
    for _ in range(100):
        truth = random.normal(size=3)
        truth *= 2 / np.linalg.norm(truth)  # one log shows nothing of it
        weighed = weigh("misalignment", _tests(truth + random.normal(size=(LOGS, 3))))
        sure.append(weighed.nats > MODEL.sure)
        told.append(weighed.instrument > 0.5)
    assert np.mean(sure) > 0.9
    assert np.mean(np.array(told)[sure]) > 0.95
    assert np.abs(weighed.value - truth).max() < 4 / np.sqrt(LOGS)


def test_a_value_in_each_log_is_not() -> None:
    random = np.random.default_rng(1)
    for _ in range(50):
        weighed = weigh("misalignment", _tests(5 * random.normal(size=(LOGS, 3))))
        assert weighed.nats > MODEL.sure
        assert weighed.instrument < 0.05


def test_nothing_is_nothing() -> None:
    random = np.random.default_rng(2)
    nats = [weigh("misalignment", _tests(random.normal(size=(LOGS, 3)))).nats for _ in range(250)]
    assert np.mean(np.array(nats) > MODEL.sure) < 0.01


def test_what_one_log_has_on_its_own_is_told_from_what_all_have() -> None:
    values = np.random.default_rng(3).normal(size=(LOGS, 3))
    values[4] += 9.0
    weighed = weigh("misalignment", _tests(values))
    assert weighed.apart > weighed.shared
    assert weighed.present[4] > 0.95
    assert np.delete(weighed.present, 4).max() < 0.5


def test_a_few_of_many_logs_are_no_property_of_all() -> None:
    for count, everywhere in ((1, False), (10, True)):
        nats = np.full((1, 1, LOGS), -1.0)
        nats[..., :count] = 8.0
        total, present, share = mixture(nats)
        assert total > MODEL.sure or count == 1
        assert (share > 0.5) == everywhere
        assert (present[:count] > 0.9).all()
        assert (present[count:] < 0.5).all()


@pytest.fixture(scope="module")
def late() -> list[mg.Recording]:
    """Three logs of one instrument that is late by 20 ms."""
    return [
        replace(mg.simulate("wide", 150, 10, seed=seed, delay=0.02).recording, attitude=None, name=f"dive {seed}")
        for seed in range(3)
    ]


def test_many_logs_are_one_comparison(late: list[mg.Recording], tmp_path: Path) -> None:
    mute = replace(late[0], angular_rate=None, angular_rate_fresh=None, name="mute")
    gap = mg.find_gap([*late, mute])
    assert gap.verdict == "closed"
    (effect,) = gap.effects
    assert (effect.name, effect.of) == ("timing", "instrument")
    assert effect.value == pytest.approx(20.0, abs=4 * effect.sigma[0])
    assert [log.log for log in effect.logs] == ["dive 0", "dive 1", "dive 2"]
    assert [own.log for own in gap.own] == ["mute"]
    assert "in the instrument, the same in all logs" in gap.sentence
    stated = [1e3 * gap.calibrations[log.log].delay_sigma for log in effect.logs]  # with the model error
    assert [log.sigma[0] for log in effect.logs] == pytest.approx(stated)
    assert all(c.delay == pytest.approx(0.02, abs=0.02) for c in gap.calibrations.values())
    assert json.loads(json.dumps(gap.to_dict()))["effects"][0]["logs"][1]["log"] == "dive 1"


def test_rows_that_are_held_are_the_instruments() -> None:
    held = [
        replace(mg.simulate("wide", 100, 10, seed=seed, effects=["sample-hold"]).recording, attitude=None)
        for seed in range(2)
    ]
    gap = mg.find_gap(held, candidates=["sample-hold", "axis-order"])
    assert [(effect.name, effect.of) for effect in gap.effects] == [("sample-hold", "instrument")]
    first, second = gap.effects[0].logs
    assert [value_of(gap.effects[0], log.value, log.sigma) for log in (first, second)] == [
        f"{float(log.value[0]):.3g}" for log in (first, second)
    ]  # noise has no standard deviation in one log


def test_the_command_takes_many_logs(
    late: list[mg.Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for recording in late[:2]:
        write_mcap(tmp_path / f"{recording.name}.mcap", recording)
    (tmp_path / "bad.mcap").write_bytes(b"no log")
    output = tmp_path / "out"
    assert cli.main(["gap", str(tmp_path), "-o", str(output), "--candidates", "timing,misalignment", "-v"]) == 0
    assert "Log by log:" in (printed := capsys.readouterr().out)
    assert re.search(r"magnetometer delay +dive 1 +\S+ ± \S+ ms +\d+%", printed)
    told = json.loads((output / "gap.json").read_text(encoding="utf-8"))
    assert [effect["name"] for effect in told["effects"]] == ["timing"]
    assert [own["log"] for own in told["own"]] == ["bad"]
    assert "magnetometer delay" in (output / "report.html").read_text(encoding="utf-8")
    kept = mg.Calibration.load(output / "calibrations" / "dive 0.yaml")
    assert kept.delay == pytest.approx(0.02, abs=0.02)


def _of_another(seed: int) -> mg.Recording:
    """A log of another instrument that is late by 20 ms as well."""
    sensor = {"soft_iron": np.diag([0.95, 1.1, 1.0]), "hard_iron": np.array([-8e-6, 3e-6, 14e-6])}
    one = mg.simulate("wide", 150, 10, seed=seed, delay=0.02, gyro_bias=np.array([-0.01, 0.006, -0.004]), **sensor)
    return replace(one.recording, attitude=None, name=f"other {seed}")


def test_logs_of_two_instruments_have_no_effect_of_the_instrument(
    late: list[mg.Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [late[0], _of_another(5), late[1], _of_another(6)]
    gap = mg.find_gap(logs, candidates=["timing", "cubic"])
    assert (gap.effects, gap.calibrations) == ((), {})
    assert (
        "2 instruments (dive 0, dive 1; other 5, other 6): give the logs of one instrument alone" in gap.sentence
    )
    for recording in logs[:2]:
        write_mcap(tmp_path / f"{recording.name}.mcap", recording)
    assert cli.main(["gap", str(tmp_path), "-o", str(tmp_path / "out"), "--candidates", "timing"]) == 1
    told = capsys.readouterr()
    assert "the logs are of 2 instruments (dive 0; other 5)" in told.err
    assert "Other hypotheses" not in told.out


def test_a_single_log_of_another_instrument_is_left_out(late: list[mg.Recording]) -> None:
    gap = mg.find_gap([*late, _of_another(5)], candidates=["timing", "cubic"])
    assert [(own.log, "another instrument" in own.sentence) for own in gap.own] == [("other 5", True)]
    assert [log.log for log in gap.effects[0].logs] == ["dive 0", "dive 1", "dive 2"]
    assert gap.verdict == "closed"


def test_logs_of_one_instrument_with_a_scale_of_the_gyroscope_are_of_one() -> None:
    logs = [mg.simulate("wide", 150, seed=s, effects=["gyro-scale"], effects_seed=3).recording for s in (1, 2)]
    gap = mg.find_gap(logs, candidates=["gyro-scale"])
    assert [(effect.name, effect.of) for effect in gap.effects] == [("gyro-scale", "instrument")]
    assert gap.verdict == "closed"


def test_why_none_can_be_read_is_said_of_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one.mcap").write_bytes(b"no log")
    (tmp_path / "two.csv").write_text("time,nothing\n", encoding="utf-8")
    assert cli.main(["gap", str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "none of 2 logs can be read: one: the content is not that of a .mcap file" in told
    assert "; two: holds a header but no data" in told


def test_what_is_not_among_the_candidates_is_told_in_words() -> None:
    logs = []
    for seed in (1, 2):
        recording = mg.simulate("wide", 120, seed=seed).recording
        field = recording.magnetic_field
        logs.append(replace(recording, magnetic_field=field + 1.5e-6 * (field / 50e-6) ** 3))
    gap = mg.find_gap(logs, candidates=["timing"])
    assert gap.verdict == "unknown"
    assert gap.sentence.endswith(
        "varies with the direction of the field (attitude) is missing, and it is not among the candidates"
    )


def test_what_cannot_be_compared_is_said(late: list[mg.Recording]) -> None:
    assert mg.find_gap(late[:1]).verdict == "not enough information"
    twice = mg.find_gap([late[0], replace(late[0], name="copy")])
    assert [(each.log, twice.verdict) for each in twice.own] == [("copy", "not enough information")]
    mute = replace(late[0], angular_rate=None, angular_rate_fresh=None, name="mute")
    shadowed = mg.find_gap([mute, late[0]])  # the samples of a log that cannot be used are not counted with it
    assert [each.log for each in shadowed.own] == ["mute"]
    assert "1 of the logs" in shadowed.sentence
    with pytest.raises(mg.MagycError, match="no recordings"):
        mg.find_gap([])
    with pytest.raises(mg.MagycError, match="takes no calibration="):
        mg.find_gap(late, calibration=mg.Calibration(np.eye(3), np.zeros(3)))  # type: ignore[call-overload]
    assert find_gap_of_many(late[:1], ("timing",)).effects == ()


def test_logs_that_say_nothing_alone_are_left_out() -> None:
    """By the check of one log: what they lack would be named as an effect of the instrument."""
    still = mg.simulate((2, 2, 10), 60, seed=1).recording
    silent = mg.simulate("wide", 60, seed=2, magnetometer_noise=0.0).recording
    gap = mg.find_gap([still, silent])
    assert gap.verdict == "not enough information"
    assert gap.calibrations == {}
    words = [mg.find_gap(log, candidates=["timing"]).sentence for log in (still, silent)]
    assert [f"not enough information: {own.sentence}; nothing was tested" for own in gap.own] == words
    assert ["too little motion" in words[0], "no measurable noise" in words[1]] == [True, True]


def test_a_weaker_effect_beside_a_strong_one_is_named() -> None:
    """A delay has a small part of the evidence of a strong current, but is no rival of it."""
    effects = [("motor-current", 4.0), "timing"]
    logs = [mg.simulate("wide", 150, seed=seed, effects=effects, effects_seed=3).recording for seed in (11, 12)]
    gap = mg.find_gap(
        logs, candidates=["motor-current", "timing", "eddy-plane", "hard-iron-drift", "misalignment"]
    )
    assert gap.verdict == "closed"
    assert {"motor-current", "timing"} == {effect.name for effect in gap.effects}
    assert all(calibration.delay == pytest.approx(0.04, abs=0.01) for calibration in gap.calibrations.values())


def test_steps_of_many_logs_are_undone() -> None:
    simulations = [mg.simulate("wide", 100, seed=seed, magnetometer_noise=0.4e-6) for seed in (61, 62)]
    cut = [1e-6 * np.trunc(one.recording.magnetic_field / 1e-6) for one in simulations]
    logs = [replace(one.recording, magnetic_field=field) for one, field in zip(simulations, cut, strict=True)]
    gap = mg.find_gap(logs, candidates=["quantisation", "timing", "cubic"])
    assert [(effect.name, effect.of) for effect in gap.effects] == [("quantisation", "instrument")]
    assert "truncated towards zero" in gap.sentence
    for one, found in zip(simulations, gap.calibrations.values(), strict=True):
        assert found.trusted
        assert found.covariance is not None
        error = found.hard_iron - one.truth.hard_iron
        assert (np.abs(error) < 3.5 * np.sqrt(np.diag(found.covariance)[6:9])).all()


def test_a_log_at_full_scale_among_many_is_doubted() -> None:
    logs = [mg.simulate("wide", 100, seed=seed).recording for seed in (61, 62)]
    logs[1] = replace(logs[1], magnetic_field=np.clip(logs[1].magnetic_field, -55e-6, 55e-6))
    free, clipped = mg.find_gap(logs, candidates=["saturation", "timing"]).calibrations.values()
    assert free.trusted
    assert not clipped.trusted
    assert clipped.message.startswith("axis z of the magnetometer cut off")


def test_the_delay_is_estimated_beside_other_effects() -> None:
    logs = [mg.simulate("wide", 100, seed=seed, effects=["motor-current"]).recording for seed in (3, 4)]
    gap = mg.find_gap(logs, candidates=["motor-current"])
    assert gap.verdict == "closed"
    assert all(c.delay_sigma and abs(c.delay) < 4 * c.delay_sigma for c in gap.calibrations.values())


def test_what_is_missing_is_in_no_calibration_that_is_trusted() -> None:
    effects = ["cubic", "misalignment"]
    logs = [mg.simulate("wide", 150, seed=seed, effects=effects, effects_seed=3).recording for seed in (1, 2)]
    gap = mg.find_gap(logs, candidates=["motor-current"])
    assert gap.verdict == "unknown"
    assert not any(calibration.trusted for calibration in gap.calibrations.values())
    assert all("is missing" in calibration.message for calibration in gap.calibrations.values())


def test_a_log_that_is_calibrated_already_is_left_out() -> None:
    logs = [mg.simulate("wide", 60, seed=seed).recording for seed in (1, 2, 3)]
    gap = mg.find_gap([logs[0], as_calibrated(logs[1]), logs[2]], candidates=["timing"])
    assert [own.sentence for own in gap.own] == [CALIBRATED]
    assert all(len(calibration.fitted_to) == 1 for calibration in gap.calibrations.values())
