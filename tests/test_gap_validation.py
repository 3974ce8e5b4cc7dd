"""A result on another log: what differs there is named, and what was settled before the search holds there too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap.validation import agreement, differences
from magyc_gtsam.io import write_mcap
from magyc_gtsam.simulation.environment import CHANNELS

_AXES = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])


@pytest.fixture(scope="module")
def calibration() -> mg.Calibration:
    """Of a log in which nothing is missing."""
    gap = mg.find_gap(mg.simulate("wide", 300, seed=1).recording)
    assert gap.verdict == "none"
    return gap.calibration


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_the_same_instrument_differs_in_nothing(calibration: mg.Calibration, seed: int) -> None:
    """Not in another place either, where the field is a fifth weaker."""
    for field in (1.0, 0.8):
        other = mg.simulate("wide", 300, seed=seed, field=field * np.array([20e-6, 2e-6, 42e-6])).recording
        assert differences(other, calibration) == ()


@pytest.mark.parametrize("motion", ["wide", "moderate"])
def test_what_differs_is_named(calibration: mg.Calibration, motion: str) -> None:
    truth = mg.simulate("wide", 1).truth
    moved = truth.hard_iron + np.array([3e-6, 0, 0])
    worst = differences(mg.simulate(motion, seed=14, hard_iron=moved).recording, calibration)[0]
    assert worst.name == "hard iron x"
    assert worst.after - worst.before == pytest.approx(3.0, abs=4 * worst.sigma)

    (late,) = differences(mg.simulate(motion, seed=15, delay=0.1).recording, calibration)
    assert late.name.startswith("magnetometer delay")
    assert late.after == pytest.approx(100, abs=4 * late.sigma)

    bent = truth.soft_iron * np.array([[1.05, 1, 1], [1, 1, 1], [1, 1, 1]])
    names = {row.name for row in differences(mg.simulate(motion, seed=16, soft_iron=bent).recording, calibration)}
    assert "soft iron xx" in names


def test_terminal_and_page_show_what_differs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    moved = mg.simulate("wide", 1).truth.hard_iron + np.array([3e-6, 0, 0])
    for name, iron in (("here", None), ("there", moved)):
        more = {} if iron is None else {"hard_iron": iron}
        write_mcap(tmp_path / f"{name}.mcap", mg.simulate("wide", 200, seed=17, **more).recording)
    asked = ["gap", str(tmp_path / "here.mcap"), "--validate", str(tmp_path / "there.mcap")]
    assert cli.main([*asked, "--candidates", "timing", "-o", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "there hard iron x is " in said.err
    for text in (said.out, (tmp_path / "out" / "report.html").read_text()):
        assert "parameter that differs" in text
        assert "hard iron x (µT)" in text


def test_exchanged_axes_hold_on_another_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = []
    for seed in (21, 22):
        recording = mg.simulate("wide", 300, seed=seed).recording
        assert recording.angular_rate is not None
        turned = replace(recording, angular_rate=recording.angular_rate @ _AXES, attitude=None)
        logs.append(str(tmp_path / f"{seed}.mcap"))
        write_mcap(Path(logs[-1]), turned)
    asked = ["--candidates", "axis-order", "-o", str(tmp_path / "out"), "-q"]
    assert cli.main(["gap", *logs[:1], "--validate", logs[1], *asked]) == 0
    assert capsys.readouterr().err == ""
    gap = mg.find_gap(mg.read(logs[0]), candidates=["axis-order"])
    assert gap.names == ("axis-order",)
    assert [term.name for term in gap.base.terms] == ["axis-order"]
    loop = agreement(mg.read(logs[1]), gap.base)[0].open_loop
    assert loop.rms < 1.2 * loop.floor


def test_a_log_that_lacks_what_is_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No gyroscope is seen before the search, and nothing is written; a channel of what was found only after it."""
    driven = mg.simulate("wide", 300, seed=31, effects=["motor-current"], channels=CHANNELS).recording
    write_mcap(tmp_path / "driven.mcap", driven)
    for name, other in (
        ("still", replace(driven, angular_rate=None, attitude=None, acceleration=None)),
        ("unlogged", mg.simulate("wide", 300, seed=32).recording),
    ):
        write_mcap(tmp_path / f"{name}.mcap", other)
    out = tmp_path / "out"
    asked = [
        "gap",
        str(tmp_path / "driven.mcap"),
        "--candidates",
        "motor-current",
        "-q",
        "-o",
        str(out),
        "--validate",
    ]
    assert cli.main([*asked, str(tmp_path / "still.mcap")]) == 2
    assert "no angular rate" in capsys.readouterr().err
    assert not out.exists()
    assert cli.main([*asked, str(tmp_path / "unlogged.mcap")]) == 1
    assert "could not be judged on the other log: unlogged.mcap: " in (said := capsys.readouterr().err)
    assert "no current channel" in said
    assert (out / "report.html").exists()


