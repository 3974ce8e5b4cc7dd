"""The study of faults: what it puts in, how it judges, and that it goes on where it was."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation import GYRO_BIAS, HARD_IRON, SOFT_IRON
from magyc_gtsam.study.faults import running
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.scoring import score
from magyc_gtsam.study.faults.signals import LoggedSamples, record

TRUE_IRON = SOFT_IRON / np.cbrt(np.linalg.det(SOFT_IRON))


def result(hard_iron: np.ndarray, sigma: float, soft_iron: np.ndarray = TRUE_IRON) -> mg.Calibration:
    """A trusted calibration whose hard iron is known to `sigma` T."""
    variance = np.repeat([1e-4, sigma, 1e-4], [6, 3, 3]) ** 2
    return mg.Calibration(soft_iron, hard_iron, GYRO_BIAS, covariance=np.diag(variance), method="test")


@functools.cache
def without_fault(seed: int, rate: float, duration: float) -> LoggedSamples:
    return record("wide", seed, replace(FAULTS["clean"], rate=rate), duration=duration)


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_changes_the_log_more_the_stronger_it_is(name: str) -> None:
    fault = FAULTS[name]
    logs = [record("wide", 1, fault, size, name, 120.0) for size in (fault.weak, fault.strong)]
    logs.insert(0, without_fault(1, fault.rate, 120.0))
    for log in logs:
        assert isinstance(log.recording(name), Recording)
    same = [
        all(
            a.shape == b.shape and (a == b).all()
            for a, b in zip(vars(logs[0]).values(), vars(log).values(), strict=True)
        )
        for log in logs[1:]
    ]
    assert same == [name == "clean"] * 2
    if logs[0].field.shape == logs[1].field.shape == logs[2].field.shape:
        weak, strong = (
            np.linalg.norm(log.field - logs[0].field) / 1e-6
            + np.linalg.norm(log.rate - logs[0].rate) / 5e-3
            + np.linalg.norm(log.field_time - logs[0].field_time)
            for log in logs[1:]
        )
        assert strong > weak or name in ("clean", "swell-at-1-hz", "cycled-gyroscope-axes")


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["reset-flips", "switched-current", "iron-steps", "offset-drift"])
def test_an_iron_that_changes_ends_at_the_true_one(name: str, seed: int) -> None:
    fault = FAULTS[name]
    log = record("wide", seed, fault, fault.strong, name, 300.0)
    changed = log.field - without_fault(seed, fault.rate, 300.0).field
    np.testing.assert_allclose(changed[-5:], 0, atol=2e-3 * fault.strong)
    assert np.abs(changed).max() > 0.3 * fault.strong


def test_there_are_as_many_as_promised() -> None:
    assert len(FAULTS) > 60
    assert all(fault.weak != fault.strong for name, fault in FAULTS.items() if name != "clean")


def test_right_wrong_and_refused() -> None:
    off = np.array([3e-6, 0, 0])
    assert score(result(HARD_IRON, 1e-7)).outcome == "right and trusted"
    assert score(result(HARD_IRON + off, 2e-6)).outcome == "right and trusted"  # within its sigmas
    assert score(result(HARD_IRON + off, 2e-7)).outcome == "wrong and trusted"
    assert score(result(HARD_IRON + 0.05 * off, 2e-8)).outcome == "right and trusted"  # too small to matter
    assert score(replace(result(HARD_IRON + off, 2e-7), converged=False)).outcome == "refused"
    assert score(None).outcome == "refused"
    tilted = TRUE_IRON @ (np.eye(3) + 0.05 * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]]))
    wrong = score(result(HARD_IRON, 1e-8, tilted))
    assert wrong.outcome == "wrong and trusted"
    assert wrong.heading == pytest.approx(np.degrees(0.05), rel=0.1)


def test_terms_count_as_they_stand_at_the_end() -> None:
    """A step that was named, before which the hard iron was another one, beside a delay and scales of the gyroscope."""
    step = np.array([4e-6, -2e-6, 1e-6])
    others = (Term("timing", [0.03], [[1e-6]]), Term("gyro-scale", np.full(6, 0.01), 1e-6 * np.eye(6)))
    loop = Term("hysteresis", np.full(3, 1e-7), 1e-16 * np.eye(3), {"coercive": 2e-6})

    def named(size: np.ndarray, sigma: float) -> mg.Calibration:
        terms = (Term("hard-iron-step", size, sigma**2 * np.eye(3), {"time": 300.0}), *others)
        return replace(result(HARD_IRON - step, 1e-7), terms=terms)

    right = score(named(step, 1e-7), end=600.0)
    assert right.outcome == "right and trusted"
    assert right.hard_iron < 1e-12
    assert right.heading < 1e-6
    assert score(named(step, 1e-7), end=200.0).outcome == "wrong and trusted"
    assert score(named(0.5 * step, 1e-7), end=600.0).outcome == "wrong and trusted"
    off = score(named(0.5 * step, 2e-6), end=600.0)
    assert off.outcome == "right and trusted"  # within the step's own sigma
    assert off.hard_iron_sigmas == pytest.approx(2e-6 / np.hypot(1e-7, 2e-6))
    assert off.axes_covered == 1
    remembering = replace(named(step, 1e-7), terms=(*named(step, 1e-7).terms, loop))
    assert score(remembering, end=600.0).hard_iron < 1e-9  # a loop needs what came before
    tone = Term("tone", np.full(6, 5e-6), 1e-16 * np.eye(6), {"frequency": 0.3})
    humming = replace(named(step, 1e-7), terms=(*named(step, 1e-7).terms, tone))
    assert score(humming, end=600.0).hard_iron < 1e-9  # which the true readings do not have


@pytest.mark.parametrize("places", [1, 2])
def test_the_heading_is_that_of_the_gyroscopes_axes(places: int) -> None:
    """Exchanged cyclically they are another frame, in which the field is given; the magnetometer's would be wrong."""
    body_R_sensor = record("wide", 0, FAULTS["cycled-gyroscope-axes"], places, duration=20.0).body_R_sensor
    np.testing.assert_allclose(body_R_sensor, np.roll(np.eye(3), places, axis=0), atol=1e-9)
    plain = result(HARD_IRON, 1e-7)
    named = replace(plain, terms=(Term("axis-order", body_R_sensor.T.ravel(), 1e-16 * np.eye(9)),))
    right = score(named, body_R_sensor=body_R_sensor)
    assert right.outcome == "right and trusted"
    assert right.heading < 1e-6
    assert score(named).outcome == score(plain, body_R_sensor=body_R_sensor).outcome == "wrong and trusted"
    off = HARD_IRON + body_R_sensor.T @ [0.0, 2e-7, 0.0]  # along the body's y
    assert score(replace(named, hard_iron=off), body_R_sensor=body_R_sensor).heading_sigmas == pytest.approx(
        score(replace(plain, hard_iron=HARD_IRON + [0.0, 2e-7, 0.0])).heading_sigmas, rel=0.1
    )
    # Its hard iron and that sigma are in the magnetometer's axes all the same.
    unequal = np.diag(np.r_[np.diag(named.covariance)[:6], [1e-14, 4e-14, 9e-14], np.diag(named.covariance)[9:]])
    along_z = replace(named, hard_iron=HARD_IRON + [0.0, 0.0, 6e-7], covariance=unequal)
    assert score(along_z, body_R_sensor=body_R_sensor).hard_iron_sigmas == pytest.approx(2.0)


