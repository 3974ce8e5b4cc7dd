"""Blackbox logs of Betaflight and INAV, written here by the format's description and read by orangebox."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import MagycError
from magyc_gtsam.io import info, read

pytest.importorskip("orangebox")

NAMES = ["loopIteration", "time"] + [f"{k}[{i}]" for k in ("gyroADC", "accSmooth", "magADC") for i in range(3)]
COUNT = 2e-9  # T, of a compass with 2 µT per 1000 counts, fine enough that rounding is no matter
GYRO = 0.0625  # deg/s


def unsigned(value: int) -> bytes:
    """Seven bits a byte, the lowest first."""
    result = bytearray()
    while value > 127:
        result.append((value & 127) | 128)
        value >>= 7
    return bytes([*result, value])


def signed(value: int) -> bytes:
    return unsigned((value << 1) ^ (value >> 31))


def written(names: list[str], rows: np.ndarray, *, ended: bool = True, headers: str = "") -> bytes:
    """A log of I frames: loopIteration and time unsigned, all else signed, nothing predicted."""
    scale = struct.unpack("<I", struct.pack("<f", GYRO))[0]
    lines = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        "I interval:1",
        "P interval:1/1",
        "Firmware type:Cleanflight",
        "Firmware revision:INAV 7.1.0 (abc) MATEKF405",
        f"gyro_scale:0x{scale:08x}",
        "acc_1G:4096",
        *headers.split(),
        "Field I name:" + ",".join(names),
        "Field I signed:" + ",".join("0" if k < 2 else "1" for k in range(len(names))),
        "Field I predictor:" + ",".join("0" for _ in names),
        "Field I encoding:" + ",".join("1" if k < 2 else "0" for k in range(len(names))),
        "Field P predictor:" + ",".join("1" for _ in names),
        "Field P encoding:" + ",".join("0" for _ in names),
    ]
    head = "".join(f"H {line}\n" for line in lines).encode()
    frames = b"".join(
        b"I" + unsigned(int(row[0])) + unsigned(int(row[1])) + b"".join(signed(int(v)) for v in row[2:])
        for row in rows
    )
    return head + frames + (b"E\xffEnd of log\0" if ended else b"")


def table(simulated: mg.Simulation) -> np.ndarray:
    """The recording in counts; the compass is new in every second row."""
    recording = simulated.recording
    assert recording.angular_rate is not None
    held = recording.magnetic_field[np.arange(len(recording.time)) // 2 * 2]
    rate = np.degrees(recording.angular_rate) / GYRO
    up = np.tile([0.0, 0.0, 4096.0], (len(rate), 1))
    micro = np.round(recording.time * 1e6)
    return np.round(np.c_[np.arange(len(micro)), micro, rate, up, held / COUNT]).astype(np.int64)


@pytest.fixture(scope="module")
def simulated() -> mg.Simulation:
    return mg.simulate("wide", 120, rate=20, seed=3)


def test_a_log_becomes_a_recording_and_a_calibration(simulated: mg.Simulation, tmp_path: Path) -> None:
    path = tmp_path / "LOG00001.BFL"
    path.write_bytes(written(NAMES, table(simulated)))
    recording = read(path, magnetic_unit=COUNT)
    assert recording.angular_rate is not None
    assert recording.acceleration is not None
    truth = simulated.recording
    assert truth.angular_rate is not None
    assert len(recording.gyroscope.time) >= len(truth.time) - 1  # the library drops the last frame
    every, last = slice(0, None, 2), len(recording.gyroscope.time)
    np.testing.assert_allclose(recording.magnetometer.value, truth.magnetic_field[:last][every], atol=COUNT)
    np.testing.assert_allclose(recording.gyroscope.value, truth.angular_rate[:last], atol=np.radians(GYRO))
    np.testing.assert_allclose(recording.magnetometer.time, truth.time[:last][every] - truth.time[0], atol=1e-6)
    np.testing.assert_allclose(recording.acceleration[:, 2], 9.80665)
    calibration = mg.calibrate(recording)
    np.testing.assert_allclose(calibration.hard_iron, simulated.truth.hard_iron, atol=1e-6)
    for target in ("px4", "ardupilot"):
        with pytest.raises(MagycError, match="the log is of Betaflight or INAV, and its magADC includes"):
            calibration.export(target)
    described = info(path)
    assert described.format == "Blackbox (INAV 7.1.0 (abc) MATEKF405)"
    assert {source.serves_as for source in described.sources} == {
        ("magnetic_field",),
        ("angular_rate",),
        ("acceleration",),
    }


def test_what_is_wrong_with_a_log_is_said(simulated: mg.Simulation, tmp_path: Path) -> None:
    path, rows = tmp_path / "log.bbl", table(simulated)[:400]
    path.write_bytes(written(NAMES, rows))
    with pytest.raises(MagycError, match="counts of the compass chip; give the tesla per count"):
        read(path)
    assert read(path, magnetic_unit="counts").magnetic_field_unit == "counts"
    with pytest.raises(MagycError, match="log 3|log_index: 3"):
        read(path, magnetic_unit=COUNT, log=3)
    path.write_bytes(written(NAMES[:8], rows[:, :8]))
    with pytest.raises(MagycError, match="no magADC in the log"):
        read(path, magnetic_unit=COUNT)
    path.write_bytes(written(NAMES, rows, ended=False))  # the power was cut
    cut = read(path, magnetic_unit=COUNT)
    assert any("is cut off" in note for note in cut.notes)
    assert len(cut.time) >= 398
    for scale in ("px3d800000", "0x7fffffffff", "0"):
        path.write_bytes(written(NAMES, rows).replace(b"gyro_scale:0x3d800000", b"gyro_scale:" + scale.encode()))
        with pytest.raises(MagycError, match="gyro_scale in the header must be between"):
            read(path, magnetic_unit=COUNT)
    path.write_bytes(b"H Product:Blackbox" + bytes(range(256)))
    with pytest.raises(MagycError, match=r"log\.bbl: "):
        read(path, magnetic_unit=COUNT)
    path.write_bytes(b"no blackbox at all\0")
    with pytest.raises(MagycError, match="the content is not that of a"):
        read(path)


def test_several_logs_and_high_resolution(simulated: mg.Simulation, tmp_path: Path) -> None:
    path, rows = tmp_path / "log.bbl", table(simulated)[:300]
    fine = written(NAMES, rows[150:], headers="blackbox_high_resolution:1")
    path.write_bytes(written(NAMES, rows[:150]) + fine)
    first, second = (read(path, magnetic_unit=COUNT, log=k) for k in (1, 2))
    assert "the file holds 2 logs, this is number 2 (log=)" in second.notes
    assert min(len(first.time), len(second.time)) >= 149
    np.testing.assert_allclose(first.angular_rate, rows[: len(first.time), 2:5] * np.radians(GYRO), rtol=1e-6)
    np.testing.assert_allclose(
        second.angular_rate, rows[150 : 150 + len(second.time), 2:5] * np.radians(GYRO) / 10, rtol=1e-6
    )
