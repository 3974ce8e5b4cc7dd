"""The blind test itself: frozen scenarios, seals that hold, a diagnosis that cannot see, a scorer that can fail."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magyc_gtsam import MagycError, cli
from magyc_gtsam.blindtest import diagnosis
from magyc_gtsam.blindtest.detectability import seen_by_a_perfect_test, stands_out
from magyc_gtsam.blindtest.from_outside import EffectsFromFile, changed
from magyc_gtsam.blindtest.gates import gates, interval, missing
from magyc_gtsam.blindtest.generator import generate, noise_free, truth_of
from magyc_gtsam.blindtest.heading import heading_error, heading_errors
from magyc_gtsam.blindtest.pictures import draw
from magyc_gtsam.blindtest.reliability import reliability_rows, scores
from magyc_gtsam.blindtest.running import run
from magyc_gtsam.blindtest.scenarios import (
    FACTORS,
    MOTIONS,
    Scenario,
    fingerprint,
    real_scenarios,
    rivals,
    scenarios,
)
from magyc_gtsam.blindtest.scoring import UNKNOWN, WRONG, Outcome, beyond, confusion, judged, score
from magyc_gtsam.blindtest.sealing import MANIFEST, RECORDINGS, SEALED, opened, seal
from magyc_gtsam.blindtest.tables import markdown, outcome_rows, standing_rows
from magyc_gtsam.cli import main
from magyc_gtsam.cli.study_options import recordings_of
from magyc_gtsam.io import write_mcap
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation import simulate
from magyc_gtsam.simulation.effects import FOREIGN, NAMED
from magyc_gtsam.simulation.environment import CHANNELS

SMALL = ["none", "single", "foreign"]


def some(duration: float = 60.0) -> list[Scenario]:
    """Four short scenarios."""
    every = scenarios("wide", 2, 7, SMALL, duration)
    wanted = ("none-wide-000", "single-wide-timing-x1-00", "single-wide-motor-current-x1-00")
    return [s for s in every if s.id in (*wanted, "foreign-wide-loose-magnet-x2-00")]


@pytest.fixture(scope="module")
def sealed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("blind")
    seal(folder, some())
    return folder


def test_scenarios_are_frozen_and_cover_everything() -> None:
    """The full test of edition 1; whoever changes scenarios, strengths' factors or seeds changes the test."""
    prints = {motion: fingerprint(scenarios(motion, 300, 1))[:12] for motion in MOTIONS}
    assert prints == {"wide": "d7b6c008cdb5", "moderate": "1f93ba0056b5", "multi": "961dd2340f34"}
    every = scenarios("moderate", 300, 1)
    assert len({s.id for s in every}) == len({s.seed for s in every}) == len(every)
    count = {kind: sum(s.set == kind for s in every) for kind in ("none", "single", "pair", "withheld", "foreign")}
    assert count == {
        "none": 300,
        "single": 10 * (4 * (len(NAMED) - 1) + 1),
        "pair": 60,
        "withheld": 100,
        "foreign": 40 * len(FOREIGN),
    }
    assert {s.factor for s in every if s.set == "foreign"} == set(FACTORS)
    for s in every:
        assert s.set != "pair" or not rivals(*s.names)
        assert s.set != "pair" or "g-sensitivity" not in s.names
        assert s.set != "withheld" or s.withheld
    assert {s.seed for s in scenarios("moderate", 300, 0)}.isdisjoint(s.seed for s in every)
    assert {n for s in real_scenarios(["log"]) for n in s.names} < set(NAMED)


