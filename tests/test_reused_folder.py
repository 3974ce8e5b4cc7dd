"""A folder of results that is named again: a refused run leaves it, and any other replaces what was there."""

from __future__ import annotations

from pathlib import Path

import pytest

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.cli.own_files import EXPORTS
from magyc_gtsam.io import write_mcap

WRONG_OPTIONS = (
    ("--method", "smother"),
    ("--magnetic-unit", "gaus"),
    ("--magnetic-unit", "counts"),
    ("--gyroscope-scale", "15"),
    ("--gyroscope-axes", "x,y,y"),
    ("--window", "100"),
    ("--option", "smooth=3"),
    ("--magnetic-field", "/compass"),  # only the logs tell that they lack it
    ("--start", "900"),
)


@pytest.fixture(scope="module")
def dives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two dives, and a log without motion beside them."""
    folder = tmp_path_factory.mktemp("logs")
    (folder / "dives").mkdir()
    for seed in (1, 2):
        write_mcap(folder / "dives" / f"{seed}.mcap", mg.simulate("wide", 120, 10, seed=seed).recording)
    write_mcap(folder / "still.mcap", mg.simulate("tiny", 30, 10).recording)
    return folder


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 1)


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder without the parts that only spare time."""
    files = (file for file in sorted(folder.rglob("*")) if file.is_file() and ".parts" not in file.parts)
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def test_a_refused_run_leaves_the_results_of_many_logs(
    dives: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A misspelled option deleted the calibrations of a whole season."""
    season = tmp_path / "season"
    command = ["calibrate", str(dives / "dives"), "-q", "-o"]
    assert main([*command, str(season)]) == 0
    before = contents(season)
    assert {"1/calibration.yaml", "2/px4.params", "calibrations.csv", "index.html"} <= before.keys()
    capsys.readouterr()
    for words in WRONG_OPTIONS:
        assert main([*command, str(season), *words]) == 2
        assert contents(season) == before, words
        assert main([*command, str(tmp_path / "made" / "new"), *words]) == 2
        assert [path.name for path in tmp_path.iterdir()] == ["season"], words
    capsys.readouterr()
    for command in ("history", "gap"):  # refused before the first log is read
        assert main([command, str(dives / "dives"), "-o", str(season), "--magnetic-unit", "gaus"]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert main(["history", str(dives / "dives"), "-o", str(season), "--gyroscope-scale", "15"]) == 2
    assert "--gyroscope-scale: must be 0 or more and below 10 %, got 15" in capsys.readouterr().err
    assert contents(season) == before


def test_a_part_of_a_run_with_other_options_is_not_taken_up(dives: Path, tmp_path: Path) -> None:
    """The table told of the first run, and the folders held the results of the second."""
    pytest.importorskip("pyarrow")
    season = tmp_path / "season"
    command = ["calibrate", str(dives / "dives"), "-q", "-o", str(season)]
    assert main(command) == 0
    first = (season / "1" / "calibration.yaml").read_bytes()
    assert main([*command, "--window", "0.8"]) == 0
    assert main(command) == 0
    assert (season / "1" / "calibration.yaml").read_bytes() == first


def test_a_run_replaces_what_any_command_wrote(dives: Path, tmp_path: Path) -> None:
    """The page and the parameters of an earlier log stayed beside a result that must not be trusted."""
    good, still = str(dives / "dives" / "1.mcap"), str(dives / "still.mcap")
    both, folder = str(dives / "dives"), tmp_path / "results"
    one = ["calibration.yaml", "configuration.yaml", "report.html"]
    runs: dict[str, tuple[list[str], int, list[str]]] = {
        "pdf": (["calibrate", good, "--pdf"], 0, [*one, *EXPORTS.values(), "report.pdf"]),
        "untrusted": (["calibrate", still], 1, one),
        "history": (["history", both], 0, ["history.yaml", "next.yaml", "report.html", *EXPORTS.values()]),
        "gap": (["gap", good, "--candidates", "timing"], 0, [*one, "gap.json"]),
        "gaps": (
            ["gap", both, "--candidates", "timing"],
            0,
            ["gap.json", "report.html", "calibrations/1.yaml", "calibrations/2.yaml"],
        ),
        "compare": (
            ["compare", good, "--methods", "smoother"],
            0,
            ["comparison.csv", "comparison.json", "configuration.yaml", "report.html"],
        ),
        "many": (["calibrate", both], 0, ["index.html", "calibrations.csv"]),
    }
    folder.mkdir()
    own = {"report.pdf", "index.html", "comparison.csv", "gap.json", "notes.txt", "calibration.yaml.bak"}
    for name in own:
        (folder / name).write_text("of the user")
    assert main(["calibrate", good, "-q", "-o", str(folder)]) == 0
    assert {name for name in own if (folder / name).read_text() == "of the user"} == own
    for name in own - {"notes.txt"}:
        (folder / name).unlink()
    for last in (
        "many",
        "untrusted",
        "pdf",
        "untrusted",
        "history",
        "gap",
        "gaps",
        "compare",
        "pdf",
        "gaps",
        "many",
    ):
        words, code, files = runs[last]
        assert main([*words, "-q", "-o", str(folder)]) == code
        there = {name for name in contents(folder) if name[:2] not in ("1/", "2/")}
        assert there - {"calibrations.parquet"} == {*files, "notes.txt"}, last
