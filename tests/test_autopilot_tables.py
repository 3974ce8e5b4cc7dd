"""Logs of autopilots that were converted to text: their readings are corrected, by parameters that the text lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam.io import read

SIMULATION = mg.simulate("wide", 60, rate=20, seed=3)
RECORDING = SIMULATION.recording
PX4 = "timestamp,magnetometer_ga[0],magnetometer_ga[1],magnetometer_ga[2],gx,gy,gz"


def table(path: Path, header: str, unit: float) -> Path:
    offset = np.round(-SIMULATION.truth.hard_iron / unit)  # in flight
    rows = [np.round(RECORDING.time * 1e6), *(RECORDING.magnetic_field / unit + offset).T]
    rows += [np.full(len(RECORDING.time), o) for o in offset] if "Ofs" in header else []
    rows += list(RECORDING.angular_rate.T)
    np.savetxt(path, np.column_stack(rows), fmt="%.9g", delimiter=",", header=header, comments="")
    return path


@pytest.mark.parametrize(
    ("header", "unit", "of"),
    [
        ("TimeUS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,GyrX,GyrY,GyrZ", "mgauss", "ArduPilot's MAG messages"),
        ("TimeUS,MAG[0].MagX,MAG[0].MagY,MAG[0].MagZ,gx,gy,gz", "mgauss", "ArduPilot's MAG messages"),
        (PX4, "gauss", "PX4's magnetometer_ga"),
    ],
)
def test_a_table_of_corrected_readings_gives_no_parameters(
    tmp_path: Path, header: str, unit: str, of: str
) -> None:
    """They would have replaced the vehicle's offsets by the small rest."""
    named = ",".join(header.split(",")[1:4])
    step = {"mgauss": 1e-7, "gauss": 1e-4}[unit]
    path = table(tmp_path / "a.csv", header, step)
    recording = read(path, magnetic_field=named, magnetic_unit=unit, time_unit="us")
    calibration = mg.calibrate(recording)
    for target in ("px4", "ardupilot"):
        with pytest.raises(mg.MagycError, match=f"the columns are of {of}, which were corrected in flight"):
            calibration.export(target)
    assert "initial_mag_bias_x" in calibration.export("ros")
    other = read(
        table(tmp_path / "b.csv", "TimeUS,MagX,MagY,MagZ,gx,gy,gz", step), magnetic_unit=unit, time_unit="us"
    )
    assert other.autopilot is None  # of some instrument


def test_an_ardupilot_log_as_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "flight.log"
    path.write_text("FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\nMAG, 1000000, 0, 100, 200, 300\n")
    with pytest.raises(mg.MagycError, match=r"an ArduPilot log as text; read the \.BIN"):
        read(path)