def test_what_the_diagnosis_gets(sealed: Path) -> None:
    manifest = json.loads((sealed / MANIFEST).read_text())
    assert manifest["count"] == 4
    by_id = {opened(sealed, n, manifest)["scenario"]["id"]: n for n in manifest["sha256"]}
    recording = diagnosis.load(sealed / RECORDINGS / f"{by_id['single-wide-motor-current-x1-00']}.npz")
    assert recording.attitude is None
    assert set(recording.channels) == set(CHANNELS)
    again = generate(next(s for s in some() if s.id == "single-wide-motor-current-x1-00"))
    np.testing.assert_array_equal(recording.magnetic_field, again.recording.magnetic_field)
    np.testing.assert_array_equal(recording.acceleration, again.recording.acceleration)
    assert truth_of(some()[1], again)["effects"][0]["name"] == "motor-current"
    assert again.attitude is not None
    hidden = generate(Scenario("x", "withheld", "wide", 5, (("motor-current", 1.0),), ("current",), 60.0))
    assert "current" not in hidden.recording.channels


def test_seals(sealed: Path, tmp_path: Path) -> None:
    manifest = seal(sealed, some())  # what is sealed stays
    number = next(iter(manifest["sha256"]))
    with pytest.raises(MagycError, match="holds another blind test"):
        seal(sealed, some()[:2])
    truth = sealed / SEALED / f"{number}.json"
    kept = truth.read_bytes()
    try:
        truth.write_bytes(kept.replace(b"wide", b"tiny"))
        with pytest.raises(MagycError, match="was changed after sealing"):
            opened(sealed, number, manifest)
    finally:
        truth.write_bytes(kept)
    with pytest.raises(MagycError, match="holds no blind test"):
        score(tmp_path)


ATTEMPTS = """
import importlib, runpy, sys
module = runpy.run_path(sys.argv[1])
module["blindfold"](module["Path"](sys.argv[2]) / "sealed")
import magyc_gtsam as mg
truth = sys.argv[2] + "/sealed/00000.json"
attempts = {
    "import": lambda: __import__("magyc_gtsam.simulation"),
    "import_module": lambda: importlib.import_module("magyc_gtsam.simulation.effects.strengths"),
    "simulate": lambda: mg.simulate("wide"),
    "blindtest": lambda: importlib.import_module("magyc_gtsam.blindtest.generator"),
    "beside the script": lambda: importlib.import_module("generator"),
    "open": lambda: open(truth),
    "path": lambda: module["Path"](truth).read_text(),
    "list": lambda: list((module["Path"](sys.argv[2]) / "sealed").iterdir()),
    "relative": lambda: open(sys.argv[2] + "/recordings/../sealed/00000.json"),
}
for name, attempt in attempts.items():
    try:
        attempt()
    except (ImportError, PermissionError):
        continue
    print("saw the truth by", name)
recording = module["load"](module["Path"](sys.argv[2]) / "recordings/00000.npz")
mg.calibrate(recording)
print(len(recording.time), sorted(n for n in sys.modules if n.startswith(module["FORBIDDEN"])))
"""


def test_the_diagnosing_process_cannot_see_generator_or_truth(sealed: Path) -> None:
    finished = subprocess.run(
        [sys.executable, "-P", "-c", ATTEMPTS, diagnosis.__file__, str(sealed)], capture_output=True, text=True
    )
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout == "600 []\n"


def scenario(kind: str, *names: str, factor: float = 1.0, motion: str = "wide") -> Scenario:
    return Scenario("x", kind, motion, 1, tuple((n, factor) for n in names))


