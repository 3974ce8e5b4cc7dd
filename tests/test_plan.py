"""Which motion and how long: what a plan promises is what a calibration of that motion states."""

import json
import re

import numpy as np
import pytest

from magyc_gtsam import MagycError, calibrate, cli, simulate
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.study.known_facts import placed
from magyc_gtsam.study.plan import WAYS, plan, shortest

ALIGNED = SmootherOptions(misalignment=0)
NOISE = (1e-6, 5e-3)


def weakest(calibration):
    return np.sqrt(np.linalg.eigvalsh(calibration.covariance[6:9, 6:9])[-1])


def test_a_plan_is_what_calibrations_state():
    """In the median of other draws of the motion, so that it is of the motion and not of the draw."""
    planned = {p.known: p for p in plan(NOISE, ALIGNED, motions=["level"], durations=[300.0])}
    assert tuple(planned) == WAYS
    earlier = calibrate(simulate("wide", seed=990).recording, misalignment=0)
    matrix = {"prior": earlier, "hard_iron_walk": 1e-3}
    stated = {"nothing": [], "both": []}
    for run in (placed("level", 300, seed) for seed in range(3, 12)):
        for way, options in (("nothing", {}), ("both", matrix | {"field": run.field})):
            stated[way].append(weakest(calibrate(run.recording, noise=NOISE, misalignment=0, **options)))
    for way, sigmas in stated.items():
        assert planned[way].hard_iron == pytest.approx(np.median(sigmas), rel=0.35)
    assert planned["both"].hard_iron < 0.3 * planned["the place"].hard_iron < 0.3 * planned["nothing"].hard_iron


def test_a_skew_that_is_left_open_costs_heading():
    (aligned,), (open_,) = (
        [p for p in plan(NOISE, options, motions=["level"], durations=[600.0]) if p.known == "both"]
        for options in (ALIGNED, None)
    )
    assert open_.heading > 3 * aligned.heading


def test_an_earlier_calibration_is_worth_what_it_knows():
    good = calibrate(simulate("wide", seed=991).recording, misalignment=0)
    ways = {}
    for walk in (0.0, 5e-6):
        options = SmootherOptions(misalignment=0, prior=good, hard_iron_walk=walk)
        found = plan(NOISE, options, motions=["tiny"], durations=[30.0])
        ways[walk] = next(p for p in found if p.known == "an earlier calibration")
    assert ways[0.0].hard_iron < 0.15e-6 < 0.3e-6 < ways[5e-6].hard_iron


def test_the_shortest_time():
    planned = plan(NOISE, motions=["moderate"], durations=[600.0, 60.0, 120.0])
    assert [p.duration for p in planned[:: len(WAYS)]] == [60.0, 120.0, 600.0]
    found = shortest(planned, "moderate", "nothing", 0.5)
    assert found is not None
    assert found.duration == 120.0
    assert shortest(planned, "moderate", "nothing", 0.05) is None


def test_what_is_no_plan_is_refused():
    with pytest.raises(MagycError, match="motion 'waltz' is not one of wide"):
        plan(motions=["waltz"])
    with pytest.raises(MagycError, match="noise must be above 0"):
        plan((0.0, 5e-3))


def test_the_command(capsys, monkeypatch):
    monkeypatch.setattr("magyc_gtsam.study.plan.DURATIONS", (60.0, 120.0))
    assert cli.main(["calibrate", "--plan", "0.5", "--noise", "1", "5", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["heading_deg"] == 0.5
    assert {p["known"] for p in said["planned"]} == set(WAYS)
    assert cli.main(["calibrate", "--plan", "120"]) == 2
    assert "must be between 0 and 90" in capsys.readouterr().err
    assert cli.main(["calibrate", "--plan", "1", "log.mcap"]) == 2
    assert "needs no LOG and writes no files" in capsys.readouterr().err
    assert cli.main(["calibrate", "--plan", "0.5"]) == 0
    shown = re.findall(r"\(([\d.]+) µT\)", capsys.readouterr().out)
    assert shown
    assert all(len(number.replace(".", "").lstrip("0")) == 2 for number in shown)  # two digits, also of 1.0
    for option, value in (("--delay", "3"), ("--field-strength", "48"), ("--window", "2")):
        assert cli.main(["calibrate", "--plan", "1", option, value]) == 2
        assert f"{option}: has no effect on a plan" in capsys.readouterr().err
    assert cli.main(["calibrate"]) == 2  # LOG is needed again
