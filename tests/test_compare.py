"""`compare`: every method on one recording, its files, its page and its exit codes."""

from __future__ import annotations

import csv
import io
import json
import logging
import os
import re
import signal
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import run
from test_report import drawn_figures

import magyc_gtsam as mg
from magyc_gtsam import cli, estimators
from magyc_gtsam.io import write_mcap
from magyc_gtsam.report import compare_page, compare_words
from magyc_gtsam.report.compare_page import render_comparison
from magyc_gtsam.study import comparison as module
from magyc_gtsam.study import judging
from magyc_gtsam.study.comparison import compare
from magyc_gtsam.study.judging import UNCALIBRATED
from magyc_gtsam.study.outcome import Comparison, MethodOutcome, OutcomeStatus, heading_error

HOSTILE = "<script>document.title = 'taken'</script>"
QUICK = ("smoother", "magfactor3", "sar-ls", "ellipsoid", "autocal")


def crash(recording: mg.Recording, *, progress: Any = None) -> mg.Calibration:
    """A method with a defect."""
    raise ZeroDivisionError("a defect of the method")


def doubt(recording: mg.Recording, *, progress: Any = None) -> mg.Calibration:
    """A method that does not trust its own result."""
    return mg.Calibration(np.eye(3), np.array([1e-6, 0, 0]), converged=False, message="no luck")


@pytest.fixture(scope="module")
def dive() -> mg.Simulation:
    return mg.simulate("dive", 240, seed=3, delay=0.05)


@pytest.fixture(scope="module")
def compared(dive: mg.Simulation) -> Comparison:
    return compare(dive.recording, QUICK)


