"""A folder of results that is named again: a refused run leaves it, and any other replaces what was there."""

from __future__ import annotations

from pathlib import Path

import pytest

import magyc_gtsam as mg
from magyc_gtsam.cli import main
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