@pytest.mark.parametrize(
    ("hidden", "verdict", "named", "kind"),
    [
        (scenario("none"), "none", [], "silent"),
        (scenario("none"), "closed", [("timing", ())], "wrong"),
        (scenario("none"), "unknown", [], "unknown"),
        (scenario("single", "timing"), "closed", [("timing", ())], "right"),
        (scenario("single", "timing"), "closed", [("hysteresis", ("timing",))], "in its set"),
        (scenario("single", "timing"), "closed", [("hysteresis", ())], "wrong"),
        (scenario("single", "timing"), "closed", [("timing", ()), ("tone", ())], "wrong"),
        (scenario("single", "timing"), "closed", [("timing", ()), ("hysteresis", ("timing",))], "one too many"),
        (scenario("single", "timing"), "closed", [("timing", ()), ("timing", ())], "one too many"),
        (scenario("single", "timing"), "unknown", [("tone", ())], "unknown"),
        (scenario("single", "timing"), "none", [], "silent"),
        (scenario("pair", "timing", "tone"), "closed", [("tone", ()), ("timing", ())], "right"),
        (scenario("pair", "timing", "tone"), "open", [("tone", ())], "partial"),
        (scenario("pair", "timing", "tone"), "closed", [("tone", ()), ("spikes", ("tone",))], "one too many"),
        (
            scenario("pair", "timing", "tone"),
            "closed",
            [("spikes", ("tone", "timing")), ("tone", ())],
            "in its set",
        ),
        (scenario("foreign", "servo-magnet"), "closed", [("hard-iron-drift", ())], "wrong"),
        (scenario("withheld", "motor-current"), "closed", [("hard-iron-drift", ())], "wrong"),
        (scenario("withheld", "motor-current"), "closed", [("hard-iron-drift", ("motor-current",))], "in its set"),
        (scenario("withheld", "motor-current"), "unknown", [], "unknown"),
        (scenario("withheld", "temperature-hard-iron"), "closed", [("hard-iron-drift", ())], "right"),
        (scenario("single", "axis-order"), "refused", [], "refused"),
        (scenario("single", "timing"), "crashed", [], "crashed"),
        (scenario("single", "sample-hold"), "closed", [("sample-hold", ()), ("timing", ())], "right"),
        (scenario("single", "sample-hold"), "closed", [("timing", ())], "partial"),
        (scenario("single", "motor-current"), "closed", [("motor-current", ()), ("tone", ())], "right"),
    ],
)
def test_judgement(hidden: Scenario, verdict: str, named: list, kind: str) -> None:
    assert judged(hidden, verdict, named) == kind


def outcome(kind: str, hidden: Scenario, said: str = "", excess: object = None, heading: object = None) -> Outcome:
    named = ((said, ()),) if said else ()
    verdict = "unknown" if kind == "unknown" else "closed" if said else "none"
    return Outcome("0", hidden, verdict, named, kind, "", excess, heading, 1.0)  # type: ignore[arg-type]


def test_gates_pass_and_fail() -> None:
    nothing, timing, servo = scenario("none"), scenario("single", "timing"), scenario("foreign", "servo-magnet")
    good = [
        *[outcome("silent", nothing)] * 99,
        outcome("unknown", nothing),
        *[outcome("right", timing, "timing", (4.0, 0.1), (1.0, 0.2))] * 19,
        outcome("silent", timing),
        *[outcome("unknown", servo)] * 9,
        outcome("silent", servo),
    ]
    measured = {gate.name: gate for gate in gates(good)}
    assert all(gate.passed for gate in measured.values())
    assert measured["nothing hidden: UNKNOWN"].share == 0.01
    assert measured["excess open-loop variance cut, median"].share == pytest.approx(0.975)
    assert measured["one effect ×1: named"].count == 19
    assert missing(good) == {}
    bad = [
        *[outcome("wrong", nothing, "tone")] * 3,
        *[outcome("wrong", timing, "tone", (4.0, 3.0), (1.0, 1.2))] * 3,
        outcome("right", timing, "timing", (4.0, 3.0), (1.0, 1.2)),
        outcome("wrong", servo, "hard-iron-drift"),
    ]
    failed = {gate.name for gate in gates(bad) if not gate.passed}
    assert failed == {gate.name for gate in gates(bad)} - {"nothing hidden: UNKNOWN", "crashed"}
    assert missing(bad) == {"timing": (1, 4)}
    # What the level motion cannot show is not asked of it.
    level = [outcome("silent", scenario("single", "g-sensitivity", motion="moderate"))]
    assert "one effect ×1: named" not in {gate.name for gate in gates(level)}


def test_intervals_against_the_published_table() -> None:
    """Clopper and Pearson (1934): 0 of 10 and 3 of 10 at 95 %."""
    assert interval(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)
    assert interval(3, 10) == pytest.approx((0.0667, 0.6525), abs=1e-4)
    assert interval(10, 10)[1] == 1.0