@pytest.fixture
def two_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two methods in the registry that crash and doubt."""
    for name in ("crash", "doubt"):
        method = estimators.Method(name, "none", (), f"{__name__}:{name}")
        monkeypatch.setitem(estimators._METHODS, name, method)


def outcome(comparison: Comparison, name: str) -> module.Outcome:
    return next(o for o in comparison.outcomes if o.method == name)


def test_each_row_is_what_calibrate_gives(dive: mg.Simulation, compared: Comparison) -> None:
    assert [o.method for o in compared.outcomes] == list(QUICK)
    for o in compared.outcomes:
        alone = mg.calibrate(dive.recording, o.method)
        assert o.calibration is not None
        np.testing.assert_array_equal(o.calibration.hard_iron, alone.hard_iron)
        assert (o.status is not OutcomeStatus.UNTRUSTED) == alone.converged
        if o.status is not OutcomeStatus.DOUBTFUL:
            assert o.reason.startswith(alone.message)
        norm = np.linalg.norm(alone.apply(dive.recording.magnetic_field), axis=1)
        assert o.spread == pytest.approx(norm.std())
        assert o.seconds is not None
        assert o.seconds > 0
    assert compared.raw.spread == pytest.approx(np.linalg.norm(dive.recording.magnetic_field, axis=1).std())


def test_one_delay_for_all_headings(dive: mg.Simulation, compared: Comparison) -> None:
    assert compared.delay_from == "smoother"
    assert compared.delay == pytest.approx(0.05, abs=0.03)
    for o in compared.outcomes:
        assert o.heading is not None
        assert o.calibration is not None
        again = heading_error(dive.recording, o.calibration, compared.delay)
        np.testing.assert_array_equal(o.heading.error, again.error)
    truth = heading_error(dive.recording, dive.truth)
    smoother, raw = outcome(compared, "smoother").heading, compared.raw.heading
    assert smoother is not None
    assert raw is not None
    assert smoother.deviation == pytest.approx(truth.deviation, rel=0.15)
    assert raw.deviation > 5 * truth.deviation


def test_heading_of_a_known_error() -> None:
    """A hard iron across a level turn: arcsin(h/H) at most, and nothing after it is gone."""
    time = np.arange(1000) / 10
    turn = np.linspace(0, 4 * np.pi, 1000)
    half = np.stack([0 * turn, 0 * turn, np.sin(turn / 2), np.cos(turn / 2)], axis=1)
    field = np.stack([20e-6 * np.cos(turn), -20e-6 * np.sin(turn), 40e-6 + 0 * turn], axis=1)
    recording = mg.Recording(time, field + [2e-6, 0, 0], attitude=half)
    error = heading_error(recording, UNCALIBRATED)
    assert np.abs(error.error).max() == pytest.approx(np.rad2deg(np.arcsin(0.1)), rel=0.02)
    clean = heading_error(recording, mg.Calibration(np.eye(3), [2e-6, 0, 0]))
    assert clean.deviation < 1e-6
    with pytest.raises(mg.MagycError, match="no reference attitude"):
        heading_error(mg.Recording(time, field), UNCALIBRATED)


def test_all_registered_methods_are_there_and_what_is_missing_is_said(dive: mg.Simulation) -> None:
    bare = replace(dive.recording, angular_rate=None, attitude=None, acceleration=None)
    result = compare(bare.between(0, 60))
    assert [o.method for o in result.outcomes] == list(mg.methods())
    for o in result.outcomes:
        needs = mg.methods()[o.method].needs
        assert (o.status is OutcomeStatus.IMPOSSIBLE) == bool(needs)
        if "angular_rate" in needs:
            assert "a gyroscope" in o.reason
        if "attitude" in needs:
            assert "a reference attitude" in o.reason
    assert result.raw.heading is None


def test_a_log_that_allows_nothing_has_a_page(dive: mg.Simulation) -> None:
    result = compare(replace(dive.recording, angular_rate=None), ("smoother", "sar-ls"))
    assert result.calibrated == result.trusted == ()
    page = render_comparison(result)
    assert "This log allows none of the methods" in page
    assert "smoother is not possible: needs a gyroscope" in page


def test_a_method_that_fails_stops_nobody(dive: mg.Simulation, two_more: None) -> None:
    seen: list[tuple[str, float]] = []
    result = compare(
        dive.recording, ("crash", "doubt", "smoother"), progress=lambda name, share: seen.append((name, share))
    )
    assert [o.status for o in result.outcomes] == [
        OutcomeStatus.FAILED,
        OutcomeStatus.UNTRUSTED,
        OutcomeStatus.TRUSTED,
    ]
    assert outcome(result, "crash").reason == "ZeroDivisionError: a defect of the method"
    assert outcome(result, "doubt").reason == "no luck"
    assert ("smoother", 1.0) in seen
    assert "crash failed: ZeroDivisionError: a defect of the method" in compare_words.remarks(result)
    wrong = "the axes disagree: " + "as given " * 20 + "; bring both to one frame (gyroscope_axes='y,x,-z')"
    result = replace(result, outcomes=(replace(outcome(result, "crash"), reason=wrong),))
    assert f"crash failed: {wrong}" in compare_words.remarks(result)  # whole, as the remedy comes last


def test_interrupting_stops_all(dive: mg.Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*arguments: Any, **options: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "calibrate", interrupt)
    with pytest.raises(KeyboardInterrupt):
        compare(dive.recording, ("sar-ls",))


def test_an_interrupt_keeps_what_is_done(
    dive: mg.Simulation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, here: Callable[..., tuple[int, str, str]]
) -> None:
    """Ctrl-C inside a graph's optimiser, which ends with its best values, and outside of one."""
    write_mcap("dive.mcap", dive.recording)
    asked = ("sar-ls", "magyc-bfg", "magyc-ifg", "ellipsoid")
    ordinary = estimators.calibrate

    def interrupted_in(method: str) -> None:
        def calibrate(recording: mg.Recording, name: str, *, progress: Any, **options: Any) -> mg.Calibration:
            def stop(share: float) -> None:
                if 0 < share < 1 and name == method:
                    raise KeyboardInterrupt
                progress(share)

            return ordinary(recording, name, progress=stop, **options)

        monkeypatch.setattr(module, "calibrate", calibrate)

    for method, done in (("magyc-bfg", 2), ("magyc-ifg", 2), ("ellipsoid", 4)):
        interrupted_in(method)
        result = compare(dive.recording, asked)
        assert [o.method for o in result.outcomes] == list(asked[:done])
        assert result.not_run == asked[done:]
        assert result.interrupted == (method != "ellipsoid")  # which has no share between 0 and 1
    interrupted_in("magyc-bfg")
    code, _, error = here("compare", "dive.mcap", "--methods", ",".join(asked), "-o", "out", "--quiet")
    assert code == 130
    assert error == "magyc-gtsam: interrupted; the methods that had finished are in out\n"
    data = json.loads(Path("out/comparison.json").read_text(encoding="utf-8"))
    assert [o["method"] for o in data["outcomes"]] == ["raw", "sar-ls", "magyc-bfg"]
    assert data["not_run"] == ["magyc-ifg", "ellipsoid"]
    assert "Interrupted before magyc-ifg, ellipsoid." in Path("out/report.html").read_text(encoding="utf-8")