def test_the_stated_heading_is_that_of_a_draw() -> None:
    """Hard iron drawn from its sigma: the heading is off by its own stated sigma, in the mean."""
    random, squares = np.random.default_rng(0), []
    for _ in range(200):
        got = score(result(HARD_IRON + 1e-7 * random.standard_normal(3), 1e-7))
        squares.append((got.hard_iron_sigmas, got.heading_sigmas))
    assert np.mean(np.array(squares) < 3, axis=0).min() > 0.97
    assert np.median(squares, axis=0).min() > 0.5


def seen(recording: Recording) -> mg.Calibration:
    """A method for worker processes: always the truth."""
    if "lost" in recording.name:
        raise mg.MagycError("too little is left")
    if recording.name == "clean-weak-wide-1":
        raise ValueError("a defect")
    return result(HARD_IRON, 1e-7)


def wrong(recording: Recording) -> mg.Calibration:
    """A method for worker processes: always 9 µT off."""
    return result(HARD_IRON + 9e-6, 1e-7)


def test_it_runs_in_processes_and_goes_on_where_it_was(tmp_path: Path) -> None:
    every = running.cases(["clean", "lost-samples"], ["wide"], range(2))
    assert len(every) == 2 + 4
    shares: list[float] = []
    rows = running.run(tmp_path, every, {"a": seen, "b": wrong}, 2, shares.append)
    assert shares[-1] == 1.0
    assert len(rows) == 12
    parts = sorted((tmp_path / "parts").iterdir())
    written = [part.stat().st_mtime_ns for part in parts]
    parts[0].unlink()
    assert running.run(tmp_path, every, {"a": seen, "b": wrong}, 1) == rows
    assert [part.stat().st_mtime_ns for part in parts][1:] == written[1:]
    worst, *_, best = running.cells(rows)
    assert worst.counts == {"wrong and trusted": 2, "right and trusted": 0, "refused": 0, "crashed": 0}
    assert (worst.method, worst.hard_iron) == ("b", pytest.approx(9e-6))
    assert best.method == "a"
    assert [row["message"] for row in rows if row["outcome"] == "crashed"] == ["ValueError: a defect"]
    refused = [row for row in rows if row["fault"] == "lost-samples" and row["method"] == "a"]
    assert [row["message"] for row in refused] == ["too little is left"] * 4
    assert parquet.read_table(tmp_path / "faults.parquet").to_pylist() == rows


