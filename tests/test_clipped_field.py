"""A magnetometer that is cut off at its full scale: told from stuck and coarse ones, kept for the gap, not trusted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_fault_findings import find_clipped_field, find_stuck

import magyc_gtsam as mg
from magyc_gtsam.cli import main
from magyc_gtsam.io import write_mcap
from magyc_gtsam.sensor_faults.usable import without_faults
from magyc_gtsam.simulation import AMPLITUDES
from magyc_gtsam.study.efficiency import error, nees

CHI2_11 = 31.3  # 99.9 % point of χ² of 11 degrees of freedom
STEPS = (0.0, 0.15e-6, 0.5e-6, 1.5e-6, 3e-6)


def cut(recording: mg.Recording, share: float, step: float = 0.0) -> mg.Recording:
    """The same with a full scale that a share of the rows is beyond, in counts of `step` T."""
    field = recording.magnetic_field
    level = np.quantile(np.abs(field).max(axis=1), 1 - share)
    return mg.Recording(recording.time, coarse(np.clip(field, -level, level), step), recording.angular_rate)


def coarse(field: np.ndarray, step: float) -> np.ndarray:
    """In counts of `step` T."""
    return np.round(field / step) * step if step else field.copy()


def quiet(recording: mg.Recording, field: np.ndarray) -> None:
    """Nothing of it is called cut off."""
    assert find_clipped_field(mg.Recording(recording.time, field, recording.angular_rate)) is None


@pytest.mark.parametrize("motion", AMPLITUDES)
@pytest.mark.parametrize("share", [0.1, 0.3, 0.7])
def test_it_is_named_and_not_trusted(motion: str, share: float) -> None:
    """Trusted, wide was 4 sigmas off at 0.1, and moderate 20 at 0.3."""
    recording = cut(mg.simulate(motion, seed=round(10 * share)).recording, share)
    found = find_clipped_field(recording)
    assert found is not None
    assert "z" in found.axes
    assert found.share == pytest.approx(share, abs=0.01)
    assert found.shown == f"{np.abs(recording.magnetic_field).max() * 1e6:.4g} µT"
    usable = without_faults(recording, ("magnetic_field", "angular_rate"))
    assert usable.left_out == []
    assert len(usable.recording.time) == 6000
    calibration = mg.calibrate(recording)
    assert not calibration.trusted
    assert calibration.message.startswith(f"magnetic_field: ax{'is' if len(found.axes) == 1 else 'es'} ")
    assert f"of the magnetometer cut off at {found.shown} in {found.count} samples" in calibration.message
    assert "at most 0.5% do no harm: choose a larger full scale" in calibration.message


def test_other_methods_do_not_trust_it_either() -> None:
    recording = cut(mg.simulate("wide", 200, seed=1).recording, 0.2)
    with pytest.raises(mg.MagycError, match="axis z of the magnetometer cut off at .*; method 'twostep' failed"):
        mg.calibrate(recording, "twostep")
    for method in ("magyc-bfg", "autocal", "magical"):
        calibration = mg.calibrate(recording, method)
        assert not calibration.converged
        assert "axis z of the magnetometer cut off at" in calibration.message
    counts = mg.Recording(recording.time, recording.magnetic_field * 1e7, magnetic_field_unit="counts")
    found = find_clipped_field(counts)
    assert found.shown.endswith(" counts")


@pytest.mark.parametrize("motion", AMPLITUDES)
def test_so_few_do_no_harm(motion: str) -> None:
    for seed in range(3):
        simulation = mg.simulate(motion, seed=seed)
        recording = cut(simulation.recording, 0.004)
        assert find_clipped_field(recording) is None
        calibration = mg.calibrate(recording)
        assert calibration.trusted
        assert nees(error(calibration, simulation.truth), calibration.covariance) < CHI2_11


@pytest.mark.parametrize("step", [0.15e-6, 0.5e-6, 1e-6, 1.5e-6])
def test_coarse_sensors_that_are_cut_off(step: float) -> None:
    """Noise of 1 µT."""
    for seed in range(3):
        found = find_clipped_field(cut(mg.simulate("wide", seed=seed).recording, 0.35, step))
        assert found is not None
        assert "z" in found.axes


@pytest.mark.parametrize("motion", [*AMPLITUDES, "multi", "dive", "survey"])
def test_clean_and_coarse_sensors_are_not_cut_off(motion: str) -> None:
    for seed in range(2):
        for noise in (0.0, 0.1e-6, 1e-6):
            recording = mg.simulate(motion, seed=seed, magnetometer_noise=noise).recording
            for step in STEPS:
                field = coarse(recording.magnetic_field, step)
                quiet(recording, field)
                quiet(recording, np.repeat(field[::3], 3, axis=0))


def test_a_vehicle_at_rest_is_not_cut_off() -> None:
    """Where z is largest; noise of all sizes against the steps, of z less than of the others, and on an edge."""
    random = np.random.default_rng(0)
    for seed in range(8):
        recording = mg.simulate("wide", seed=seed, magnetometer_noise=0.0).recording
        for noise in (0.02e-6, 0.1e-6, 0.3e-6, 1e-6):
            for step in STEPS[1:]:
                field = recording.magnetic_field.copy()
                rest = slice(1500, 4500)
                field[rest] = field[np.argmax(field[:, 2])]
                if seed % 2:
                    field[rest, 2] = coarse(field[1500, 2], step) - 0.5 * step  # an edge
                field += random.normal(0, noise, field.shape) * [1, 1, random.choice([0.2, 1.0])]
                quiet(recording, coarse(field, step))


@pytest.mark.parametrize("step", STEPS)
def test_an_axis_that_is_stuck_stays_stuck(step: float) -> None:
    """At any value, at its largest, too, and from some time on or for a while; each of these on every axis."""
    for seed, motion in enumerate(AMPLITUDES):
        recording = mg.simulate(motion, seed=seed).recording
        field = coarse(recording.magnetic_field, step)
        largest = field.max(axis=0)
        for number, (rows, values) in enumerate(
            (
                (slice(None), largest),
                (slice(1200, None), field[1200]),
                (slice(4000, None), largest),
                (slice(int(field[:5000, seed % 3].argmax()), None), field[:5000].max(axis=0)),
                (slice(2000, 3200), largest),
            )
        ):
            axis, stuck = (seed + number) % 3, field.copy()
            stuck[rows, axis] = values[axis]
            quiet(recording, stuck)
            if step <= 0.5e-6:  # with coarser steps nothing shows noise enough
                assert stuck_axis(recording, stuck) == ("magnetic_field", "xyz"[axis])


def stuck_axis(recording: mg.Recording, field: np.ndarray) -> tuple[str, str]:
    """Sensor and axis that stood still."""
    (stuck,) = find_stuck(mg.Recording(recording.time, field, recording.angular_rate))
    return stuck.sensor, stuck.axes


def test_stuck_beside_cut_off() -> None:
    """The level is spared, and nothing else."""
    recording = cut(mg.simulate("wide", seed=1).recording, 0.3)
    field = recording.magnetic_field.copy()
    field[2000:2600, 0] = field[2000, 0]
    usable = without_faults(mg.Recording(recording.time, field, recording.angular_rate), ("magnetic_field",))
    assert usable.clipped.axes == "z"
    (left_out,) = usable.left_out
    assert left_out.startswith("magnetic_field: axis x of the magnetometer is stuck at")


def test_the_gap_names_it() -> None:
    """From a tenth to a fifth of the rows: named, modelled, and the truth found."""
    for seed, share in ((1, 0.1), (2, 0.2)):
        simulation = mg.simulate("wide", 120, seed=seed)
        gap = mg.find_gap(cut(simulation.recording, share))
        assert gap.verdict == "closed"
        assert gap.names == ("saturation",)
        assert "the magnetometer clips at about" in gap.sentence
        assert gap.calibration.trusted
        sigma = gap.calibration.sigma["hard_iron"]
        assert (np.abs(gap.calibration.hard_iron - simulation.truth.hard_iron) < 4 * sigma).all()


def test_a_gap_stays_open_where_too_much_is_cut_off() -> None:
    """By the search alone it is unknown, or another name's: the hard iron is 15 to 25 µT off."""
    candidates = ["saturation", "cubic", "timing", "misalignment"]
    gap = mg.find_gap(cut(mg.simulate("wide", 120, seed=2).recording, 0.5), candidates=candidates)
    assert gap.verdict == "open"
    assert "of the magnetometer cut off at " in gap.sentence
    assert "at most 25% can be modelled: choose a larger full scale" in gap.sentence
    assert not gap.calibration.trusted
    assert gap.diagnostics["left_out"] == []