def test_an_interrupt_while_the_page_is_drawn_is_held(
    dive: mg.Simulation, monkeypatch: pytest.MonkeyPatch, here: Callable[..., tuple[int, str, str]]
) -> None:
    write_mcap("dive.mcap", dive.recording)
    times = 1

    def drawn(comparison: Comparison) -> str:
        for _ in range(times):
            os.kill(os.getpid(), signal.SIGINT)
        return "page"

    monkeypatch.setattr(compare_page, "render_comparison", drawn)
    arguments = ("compare", "dive.mcap", "--methods", "sar-ls", "-o", "out", "--quiet")
    assert here(*arguments)[0] == 130
    assert Path("out/report.html").read_text(encoding="utf-8") == "page"
    times = 2  # who insists is heard
    code, _, error = here(*arguments[:-2], "again", "--quiet")
    assert code == 130
    assert "no file is left half written" in error
    assert not Path("again").exists()


def test_an_interrupt_while_the_methods_are_judged_is_held(
    dive: mg.Simulation, monkeypatch: pytest.MonkeyPatch, here: Callable[..., tuple[int, str, str]]
) -> None:
    """After the last method was done: its result took the time and is written."""
    write_mcap("dive.mcap", dive.recording)
    ordinary = judging._judged

    def interrupted(recording: mg.Recording, result: MethodOutcome, *more: Any) -> MethodOutcome:
        if result.method == "ellipsoid":
            os.kill(os.getpid(), signal.SIGINT)
        return ordinary(recording, result, *more)

    monkeypatch.setattr(judging, "_judged", interrupted)
    code, _, error = here("compare", "dive.mcap", "--methods", "sar-ls,ellipsoid", "-o", "out", "--quiet")
    assert code == 130
    assert error == "magyc-gtsam: interrupted; the methods that had finished are in out\n"
    data = json.loads(Path("out/comparison.json").read_text(encoding="utf-8"))
    assert [o["method"] for o in data["outcomes"]] == ["raw", "sar-ls", "ellipsoid"]
    assert all(o["field_spread_T"] is not None for o in data["outcomes"])
    assert Path("out/report.html").exists()


def test_names_are_checked() -> None:
    recording = mg.simulate("wide", 30).recording
    with pytest.raises(mg.MagycError, match="'magic' is not one of smoother"):
        compare(recording, ("magic",))
    with pytest.raises(mg.MagycError, match="'sar-ls' is given twice"):
        compare(recording, ("sar-ls", "sar-ls"))


def test_long_recordings_are_thinned_for_methods_without_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_SAMPLES", 1000)
    recording = mg.simulate("wide", 240, seed=1).recording
    result = compare(recording, ("ellipsoid", "sar-ls"))
    assert outcome(result, "ellipsoid").note == "800 of 2,400 samples, evenly spaced"
    assert outcome(result, "sar-ls").note == ""
    assert "ellipsoid: 800 of 2,400 samples, evenly spaced" in compare_words.remarks(result)
    alone = mg.calibrate(recording.rows(slice(None, None, 3)), "ellipsoid")
    ellipsoid = outcome(result, "ellipsoid").calibration
    assert ellipsoid is not None
    np.testing.assert_array_equal(ellipsoid.hard_iron, alone.hard_iron)


def test_outliers_are_told_apart() -> None:
    recording = mg.simulate("wide", 240, seed=3).recording
    field = recording.magnetic_field.copy()
    wrong = np.random.default_rng(1).choice(len(field), 60, replace=False)
    field[wrong] += 40e-6
    result = compare(replace(recording, magnetic_field=field), ("ellipsoid", "autocal"))
    assert result.inlier_from == "autocal"
    fresh = result.recording.magnetic_field_fresh
    assert fresh.all()
    assert (~result.inlier[wrong]).mean() > 0.95
    assert result.inlier[np.setdiff1d(np.arange(len(field)), wrong)].mean() > 0.99
    autocal = outcome(result, "autocal")
    assert autocal.inlier_spread is not None
    assert autocal.spread is not None
    assert autocal.inlier_spread < 0.3 * autocal.spread
    assert "of inliers" in compare_words.result_header(result)
    assert any("samples lie off the ellipsoid of autocal" in s for s in compare_words.footnotes(result))


