"""Where GTSAM has no wheels: the main job works, and what needs a graph says so in one sentence."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BLOCKED = "import sys; sys.modules['gtsam'] = None\n"  # as if it were not installed
MAIN_JOB = f"""
import magyc_gtsam as mg
from magyc_gtsam import cli
log = {str(ROOT / "datasets" / "calibration_dive.mcap")!r}
assert cli.main(["calibrate", log, "--output", "folder", "--quiet"]) == 0
rec = mg.read(log)
cal = mg.Calibration.load("folder/calibration.yaml")
online = mg.OnlineCalibrator()
online.update(rec.time, rec.magnetic_field, rec.angular_rate)
assert online.converged
distance = abs(online.calibration.hard_iron - cal.hard_iron) / cal.sigma["hard_iron"]
assert distance.max() < 0.5, distance
gap = mg.find_gap(rec.between(rec.time[0], rec.time[0] + 120))
print(gap.verdict, len(cal.export("px4")) > 100)
"""
CALLS = {
    "mg.calibrate(rec, 'magyc-bfg')": "method 'magyc-bfg'",
    "mg.calibrate(rec, 'magyc-ifg')": "method 'magyc-ifg'",
    "mg.OnlineCalibrator('magyc-ifg')": "method 'magyc-ifg'",
    "magyc_gtsam.factors.norm_prior(0, 1.0)": "magyc_gtsam.factors.norm_prior",
    "magyc_gtsam.runners.optimize": "magyc_gtsam.runners.optimize",
    "magyc_gtsam.gap.term_factor": "magyc_gtsam.gap.term_factor",
}
OF_A_GRAPH = f"""
import magyc_gtsam.factors, magyc_gtsam.gap, magyc_gtsam.runners
for call in {list(CALLS)!r}:
    try:
        eval(call)
        print("it ran")
    except mg.MagycError as error:
        print(error)
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], Path]:
    """What both parts print, one after the other, in an interpreter that cannot import GTSAM, and its folder."""
    folder = tmp_path_factory.mktemp("without")
    command = [sys.executable, "-c", BLOCKED + MAIN_JOB + OF_A_GRAPH]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines(), folder


def test_the_main_job(said: tuple[list[str], Path]) -> None:
    (first, *_), folder = said
    assert first.split() == ["none", "True"]
    assert (folder / "folder" / "report.html").stat().st_size > 100_000


def test_what_needs_a_graph_says_so(said: tuple[list[str], Path]) -> None:
    for what, sentence in zip(CALLS.values(), said[0][1:], strict=True):
        assert sentence.startswith(f"{what}: needs GTSAM, which is not installed; pip install 'gtsam>=4.3'")