def test_an_effect_of_another_size_does_not_hold() -> None:
    """The value on trial is not fitted to the log that tries it."""
    effect = [("misalignment", 2.0)]
    first, same = (
        mg.simulate("wide", 200, seed=seed, effects=effect, effects_seed=5).recording for seed in (6, 7)
    )
    gap = mg.find_gap(first, candidates=["misalignment"])
    assert gap.names == ("misalignment",)
    none = mg.simulate("wide", 200, seed=8).recording
    tried = (agreement(log, gap.base, gap.calibration) for log in (same, none))
    better, worse = (after.held_out - before.held_out for before, after in tried)
    assert better > 1
    assert worse < -1


def test_iron_after_a_jump_holds_on_a_later_log() -> None:
    """And the agreement, heading included, is that of the iron after the jump, whatever its time in the first log."""
    jump = Term("hard-iron-step", [3e-6, -2e-6, 1e-6], np.eye(3) * 1e-16, {"time": 150.0})
    drift = Term("hard-iron-drift", [5e-6, 0.0, 0.0], np.eye(3) * 1e-16, {"order": 0.0, "start": 0.0, "end": 1.0})
    first = mg.calibrate(mg.simulate("wide", 200, seed=51).recording)
    dated = replace(first, terms=(*first.terms, jump, drift), diagnostics={})  # its recording need not be known
    after = replace(first, hard_iron=first.hard_iron + jump.value)
    later = mg.simulate(
        "wide", 200, seed=52, hard_iron=mg.simulate("wide", 1).truth.hard_iron + jump.value
    ).recording
    found, expected = (agreement(later, each)[0] for each in (dated, after))
    assert found.heading == expected.heading
    assert found.open_loop.rms == expected.open_loop.rms
    assert differences(later, dated) == ()


def test_a_result_with_a_jump_holds_on_the_next_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its time in the first log says nothing about the second; terminal and page say how it counts there."""
    jump = np.array([4e-6, -3e-6, 2e-6])
    first, later = (
        mg.simulate("wide", 200, seed=61).recording,
        mg.simulate("wide", 200, seed=62, hard_iron=mg.simulate("wide", 1).truth.hard_iron + jump).recording,
    )
    field = first.magnetic_field + (first.time > 100.0)[:, None] * jump
    write_mcap(tmp_path / "first.mcap", replace(first, magnetic_field=field))
    write_mcap(tmp_path / "later.mcap", later)
    asked = ["gap", str(tmp_path / "first.mcap"), "--validate", str(tmp_path / "later.mcap")]
    asked += ["--candidates", "hard-iron-step", "-o", str(tmp_path / "out")]
    assert cli.main(asked) == 0
    said = capsys.readouterr().out
    for text in (said, (tmp_path / "out" / "report.html").read_text()):
        assert "ump of the hard iron: found at " in text
        assert "s of another recording, it counts as set in" in text
    given = ["--calibration", str(tmp_path / "out" / "calibration.yaml"), "--candidates", "timing"]
    assert cli.main(["gap", str(tmp_path / "later.mcap"), *given, "-o", str(tmp_path / "next")]) == 0
    assert "note: hard-iron-step: found at " in capsys.readouterr().out


def test_spikes_of_the_other_log_are_left_out_as_in_any(calibration: mg.Calibration) -> None:
    recording = mg.simulate("wide", 300, seed=14).recording
    rate = recording.angular_rate.copy()
    rate[100::150] += 20.0
    spiky = replace(recording, angular_rate=rate)
    (clean,), (spoilt,) = agreement(recording, calibration), agreement(spiky, calibration)
    assert spoilt.open_loop.rms < 1.1 * clean.open_loop.rms


def test_the_measured_strength_of_one_place_is_not_that_of_another() -> None:
    """The instrument is the same where the field is 2 % stronger; a strength that was given is another matter."""
    here, there = (mg.simulate("wide", 200, seed=seed).recording for seed in (61, 62))
    hard_iron = mg.simulate("wide", 200, seed=62).truth.hard_iron
    there = replace(there, magnetic_field=(there.magnetic_field - hard_iron) * 1.02 + hard_iron)
    calibration = mg.calibrate(here)
    gap = mg.find_gap(there, calibration=calibration)
    assert gap.verdict == "none", gap.sentence
    assert np.linalg.det(gap.calibration.soft_iron) == pytest.approx(1.0)
    measured, _ = agreement(there, calibration, mg.calibrate(there))
    assert measured.open_loop.rms < 1.2 * measured.open_loop.floor