def test_doubts_that_a_method_has_not_itself(compared: Comparison) -> None:
    """The dive's soft iron moves the hard iron of those that have none, and their spread does not show it."""
    assert compared.reference is outcome(compared, "smoother")
    apart = outcome(compared, "magfactor3")
    assert apart.status is OutcomeStatus.DOUBTFUL
    assert apart not in compared.trusted
    assert "from that of smoother" in apart.reason
    assert any(
        remark.startswith("magfactor3 doubtful: its hard iron") for remark in compare_words.remarks(compared)
    )


def test_what_the_smoother_finds_in_the_log_is_a_doubt_of_every_method() -> None:
    """A jump of 9 µT: four methods stated the mean of both irons, and one of them was recommended."""
    recording = mg.simulate("wide", 300, 20, seed=3).recording
    step = np.where(recording.time[:, None] >= 150.0, [5e-6, 0.0, -8e-6], 0.0)
    jumped = replace(recording, attitude=None, magnetic_field=recording.magnetic_field + step)
    named = ("smoother", "wu-shi", "autocal", "sar-ls")
    result = compare(jumped, named)
    assert result.trusted == ()
    reason = outcome(result, "wu-shi").reason
    assert reason.startswith(
        "smoother, which tests its model, does not trust this log: the field or the instrument"
    )
    late = recording.time + 0.001 * recording.time  # a clock says nothing about methods without the gyroscope
    apart = mg.Recording.from_streams((late, recording.magnetic_field), (recording.time, recording.angular_rate))
    result = compare(apart, named)
    assert [each.method for each in result.trusted] == ["wu-shi", "autocal"]
    assert outcome(result, "smoother").reason.startswith("the magnetometer's clock gains")


def test_a_gyroscope_bias_that_contradicts_is_doubted(dive: mg.Simulation, compared: Comparison) -> None:
    """By many sigmas of both, however well the field fits; as far as both are known it is not."""
    smoother = outcome(compared, "smoother")
    assert smoother.calibration is not None
    off = replace(smoother.calibration, gyro_bias=smoother.calibration.gyro_bias + [5e-3, 0, 0], method="autocal")
    ran = [replace(smoother), replace(smoother, method="autocal", calibration=off)]
    judged = module.judge(dive.recording, ["smoother", "autocal"], ran)
    assert judged.recommended is not None
    assert judged.recommended.method == "smoother"
    assert [o.status for o in judged.outcomes] == [OutcomeStatus.TRUSTED, OutcomeStatus.DOUBTFUL]
    reason = judged.outcomes[1].reason
    assert re.search(r"its gyroscope bias is 5 mrad/s from that of smoother, \d+ sigmas of both", reason)
    wide = replace(off, covariance=1e4 * off.covariance)
    ran = [ran[0], replace(ran[1], calibration=wide)]
    assert len(module.judge(dive.recording, ["smoother", "autocal"], ran).trusted) == 2


def test_a_field_that_varies_more_than_before_is_doubted(dive: mg.Simulation, compared: Comparison) -> None:
    """Where the errors that the method states do not explain it; what they do explain is no sign of an error."""
    smoother = outcome(compared, "smoother").calibration
    assert smoother is not None
    level = replace(dive.recording, magnetic_field=smoother.apply(dive.recording.magnetic_field))
    bent = np.diag([1.08, 1.0, 1 / 1.08])
    for deviation, expected in ((1e-3, OutcomeStatus.DOUBTFUL), (3e-2, OutcomeStatus.TRUSTED)):
        covariance = np.diag([*[deviation**2] * 6, *[(deviation * 50e-6) ** 2] * 3])
        calibration = mg.Calibration(bent, np.zeros(3), covariance=covariance)
        ran = [MethodOutcome("ellipsoid", OutcomeStatus.TRUSTED, "", calibration=calibration)]
        (judged,) = module.judge(level, ["ellipsoid"], ran).outcomes
        assert judged.status is expected
        assert ("varies more" in judged.reason) == (expected is OutcomeStatus.DOUBTFUL)


def test_the_files_agree_with_the_calibrations(compared: Comparison) -> None:
    rows = list(csv.DictReader(io.StringIO(compare_words.csv_text(compared))))
    data = json.loads(json.dumps(compare_words.to_dict(compared)))
    assert [row["method"] for row in rows] == ["raw", *QUICK]
    assert [o["method"] for o in data["outcomes"]] == ["raw", *QUICK]
    smoother = outcome(compared, "smoother").calibration
    assert smoother is not None
    row = rows[1]
    assert float(row["hard_iron_y_T"]) == smoother.hard_iron[1]
    assert float(row["hard_iron_y_T_sigma"]) == smoother.sigma["hard_iron"][1]
    assert float(row["soft_iron_xz"]) == smoother.soft_iron[0, 2]
    assert float(row["gyro_bias_z_rad/s"]) == smoother.gyro_bias[2]
    assert float(row["delay_s"]) == smoother.delay
    assert row["status"] == "trusted"
    magfactor3 = rows[2]
    assert magfactor3["hard_iron_x_T_sigma"] == magfactor3["gyro_bias_x_rad/s"] == magfactor3["delay_s"] == ""
    again = mg.Calibration.from_dict(data["outcomes"][1]["calibration"])
    np.testing.assert_array_equal(again.hard_iron, smoother.hard_iron)


