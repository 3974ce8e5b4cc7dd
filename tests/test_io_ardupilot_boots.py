"""ArduPilot logs in which a type is described again: another firmware, or the vehicle was switched on again."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from test_io_ardupilot import RAW, dataflash, flight, middle

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import read

SHORT = (65, "QBhhhhhhhhh", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ")  # without Health and S
LONG = (65, "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")
MIXED = (65, "QBhhhhhhhhhBI", "TimeUS,I,MagY,MagZ,MagX,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")  # of the same length
INTEGRAL = (66, "QBffffffI", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,GHz")


def again(layout: tuple[int, str, str], name: str) -> bytes:
    """A description of a type within a log."""
    number, code, columns = layout
    values = (number, 3 + struct.calcsize(f"<{code}"), name.encode(), code.encode(), columns.encode())
    return bytes([0xA3, 0x95, 0x80]) + struct.pack("<BB4s16s64s", *values)


def halves(path: Path, at: int = 20) -> tuple[bytes, list[tuple[int, tuple]]]:
    """The bytes of a log up to a sample, and the messages of magnetometer and gyroscope after it, by their numbers."""
    messages = flight()
    first = [k for k, (name, _) in enumerate(messages) if name == "MAG"][at]
    whole = dataflash(path, messages[:first]).read_bytes()
    return whole, [({"MAG": 65, "IMU": 66}[name], values) for name, values in messages[first:]]


def packed(number: int, layout: tuple[int, str, str], values: tuple) -> bytes:
    return bytes([0xA3, 0x95, number]) + struct.pack(f"<{layout[1]}", *values)


IMU = (66, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")


def test_each_part_is_read_by_its_own_description(tmp_path: Path) -> None:
    """By the last, the first half had x, y, z exchanged: the lengths agree."""
    head, rest = halves(tmp_path / "a.BIN")
    tail = b""
    for number, values in rest:
        if number == 65:
            turned = (*values[:2], *values[3:5], values[2], *values[5:])
            tail += packed(65, MIXED, turned)
        else:
            tail += packed(66, INTEGRAL, (*values, 7))
    (tmp_path / "b.BIN").write_bytes(head + again(MIXED, "MAG") + again(INTEGRAL, "IMU") + tail)
    back, whole = read(tmp_path / "b.BIN"), read(dataflash(tmp_path / "c.BIN", flight()))
    np.testing.assert_array_equal(back.magnetometer.value, whole.magnetometer.value)
    np.testing.assert_array_equal(back.gyroscope.value, whole.gyroscope.value)
    np.testing.assert_allclose(back.magnetometer.value, middle(np.round(RAW)) * 1e-7, atol=1e-15)


def test_columns_of_a_part_only_are_no_guess(tmp_path: Path) -> None:
    head, rest = halves(tmp_path / "a.BIN")
    tail = b"".join(
        packed(65, SHORT, values[:-2]) if number == 65 else packed(66, IMU, values) for number, values in rest
    )
    (tmp_path / "b.BIN").write_bytes(head + again(SHORT, "MAG") + tail)
    with pytest.raises(MagycError, match="MAG is described in several ways, and only some have Health; it seems"):
        read(tmp_path / "b.BIN")


def test_a_spoilt_description_costs_the_messages_after_it(tmp_path: Path) -> None:
    head, rest = halves(tmp_path / "a.BIN")
    tail = b"".join(packed(number, LONG if number == 65 else IMU, values) for number, values in rest)
    spoilt = again((65, LONG[1], LONG[2].replace("MagX", "MagY")), "MAG")  # two columns of one name
    (tmp_path / "b.BIN").write_bytes(head + spoilt + tail)
    back = read(tmp_path / "b.BIN", end=1.0)
    np.testing.assert_allclose(back.magnetometer.value, middle(np.round(RAW[:11])) * 1e-7, atol=1e-15)
    assert any("MAG: 20 messages left out, whose format does not fit" in note for note in back.notes)


def boot(path: Path, since: int, offset: float, scale: float | None, rows: int = 20) -> bytes:
    """The log of one boot whose clock begins at `since` s, with parameters of its own."""
    names = (f"COMPASS_{part}_{axis}" for part in ("OFS", "DIA", "ODI") for axis in "XYZ")
    parameters = {name: offset if "OFS" in name else float("DIA" in name) for name in names}
    parameters |= {} if scale is None else {"COMPASS_SCALE": scale}
    messages: list[tuple[str, tuple]] = []
    for k, m in enumerate(np.round(RAW[:rows]).astype(int).tolist()):
        at = since * 1_000_000 + k * 100_000
        if k == 3:  # samples come before the parameters are all logged
            messages += [("PARM", (at, name, value)) for name, value in parameters.items()]
        logged = (int((x + offset) * (scale or 1.0)) for x in m)
        messages.append(("MAG", (at, 0, *logged, *[int(offset)] * 3, 0, 0, 0, 1, at)))
        messages.append(("IMU", (at, 0, 0.1 * k, 0.0, 0.0, 0.0, 0.0, -9.8)))
    return dataflash(path, messages).read_bytes()


def test_each_boot_has_its_own_parameters(tmp_path: Path) -> None:
    """The first boot had the scale of the second, and the first samples of the second the offset of the first."""
    parts = boot(tmp_path / "a", 1, 100.0, None) + boot(tmp_path / "b", 30, 40.0, 1.25)
    (tmp_path / "c.BIN").write_bytes(parts)
    with pytest.raises(MagycError, match=r"switched on again after sample 20, 15\.\d s .* \(end=15\.\d or start"):
        read(tmp_path / "c.BIN")
    for interval in ({"end": 15.0}, {"start": 15.0}):
        back = read(tmp_path / "c.BIN", **interval)
        np.testing.assert_allclose(back.magnetometer.value, np.round(RAW[:20]) * 1e-7, atol=0.5e-7)
    (tmp_path / "d.BIN").write_bytes(boot(tmp_path / "b", 30, 40.0, 1.25) + boot(tmp_path / "a", 1, 100.0, None))
    with pytest.raises(MagycError, match=r"its clock goes back by 30\.900 s after sample 20"):
        read(tmp_path / "d.BIN")


def test_a_boot_without_parameters_is_not_read_by_those_of_another(tmp_path: Path) -> None:
    bare = boot(tmp_path / "b", 30, 40.0, None)
    parameter = struct.calcsize("<Q16sf") + 3
    first = bare.index(bytes([0xA3, 0x95, 64]) + struct.pack("<Q", 30_300_000))
    bare = bare[:first] + bare[first + 9 * parameter :]
    (tmp_path / "c.BIN").write_bytes(boot(tmp_path / "a", 1, 100.0, None) + bare)
    with pytest.raises(MagycError, match=r"the log holds no COMPASS_\* parameters"):
        read(tmp_path / "c.BIN", start=15.0)
