"""What a calibration holds on another recording than its own, and where a channel that it follows pauses."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import magyc_gtsam as mg
from magyc_gtsam.calibration.elsewhere import TermWarning
from magyc_gtsam.cli.app import application
from magyc_gtsam.factors import unvech
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.io import write_mcap
from magyc_gtsam.recording.fingerprint import fingerprint

_SAME = np.zeros((3, 3))
_JUMP = np.array([4e-6, -1e-6, 2e-6])


@pytest.mark.parametrize(
    ("term", "iron", "said"),
    [
        (Term("hard-iron-step", _JUMP, np.eye(3) * 1e-16, {"time": 20.0}), (_SAME, _JUMP), "set in for the whole"),
        (
            Term("soft-iron-step", [0.1, 0.02, 0.0, -0.05, 0.03, 0.0], np.eye(6) * 1e-6, {"time": 20.0}),
            (unvech(np.array([0.1, 0.02, 0.0, -0.05, 0.03, 0.0])), 0.0),
            "set in for the whole",
        ),
        (
            Term("hard-iron-step", _JUMP, np.eye(3) * 1e-16, {"time": 20.0, "until": 40.0}),
            (_SAME, 0.0),
            "left out",
        ),
        (
            Term("hard-iron-drift", _JUMP, np.eye(3) * 1e-16, {"order": 0.0, "start": 0.0, "end": 60.0}),
            (_SAME, 0.0),
            "left out",
        ),
        (Term("tone", np.ones(6) * 1e-6, np.eye(6) * 1e-16, {"frequency": 1.3}), (_SAME, 0.0), "left out"),
        (
            Term("local-anomaly", _JUMP, np.eye(3) * 1e-16, {"time": 20.0, "width": 4.0}),
            (_SAME, 0.0),
            "left out",
        ),
    ],
)
def test_what_is_dated_in_one_recording_is_taken_out_of_it_only(
    term: Term, iron: tuple[np.ndarray, np.ndarray | float], said: str, tmp_path: Path
) -> None:
    """In another the iron after a jump holds from its start, in Python and on the command line."""
    own, other = (mg.simulate("wide", 60, seed=seed).recording for seed in (1, 2))
    plain = mg.simulate("wide", 1).truth
    dated = replace(plain, terms=(term,), diagnostics={"recordings": [fingerprint(own)]})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inside = dated.apply(own.between(10, 50))
    assert np.abs(inside - plain.apply(own.between(10, 50))).max() > 1e-7
    changed = np.eye(3) + iron[0]
    after = replace(plain, soft_iron=changed @ plain.soft_iron, hard_iron=plain.hard_iron + iron[1])
    with pytest.warns(TermWarning, match=f"^apply: {term.name}: .*{said}"):
        field = dated.apply(other)
    np.testing.assert_allclose(field, after.apply(other), atol=1e-15)
    unknown = replace(dated, diagnostics={})  # where its recording is not known, the times are taken as they are
    with pytest.warns(TermWarning, match=f"^apply: {term.name}: the calibration does not state the recording"):
        assert np.abs(unknown.apply(other) - after.apply(other)).max() > 1e-7
    dated.save(tmp_path / "cal.yaml")
    write_mcap(tmp_path / "other.mcap", other)
    command = ["apply", str(tmp_path / "cal.yaml"), str(tmp_path / "other.mcap"), "-o", str(tmp_path / "out.csv")]
    done = CliRunner().invoke(application(), command)
    assert done.exit_code == 0, done.output
    assert f"magyc-gtsam: note: {term.name}: " in done.output
    np.testing.assert_allclose(mg.read(tmp_path / "out.csv").magnetic_field, field, atol=1e-12)


def test_a_jump_of_the_bias_holds_on_another_recording() -> None:
    own, other = (mg.simulate("wide", 60, seed=seed).recording for seed in (1, 2))
    jump = Term("gyro-bias-step", [0.01, 0.0, -0.02], np.eye(3) * 1e-12, {"time": 20.0})
    truth = mg.simulate("wide", 1).truth
    dated = replace(truth, terms=(jump,), diagnostics={"recordings": [fingerprint(own)]})
    assert other.angular_rate is not None
    with pytest.warns(TermWarning, match=r"^apply: gyro-bias-step: found at 20.0 s of another recording"):
        rate = dated.apply_gyroscope(other)
    assert truth.gyro_bias is not None
    np.testing.assert_allclose(rate, other.angular_rate - truth.gyro_bias - jump.value, atol=1e-15)


def test_a_long_pause_of_a_channel_that_a_term_follows_is_said(tmp_path: Path) -> None:
    recording = mg.simulate("wide", 100, seed=3, effects=[("motor-current", 4.0)]).recording
    term = Term("motor-current", _JUMP, np.eye(3) * 1e-16)
    calibration = replace(mg.simulate("wide", 1).truth, terms=(term,))
    paused = recording.channels["current"].copy()
    paused[300:720] = np.nan  # 42 s
    log = replace(recording, channels={"current": paused})
    with pytest.warns(TermWarning, match="^apply: current: not logged from 30.0 to 71.9 s; there motor-current"):
        field = calibration.apply(log)
    assert np.isfinite(field).all()
    briefly = paused.copy()
    briefly[300:650] = 1.0  # 7 s are left, which are interpolated
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        calibration.apply(replace(recording, channels={"current": briefly}))
        replace(calibration, terms=()).apply(log)
    calibration.save(tmp_path / "cal.yaml")
    table = np.column_stack([log.time, log.magnetic_field, log.angular_rate, log.channels["current"]])
    cells = [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in table]
    header = "time_s,mag_x_T,mag_y_T,mag_z_T,gyro_x,gyro_y,gyro_z,current"
    (tmp_path / "log.csv").write_text("\n".join([header, *cells]) + "\n")
    command = ["apply", str(tmp_path / "cal.yaml"), str(tmp_path / "log.csv"), "-o", str(tmp_path / "out.mcap")]
    done = CliRunner().invoke(application(), command)
    assert done.exit_code == 0, done.output
    assert "note: current: not logged from 30.0 to 71.9 s" in done.output


def test_gap_begins_with_the_iron_after_a_jump_that_another_recording_had() -> None:
    own, other = (mg.simulate("wide", 60, seed=seed).recording for seed in (1, 2))
    jump = Term("hard-iron-step", _JUMP, np.eye(3) * 1e-16, {"time": 20.0})
    found = mg.calibrate(own)
    given = replace(found, terms=(jump,))
    gap = mg.find_gap(other, calibration=given, candidates=["timing"])
    assert "hard-iron-step" not in [term.name for term in gap.base.terms]
    assert any(row.name.startswith("hard iron x") for row in gap.moved)
    same = mg.find_gap(own, calibration=given, candidates=["timing"])
    assert "hard-iron-step" in [term.name for term in same.base.terms]