def test_counts_stay_counts() -> None:
    """Unit-free methods only; the same numbers as in tesla but for the unit, and nowhere a µT."""
    simulation = mg.simulate("wide", 60, 5, seed=4)
    per_count = 2.5e-7
    plain = replace(simulation.recording, angular_rate=None, attitude=None, acceleration=None)
    counts = replace(plain, magnetic_field=plain.magnetic_field / per_count, magnetic_field_unit="counts")
    result, in_tesla = compare(counts), compare(plain)
    ran = [o for o in result.outcomes if o.status is not OutcomeStatus.IMPOSSIBLE]
    assert result.trusted
    for o in ran:
        twin = outcome(in_tesla, o.method)
        assert (o.method, o.status) == (twin.method, twin.status)
        if o.status is OutcomeStatus.TRUSTED:
            assert o.calibration is not None
            assert twin.calibration is not None
            assert o.calibration.configuration["magnetic_field_unit"] == "counts"
            np.testing.assert_allclose(o.calibration.soft_iron, twin.calibration.soft_iron, rtol=1e-3, atol=1e-4)
            np.testing.assert_allclose(o.calibration.hard_iron * per_count, twin.calibration.hard_iron, atol=1e-8)
    few = tuple(o for o in result.outcomes if o.method in ("smoother", "ellipsoid"))
    assert "µT" not in render_comparison(replace(result, outcomes=few))
    assert "µT" not in json.dumps(compare_words.to_dict(result), ensure_ascii=False)
    assert "hard_iron_x_counts" in compare_words.csv_text(result)
    assert "_T" not in compare_words.csv_text(result).splitlines()[0]
    for o in result.trusted:
        assert o.calibration is not None
        with pytest.raises(mg.MagycError, match="raw counts"):
            o.calibration.export("px4")


def test_counts_with_a_gyroscope_do_not_reach_methods_in_tesla() -> None:
    recording = mg.simulate("wide", 60, seed=2).recording
    counts = replace(recording, magnetic_field=recording.magnetic_field * 1e7, magnetic_field_unit="counts")
    with pytest.raises(mg.MagycError, match="needs the field in tesla"):
        mg.calibrate(counts)
    with pytest.raises(mg.MagycError, match="field_strength: needs the field in tesla"):
        mg.calibrate(counts, "ellipsoid", field_strength=50e-6)
    result = compare(counts, ("smoother", "sar-ls"))
    assert {o.reason for o in result.outcomes} == {"needs the field in tesla"}
    with pytest.raises(mg.MagycError, match="must be 'T' or 'counts'"):
        replace(recording, magnetic_field_unit="gauss")


