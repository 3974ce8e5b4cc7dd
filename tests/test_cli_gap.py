"""`magyc-gtsam gap`: from a log to a verdict, an exit code, files and a page that can be looked at."""

from __future__ import annotations

import json
import logging
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from test_report import HOSTILE, drawn_figures

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.gap.isolability import isolability
from magyc_gtsam.gap.outcome.doubt import with_doubt
from magyc_gtsam.gap.result import Assumption, Doubt, Gap, Isolability, Manoeuvre, Untested
from magyc_gtsam.gap.validation import agreement
from magyc_gtsam.io import write_mcap
from magyc_gtsam.report.gap_page import render_gap
from magyc_gtsam.report.gap_verdict import Validation
from magyc_gtsam.report.gap_words import nats_in_words, plan_rows
from magyc_gtsam.simulation import simulate
from magyc_gtsam.simulation.environment import CHANNELS

FILES = {"gap.json", "calibration.yaml", "configuration.yaml", "report.html"}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plain log, one with a magnetometer delay and another of the same instrument."""
    folder = tmp_path_factory.mktemp("logs")
    for name, seed, effects in (("plain", 1, ()), ("late", 2, ("timing",)), ("again", 3, ("timing",))):
        write_mcap(folder / f"{name}.mcap", simulate("wide", 200, seed=seed, effects=effects).recording)
    write_mcap(folder / "brief.mcap", simulate("wide", 2).recording)
    other = simulate("wide", 100, hard_iron=np.array([1e-4, -2e-4, 3e-4]))
    write_mcap(folder / "other.mcap", other.recording)
    return folder


@pytest.fixture
def quiet_terminal() -> Iterator[None]:
    """`cli.main` mutes warnings and logging of its process; other tests must not inherit that."""
    with warnings.catch_warnings():
        yield
    logging.disable(logging.NOTSET)


@pytest.fixture(scope="module")
def late() -> tuple[mg.Recording, Gap]:
    """A magnetometer delay, found."""
    recording = simulate("wide", 200, seed=2, effects=("timing",)).recording
    return recording, mg.find_gap(recording)


@pytest.mark.usefixtures("quiet_terminal")
def test_a_log_does_not_validate_itself(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    late = str(logs / "late.mcap")
    for interval in ([], ["--start", "20"]):
        assert cli.main(["gap", late, *interval, "--validate", late, "-o", str(logs / "here")]) == 2
        assert "late.mcap holds samples of LOG, which prove nothing" in capsys.readouterr().err


@pytest.mark.usefixtures("quiet_terminal")
def test_a_late_magnetometer_is_found_and_closed(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["gap", str(logs / "late.mcap"), "--validate", str(logs / "again.mcap"), "-o", "here"]) == 0
    output, errors = capsys.readouterr()
    assert errors == ""
    assert "Gap found and closed: the magnetometer lags the gyroscope by" in output
    assert "not tested, no channel in the log: " in output
    assert "on again.mcap:" in output
    assert {file.name for file in Path("here").iterdir()} == FILES
    values = json.loads(Path("here/gap.json").read_text())
    assert values["verdict"] == "closed"
    assert [effect["name"] for effect in values["effects"]] == ["timing"]
    loops = [values["validation"][when]["open_loop"]["rms"] for when in ("before", "after")]
    assert loops[1] < loops[0]
    calibration = mg.Calibration.load("here/calibration.yaml")
    assert [term.name for term in calibration.terms] == ["timing"]
    assert "late.mcap" in Path("here/configuration.yaml").read_text()


@pytest.mark.usefixtures("quiet_terminal")
def test_nothing_missing_and_json(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["gap", str(logs / "plain.mcap"), "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["verdict"] == "none"
    assert values["effects"] == []
    folder = Path(values["folder"])
    assert folder.parent == Path("results")
    assert folder.name.startswith("plain-gap-")
    assert {file.name for file in folder.iterdir()} == FILES
    assert "Effects added" not in (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("quiet_terminal")
def test_a_gap_left_open_is_exit_code_one(
    logs: Path,
    late: tuple[mg.Recording, Gap],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    unknown = with_doubt(
        replace(
            late[1],
            verdict="unknown",
            effects=(),
            sentence="something that lives in pitch is missing, and it is not in the catalogue; nothing was changed",
            after=late[1].before,
        ),
        Doubt("something that lives in pitch is missing", "log more"),
    )
    monkeypatch.setattr("magyc_gtsam.gap.find.find_gap", lambda *_, **__: unknown)
    monkeypatch.setattr("magyc_gtsam.find_gap", lambda *_, **__: unknown, raising=False)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["gap", str(logs / "late.mcap"), "-q", "-o", "here"]) == 1
    output, errors = capsys.readouterr()
    assert output == ""
    reason = "something that lives in pitch is missing: log more"
    assert errors == (
        f"magyc-gtsam: the result must not be trusted: something is missing, and it has no name: {reason}\n"
    )
    assert {file.name for file in Path("here").iterdir()} == FILES
    assert json.loads(Path("here/gap.json").read_text())["judgement"]["cause"] == unknown.doubt.cause
    for command in (
        "export here/calibration.yaml px4",
        f"apply here/calibration.yaml {logs}/late.mcap -o out.csv",
    ):
        assert cli.main(command.split()) == 1
        output, errors = capsys.readouterr()
        assert output == ""
        assert reason in errors
        assert not Path("out.csv").exists()
    assert cli.main(["export", "here/calibration.yaml", "px4", "--force"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"# DO NOT USE: {reason}")
    assert all(line.startswith("#") for line in lines)


@pytest.mark.usefixtures("quiet_terminal")
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("gap", "Missing argument 'LOG'"),
        ("gap {logs}/none.mcap", "none.mcap: cannot be read"),
        ("gap {logs}/plain.mcap --candidates timing,gremlins", "gremlins"),
        ("gap {logs}/plain.mcap --simulated {logs}/none.mcap", "none.mcap: cannot be read"),
        ("gap {logs}/plain.mcap --validate {logs}/none.mcap", "none.mcap: cannot be read"),
        ("gap {logs}/plain.mcap --calibration {logs}/none.yaml", "none.yaml: no such file"),
        ("gap --plan waltz", "'waltz' is not one of wide"),
        ("gap --plan wide --validate {logs}/none.mcap", "needs no LOG and writes no files"),
        ("gap --plan wide --start 100", "leave out all options but --quiet and --json"),
        ("gap --plan wide -v", "leave out all options but --quiet and --json"),
        ("gap {logs}/brief.mcap --candidates timing", "2 windows of 1.5 s, at least 8 are needed"),
    ],
)
def test_one_line_for_every_mistake(
    arguments: str, says: str, logs: Path, mistaken: Callable[[str, str], None]
) -> None:
    mistaken(arguments.format(logs=logs), says)


@pytest.mark.usefixtures("quiet_terminal")
def test_other_logs_are_read_as_the_log_is(
    tmp_path_factory: pytest.TempPathFactory, mistaken: Callable[[str, str], None]
) -> None:
    """Tables without a header, in µT and deg/s, of which nothing tells columns or units."""
    folder = tmp_path_factory.mktemp("tables")
    for name, seed in (("log", 1), ("sim", 2), ("other", 3)):
        recording = simulate("wide", 100, seed=seed).recording
        assert recording.angular_rate is not None
        table = np.column_stack(
            [recording.time, recording.magnetic_field * 1e6, np.degrees(recording.angular_rate)]
        )
        np.savetxt(folder / f"{name}.txt", table)
    write_mcap(folder / "sim.mcap", simulate("wide", 100, seed=2).recording)
    columns = "time,mx,my,mz,gx,gy,gz"
    asked = f"gap {folder}/log.txt --read columns={columns} --magnetic-unit uT --angular-unit deg/s --end 90"
    others = f" --candidates timing --simulated {folder}/sim.txt --validate {folder}/other.txt"
    assert cli.main(f"{asked}{others} -q -o {folder}/here".split()) == 0
    values = json.loads((folder / "here/gap.json").read_text())
    assert values["assumptions"]
    assert values["validation"]["name"] == "other.txt"
    again = f" --candidates timing --simulated {folder}/sim.mcap -q -o {folder}/again"
    assert cli.main(f"{asked}{again}".split()) == 0  # whose topics and units are its own
    assert json.loads((folder / "again/gap.json").read_text())["assumptions"]
    (folder / "short.txt").write_text("1 2 3\n")
    mistaken(f"{asked} --simulated {folder}/none.mcap", "--simulated: ")
    mistaken(f"{asked} --validate {folder}/short.txt", "(--validate is read by LOG's options)")
    (folder / "other.csv.mcap").write_bytes((folder / "sim.mcap").read_bytes()[:300])
    mistaken(f"{asked} --validate {folder}/other.csv.mcap", "(--validate has another format than LOG")


@pytest.mark.real
@pytest.mark.usefixtures("quiet_terminal")
def test_a_still_log_is_refused_with_the_reason(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["gap", str(shared_data / "ardusub_still.BIN"), "-o", "here"]) == 1
    output, errors = capsys.readouterr()
    assert "nothing could be tested: too little motion to determine the hard iron along " in errors
    assert "turn through all headings" in errors or "pitch or roll by 20° or more while turning" in errors
    assert "Nothing could be tested" in output
    assert {file.name for file in Path("here").iterdir()} == FILES
    values = json.loads(Path("here/gap.json").read_text())
    assert values["verdict"] == "not enough information"
    assert values["effects"] == []
    assert not mg.Calibration.load("here/calibration.yaml").trusted


@pytest.mark.usefixtures("quiet_terminal")
def test_a_log_of_another_instrument(
    late: tuple[mg.Recording, Gap],
    logs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("magyc_gtsam.find_gap", lambda *_, **__: late[1], raising=False)
    monkeypatch.chdir(tmp_path)
    command = ["gap", str(logs / "late.mcap"), "-q", "-o", "here", "--validate"]
    assert cli.main([*command, str(logs / "again.mcap")]) == 0
    capsys.readouterr()
    assert cli.main([*command, str(logs / "other.mcap")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "the result does not hold on other.mcap: its 20 s prediction is off by " in line
    assert not mg.Calibration.load("here/calibration.yaml").trusted
    assert cli.main([*command, str(logs / "brief.mcap")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "the result could not be judged on the other log: brief.mcap: 2 windows" in line
    assert (tmp_path / "here" / "report.html").exists()  # what was found is kept
    # Of another instrument too, but it cannot show.
    write_mcap(tmp_path / "short.mcap", simulate("wide", 15, hard_iron=[3e-5, 0, 0], seed=4).recording)
    moving = simulate("wide", 100, seed=4).recording
    noise = np.random.default_rng(4).normal(size=(2, len(moving.time), 3))
    write_mcap(
        tmp_path / "still.mcap",
        replace(
            moving,
            magnetic_field=moving.magnetic_field[0] + 1e-6 * noise[0],
            angular_rate=5e-3 * noise[1],
            attitude=None,
        ),
    )
    for log, why in (
        ("short", "result cannot be judged by short.mcap: it holds no stretch"),
        ("still", "result cannot be judged by still.mcap: its field swept"),
    ):
        assert cli.main([*command, str(tmp_path / f"{log}.mcap")]) == 1
        assert why in capsys.readouterr().err


def test_a_simulator_of_two_seconds(late: tuple[mg.Recording, Gap]) -> None:
    with pytest.raises(mg.MagycError, match="simulated: 2 windows"):
        mg.find_gap(simulate("wide", 60).recording, simulated=simulate("wide", 2).recording, candidates=["timing"])


@pytest.fixture(scope="module")
def moderate_plan() -> tuple[Isolability, ...]:
    return isolability(simulate("moderate", channels=CHANNELS).recording)


@pytest.fixture
def planned(moderate_plan: tuple[Isolability, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of `gap --plan moderate` is computed once, from the recording that the command asks for."""
    asked = simulate("moderate", channels=CHANNELS).recording

    def table(recording: mg.Recording) -> tuple[Isolability, ...]:
        np.testing.assert_array_equal(recording.magnetic_field, asked.magnetic_field)
        assert recording.channels.keys() == asked.channels.keys()
        return moderate_plan

    monkeypatch.setattr(sys.modules[isolability.__module__], "isolability", table)