def test_on_the_command_line(tmp_path: Path, capsys: Any) -> None:
    recording = mg.simulate("wide", 150, seed=1).recording
    write_mcap(tmp_path / "cut.mcap", cut(recording, 0.15))
    assert main(["calibrate", f"{tmp_path}/cut.mcap", "-o", f"{tmp_path}/calibrated"]) == 1
    assert "must not be trusted: axis z of the magnetometer cut off at" in capsys.readouterr().err
    assert "axis z of the magnetometer cut off" in (tmp_path / "calibrated" / "report.html").read_text("utf-8")
    assert main(["gap", f"{tmp_path}/cut.mcap", "-o", f"{tmp_path}/gap", "--candidates", "saturation"]) == 0
    assert "clips at about" in capsys.readouterr().out


@pytest.mark.real
def test_a_real_log_that_is_cut_off(shared_data: Path) -> None:
    recording = mg.read(shared_data / "broad_01_slow_rotation.mcap")
    level = np.quantile(np.abs(recording.magnetometer.value).max(axis=1), 0.9)
    found = find_clipped_field(replace(recording, magnetic_field=np.clip(recording.magnetic_field, -level, level)))
    assert found is not None
    assert found.share == pytest.approx(0.1, abs=0.02)


def test_a_row_of_zeros_does_not_hide_the_full_scale() -> None:
    """A batch was examined once it had as many samples as the log has rows, and the zeros are left out before."""
    recording = cut(mg.simulate("wide", duration=120, seed=1).recording, 0.05, 0.15e-6)
    field = recording.magnetic_field.copy()
    field[600] = 0
    beside = mg.Recording(recording.time, field, recording.angular_rate)
    clipped = without_faults(recording).clipped
    assert clipped is not None
    found = without_faults(beside).clipped
    assert found is not None
    assert (found.axes, found.shown) == (clipped.axes, clipped.shown)
