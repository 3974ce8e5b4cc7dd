"""What ArduPilot's whole numbers of milligauss do to a calibration, and how certain it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_io_ardupilot import dataflash

import magyc_gtsam as mg
from magyc_gtsam.io import read
from magyc_gtsam.recording import Array

STEP = 1e-7  # T


def logged(path: Path, simulation: mg.Simulation, offset: Array, parameter: Array) -> mg.Recording:
    """The recording of a log of a compass with an offset in flight, milligauss, whose parameters are others."""
    names = [f"COMPASS_{part}_{axis}" for part in ("DIA", "ODI") for axis in "XYZ"]
    parameters = dict.fromkeys(names, 0.0) | {"COMPASS_SCALE": 0.0}
    parameters |= {f"COMPASS_OFS_{axis}": value for axis, value in zip("XYZ", parameter, strict=True)}
    messages: list[tuple[str, tuple]] = [("PARM", (0, name, float(value))) for name, value in parameters.items()]
    recording = simulation.recording
    columns = (recording.time, recording.magnetic_field / STEP, recording.angular_rate, recording.acceleration)
    for t, m, w, a in zip(*columns, strict=True):
        at = 1_000_000 + round(t * 1e6)
        whole = (m + offset).astype(int)  # truncated, as by a cast
        messages.append(("MAG", (at, 0, *whole, *offset.astype(int), 0, 0, 0, 1, at)))
        messages.append(("IMU", (at, 0, *w, *a)))
    return read(dataflash(path, messages))


@pytest.fixture(scope="module")
def simulation() -> mg.Simulation:
    return mg.simulate("wide", 600, rate=10, seed=1)


def test_truncated_fields_do_not_move_the_soft_iron(tmp_path: Path, simulation: mg.Simulation) -> None:
    """They moved it by 0.0017, at a sigma of 0.0005, on every log."""
    offset = -simulation.truth.hard_iron / STEP
    recording = logged(tmp_path / "a.BIN", simulation, offset, offset)
    exact, found = mg.calibrate(simulation.recording), mg.calibrate(recording)
    np.testing.assert_allclose(found.soft_iron, exact.soft_iron, atol=2e-4)
    np.testing.assert_allclose(found.hard_iron, exact.hard_iron, atol=1e-8)
    np.testing.assert_allclose(found.sigma["hard_iron"], exact.sigma["hard_iron"], rtol=0.05)


def test_offsets_learned_in_flight_widen_the_sigmas_of_the_hard_iron(
    tmp_path: Path, simulation: mg.Simulation
) -> None:
    """They are known to half a step, by which the hard iron is off."""
    offset = np.trunc(-simulation.truth.hard_iron / STEP) + [0.9, -0.9, 0.9]
    recording = logged(tmp_path / "a.BIN", simulation, offset, np.zeros(3))
    assert recording.autopilot is not None
    np.testing.assert_allclose(recording.autopilot.offset_sigma, 0.5 / np.sqrt(3) * STEP)
    exact = mg.calibrate(logged(tmp_path / "b.BIN", simulation, offset, offset))
    for found in (mg.calibrate(recording), mg.find_gap(recording, candidates=["misalignment"]).calibration):
        assert found.covariance is not None
        error = (found.hard_iron - simulation.truth.hard_iron) / found.sigma["hard_iron"]
        assert np.abs(error).max() < 3
    found = mg.calibrate(recording)
    assert exact.covariance is not None
    more = np.diag(found.covariance)[6:9] - np.diag(exact.covariance)[6:9]
    np.testing.assert_allclose(more, STEP**2 / 12, rtol=0.05)
    assert found.noise_covariance is not None
    assert np.all(found.sigma["hard_iron"] > np.sqrt(np.diag(found.noise_covariance)[6:9]))