@pytest.fixture
def here(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., tuple[int, str, str]]]:
    """The command line in this process: exit code, output and errors; `main` silences the libraries for good."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        code = cli.main([str(a) for a in arguments])
        shown = capsys.readouterr()
        return code, shown.out, shown.err

    with warnings.catch_warnings():
        yield call
    logging.disable(logging.NOTSET)


def test_command(dive: mg.Simulation, tmp_path: Path) -> None:
    write_mcap(tmp_path / "dive.mcap", dive.recording)
    asked = ("--methods", "smoother, sar-ls,ellipsoid", "--start", 10, "--field-strength", 50)
    result = run("compare", tmp_path / "dive.mcap", *asked, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    (folder,) = (tmp_path / "results").iterdir()
    assert folder.name.startswith("dive-compare-")
    assert {f.name for f in folder.iterdir()} == {
        "comparison.csv",
        "comparison.json",
        "configuration.yaml",
        "report.html",
    }
    for text in (
        "raw",
        "smoother",
        "sar-ls",
        "ellipsoid",
        "hard iron (µT)",
        "heading (°)",
    ):
        assert text in result.stdout
    assert result.stdout.startswith("✔ Use smoother: ")
    table = result.stdout.split("\n\n")[1].splitlines()
    assert [row.split()[0] for row in table[:3]] == ["method", "raw", "smoother"]
    assert max(map(len, table)) <= 80
    configuration = yaml.safe_load((folder / "configuration.yaml").read_text(encoding="utf-8"))
    assert configuration["methods"] == ["smoother", "sar-ls", "ellipsoid"]
    assert configuration["field_strength"] == pytest.approx(50e-6)
    assert configuration["interval"][0] == pytest.approx(10.0)
    data = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    assert data["outcomes"][1]["calibration"]["field_strength"] == pytest.approx(50e-6)


def test_command_on_raw_counts(here: Callable[..., tuple[int, str, str]]) -> None:
    field = mg.simulate("wide", 60, seed=2).recording.magnetic_field
    np.savetxt("raw.txt", np.round(field * 4e6), fmt="%d")
    read = ("raw.txt", "--read", "columns=mx,my,mz", "--read", "rate=10", "--magnetic-unit", "counts")
    code, output, _ = here("compare", *read, "--methods", "autocal,smoother", "--json")
    assert code in (0, 1)
    data = json.loads(output)
    assert data["magnetic_field_unit"] == "counts"
    assert data["outcomes"][2]["status"] == "not possible"
    assert "magnetic_field was read in counts, as requested" in data["notes"]
    code, _, error = here("calibrate", *read)
    assert code == 2
    assert "--magnetic-unit counts: a calibration needs the field in tesla" in error


def test_exit_codes(here: Callable[..., tuple[int, str, str]]) -> None:
    write_mcap("still.mcap", mg.simulate("survey", 30).recording)
    code, _, error = here("compare", "still.mcap", "--methods", "smoother,sar-ls", "--quiet")
    assert code == 1
    assert "no method gave a trusted result" in error
    for arguments, text in (
        (("--methods", "magic"), "'magic' is not one of"),
        (("--start", "20", "--end", "10"), "--start must be before --end"),
        (("--date", "2024-01-01"), "has no effect without a location"),
    ):
        code, output, error = here("compare", "still.mcap", *arguments, "-o", "out")
        assert (code, output) == (2, "")
        assert text in error
        assert error.count("\n") == 1
        assert not Path("out").exists()
    assert here("compare", "no.mcap")[0] == 2


def test_page(compared: Comparison, two_more: None, tmp_path: Path, opened: Any) -> None:
    """In a browser without a network: all figures drawn, nothing fetched, no sideways scroll, names escaped."""
    few = [outcome(compared, name) for name in ("smoother", "magfactor3")]
    bad = compare(compared.recording, ("crash", "doubt")).outcomes
    recording = replace(compared.recording, name=HOSTILE, notes=(HOSTILE,))
    file = tmp_path / "report.html"
    page_of = replace(compared, recording=recording, outcomes=(*few, *bad))
    file.write_text(render_comparison(page_of), encoding="utf-8")
    for width, scheme in ((1280, "light"), (390, "dark")):
        page = opened(file, width, scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert drawn_figures(page) == 3 * 3
    page = opened(file)
    assert page.locator("details.method[open]").count() == 1
    page.locator("#results a", has_text="doubt").click()
    page.wait_for_selector("#method-doubt[open]")
    drawn_figures(page)
    good = len(page_of.trusted)
    assert page.locator("#verdict h1").inner_text() == "Use smoother"
    assert f"{good} of 4 methods gave a result to trust" in page.inner_text("#verdict")
    assert page.title().startswith("Comparison on <script>")
    assert page.locator("details.method").count() == 3
    assert page.locator("#overview .dots i").count() == 3 * 3
    assert "crash failed: ZeroDivisionError: a defect of the method" in page.inner_text("main")
    assert "No luck" in page.inner_text("#method-doubt")
    assert "from that of smoother" in page.inner_text("#method-magfactor3")


@pytest.mark.real
def test_raw_counts_of_a_real_magnetometer(shared_data: Path) -> None:
    recording = mg.read(shared_data / "magnetometer_only.txt", columns="mx,my,mz", rate=10, magnetic_unit="counts")
    result = compare(recording, ("ellipsoid", "autocal", "smoother"))
    for name in ("ellipsoid", "autocal"):
        o = outcome(result, name)
        assert o.status is OutcomeStatus.TRUSTED, o.reason
        assert o.calibration is not None
        np.testing.assert_allclose(o.calibration.hard_iron, [-68.1, 82.8, -133.4], atol=1.0)
    assert outcome(result, "smoother").status is OutcomeStatus.IMPOSSIBLE
