"""Every command says which stretch of a log it left out because an axis was stuck, also where it has no result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.io import write_mcap

EVERY = "left out: magnetic_field: axes x, y, z are stuck at "
ONE = "left out: magnetic_field: axis x of the magnetometer is stuck at "


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Logs whose magnetometer hangs on some axes for a share of the time."""
    folder, found = tmp_path_factory.mktemp("stuck"), {}
    for name, seed, axes, share in (("all", 3, (0, 1, 2), 0.9), ("part", 4, (0,), 0.4), ("most", 5, (0,), 0.9)):
        recording = mg.simulate("wide", 900, 10, seed=seed).recording
        field = np.array(recording.magnetic_field)
        start = len(field) // 20
        for axis in axes:
            field[start : start + int(share * len(field)), axis] = field[start, axis]
        found[name] = folder / f"{name}.mcap"
        write_mcap(found[name], replace(recording, attitude=None, magnetic_field=field, name=name))
    return found


@pytest.mark.parametrize(("name", "said"), [("all", EVERY), ("part", ONE)])
@pytest.mark.parametrize("command", ["calibrate", "gap"])
def test_batch_commands(
    name: str, said: str, command: str, logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ["--candidates", "timing"] if command == "gap" else []
    assert main([command, str(logs[name]), "-o", str(tmp_path / "out"), *more]) == 0
    assert said in capsys.readouterr().out


def test_gap_of_many_logs(logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    named = [str(logs["all"]), str(logs["part"])]
    assert main(["gap", *named, "--candidates", "timing", "-o", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert f"all: {EVERY}" in told
    assert f"part: {ONE}" in told
    assert EVERY in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "said"), [("all", EVERY), ("part", ONE), ("most", ONE)])
def test_online(
    name: str, said: str, logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = main(["online", str(logs[name]), "-o", str(tmp_path / "out.yaml")])
    told = capsys.readouterr().out
    assert code == int("Do not use" in told)
    assert said in told
    assert ("samples (those of faulty sensors, stamps that repeat" in told) == (name != "all")


def test_history(logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    assert main(["history", str(logs["all"]), str(logs["part"]), "-o", str(folder)]) == 0
    told = capsys.readouterr().err
    assert f"note: all.mcap: {EVERY}" in told
    assert f"note: part.mcap: {ONE}" in told
    assert EVERY in (folder / "report.html").read_text(encoding="utf-8")
    again = mg.History.load(folder / "history.yaml")
    assert [len(factor.left_out) for factor in again.factors] == [1, 1]