def test_coverage_is_that_of_faults_that_no_data_show() -> None:
    def row(shows: bool, *sigmas: float | None) -> dict[str, object]:
        names = ("hard_iron_sigmas", "heading_sigmas", "axes_covered")
        return {"shows": shows, **dict(zip(names, sigmas, strict=True))}

    rows = [row(False, 0.5, 2.0, 1.0), row(False, 0.9, 0.1, 1.0), row(False, 3.0, 4.0, 1 / 3)]
    assert running.covered(
        [*rows, row(False, None, None, None), row(True, 9.0, 9.0, 0.0)]
    ) == running.SigmaCoverage(3, pytest.approx(7 / 9), pytest.approx(2 / 3), pytest.approx(1 / 3))
    assert running.covered([row(True, 0.1, 0.1, 1.0)]) is None


def test_unknown_names_are_refused() -> None:
    with pytest.raises(mg.MagycError, match="fault: 'nothing' is not one of clean, one-sided-spikes, "):
        running.cases(["nothing"], ["wide"], range(1))
    with pytest.raises(mg.MagycError, match="motion: 'flat' is not one of wide, moderate, "):
        running.cases(["clean"], ["flat"], range(1))
    with pytest.raises(mg.MagycError, match="strength: 'loud' is not one of weak, strong, slight, between"):
        running.cases(["clean"], ["wide"], range(1), ["loud"])


def test_other_strengths_lie_evenly_beside_the_two_of_the_study() -> None:
    for name, fault in FAULTS.items():
        sizes = [fault.slight, fault.weak, fault.between, fault.strong]
        if name == "clean" or fault.unit.startswith(("rows", "places")):
            assert all(size == int(size) for size in sizes)
        else:
            np.testing.assert_allclose(np.diff(np.log(sizes)), np.log(fault.strong / fault.weak) / 2)
    every = running.cases(["clean", "cubic"], ["wide"], range(1), ["between", "slight"])
    assert [case.strength for case in every] == ["between", "between", "slight"]


def test_a_draw_is_of_all_cases_and_the_same_again() -> None:
    every = running.cases(["clean", "one-sided-spikes"], ["wide", "low"], range(8))
    drawn = running.drawn(every, 10, seed=3)
    assert drawn == running.drawn(every, 10, seed=3) != running.drawn(every, 10, seed=4)
    assert len(set(drawn)) == 10
    assert set(drawn) < set(every)
    assert running.drawn(every, 1000, seed=3) == every


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = [
        "study",
        "faults",
        "--runs",
        "1",
        "--motion",
        "wide",
        "--by",
        "batch",
        "--workers",
        "1",
        "-o",
        str(tmp_path),
    ]
    assert main([*run, "--fault", "clean"]) == 0
    assert "1 results: 0 wrong and trusted, 1 right and trusted, 0 refused, 0 crashed" in capsys.readouterr().out
    assert main(["study", "efficiency", "--motion", "wide"]) == 2  # was ignored
    assert "--motion: has no effect on study efficiency, only on gap, faults" in capsys.readouterr().err
    assert main([*run, "--draw", "0"]) == 2
    capsys.readouterr()
    assert main([*run, "--fault", "none"]) == 2
    assert "fault: 'none' is not one of" in capsys.readouterr().err
