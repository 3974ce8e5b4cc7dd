"""The examples run, stay short, and show what they say."""

import importlib
import re
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    yield importlib.import_module
    for file in EXAMPLES.glob("*.py"):
        sys.modules.pop(file.stem, None)


@pytest.mark.parametrize(
    "name", ["isam2_survey", "batch_dive", "next_mission", "vehicle", "calibrate_log", "online_stream"]
)
def test_examples_are_short(name):
    assert len((EXAMPLES / f"{name}.py").read_text(encoding="utf-8").splitlines()) < 100


def test_isam2_survey(example, tmp_path):
    said = example("isam2_survey").main(tmp_path / "figure.png", duration=120.0)
    calibrated, without, off, sigma = (float(number) for number in re.findall(r"\d+\.\d+", said))
    assert calibrated < 0.4
    assert without > 5 * calibrated
    assert off < 4 * sigma < 2
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_batch_dive(example):
    main = example("batch_dive").main
    weighed, trusted = main(100.0), main(100.0, robust=None)
    assert weighed["heading, degrees"] < 0.4
    assert weighed["hard iron, µT"] < 3.5 * weighed["its sigma, µT"] < 1.5
    assert weighed["gyroscope bias, mrad/s"] < 1
    assert trusted["hard iron, µT"] > 5 * weighed["hard iron, µT"]


def test_next_mission(example):
    main = example("next_mission").main
    carried, alone = main(), main(carried=False)
    assert carried["heading, degrees"] < 0.6
    assert carried["hard iron, µT"] < 0.5
    assert alone["hard iron, µT"] > 5 * carried["hard iron, µT"]


def test_calibrate_log(example, tmp_path):
    said = example("calibrate_log").main(figure=tmp_path / "figure.png")
    assert said.startswith("✔ Calibrated: systematic heading error at most")
    assert (tmp_path / "figure.png").stat().st_size > 20_000


def test_online_stream(example, tmp_path):
    said = example("online_stream").main(tmp_path / "figure.png")
    found = re.fullmatch(r"converged after (\d+) s; the hard iron is off by ([\d.]+) µT at the end", said)
    assert found, said
    assert 10 < int(found[1]) < 300
    assert float(found[2]) < 1.5
    assert (tmp_path / "figure.png").stat().st_size > 10_000