@pytest.mark.usefixtures("quiet_terminal", "planned")
def test_the_plan_of_a_motion(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["gap", "--plan", "moderate"]) == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line.strip()}
    assert {"timing", "motor-current", "g-sensitivity", "misalignment"} <= rows.keys()
    assert " yes" in rows["motor-current"]
    assert " no" in rows["g-sensitivity"]
    assert "hard-iron-drift or hard-iron-step (" in rows["hard-iron-drift"]
    assert rows["named"].startswith("named as: at the larger of the two strengths")
    assert rows["timing"].count("ms") == 2


@pytest.mark.usefixtures("quiet_terminal", "planned")
def test_the_plan_for_programs_and_in_silence(capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever the order of the options."""
    assert cli.main(["gap", "--plan", "moderate", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["motion"] == "moderate"
    timing = next(row for row in values["effects"] if row["name"] == "timing")
    assert timing["smallest"] > timing["matters"] > 0
    assert timing["nameable"] is False
    assert timing["confused_with"] == {}
    drift = next(row for row in values["effects"] if row["name"] == "hard-iron-drift")
    assert drift["confused_with"] == {"hard-iron-step": pytest.approx(0.33, abs=0.1)}
    assert "as hard-iron-drift or hard-iron-step, which this motion can hardly tell apart" in drift["sentence"]
    assert cli.main(["gap", "-q", "--plan", "moderate"]) == 0
    assert capsys.readouterr() == ("", "")
    assert cli.main(["gap"]) == 2  # a LOG is needed again
    assert "LOG" in capsys.readouterr().err


def test_isolability_is_that_of_the_table_of_one_sigma_sizes(moderate_plan: tuple[Isolability, ...]) -> None:
    """Found from some five of the sigmas of each effect: pitch ±45° and ±5°, 600 s at 10 Hz."""
    moderate = {row.name: row for row in moderate_plan}
    wide = {row.name: row for row in isolability(simulate("wide", channels=CHANNELS).recording)}
    for name, sigmas in {
        "misalignment": (0.9, 3.9),
        "timing": (3.2, 2.2),
        "hard-iron-step": (0.035, 0.035),
    }.items():
        for table, sigma in zip((wide, moderate), sigmas, strict=True):
            assert 3 * sigma < table[name].smallest < 13 * sigma, name
    assert moderate["g-sensitivity"].smallest > 4 * wide["g-sensitivity"].smallest
    assert wide["timing"].left > 0.9
    assert "hard-iron-step" in wide["hard-iron-drift"].confused_with
    bare = {row.name: row for row in isolability(simulate("wide", 300).recording)}
    assert bare["motor-current"].smallest == np.inf
    assert not bare["motor-current"].nameable
    assert "cannot be tested" in bare["motor-current"].sentence


def test_agreement_on_another_recording(late: tuple[mg.Recording, Gap]) -> None:
    """The delay found once holds again; the truth agrees, a wrong hard iron does not."""
    gap, other = late[1], simulate("wide", 300, seed=9, effects=("timing",), gyro_bias=[1e-3, 2e-3, 8e-3])
    before, after = agreement(other.recording, gap.base, gap.calibration)
    assert after.open_loop.rms < 0.95 * before.open_loop.rms
    assert after.held_out > before.held_out
    assert after.heading is not None
    assert before.heading is not None
    assert after.heading < before.heading
    plain = simulate("wide", 300, seed=10)
    moved = replace(plain.truth, hard_iron=plain.truth.hard_iron + 1e-6)
    right, wrong = agreement(plain.recording, plain.truth, moved)
    assert right.whiteness == pytest.approx(1.0, abs=0.35)
    assert wrong.held_out < right.held_out - 0.1
    with pytest.raises(mg.MagycError, match="lacks gyroscope bias"):
        agreement(plain.recording, replace(plain.truth, field_strength=None))


@pytest.mark.usefixtures("quiet_terminal")
def test_a_recording_with_effects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--duration", "60", "--effect", "motor-current=0.5", "--effect", "hard-iron-step"]
    assert cli.main(["simulate", "multi", "-o", "a.mcap", *options]) == 0
    assert "a.effects.yaml: motor-current, hard-iron-step" in capsys.readouterr().out
    assert set(mg.read("a.mcap").channels) == {"current"}
    hidden = yaml.safe_load(Path("a.effects.yaml").read_text())["effects"]
    assert {e["name"]: e["factor"] for e in hidden} == {"motor-current": 0.5, "hard-iron-step": 1.0}
    assert cli.main(["simulate", "multi", "-o", "a.mcap", "--effect", "tone=loud"]) == 2
    assert "--effect: the factor of 'tone' must be a number, got 'loud'" in capsys.readouterr().err
    assert cli.main(["simulate", "multi", "-o", "a.mcap", "--duration", "60"]) == 0
    assert not Path("a.effects.yaml").exists()  # those of the earlier recording


def test_plan_rows() -> None:
    seen = Isolability("timing", "late", 8.0, "ms", 10.0, 0.94, True, {}, "yes")
    never = Isolability("motor-current", "current", np.inf, "µT", 1.0, np.nan, False, {"tone": 0.85}, "no")
    assert plan_rows([seen, never, replace(seen, confused_with={"hysteresis": 0.85})]) == [
        ["timing", "8 ms", "10 ms", "yes", "94%", "timing"],
        ["motor-current", "never", "1 µT", "no", "", ""],
        ["timing", "8 ms", "10 ms", "yes", "94%", "timing or hysteresis (85%)"],
    ]


def test_page_of_a_closed_gap(opened: Any, late: tuple[mg.Recording, Gap], tmp_path: Path) -> None:
    recording, gap = late
    target = tmp_path / "report.html"
    target.write_text(render_gap(recording, gap, Validation("other.mcap", 5e-5, gap.before, gap.after)))
    page = opened(target)
    assert page.locator("#verdict h1").inner_text() == "Gap found and closed"
    assert drawn_figures(page) == len(gap.before.maps) + 2 + 1  # over time and heading, and the reference
    text = page.inner_text("main")
    for words in ("Magnetometer delay", "On another recording: other.mcap", "Evidence", "Could not be tested"):
        assert words in text
    assert nats_in_words(max(h.evidence for h in gap.hypotheses)) in text


@pytest.mark.parametrize(("width", "scheme"), [(390, "light"), (1280, "dark")])
def test_page_of_an_unknown_gap_with_hostile_names(
    opened: Any,
    late: tuple[mg.Recording, Gap],
    tmp_path: Path,
    width: int,
    scheme: str,
) -> None:
    recording, gap = late
    hostile = replace(
        gap,
        verdict="unknown",
        effects=(),
        sentence=f"something is missing {HOSTILE}",
        after=gap.before,
        untested=(Untested("motor-current", "motor current", f"no channel {HOSTILE}"),),
        assumptions=(Assumption("timing", 0.0, 40.0, 3.0, "ms", True, f"the simulator is never late {HOSTILE}"),),
        next_manoeuvre=Manoeuvre(
            ("timing", "hysteresis"), "turn faster", "turn faster, to tell timing from hysteresis"
        ),
        doubt=Doubt(f"something is missing {HOSTILE}", "record again"),
    )
    target = tmp_path / "report.html"
    target.write_text(render_gap(replace(recording, name=HOSTILE, notes=(HOSTILE,)), hostile))
    page = opened(target, width=width, scheme=scheme)
    assert page.locator("#verdict h1").inner_text() == "Something is missing, and it has no name"
    assert page.title().startswith("Gap in <script>")
    text = page.inner_text("main")
    assert text.count("Turn faster, to tell timing from hysteresis") == 1
    assert "The calibration was not changed." in text
    assert "The simulator is never late" in text
    assert page.evaluate("document.documentElement.scrollWidth") <= width
