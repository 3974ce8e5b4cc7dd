"""The installed command on small logs: files, numbers, exit codes, and one line for every mistake."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import pkgutil
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import COMMAND, Finished, installed, run

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.cli.own_files import EXPORTS
from magyc_gtsam.cli.reading import Reading, parse_pairs
from magyc_gtsam.cli.terminal import show
from magyc_gtsam.io import write_mcap
from magyc_gtsam.option_names import as_options
from magyc_gtsam.recording.axes import parse_axes
from magyc_gtsam.simulation import simulate

DATASETS = Path(__file__).parents[1] / "datasets"
FILES = {
    "calibration.yaml",
    "configuration.yaml",
    "report.html",
    "px4.params",
    "ardupilot.param",
    "vectornav.txt",
    "ros.yaml",
}
UNTRUSTED = {"calibration.yaml", "configuration.yaml", "report.html"}


def refused(result: Finished) -> str:
    """The one line of a command that was refused."""
    assert result.returncode == 2, result.stderr
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    assert result.stderr.count("\n") == 1
    return result.stderr


@pytest.fixture(scope="module")
def dive() -> mg.Simulation:
    return simulate("dive", duration=240, seed=3)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory, dive: mg.Simulation) -> Path:
    """Logs: dive, still (hardly any motion), field (no gyroscope; also as a table), zero, and a text that is none."""
    folder = tmp_path_factory.mktemp("logs")
    write_mcap(folder / "dive.mcap", dive.recording)
    write_mcap(folder / "still.mcap", simulate("survey", duration=30).recording)
    write_mcap(folder / "field.mcap", replace(dive.recording, angular_rate=None, acceleration=None))
    zeros = [f"{k / 10},0,0,0,{k % 7},{k % 5},{k % 3}" for k in range(20)]
    (folder / "zero.csv").write_text("\n".join(["time_s,mag_x_uT,mag_y_uT,mag_z_uT,gyro_x,gyro_y,gyro_z", *zeros]))
    (folder / "field.csv").write_text("time_s,mag_x_uT,mag_y_uT,mag_z_uT\n0,20,1,40\n1,22,2,41\n2,21,1,40\n")
    (folder / "text.csv").write_text("Dear diary,\ntoday nothing turned.\n")
    return folder


@pytest.fixture
def quiet_logging() -> Iterator[None]:
    """`main` silences the libraries of its process; here the process goes on."""
    yield
    logging.disable(logging.NOTSET)


@pytest.fixture(scope="module")
def result(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Finished, Path]:
    """The plainest call, and the folder it made."""
    cwd = tmp_path_factory.mktemp("plain")
    finished = installed("calibrate", logs / "dive.mcap", cwd=cwd)
    (folder,) = (cwd / "results").iterdir()
    return finished, folder


def agrees(calibration: mg.Calibration, truth: mg.Calibration, sigmas: float = 4.5) -> None:
    """All parameters lie within so many of their own standard deviations."""
    for name in ("soft_iron", "hard_iron", "gyro_bias"):
        error = np.abs(getattr(calibration, name) - getattr(truth, name))
        assert (error < sigmas * calibration.sigma[name]).all(), (name, error / calibration.sigma[name])


def test_calibrate(result: tuple[Finished, Path], dive: mg.Simulation, logs: Path) -> None:
    finished, folder = result
    assert finished.returncode == 0
    assert finished.stderr == ""
    assert re.fullmatch(r"dive-\d{8}-\d{6}", folder.name)
    assert {file.name for file in folder.iterdir()} == FILES
    assert [p.name for p in folder.parent.iterdir()] == [folder.name]  # no temporary directory is left

    calibration = mg.Calibration.load(folder / "calibration.yaml")
    agrees(calibration, dive.truth)
    assert calibration.converged
    assert re.match(
        r"✔ Calibrated: systematic heading error at most [\d.]+° \(1σ\); single samples [\d.]+° by sensor noise\n",
        finished.stdout,
    )
    for text in ("Hard iron (µT)", "±", str(folder.relative_to(folder.parents[1]))):
        assert text in finished.stdout

    configuration = yaml.safe_load((folder / "configuration.yaml").read_text(encoding="utf-8"))
    assert configuration["magyc_gtsam"] == mg.__version__
    assert configuration["method"] == "smoother"
    assert configuration["command"] == f"magyc-gtsam calibrate {logs / 'dive.mcap'}"
    assert configuration["log"]["sha256"] == hashlib.sha256((logs / "dive.mcap").read_bytes()).hexdigest()
    assert configuration["interval"] == [0.0, pytest.approx(239.9)]

    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("application/json") > 3
    for target, name in {"px4": "px4.params", "ros": "ros.yaml"}.items():
        assert (folder / name).read_text(encoding="utf-8") == calibration.export(target)


def test_calibrate_with_every_option(logs: Path, dive: mg.Simulation, tmp_path: Path) -> None:
    finished = run(
        *("calibrate", logs / "dive.mcap", "--output", "here", "--json", "--start", 20, "--end", 220),
        *("--magnetic-field", "/imu/mag", "--angular-rate", "/imu/data_raw", "--stamps", "log"),
        *("--field-strength", 48.5, "--noise", 1, 5, "--delay", 0, "--no-robust", "--window", 0.8),
        *("--option", "turn=0.2"),
        cwd=tmp_path,
    )
    assert finished.returncode == 0
    answer = json.loads(finished.stdout)
    assert answer["trusted"]
    assert {*answer["files"]} == FILES
    assert Path(answer["folder"]) == Path("here")
    calibration = mg.Calibration.from_dict(answer["calibration"])
    assert calibration.delay == 0
    assert calibration.field_strength == pytest.approx(48.5e-6)
    expected = {"window": 0.8, "turn": 0.2, "robust": False, "delay": 0.0, "field_strength": 48.5e-6}
    assert {k: calibration.configuration[k] for k in expected} == pytest.approx(expected)
    scale = dive.truth.field_strength / 48.5e-6
    agrees(calibration, replace(dive.truth, soft_iron=dive.truth.soft_iron * scale))
    configuration = yaml.safe_load((tmp_path / "here/configuration.yaml").read_text(encoding="utf-8"))
    assert configuration["interval"] == pytest.approx([20, 220])
    assert configuration["options"]["noise"] == pytest.approx([1e-6, 5e-3])
    assert configuration["reading"]["stamps"] == "log"

    again = run("calibrate", logs / "dive.mcap", "-o", ".", "-q", "--method", "magyc-bfg", cwd=tmp_path / "here")
    assert (again.returncode, again.stdout) == (1, "")  # this motion is too little for it
    assert {file.name for file in (tmp_path / "here").iterdir()} == UNTRUSTED
    assert mg.Calibration.load(tmp_path / "here/calibration.yaml").method == "magyc-bfg"


def test_a_configuration_is_read_back(logs: Path, tmp_path: Path) -> None:
    """The same calibration to the last bit; what is given beside it counts more."""
    given = (
        "--start",
        20,
        "--end",
        110,
        "--noise",
        1,
        5,
        "--delay",
        3.5,
        "--option",
        "turn=0.2",
        "--field-strength",
        48.5,
    )
    assert run("calibrate", logs / "dive.mcap", "-o", "first", "-q", *given, cwd=tmp_path).returncode == 0
    again = run("calibrate", "--config", "first/configuration.yaml", "-o", "again", "-q", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    first, second = (mg.Calibration.load(tmp_path / name / "calibration.yaml") for name in ("first", "again"))
    assert second.delay == pytest.approx(3.5e-3)
    np.testing.assert_allclose(second.hard_iron, first.hard_iron, rtol=1e-12)
    other = run(
        *("calibrate", "--config", "first/configuration.yaml", "-o", "other", "-v", "--pdf", "--delay", "auto"),
        cwd=tmp_path,
    )
    assert other.returncode == 0, other.stderr
    assert '"iterations"' in other.stdout
    other_part, rest = ("--start", 111, "--end", 180), ("--start", 181, "--end", 240)
    prior = ("--prior", "first/calibration.yaml", "--hard-iron-walk", 2, "--option", "turn=0.2", *other_part)
    assert run("calibrate", logs / "dive.mcap", "-o", "known", "-q", *prior, cwd=tmp_path).returncode == 0
    moved = tmp_path / "moved.mcap"
    shutil.copy(logs / "dive.mcap", moved)
    same_place = (tmp_path / "known/configuration.yaml").read_text(encoding="utf-8")
    (tmp_path / "moved.yaml").write_text(same_place.replace(str(logs / "dive.mcap"), str(moved)), encoding="utf-8")
    write_mcap(moved, mg.read(logs / "dive.mcap").between(0, 200))
    assert "--config: " in (said := refused(run("calibrate", "--config", "moved.yaml", "-q", cwd=tmp_path)))
    assert "restore the log, or name it" in said
    meant = run("calibrate", moved, "--config", "moved.yaml", "-q", cwd=tmp_path)
    assert meant.returncode == 0
    assert "moved.mcap is not the log of moved.yaml, only its options are used" in meant.stderr
    kept, new = (tmp_path / name / "calibration.yaml" for name in ("kept", "new"))
    repeated = ("calibrate", "--config", "known/configuration.yaml", "-q")
    assert run(*repeated, "-o", "kept", cwd=tmp_path).returncode == 0
    assert kept.read_text() == (tmp_path / "known/calibration.yaml").read_text()
    assert run(*repeated, "-o", "new", *rest, "--prior", "known/calibration.yaml", cwd=tmp_path).returncode == 0
    alone = mg.calibrate(mg.read(logs / "dive.mcap").between(181, 240), turn=0.2)
    assert (mg.Calibration.load(new).sigma["hard_iron"] < alone.sigma["hard_iron"]).all()
    assert mg.Calibration.load(tmp_path / "other" / "calibration.yaml").delay_sigma is not None
    assert (tmp_path / "other" / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    "written", ["options: {noise: 5}", "options: {delay: x}", "options: {field_strength: [1]}", "a: &x [1]\nb: *x",
                "reading: {}", "[" * 3000]
)  # fmt: skip
def test_a_configuration_of_another_kind(tmp_path: Path, written: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "configuration.yaml"
    path.write_text(f"reading: {{log: a.mcap}}\nmethod: smoother\n{written}\n")
    assert cli.main(["calibrate", "--config", str(path)]) == 2
    said = capsys.readouterr().err
    assert "--config" in said
    assert "internal error" not in said


def test_the_field_of_a_place(logs: Path, tmp_path: Path) -> None:
    place = ("--location", -33.4, -70.6, "--altitude", 500, "--date", "2024-06-01")
    finished = run("calibrate", logs / "dive.mcap", "-o", "here", "-q", *place, cwd=tmp_path)
    assert finished.returncode == 0
    strength = mg.Calibration.load(tmp_path / "here/calibration.yaml").field_strength
    assert strength == pytest.approx(23.0e-6, rel=0.02)  # the weak field of Santiago


def test_a_field_strength_in_tesla_is_told_by_its_option(logs: Path, tmp_path: Path) -> None:
    told = refused(run("calibrate", logs / "dive.mcap", "--field-strength", "50e-6", cwd=tmp_path))
    assert (
        "--field-strength: must be that of the Earth, 20 to 70 µT (8 to 175 µT is accepted), got 5e-05 µT" in told
    )
    assert told.endswith("is that tesla? give 50\n")
    refused(run("simulate", "wide", "-o", "x.mcap", "--field-strength", "nan", cwd=tmp_path))


def test_an_earlier_calibration_is_a_prior(logs: Path, tmp_path: Path) -> None:
    known = ("--misalignment", 0, "--gyroscope-scale", 1)
    run("calibrate", logs / "dive.mcap", "-o", "first", "-q", "--start", 61, *known, cwd=tmp_path)
    earlier = tmp_path / "first/calibration.yaml"
    again = run(
        "calibrate", logs / "dive.mcap", "-o", "second", "-q", "--prior", earlier, "--hard-iron-walk", 2, "--end", 60,
        *known, cwd=tmp_path,
    )  # fmt: skip
    assert again.returncode == 0, again.stderr
    first, second = (mg.Calibration.load(tmp_path / each / "calibration.yaml") for each in ("first", "second"))
    assert second.configuration["hard_iron_walk"] == pytest.approx(2e-6)
    assert second.configuration["gyroscope_scale"] == pytest.approx(0.01)
    assert np.all(np.abs(second.terms[-1].value) < 4 * second.terms[-1].sigma)  # of a perfect gyroscope
    assert (second.sigma["soft_iron"] < 1.1 * first.sigma["soft_iron"]).all()
    earlier.write_text(earlier.read_text().replace("converged: true", "converged: false"))
    doubted = run("calibrate", logs / "dive.mcap", "-o", "third", "--end", 60, "--prior", earlier, cwd=tmp_path)
    assert "note: the earlier calibration must not be trusted by itself" in doubted.stdout


def test_a_result_that_must_not_be_trusted(logs: Path, tmp_path: Path) -> None:
    finished = run("calibrate", logs / "still.mcap", "--output", "here", cwd=tmp_path)
    assert finished.returncode == 1
    assert "must not be trusted" in finished.stderr
    assert "motion" in finished.stderr or "observable" in finished.stderr
    assert finished.stderr.count("\n") == 1
    first = finished.stdout.splitlines()[0]
    assert first.startswith("✘ Do not use this calibration: ")
    reason = first.removeprefix("✘ Do not use this calibration: ")
    assert len(reason.split()) <= 30
    assert finished.stderr == f"magyc-gtsam: the result must not be trusted: {reason}\n"
    assert {file.name for file in (tmp_path / "here").iterdir()} == UNTRUSTED
    assert reason[1:] in (tmp_path / "here" / "report.html").read_text(encoding="utf-8")


def test_what_must_not_be_trusted_cannot_be_pasted(logs: Path, tmp_path: Path) -> None:
    """Parameters of an earlier run do not stay beside it, and what is forced holds comments only."""
    run("calibrate", logs / "dive.mcap", "-o", "here", "-q", cwd=tmp_path)
    assert {file.name for file in (tmp_path / "here").iterdir()} == FILES
    finished = run("calibrate", logs / "still.mcap", "-o", "here", "--json", cwd=tmp_path)
    assert finished.returncode == 1
    answer = json.loads(finished.stdout)
    assert not answer["trusted"]
    assert answer["verdict"]["sentence"].startswith("✘")
    assert finished.stderr.rstrip().endswith(f"{answer['verdict']['cause']}: {answer['verdict']['action']}")
    assert {file.name for file in (tmp_path / "here").iterdir()} == UNTRUSTED

    exported = run("export", "here/calibration.yaml", "px4", cwd=tmp_path)
    assert (exported.returncode, exported.stdout) == (1, "")
    assert "must not be trusted" in exported.stderr
    applied = run("apply", "here/calibration.yaml", logs / "dive.mcap", "-o", "out.csv", cwd=tmp_path)
    assert (applied.returncode, applied.stdout) == (1, "")
    assert not (tmp_path / "out.csv").exists()
    assert run(
        "apply", "here/calibration.yaml", logs / "dive.mcap", "-o", "out.csv", "--force", cwd=tmp_path
    ).stdout
    assert (tmp_path / "out.csv").exists()

    forced = run("calibrate", logs / "still.mcap", "-o", "forced", "--force", "-q", cwd=tmp_path)
    assert forced.returncode == 1
    for name in FILES - UNTRUSTED:
        lines = (tmp_path / "forced" / name).read_text(encoding="utf-8").splitlines()
        assert lines[0].startswith("# DO NOT USE: "), name
        assert not re.search(r"\w=[,:)]", lines[0]), name
        assert len(lines) > 5, name
        assert all(line.startswith("#") for line in lines), name


def test_the_heading_is_the_same_number_everywhere(result: tuple[Finished, Path]) -> None:
    finished, folder = result
    calibration = mg.Calibration.load(folder / "calibration.yaml")
    assert calibration.observability is not None
    assert calibration.observability.heading_sigma is not None
    number = f"{calibration.observability.heading_sigma:.2g}°"
    assert f"at most {number} (1σ)" in finished.stdout
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f"<b>{number}</b>" in page
    assert f"at most {number} (1σ)" in page


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("calibrate {logs}/none.mcap", "none.mcap: cannot be read"),
        ("calibrate", "Missing argument 'LOG'; see magyc-gtsam calibrate --help"),
        ("calibrate {logs}/dive.mcap -o {logs}/text.csv/deeper", "text.csv: expected a folder, this is a file"),
    ],
)
def test_one_line_on_standard_error(arguments: str, says: str, logs: Path, tmp_path: Path) -> None:
    assert says in refused(run(*arguments.format(logs=logs).split(), cwd=tmp_path))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("quiet_logging")
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("calibrate {logs}/text.csv", "text.csv"),
        ("calibrate {logs}/field.mcap", "no angular rate"),
        (
            "calibrate {logs}/dive.mcap --magnetic-unit furlong",
            "'furlong' is unknown; there are T, mT, uT, nT, gauss, mgauss, counts (--magnetic-unit)",
        ),
        ("calibrate {logs}/dive.mcap --magnetic-unit gauss", "is not a field in tesla"),
        ("calibrate {logs}/dive.mcap --method fluke", "'fluke' is not one of smoother"),
        ("calibrate {logs}/dive.mcap --magnetic-field /compass", "no topic '/compass'; the file has /imu/mag"),
        ("calibrate {logs}/dive.mcap --start 900", "interval from 900 s: holds 0 rows of a recording of 239.9 s"),
        ("calibrate {logs}/dive.mcap --start 9 --end 5", "--start must be before --end, got 9 s and 5 s"),
        ("calibrate {logs}/dive.mcap -o {logs}/text.csv", "text.csv: expected a folder, this is a file"),
        ("calibrate {logs}/dive.mcap --option smooth=3", "no option 'smooth'; it has"),
        ("calibrate {logs}/dive.mcap --option turn=much", "turn must be above 0 and below"),
        (
            "calibrate {logs}/dive.mcap --delay soon",
            "--delay: must be a number of milliseconds or 'auto', got 'soon'",
        ),
        ("calibrate {logs}/dive.mcap --delay 10001", "--delay: must be between -10000 and 10000 ms, got 10001"),
        (
            "calibrate {logs}/dive.mcap --noise 1e-6 0.005",
            "--noise: the magnetometer's must be at least 1e-05 µT, got 1e-06; if it is in SI units, give 1 µT",
        ),
        (
            "calibrate {logs}/dive.mcap --location 47 -o out",
            "'--location': needs 2 values (LAT LON), and '-o' comes",
        ),
        ("calibrate {logs}/dive.mcap --end 5", "dive.mcap: 4 windows of 1.5 s, at least 8 are needed"),
        ("calibrate {logs}/dive.mcap --end 5", "; 5.0 s of the log are used"),
        ("calibrate {logs}/dive.mcap --output=", "'--output' / '-o': must be a path, got ''"),
        ("apply none.yaml {logs}/dive.mcap --output=", "'--output' / '-o': must be a path, got ''"),
        ("export none.yaml px4 --output=", "'--output' / '-o': must be a path, got ''"),
        ("export none.yaml px4 -o {logs}", "none.yaml: no such file"),
        (
            "calibrate {logs}/dive.mcap --noise nan 1",
            "--noise: the magnetometer's must be above 0 and below 1000 µT",
        ),
        ("calibrate --config {logs}/none.yaml", "--config: "),
        ("calibrate --config {logs}/text.csv", "name a configuration.yaml"),
        ("calibrate {logs}/dive.mcap --location 1 2", "give --date YYYY-MM-DD too"),
        ("calibrate {logs}/dive.mcap --misalignment much", "must be a number of degrees from 0 to 45, or 'auto'"),
        ("calibrate {logs}/dive.mcap --prior nowhere.yaml", "no such file"),
        ("calibrate {logs}/dive.mcap --hard-iron-walk 2", "since an earlier calibration; give it"),
        ("calibrate {logs}/dive.mcap --misalignment -1", "number of degrees from 0 to 45, or 'auto', got '-1'"),
        (
            "calibrate {logs}/dive.mcap --soft-iron-walk -2",
            "--soft-iron-walk: must be 0 or more and below 1000 %, got -2",
        ),
        (
            "calibrate {logs}/dive.mcap --soft-iron-walk 2000",
            "--soft-iron-walk: must be 0 or more and below 1000 %",
        ),
        (
            "calibrate {logs}/dive.mcap --hard-iron-walk 2000000",
            "--hard-iron-walk: must be 0 or more and below 1000000 µT, got 2000000",
        ),
        ("calibrate {logs}/dive.mcap --gyroscope-scale 15", "--gyroscope-scale: must be 0 or more and below 10 %"),
        ("calibrate {logs}/dive.mcap --noise 1 20000", "the gyroscope's must be above 0 and below 10000 mrad/s"),
        (
            "calibrate {logs}/dive.mcap --heading h --heading-sigma 0 --location 1 2 --date 2024-06-01",
            "--heading-sigma: must be above 0 and below 180 degrees, got 0",
        ),
        ("calibrate {logs}/dive.mcap --window 100", "--window must be above 0 and below 60 s, got 100"),
        (
            "online {logs}/dive.mcap --hard-iron-walk 2000000",
            "--hard-iron-walk: must be 0 or more and below 1000000",
        ),
        ("calibrate {logs}/dive.mcap --gyroscope-axes x,y,y", "such as 'y,-x,z'"),
        ("calibrate {logs}/dive.mcap --angular-rate-is never", "'never' is not one of"),
        ("calibrate {logs}/dive.mcap --frobnicate", "No such option: --frobnicate"),
        ("frobnicate", "No such command 'frobnicate'"),
        ("apply {logs}/dive.mcap {logs}/dive.mcap -o out.csv", "dive.mcap: not a text file"),
        ("apply none.yaml {logs}/dive.mcap -o out.bag", "must end in .mcap or .csv"),
        ("apply none.yaml {logs}/dive.mcap -o {logs}/dive.mcap", "is the log itself"),
        ("export none.yaml px4", "none.yaml: no such file"),
        ("info {logs}/none.mcap", "none.mcap: cannot be read"),
        ("simulate waltz -o out.mcap", "'waltz' is not one of wide"),
        (
            "simulate wide -o out.mcap --hard-iron 1e9 0 0",
            "--hard-iron: must be from -1000 to 1000 µT, got 1e+09 0 0",
        ),
        (
            "simulate wide -o out.mcap --gyroscope-noise -1",
            "--gyroscope-noise: must be from 0 to 5000 mrad/s, got -1",
        ),
        ("calibrate {logs}/dive.mcap --option foo=1", "hard_iron_walk, heading"),
        (
            "calibrate {logs}/dive.mcap --option robust=huber",
            "kernels such as 'huber' are for the methods magyc-bfg",
        ),
        (
            "online {logs}/field.csv",
            "calibrate the magnetometer alone (`magyc-gtsam calibrate` with --method 'autocal')",
        ),
        ("calibrate {logs}/zero.csv", "zero in 100% of 20 rows, which no magnetometer measures; check that"),
        ("simulate dive -o out.mcap --rate 0", "--rate: must be more than 0, got 0"),
    ],
)
def test_one_line_for_every_mistake(
    arguments: str, says: str, logs: Path, mistaken: Callable[[str, str], None]
) -> None:
    before = set(logs.iterdir())
    mistaken(arguments.format(logs=logs), says)
    assert set(logs.iterdir()) == before


def test_interrupted(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> None:
    """While it reads and fits a log that takes it seconds: the folder for its results is made before it reads."""
    log = tmp_path_factory.mktemp("long") / "log.csv"
    rows = "".join(f"{0.01 * k:.2f},20e-6,{k % 7}e-6,40e-6,0.1,{k % 5}e-2,0.2\n" for k in range(100_000))
    log.write_text(f"time,mx,my,mz,gx,gy,gz\n{rows}")
    arguments = [COMMAND, "calibrate", str(log), "-o", "here/there"]
    with subprocess.Popen(
        arguments, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            while process.poll() is None and not (tmp_path / "here").is_dir():
                time.sleep(0.005)
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=120)
        finally:
            process.kill()
    assert process.returncode == 130
    assert errors == "magyc-gtsam: interrupted; no file is left half written\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("folder", ["new", "there"])
@pytest.mark.parametrize(
    "stage",
    [
        "magyc_gtsam.estimators.smoother.smoother.fit_field_chain",  # fitting
        "magyc_gtsam.cli.results.write_exports",  # writing: calibration.yaml is there, the page is not
        "magyc_gtsam.cli.results.write_page",
    ],
)
def test_interrupted_later(
    stage: str,
    folder: str,
    logs: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """While it fits, and while it writes into a new folder or one that is there: nothing of it is left."""
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "calibration.yaml").write_text("an earlier one", encoding="utf-8")
    ordinary = pkgutil.resolve_name(stage)

    def interrupted(*given: Any, **options: Any) -> Any:
        result = ordinary(*given, **options)
        os.kill(os.getpid(), signal.SIGINT)
        return result

    monkeypatch.setattr(stage, interrupted)
    assert cli.main(["calibrate", str(logs / "dive.mcap"), "-o", str(tmp_path / folder)]) == 130
    assert capsys.readouterr().err == "magyc-gtsam: interrupted; no file is left half written\n"
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["calibration.yaml", "there"]
    assert (tmp_path / "there" / "calibration.yaml").read_text(encoding="utf-8") == "an earlier one"


@pytest.mark.parametrize("suffix", ["mcap", "csv"])
def test_apply(
    suffix: str, result: tuple[Finished, Path], dive: mg.Simulation, logs: Path, tmp_path: Path
) -> None:
    file = result[1] / "calibration.yaml"
    calibration = mg.Calibration.load(file)
    shifted = tmp_path / "log.mcap"  # a log with a clock of its own, sensors of different rates and a channel
    streams = {
        "magnetic_field": (dive.recording.time[::3], dive.recording.magnetic_field[::3]),
        "angular_rate": (dive.recording.time, dive.recording.angular_rate),
    }
    depth = {"depth": (dive.recording.time[:-60:60], dive.recording.time[:-60:60] / 7)}
    write_mcap(shifted, mg.Recording.from_streams(**streams, channels=depth), epoch=1_700_000_000_123_456_789)
    finished = run("apply", file, shifted, "--output", f"out.{suffix}", cwd=tmp_path)
    assert finished.returncode == 0, finished.stderr
    raw, calibrated = mg.read(shifted), mg.read(tmp_path / f"out.{suffix}")
    assert np.array_equal(calibrated.time, raw.time)
    assert np.array_equal(calibrated.magnetometer.time, raw.magnetometer.time)
    assert np.array_equal(calibrated.magnetometer.value, calibration.apply(raw.magnetometer.value))
    assert np.array_equal(calibrated.gyroscope.value, calibration.apply_gyroscope(raw.gyroscope.value))
    assert np.array_equal(calibrated.channels["depth"], raw.channels["depth"], equal_nan=True)
    assert "1700000000.123456789 s" in " ".join(calibrated.notes)
    assert np.linalg.norm(calibrated.magnetic_field, axis=1).std() < 1.2e-6
    for second in (f"out.{suffix}", "twice.mcap"):
        again = refused(run("apply", file, f"out.{suffix}", "-o", second.replace("out", "twice"), cwd=tmp_path))
        assert "the field is calibrated already" in again
        assert "apply the calibration to the log as it was recorded" in again
    assert "calibrated already" in run("info", f"out.{suffix}", cwd=tmp_path).stdout
    help_text = " ".join(run("apply", "--help", cwd=tmp_path).stdout.split())
    assert "apply and history refuse it as a LOG" in help_text.replace("`", "")
    taken = run("calibrate", f"out.{suffix}", "-o", "of_output", cwd=tmp_path)  # by all others, with a note
    assert "note: the field is calibrated already" in taken.stdout, taken.stderr
    rest = tmp_path / "of_output"  # of the calibration before: neither exported nor applied
    for name in EXPORTS.values():
        assert "holds only the rest that the one before has left" in (rest / name).read_text(encoding="utf-8")
    assert "Paste the parameters" not in (rest / "report.html").read_text(encoding="utf-8")
    for words in (
        ("export", rest / "calibration.yaml", "ros"),
        ("apply", rest / "calibration.yaml", shifted, "-o", "a.csv"),
    ):
        assert "calibrate the log as it was recorded" in refused(run(*words, cwd=tmp_path))
    repeated = run("calibrate", "--config", rest / "configuration.yaml", "-o", "repeated", cwd=tmp_path)
    assert repeated.returncode == taken.returncode, repeated.stderr


def test_a_sentence_that_is_wrapped_keeps_its_indent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "40")
    long = "no parameter is determined by a motion that does not turn through all headings"
    show(f"  {long}", "verdict")
    *lines, last = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert all(line.startswith("  ") and not line.startswith("   ") for line in lines)
    assert " ".join(" ".join(lines).split()) == long
    assert last == "verdict"


def test_a_closed_output_leaves_the_exit_code(logs: Path, tmp_path: Path) -> None:
    command = ["sh", "-c", '"$@" >&-', "sh", COMMAND, "calibrate", str(logs / "still.mcap"), "-o", "out"]
    finished = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, encoding="utf-8", check=False)
    assert finished.returncode == 1, finished.stderr
    assert "the result must not be trusted" in finished.stderr


def test_a_result_is_no_log(result: tuple[Finished, Path], tmp_path: Path) -> None:
    for name in ("calibration.yaml", "configuration.yaml"):
        assert "a result of magyc-gtsam, not a log" in refused(run("calibrate", result[1] / name, cwd=tmp_path))


def test_apply_of_a_calibration_of_another_instrument(
    result: tuple[Finished, Path], logs: Path, tmp_path: Path
) -> None:
    own = mg.Calibration.load(result[1] / "calibration.yaml")
    replace(own, hard_iron=own.hard_iron + 4e-4).save(tmp_path / "other.yaml")
    finished = run("apply", "other.yaml", logs / "dive.mcap", "-o", "out.mcap", "-q", cwd=tmp_path)
    assert finished.returncode == 1
    assert finished.stdout == ""
    assert re.search(r"must not be trusted: apply: .* median strength of \d+ µT", finished.stderr)
    assert finished.stderr.endswith("; nothing was written, --force writes it\n")
    assert not (tmp_path / "out.mcap").exists()
    forced = run("apply", "other.yaml", logs / "dive.mcap", "-o", "out.mcap", "-q", "--force", cwd=tmp_path)
    assert forced.returncode == 1
    assert (tmp_path / "out.mcap").exists()


def test_apply_in_other_gyroscope_axes(result: tuple[Finished, Path], logs: Path, tmp_path: Path) -> None:
    file, option = result[1] / "calibration.yaml", ("--gyroscope-axes", "y,-x,z")
    turned = refused(run("apply", file, logs / "dive.mcap", *option, "-o", "out.csv", cwd=tmp_path))
    assert "leave out --gyroscope-axes" in turned
    own = mg.Calibration.load(file)
    replace(own, configuration={**own.configuration, "gyroscope_axes": "y,-x,z"}).save(tmp_path / "turned.yaml")
    unturned = refused(run("apply", "turned.yaml", logs / "dive.mcap", "-o", "out.csv", cwd=tmp_path))
    assert "--gyroscope-axes 'y,-x,z'" in unturned
    assert run("apply", "turned.yaml", logs / "dive.mcap", *option, "-o", "out.csv", cwd=tmp_path).returncode == 0


def test_export(result: tuple[Finished, Path], tmp_path: Path) -> None:
    file = result[1] / "calibration.yaml"
    for target in ("ardupilot", "vectornav"):
        finished = run("export", file, target, cwd=tmp_path)
        assert finished.returncode == 0
        assert finished.stdout == mg.Calibration.load(file).export(target)
    assert run("export", file, "px4", "-o", "px4.params", cwd=tmp_path).stdout == ""
    assert (tmp_path / "px4.params").read_bytes() == (result[1] / "px4.params").read_bytes()
    assert "'px3' is not one of 'px4'" in refused(run("export", file, "px3", cwd=tmp_path))


def test_the_command_line_as_a_module() -> None:
    command = [sys.executable, "-m", "magyc_gtsam", "--version"]
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (finished.returncode, finished.stdout) == (0, f"magyc-gtsam {mg.__version__}\n")


def test_info(logs: Path, tmp_path: Path) -> None:
    finished = run("info", logs / "dive.mcap", cwd=tmp_path)
    assert (finished.returncode, finished.stderr) == (0, "")
    for text in ("/imu/mag", "/imu/data_raw", "10.0", "can be read: yes;", "motion: the sensor turned by about"):
        assert text in finished.stdout
    answer = json.loads(run("info", logs / "still.mcap", "--json", cwd=tmp_path).stdout)
    assert answer["readable"]
    assert "sensor_msgs/msg/Imu" in {source["type"] for source in answer["sources"]}
    assert answer["turned"] < 1.0  # rad, the noise of 30 s
    assert {s["name"]: s["count"] for s in answer["sources"]}["/imu/mag"] == 300
    finished = run("info", logs / "field.mcap", cwd=tmp_path)
    assert finished.returncode == 0
    assert "can be read: yes, without a gyroscope" in finished.stdout
    finished = run("info", logs / "dive.mcap", "--magnetic-field", "/absent", cwd=tmp_path)
    assert finished.returncode == 0
    assert "can be read: no, " in finished.stdout
    assert "'/absent'" in finished.stdout


@pytest.mark.parametrize(("name", "turned"), [("ardusub_still.BIN", False), ("nexus5_calibration_d1.mcap", True)])
def test_info_of_real_logs(name: str, turned: bool, shared_data: Path, tmp_path: Path) -> None:
    finished = run("info", shared_data / name, "--json", cwd=tmp_path)
    assert finished.returncode == 0
    assert (json.loads(finished.stdout)["turned"] > 2 * np.pi) is turned


def test_info_does_not_calibrate() -> None:
    """Nor imports what only a calibration needs."""
    script = (
        "import sys; from magyc_gtsam.cli import main; main(sys.argv[1:]); "
        "print(*(m for m in ('magyc_gtsam.estimators', 'scipy', 'gtsam', 'matplotlib') if m in sys.modules), "
        "file=sys.stderr)"
    )
    dive = Path(__file__).parent.parent / "datasets" / "calibration_dive.mcap"
    for arguments in (("info", str(dive)), ("--help",)):
        finished = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True)
        assert (finished.returncode, finished.stderr.strip()) == (0, "")


def test_axes_that_differ(tmp_path: Path) -> None:
    """The message names the axes in words that the option takes."""
    dive = simulate("dive", duration=240, seed=3, magnetometer_noise=0.05e-6, gyroscope_noise=1e-3)
    turned = dive.recording.angular_rate[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    write_mcap(tmp_path / "log.mcap", replace(dive.recording, angular_rate=turned))
    message = refused(run("calibrate", "log.mcap", cwd=tmp_path))
    axes = re.search(r"with (x ← .*?z ← \S+)", message)
    assert axes, message
    assert "--gyroscope-axes" in message
    finished = run("calibrate", "log.mcap", "--gyroscope-axes", axes[1], "-q", "-o", "here", cwd=tmp_path)
    assert finished.returncode == 0
    agrees(mg.Calibration.load(tmp_path / "here/calibration.yaml"), dive.truth)


def test_a_table_without_header(dive: mg.Simulation, tmp_path: Path) -> None:
    rows = np.column_stack([dive.recording.magnetic_field * 1e6, np.degrees(dive.recording.angular_rate)])
    np.savetxt(tmp_path / "log.txt", rows)
    assert "--read columns=" in run("info", "log.txt", cwd=tmp_path).stdout
    finished = run(
        *("calibrate", "log.txt", "--read", "columns=mx,my,mz,gx,gy,gz", "--read", "rate=10"),
        *("--magnetic-unit", "uT", "--angular-unit", "deg/s", "-q", "-o", "here"),
        cwd=tmp_path,
    )
    assert finished.returncode == 0, finished.stderr
    agrees(mg.Calibration.load(tmp_path / "here/calibration.yaml"), dive.truth)


def test_simulate(tmp_path: Path) -> None:
    sensor = ("--field-strength", 50, "--hard-iron", -1, 2, 3, "--gyroscope-bias", 1, 2, -3, "--delay", 20)
    noise = ("--magnetometer-noise", 0.5, "--gyroscope-noise", 1)
    finished = run(
        "simulate", "wide", "-o", "a.mcap", "--duration", 30, "--seed", 7, *sensor, *noise, cwd=tmp_path
    )
    assert finished.returncode == 0
    truth = mg.Calibration.load(tmp_path / "a.truth.yaml")
    assert np.allclose(truth.hard_iron, [-1e-6, 2e-6, 3e-6])
    assert np.allclose(truth.gyro_bias, [1e-3, 2e-3, -3e-3])
    assert truth.delay == pytest.approx(0.02)
    assert dict(truth.noise) == pytest.approx({"magnetic_field": 0.5e-6, "angular_rate": 1e-3})
    recording = mg.read(tmp_path / "a.mcap")
    assert len(recording.time) == 300
    strength = np.linalg.norm(truth.apply(recording.magnetic_field), axis=1).mean()
    assert strength == pytest.approx(truth.field_strength, rel=0.01)


def test_datasets_are_what_their_commands_make(tmp_path: Path) -> None:
    text = (DATASETS / "README.md").read_text(encoding="utf-8")
    commands = re.findall(r"^magyc-gtsam (simulate .*)$", text, re.MULTILINE)
    for command in commands:
        assert run(*shlex.split(command), cwd=tmp_path).returncode == 0
    made = {file.name for file in tmp_path.iterdir()}
    assert made == {file.name for file in DATASETS.iterdir()} - {"README.md"}
    for file in DATASETS.glob("*.mcap"):
        assert file.stat().st_size < 1.5e6
        shipped, again = mg.read(file), mg.read(tmp_path / file.name)
        for name in ("time", "magnetic_field", "angular_rate", "acceleration", "attitude"):
            np.testing.assert_allclose(getattr(again, name), getattr(shipped, name), rtol=1e-9, atol=1e-15)
        truth = file.with_suffix(".truth.yaml").name
        shipped_truth, again_truth = (mg.Calibration.load(d / truth).to_dict() for d in (DATASETS, tmp_path))
        np.testing.assert_allclose(again_truth["soft_iron"], shipped_truth["soft_iron"])
        assert again_truth["hard_iron"] == shipped_truth["hard_iron"]


def test_help_waits_for_nothing() -> None:
    code = (
        "import sys; from magyc_gtsam.cli import main; "
        "codes = [main([]), main(['--help']), main(['calibrate', '-h']), main(['--version'])]; "
        "print(codes, sorted({'numpy', 'gtsam', 'scipy', 'matplotlib', 'rich'} & set(sys.modules)))"
    )
    finished = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, encoding="utf-8")
    assert finished.stdout.endswith("[0, 0, 0, 0] []\n")
    for text in ("calibrate", "export", "--gyroscope-axes", f"magyc-gtsam {mg.__version__}"):
        assert text in finished.stdout


@pytest.mark.usefixtures("quiet_logging")
def test_a_bug_is_one_line_too(
    logs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object, **options: object) -> None:
        raise ZeroDivisionError("by\nzero")

    monkeypatch.setattr("magyc_gtsam.io.info_and_recording", broken)
    monkeypatch.delenv("MAGYC_DEBUG", raising=False)
    assert cli.main(["info", str(logs / "dive.mcap")]) == 2
    message = capsys.readouterr().err
    assert message.startswith("magyc-gtsam: internal error: ZeroDivisionError: by zero; this is a bug")
    assert message.count("\n") == 1
    monkeypatch.setenv("MAGYC_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        cli.main(["info", str(logs / "dive.mcap")])


@pytest.mark.usefixtures("quiet_logging")
def test_a_disk_that_is_full(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("magyc_gtsam.cli.results.write_page", full)
    assert cli.main(["calibrate", str(logs / "dive.mcap"), "-q", "-o", str(tmp_path / "here/there")]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_parts_of_the_arguments(logs: Path) -> None:
    assert parse_axes("y,-x,z").tolist() == [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    assert np.array_equal(parse_axes("x ← y, y ← −x, z ← z"), parse_axes("Y, -X, +Z"))
    assert parse_pairs("--option", ["a=1", "b-c=[1, 2]", "d=x=y"]) == {"a": 1, "b_c": [1, 2], "d": "x=y"}
    with pytest.raises(mg.MagycError, match="expected key=value"):
        parse_pairs("--option", ["a"])
    assert as_options("name one (magnetic_field=) or end=3.5 (stamps='log')") == (
        "name one (--magnetic-field) or --end 3.5 (--stamps 'log')"
    )
    assert as_options("give the rate in Hz (rate=)") == "give the rate in Hz (--read rate=)"
    mean = Reading(logs / "dive.mcap", angular_rate_is="interval-mean").recording()
    assert mean.angular_rate_is == "interval-mean"
    mirrored = Reading(logs / "dive.mcap", gyroscope_axes="-x,y,z").recording()
    assert mirrored.acceleration is None
    assert "acceleration left out" in mirrored.notes[-1]


def test_completion_answers_the_shell(tmp_path: Path) -> None:
    """What `--install-completion` writes asks the command, which answers with what may follow."""
    home = {**os.environ, "HOME": str(tmp_path)}
    asked = [
        "bash",
        "-c",
        '"$0" --install-completion; exit $?',
        COMMAND,
    ]  # which asks what shell it was called from
    assert subprocess.run(asked, env=home, capture_output=True, check=True, timeout=120).returncode == 0
    script = (tmp_path / ".bash_completions" / "magyc-gtsam.sh").read_text(encoding="utf-8")
    assert "_MAGYC_GTSAM_COMPLETE=complete_bash" in script
    for words, place, expected in (
        ("magyc-gtsam ca", "1", ["calibrate"]),
        ("magyc-gtsam export --per", "2", ["--per-motor"]),
    ):
        asking = {**home, "_MAGYC_GTSAM_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": place}
        answer = subprocess.run([COMMAND], env=asking, capture_output=True, text=True, check=True, timeout=120)
        assert answer.stdout.split() == expected


def test_verbose_is_short_and_open_opens(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    out = tmp_path / "out"
    assert cli.main(["calibrate", str(logs / "dive.mcap"), "-o", str(out), "--verbose", "--open"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any('"diagnostics"' in line for line in lines)
    assert len(lines) < 200
    assert opened == [(out / "report.html").resolve().as_uri()]