def test_confusion_and_tables(tmp_path: Path) -> None:
    outcomes = [
        outcome("right", scenario("single", "timing"), "timing"),
        outcome("wrong", scenario("single", "timing"), "tone"),
        outcome("unknown", scenario("foreign", "servo-magnet", factor=2.0)),
        outcome("silent", scenario("none")),
    ]
    rows, columns, counts = confusion(outcomes)
    assert rows == ["timing", "servo-magnet", "nothing"]
    assert columns == ["timing", "tone", "unknown", "silent"]
    np.testing.assert_array_equal(counts, [[1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    picture = tmp_path / "confusion.svg"
    draw(picture, outcomes, "Said of what was hidden")
    for word in ("servo-magnet", "tone", "nothing", "Said of what was hidden"):
        assert f"<!-- {word} -->" in picture.read_text()
    assert outcome_rows(outcomes)[2] == ["timing", "1", "1", "1", "·", "·", "tone"]
    page = markdown(outcomes, "Test")
    assert "| one effect ×1: wrong name | 50.0 % | 1.3 to 98.7 | 1 of 2 | ≤ 3 % | FAILED |" in page
    assert "Named in less than 90 % of their runs at published strength: timing 1 of 2." in page


def test_how_far_it_stands_out() -> None:
    """What is said is told by how much could have been seen."""
    twice = [stands_out(scenario("single", "motor-current", factor=factor)) for factor in (1.0, 2.0)]
    assert twice[0] == pytest.approx(17, rel=0.3)  # sigmas, as the table of strengths has it
    assert twice[1] == pytest.approx(2 * twice[0], rel=0.1)
    assert stands_out(scenario("single", "axis-order")) is None
    assert stands_out(scenario("none")) is None
    # A test at level 0.01 / 44 of three values is passed by chance so often, and by five sigmas mostly.
    assert seen_by_a_perfect_test(np.zeros(1)) == pytest.approx(0.01 / 44, rel=1e-3)
    assert seen_by_a_perfect_test(np.array([5.0])) == pytest.approx(0.79, abs=0.02)
    outcomes = [
        replace(outcome("right", scenario("single", "timing"), "timing"), stands_out=5.5),
        replace(outcome("silent", scenario("single", "timing")), stands_out=5.1),
        replace(outcome("wrong", scenario("single", "cubic"), "timing"), stands_out=30.0),
        outcome("right", scenario("single", "tone"), "tone"),
    ]
    assert standing_rows(outcomes) == [
        ["5 to 6", "2", "50 %", "0 %", "0 %", "50 %", "86 %"],
        ["from 20", "1", "0 %", "100 %", "0 %", "0 %", "100 %"],
    ]
    assert "| 5 to 6 | 2 | 50 % |" in markdown(outcomes, "Test")


def test_heading_is_judged_on_the_channels_that_the_diagnosis_had() -> None:
    hidden = Scenario("a", "withheld", "wide", 3, (("motor-current", 1.0),), ("current",), 60.0)
    clean = noise_free(hidden)
    assert set(clean.channels) == set(generate(hidden).recording.channels)
    assert "current" not in clean.channels
    assert clean.attitude is not None


def test_heading_of_the_truth_is_exact() -> None:
    plain = Scenario("x", "none", "wide", 11, (), (), 60.0)
    hidden, clean = generate(plain), noise_free(plain)
    assert heading_error(hidden.truth, clean) < 1e-9
    tilted = Scenario("x", "single", "wide", 11, (("misalignment", 1.0),), (), 60.0)
    assert heading_error(generate(tilted).truth, noise_free(tilted)) > 0.1


def test_effects_are_put_into_recordings() -> None:
    real = simulate("wide", 120, seed=3).recording
    as_they_are = [s for s in real_scenarios(["log"], 1) if not s.names]
    others = [s for s in real_scenarios(["log"], 1) if s.names]
    step = next(s for s in others if s.names == ("hard-iron-step",))
    stepped = generate(step, real)
    assert stepped.recording.attitude is None
    spans = set()
    for plain, cut in ((generate(each, real).recording, each.cut) for each in as_they_are):
        rows = np.isin(real.time, plain.time)
        assert 0.94 * len(real.time) < rows.sum()
        assert cut == (rows.sum() < len(real.time))
        np.testing.assert_allclose(plain.magnetic_field, real.magnetic_field[rows], rtol=1e-12)
        spans.add((plain.time[0], plain.time[-1]))
    assert len(spans) == 5
    assert [each.cut for each in (*as_they_are, *others)].count(False) == 1 + len(others)
    change = np.linalg.norm(stepped.recording.magnetic_field - real.magnetic_field, axis=1)
    # Two minutes instead of ten: what stands out as far is larger by the root of five, or a little more.
    assert 2.0 < change.max() / 6e-7 < 3.5
    assert change.min() < 1e-12
    assert isinstance(stepped.recording, Recording)


def test_what_a_real_recording_holds_anyway_is_not_judged(tmp_path: Path) -> None:
    """A recording that is late as it is: its delay is no wrong name beside a step, and to find one is no success."""
    real = simulate("wide", 80, seed=3, effects=(("timing", 4.0),)).recording
    every = real_scenarios(["log"], 1)
    chosen = [s for s in every if not s.names][:1] + [s for s in every if s.label in ("hard-iron-step", "timing")]
    run(tmp_path, chosen, {"log": real}, workers=1)
    outcomes = {o.scenario.label: o for o in score(tmp_path)}
    assert outcomes.keys() == {"nothing", "hard-iron-step"}
    assert [name for name, _ in outcomes["nothing"].named] == ["timing"]
    assert len(list((tmp_path / "results").iterdir())) == len(chosen)
    assert outcomes["hard-iron-step"].kind in ("right", "in its set")


def test_a_set_counts_where_it_holds_what_was_put_in_and_did_not_without() -> None:
    already = {"timing": frozenset({"eddy-plane"}), "gyro-scale": frozenset()}

    def kind(hidden: str, *named: tuple[str, tuple[str, ...]]) -> str:
        scenario = Scenario("x", "real", "log", 1, ((hidden, 1.0),))
        return judged(scenario, "closed", beyond(named, scenario.names, already))

    late, scale = ("timing", ("eddy-plane",)), ("gyro-scale", ())
    assert kind("cubic", late, scale) == "silent"
    assert kind("cubic", late, ("cubic", ())) == "right"
    assert kind("cubic", late, ("hysteresis", ())) == "wrong"
    assert kind("cubic", ("cubic", ()), ("gyro-quadratic", ("gyro-scale",))) == "right"
    assert kind("cubic", ("cubic", ()), ("gyro-quadratic", ())) == "wrong"
    assert kind("gyro-quadratic", late, ("gyro-scale", ("gyro-quadratic",))) == "in its set"
    assert kind("eddy-plane", late) == "silent"
    # What is there anyway and was said by itself excuses no other name.
    assert kind("cubic", late, ("cubic", ()), ("hysteresis", ("timing",))) == "wrong"


def test_a_small_blind_test_from_end_to_end(tmp_path: Path) -> None:
    """Two diagnosing processes on three recordings; a second run finds everything done."""
    every = scenarios("wide", 2, 7, ["none", "single"], duration=120.0)
    wanted = {
        "none-wide-000": {"silent"},
        "single-wide-axis-order-x1-00": {"right"},
        "single-wide-timing-x2-00": {"right", "in its set"},
    }
    chosen = [s for s in every if s.id in wanted]
    shares: list[float] = []
    run(tmp_path, chosen, diagnosing=shares.append)
    assert shares[-1] == 1.0
    outcomes = score(tmp_path, heading_errors, stands_out)
    assert {o.scenario.id for o in outcomes} == wanted.keys()
    for o in outcomes:
        assert o.kind in wanted[o.scenario.id], f"{o.scenario.id}: {o.sentence}"
    late = next(o for o in outcomes if o.scenario.names == ("timing",))
    assert late.heading is not None
    assert late.heading[1] < 0.5 * late.heading[0]
    assert late.stands_out is not None
    assert late.stands_out > 10
    stamps = [file.stat().st_mtime_ns for file in sorted((tmp_path / "results").iterdir())]
    run(tmp_path, chosen)
    assert [file.stat().st_mtime_ns for file in sorted((tmp_path / "results").iterdir())] == stamps


def test_the_command_refuses_what_it_does_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    try:
        assert cli.main(["study", "gap", "--set", "gremlins"]) == 2
    finally:
        logging.disable(logging.NOTSET)
    assert "--set: 'gremlins' is not one of none, single, pair, withheld, foreign" in capsys.readouterr().err


def test_a_part_of_a_log_is_taken(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap", simulate("wide", 30, seed=1).recording)
    read = recordings_of([str(tmp_path / "log.mcap"), f"{tmp_path / 'log.mcap'}@5:20.5"])
    assert read.keys() == {"log", "log@5:20.5"}
    assert read["log"].duration == pytest.approx(30, abs=0.2)
    assert read["log@5:20.5"].duration == pytest.approx(15.5, abs=0.2)


def test_what_is_stated_too_surely_is_not_true() -> None:
    def stated(label: str, kind: str, names: tuple[str, ...], probability: float) -> Outcome:
        hidden = Scenario(label, kind, "wide", 1, tuple((name, 1.0) for name in names))
        said = {"timing": probability, "unknown": 1 - probability, "nothing": 0.0}
        return Outcome("0", hidden, "closed", (), "right", "", None, None, 1.0, None, said)

    late = [stated(f"{k}", "single", ("timing",), 0.97) for k in range(97)]
    foreign = [stated(f"f{k}", "foreign", ("servo-magnet",), 0.97) for k in range(3)]
    (row,) = reliability_rows([*late, *foreign])
    assert row[1:4] == ["100", "0.970", "0.970"]
    assert row[-1] == ""
    (row,) = reliability_rows([*late[:50], *foreign * 5])
    assert row[-1] == "not true"
    true, sure = scores([*late, *foreign]), scores([*late, *foreign * 5])
    assert true is not None
    assert sure is not None
    assert true.log == pytest.approx(-0.97 * np.log(0.97) - 0.03 * np.log(0.03))
    assert true.brier == pytest.approx(2 * 0.97 * 0.03)
    assert sure.log > true.log


def test_statements_about_a_real_log_count_where_their_truth_is_known(tmp_path: Path) -> None:
    """Not those about what the log may have as it is, nor about what is unknown in it."""
    said = {
        "real-log-as-it-is-00": ((), {"hysteresis": 0.3, "timing": 0.97, "unknown": 0.2}),
        "real-log-cubic-00": (("cubic",), {"cubic": 0.9, "hysteresis": 0.9, "timing": 0.97, "unknown": 0.9}),
        "real-log-spikes-00": (("spikes",), {"spikes": 0.1, "cubic": 0.85, "nothing": 0.6}),
    }
    each = [
        Scenario(label, "real", "log", 1, tuple((name, 1.0) for name in names))
        for label, (names, _) in said.items()
    ]
    seal(tmp_path, each, {"log": simulate("wide", 60, seed=1).recording})
    (tmp_path / "results").mkdir(exist_ok=True)
    outcome = {"effects": [], "verdict": "closed", "cpu_seconds": 1.0}
    for sealed in (tmp_path / "sealed").glob("*.json"):
        label = json.loads(sealed.read_text())["scenario"]["id"]
        result = outcome | {"probabilities": said[label][1]}
        (tmp_path / "results" / sealed.name).write_text(json.dumps(result))
    outcomes = score(tmp_path)
    (row,) = reliability_rows(outcomes)
    assert row[1:4] == ["2", "0.875", "0.500"]
    scored = scores(outcomes)
    assert scored is not None
    assert scored.recordings == 2


def test_the_number_of_processes_is_the_one_given(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    given = []

    def run(*arguments: object, **_: object) -> None:
        given.append(arguments[3])
        raise MagycError("enough")

    monkeypatch.setattr("magyc_gtsam.blindtest.running.run", run)
    try:
        assert cli.main(["study", "gap", "--motion", "wide", "--workers", "5", "-o", str(tmp_path)]) == 2
    finally:
        logging.disable(logging.NOTSET)
    assert given == [5]


EXAMPLE = Path(__file__).parents[1] / "examples" / "foreign_effects.py"


def test_functions_of_a_file_are_put_into_recordings(tmp_path: Path) -> None:
    outside = EffectsFromFile.read(EXAMPLE)
    assert set(outside.effects) == {
        f"foreign_effects.{name}"
        for name in ("gain_with_temperature", "late_in_fast_turns", "gripper", "bias_with_shaking")
    }
    every = outside.scenarios("wide", 30, 1, duration=20.0)
    assert len(every) == 4 * len(FACTORS)
    for scenario in every:
        hidden = generate(scenario, outside=outside.effects)
        plain = generate(replace(scenario, effects=())).recording
        moved = [
            not np.array_equal(getattr(hidden.recording, key), getattr(plain, key))
            for key in ("magnetic_field", "angular_rate")
        ]
        assert moved == ([False, True] if "shaking" in scenario.label else [True, False])
        assert hidden.recording.attitude is None
        assert hidden.attitude is not None
        assert judged(scenario, "unknown", ()) == UNKNOWN
        assert judged(scenario, "closed", [("timing", ())]) == WRONG
        assert heading_errors(scenario, {}) is None
    assert {s.factor for s in every} == set(FACTORS)
    manifest = seal(tmp_path, every[:2], outside=outside.effects)
    assert manifest["scenarios"] == fingerprint(every[:2])


def test_an_effect_changes_what_it_says_and_nothing_else() -> None:
    recording = simulate("wide", 20, seed=1, channels=CHANNELS).recording
    shifted = changed(
        recording, "x", lambda arrays, factor, random: {"angular_rate": arrays["angular_rate"] + factor}, 2.0, 1
    )
    np.testing.assert_allclose(shifted.angular_rate, recording.angular_rate + 2.0)
    np.testing.assert_array_equal(shifted.magnetic_field, recording.magnetic_field)
    warm = changed(recording, "x", lambda a, f, r: {"channel temperature": a["channel temperature"] + 1}, 1.0, 1)
    np.testing.assert_allclose(warm.channels["temperature"], recording.channels["temperature"] + 1)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda a, f, r: None, "must return a dictionary of arrays"),
        (lambda a, f, r: {"time": a["time"]}, "is not one of"),
        (lambda a, f, r: {"magnetic_field": a["time"]}, "of shape"),
        (lambda a, f, r: {"magnetic_field": a["magnetic_field"] * np.nan}, "must be finite"),
        (lambda a, f, r: {"magnetic_field": a["magnetic_field"] * 1e6}, "mine.effect: .* likely unit: µT"),
        (lambda a, f, r: {}, "mine.effect: changes nothing at factor 1"),
        (lambda a, f, r: {"magnetic_field": a["magnetic_field"]}, "changes nothing"),
        (lambda a, f, r: 1 / 0, "ZeroDivisionError"),
    ],
)
def test_what_no_recording_can_hold_is_refused(given: object, said: str) -> None:
    recording = simulate("wide", 20, seed=1).recording
    with pytest.raises(MagycError, match=said):
        changed(recording, "mine.effect", given, 1.0, 1)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "said"), [("", "holds no function"), ("import nowhere", "must run by itself"), (None, "Python file")]
)
def test_files_without_effects_are_refused(
    tmp_path: Path, text: str | None, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / ("mine.txt" if text is None else "mine.py")
    path.write_text(text or "", encoding="utf-8")
    assert main(["study", "gap", "--foreign", str(path), "-o", str(tmp_path / "out")]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert main(["study", "gap", "--foreign", str(EXAMPLE), "--set", "none", "-o", str(tmp_path / "out")]) == 2
    assert "has no effect with --foreign" in capsys.readouterr().err
