"""Text tables: names, units, separators and stamps as people write them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import info, read
from magyc_gtsam.io.log_info import turned

RANDOM = np.random.default_rng(5)
N = 50
TIME = np.arange(N) * 0.01
FIELD = RANDOM.normal(0, 3e-5, (N, 3))  # T
RATE = RANDOM.normal(0, 0.5, (N, 3))  # rad/s


def write(path: Path, header: str, *columns: np.ndarray, separator: str = ",", tail: str = "") -> Path:
    table = np.column_stack(columns).tolist()
    lines = [header] if header else []
    lines += [separator.join(repr(x) for x in row) for row in table]
    path.write_text("\n".join(lines) + "\n" + tail)
    return path


@pytest.mark.parametrize(
    ("header", "scale", "time_scale", "separator"),
    [
        ("time,mx,my,mz,gx,gy,gz", (1, 1), 1, ","),
        ("Time (s),Magnetometer X (uT),Magnetometer Y (uT),Magnetometer Z (uT),"
         "Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)", (1e6, 180 / np.pi), 1, ","),
        ("t [s]; mag_x [uT]; mag_y [uT]; mag_z [uT]; wx [rad/s]; wy [rad/s]; wz [rad/s]", (1e6, 1), 1, ";"),
        ("timestamp_ns\tmag.x\tmag.y\tmag.z\tgyro.x\tgyro.y\tgyro.z", (1, 1), 1e9, "\t"),
        ("time_ms magnetic_field_x_T magnetic_field_y_T magnetic_field_z_T "
         "angular_rate_x angular_rate_y angular_rate_z", (1, 1), 1e3, " "),
        ("TimeUS,MagX_mG,MagY_mG,MagZ_mG,GyrX_dps,GyrY_dps,GyrZ_dps", (1e7, 180 / np.pi), 1e6, ","),
        ("stamp_us,imu_magnetic_field_x_gauss,imu_magnetic_field_y_gauss,imu_magnetic_field_z_gauss,"
         "angular_velocity.x,angular_velocity.y,angular_velocity.z", (1e4, 1), 1e6, ","),
        ("# t mx my mz wx wy wz", (1, 1), 1, " "),
    ],
)  # fmt: skip
def test_names_and_units(
    tmp_path: Path, header: str, scale: tuple[float, float], time_scale: float, separator: str
) -> None:
    time = TIME * time_scale if time_scale == 1 else np.round(TIME * time_scale)
    path = write(tmp_path / "a.csv", header, time, FIELD * scale[0], RATE * scale[1], separator=separator)
    back = read(path)
    np.testing.assert_allclose(back.time, TIME, atol=1e-12)
    np.testing.assert_allclose(back.magnetic_field, FIELD, rtol=1e-12)
    np.testing.assert_allclose(back.angular_rate, RATE, rtol=1e-12)  # type: ignore[arg-type]


def test_values_are_exact_and_stamps_to_the_nanosecond(tmp_path: Path) -> None:
    nanoseconds = 1_620_000_000_000_000_001 + np.arange(N, dtype=np.int64) * 10_000_003
    rows = [
        f"{s // 10**9}.{s % 10**9:09d},{m[0]!r},{m[1]!r},{m[2]!r}"
        for s, m in zip(nanoseconds, FIELD.tolist(), strict=True)
    ]
    (tmp_path / "a.csv").write_text("time_s,mx,my,mz\n" + "\n".join(rows))
    back = read(tmp_path / "a.csv")
    np.testing.assert_array_equal(np.round(back.time * 1e9), nanoseconds - nanoseconds[0])
    np.testing.assert_array_equal(back.magnetic_field, FIELD)
    assert "time 0 is 2021-05-03T00:00:00.000000001Z (1620000000.000000001 s)" in back.notes
    calendar = [f"2021-05-03T02:00:00.{k * 10:03d}000001+02:00" for k in range(N)]
    rows = [f"{c},{m[0]!r},{m[1]!r},{m[2]!r}" for c, m in zip(calendar, FIELD.tolist(), strict=True)]
    (tmp_path / "b.csv").write_text("time,mx,my,mz\n" + "\n".join(rows))
    back = read(tmp_path / "b.csv")
    np.testing.assert_allclose(back.time, TIME, atol=1e-12)
    assert "time 0 is 2021-05-03T00:00:00.000000001Z (1620000000.000000001 s)" in back.notes


def test_a_clock_that_begins_below_zero(tmp_path: Path) -> None:
    """Its fraction of a second was counted from the second below, in the note and in what `apply` wrote."""
    log = write(tmp_path / "a.csv", "time_s,mx,my,mz,gx,gy,gz", np.round(TIME - 0.245, 3), FIELD, RATE)
    assert read(log).notes == ("time 0 is -0.245000000 s on the log's own clock",)
    mg.Calibration(np.eye(3), np.zeros(3)).save(tmp_path / "cal.yaml")
    apply = ["apply", str(tmp_path / "cal.yaml"), str(log), "-q", "-o"]
    cli.main([*apply, str(tmp_path / "out.csv")])
    lines = [path.read_text().splitlines()[1:] for path in (log, tmp_path / "out.csv")]
    before, after = ([float(line.split(",")[0]) for line in each] for each in lines)
    assert before == after
    assert cli.main([*apply, str(tmp_path / "out.mcap")]) == 2
    assert not (tmp_path / "out.mcap").exists()


def test_named_columns(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "clock,a1,a2,a3,b1,b2,b3", TIME, FIELD, RATE)
    with pytest.raises(
        MagycError, match=r"no magnetometer among the columns clock, a1.* and the column of time stamps"
    ):
        read(path)
    back = read(path, time="clock", magnetic_field="a1,a2,a3", angular_rate=["b1", "b2", "b3"])
    np.testing.assert_array_equal(back.angular_rate, RATE)
    with pytest.raises(MagycError, match="no column 'a9'; the file has clock, a1"):
        read(path, time="clock", magnetic_field="a1,a2,a9")
    with pytest.raises(MagycError, match="expected 3 columns .x, y, z., got 2"):
        read(path, time="clock", magnetic_field="a1,a2")


def test_an_attitude_without_a_prefix_has_a_name(tmp_path: Path) -> None:
    names = "t,mag_x,mag_y,mag_z,quaternion_x,quaternion_y,quaternion_z,quaternion_w"
    path = write(tmp_path / "a.csv", names, TIME, FIELD, np.tile([0.0, 0.0, 0.0, 1.0], (len(TIME), 1)))
    (named,) = [source.name for source in info(path).sources if "attitude" in source.serves_as]
    assert named == "quaternion_x, quaternion_y, quaternion_z, quaternion_w"
    np.testing.assert_array_equal(read(path, attitude=named).attitude, read(path).attitude)


def test_two_magnetometers(tmp_path: Path) -> None:
    numbered = "t,mag1_x_uT,mag1_y_uT,mag1_z_uT,mag2_x_uT,mag2_y_uT,mag2_z_uT"
    path = write(tmp_path / "a.csv", numbered, TIME, 1e6 * FIELD, 2e6 * FIELD)
    with pytest.raises(
        MagycError, match="2 sets of columns could be meant: mag1_x_uT, mag1_y_uT, mag1_z_uT; mag2"
    ):
        read(path)
    sources = info(path).sources  # what `--all` reads one by one
    assert [(source.name, source.serves_as) for source in sources] == [
        ("mag1", ("magnetic_field",)),
        ("mag2", ("magnetic_field",)),
    ]
    for source, factor in zip(sources, (1, 2), strict=True):
        field = read(path, magnetic_field=source.name).magnetic_field
        np.testing.assert_allclose(field, factor * FIELD, rtol=1e-12)
    names = "t,imu_mag_x,imu_mag_y,imu_mag_z,gps_mag_x,gps_mag_y,gps_mag_z"
    write(path, names, TIME, FIELD, 2 * FIELD)
    with pytest.raises(MagycError, match="2 sets of columns could be meant: imu_mag_x, imu_mag_y, imu_mag_z; gps"):
        read(path)
    np.testing.assert_array_equal(read(path, magnetic_field="gps").magnetic_field, 2 * FIELD)


def test_a_wrong_unit_that_was_given_is_named(tmp_path: Path) -> None:
    recording = mg.simulate("wide", 20).recording
    path = tmp_path / "a.csv"
    table = np.column_stack([recording.time, recording.magnetic_field * 1e6])
    np.savetxt(path, table, delimiter=",", header="time,mag_x,mag_y,mag_z", comments="")
    with pytest.raises(MagycError, match="likely unit: µT"):
        read(path)
    with pytest.raises(MagycError, match="it was read in mT, as requested: name another unit, or none") as given:
        read(path, magnetic_unit="mT")
    assert "likely" not in str(given.value)


def test_wrong_unit_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t,mx,my,mz,gx,gy,gz", TIME, FIELD * 1e6, RATE * 180)
    with pytest.raises(MagycError, match="likely unit: µT"):
        read(path)
    with pytest.raises(MagycError, match="likely unit: deg/s"):
        read(path, magnetic_unit="uT")
    back = read(path, magnetic_unit="µT", angular_unit="deg/s")
    np.testing.assert_allclose(back.magnetic_field, FIELD, rtol=1e-12)
    labelled = write(tmp_path / "b.csv", "t,mx (T),my (T),mz (T)", TIME, FIELD * 1e6)
    assert any(
        "read in uT, as requested, though the header says T" in n for n in read(labelled, magnetic_unit="uT").notes
    )
    mixed = write(tmp_path / "c.csv", "t,mx (T),my (T),mz (uT)", TIME, FIELD)
    with pytest.raises(MagycError, match=r"mz \(uT\): different units in the header; .*magnetic_unit="):
        read(mixed)
    first = write(tmp_path / "d.csv", "t,mx (uT),my,mz", TIME, FIELD * 1e6)
    assert read(mixed, magnetic_unit="T").notes[0].endswith("though the header says T, uT")
    np.testing.assert_allclose(read(first, magnetic_unit="uT").magnetic_field, FIELD, rtol=1e-12)
    with pytest.raises(MagycError, match=r"mx \(uT\), my, mz: different units in the header"):
        read(first)
    alike = write(tmp_path / "e.csv", "t,mx (uT),my (µT),mz (microtesla)", TIME, FIELD * 1e6)
    np.testing.assert_allclose(read(alike).magnetic_field, FIELD, rtol=1e-12)


def test_unit_of_time_is_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "time,mx,my,mz", TIME * 1e3, FIELD)
    with pytest.raises(MagycError, match=r"has a median step of 10; likely unit: ms; name it \(time_unit='ms'\)"):
        read(path)
    np.testing.assert_allclose(read(path, time_unit="ms").time, TIME, atol=1e-12)


def test_without_header(tmp_path: Path) -> None:
    path = write(tmp_path / "a.txt", "", FIELD, separator=" ")
    said = r"3 columns of numbers without a header; name .*columns='mx,my,mz'.* rate in Hz \(rate=\)"
    with pytest.raises(MagycError, match=said):
        read(path)
    back = read(path, columns="mx my mz", rate=20)
    np.testing.assert_array_equal(back.magnetic_field, FIELD)
    np.testing.assert_allclose(back.time, np.arange(N) / 20)
    assert "header" in str(info(path).problem)


def test_every_column_must_be_named(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "", TIME, FIELD, RATE)
    with pytest.raises(MagycError, match="7 values, expected 4; name every column of the table .columns=."):
        read(path, columns="t,mx,my,mz")


def test_comments_and_separators_at_the_end_of_lines_as_xsens_writes_them(tmp_path: Path) -> None:
    lines = ["// Start Time: 0", "// Sample rate: 100.0Hz", "Counter\tGyr_X\tGyr_Y\tGyr_Z\tMag_X\tMag_Y\tMag_Z"]
    lines += [f" {k}\t" + "\t".join(map(repr, [*RATE[k].tolist(), *FIELD[k].tolist()])) + "\t" for k in range(N)]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(lines) + "\n")
    back = read(path, rate=100)
    np.testing.assert_array_equal(back.magnetometer.value, FIELD)
    np.testing.assert_array_equal(back.gyroscope.value, RATE)
    path.write_text("\n".join([*lines[:9], lines[9] + "7\t", *lines[10:]]))
    with pytest.raises(MagycError, match="line 10: 9 values, expected 8"):
        read(path, rate=100)


def test_empty_cells_are_another_sensors_rows(tmp_path: Path) -> None:
    lines = ["time,mx,my,mz,gx,gy,gz,note,current"]
    for k in range(N):
        field = ",".join(map(repr, FIELD[k].tolist())) if k % 4 == 0 else ",,"
        lines.append(f"{k / 100},{field},{','.join(map(repr, RATE[k].tolist()))},fine,{k if k % 10 == 0 else ''}")
    (tmp_path / "a.csv").write_text("\n".join(lines))
    back = read(tmp_path / "a.csv")
    np.testing.assert_array_equal(back.magnetometer.value, FIELD[::4])
    np.testing.assert_array_equal(back.gyroscope.value, RATE[: len(back.gyroscope.value)])
    np.testing.assert_allclose(back.channels["current"][:41], np.arange(41), atol=1e-12)
    assert any("columns with text were left out: note" in n for n in back.notes)


def test_broken_lines(tmp_path: Path) -> None:
    header = "# a comment\ntime,mx,my,mz"
    path = write(tmp_path / "a.csv", header, TIME, FIELD, tail="0.5,1e-5,2e")
    back = read(path)
    assert len(back.time) == N
    assert any(f"line {N + 3}, the last, is incomplete" in n for n in back.notes)
    lines = path.read_text().splitlines()
    (tmp_path / "b.csv").write_text("\n".join([*lines[:9], "0.07,1e-5", *lines[10:-1]]))
    with pytest.raises(MagycError, match="line 10: 2 values, expected 4"):
        read(tmp_path / "b.csv")
    (tmp_path / "c.csv").write_text("\n".join([*lines[:9], "0.07,1e-5,bad,3e-5", *lines[10:-1]]))
    with pytest.raises(MagycError, match="line 10: 'bad' in column 3 is not a number"):
        read(tmp_path / "c.csv")
    (tmp_path / "d.csv").write_text("\n".join([*lines[:9], "noon,1e-5,1e-5,3e-5", *lines[10:-1]]))
    with pytest.raises(MagycError, match="line 10: 'noon' is neither a number nor a date and time"):
        read(tmp_path / "d.csv")
    (tmp_path / "e.csv").write_text("time,mx,my,mz\n")
    with pytest.raises(MagycError, match="a header but no data"):
        read(tmp_path / "e.csv")


def test_rate_beside_stamps(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t,mx,my,mz", np.floor(TIME), FIELD)
    with pytest.raises(MagycError, match=r"a\.csv: m: 49 stamps occur twice .*; give the rate in Hz in place"):
        read(path)
    spaced = read(path, rate=100)
    np.testing.assert_allclose(spaced.time, TIME)
    assert not spaced.channels
    assert "the stamps in t were not used: the rate is 100 Hz" in spaced.notes
    with pytest.raises(MagycError, match="stamps='log': a text log has only the stamps in its columns"):
        read(path, stamps="log")
    with pytest.raises(MagycError, match=r"rate: the column t of time stamps \(time=\) was named, too"):
        read(path, rate=100, time="t")


@pytest.mark.parametrize("stamp", ["01.09.2025 08:00:{:06.3f}", "08:00:{:06.3f}", "9/12/2025 11:55:{:06.3f}"])
def test_stamps_in_another_form_than_iso(tmp_path: Path, stamp: str) -> None:
    lines = [f"{stamp.format(t)},{x},{y},{z}" for t, (x, y, z) in zip(TIME, FIELD.tolist(), strict=True)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time,mx,my,mz", *lines]) + "\n")
    with pytest.raises(MagycError, match=r"in line 2 and the others, .* ISO 8601 .* Hz in their place \(rate=\)"):
        read(path)
    np.testing.assert_array_equal(read(path, rate=100).magnetic_field, FIELD)


def test_the_unit_of_stamps_is_that_of_their_steps(tmp_path: Path) -> None:
    for name, scale, unit in (("nanoseconds", 1e9, "ns"), ("milliseconds", 1e3, "ms")):
        path = write(
            tmp_path / f"{name}.csv", "time,mx,my,mz", np.round(TIME * 100 * scale), FIELD
        )  # steps of 1 s
        with pytest.raises(MagycError, match=f"likely unit: {unit}; name it"):
            read(path)
        assert read(path, time_unit=unit).duration == pytest.approx(100 * TIME[-1])
    path = write(tmp_path / "labelled.csv", "time (s),mx,my,mz", TIME * 1e4, FIELD)
    with pytest.raises(
        MagycError, match=r"is read in s and has a median step of 100 s; likely unit: ms; name it \(ti"
    ):
        read(path)
    assert read(path, time_unit="ms").duration == pytest.approx(10 * TIME[-1])


def test_messages_name_the_file_the_header_and_what_counts_need(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "time,mx,my,mz", TIME, np.rint(FIELD * 1e7))
    with pytest.raises(MagycError, match=r"a\.csv: magnetic_field: .* or raw counts; .* give the tesla per count"):
        read(path)
    table = write(tmp_path / "b.csv", "time,mx,my,mz,", TIME, FIELD, tail="").read_text().replace("\n", ",\n")
    path.write_text(table.replace("mz,,", "mz,"))
    assert not read(path).channels
    assert not any("not finite" in note for note in read(path).notes)
    assert "channel" not in {use for source in info(path).sources for use in source.serves_as}
    for title in ("Vessel: Aurora\nDate: today\n\n", "Log of the boat\nDate: today\n", "Log\n"):
        path.write_text(title + write(tmp_path / "c.csv", "time,mx,my,mz", TIME, FIELD).read_text())
        with pytest.raises(
            MagycError, match="looks like the header: remove the lines above it, or begin them with #"
        ):
            read(path)
    tabs = write(tmp_path / "c.txt", "time\tmx\tmy\tmz", TIME, FIELD, separator="\t").read_text().replace(".", ",")
    path.write_text(tabs)
    np.testing.assert_array_equal(read(path).magnetic_field, FIELD)
    two = write(tmp_path / "d.csv", "time,mx,my,mz,gx,gz", TIME, FIELD, RATE[:, :2])
    with pytest.raises(MagycError, match=r"columns time, .*, gx, gz; name its three columns \(angular_rate='"):
        _ = read(two).gyroscope


def test_what_is_no_log(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").touch()
    with pytest.raises(MagycError, match="expected a file, got a directory; read its bag_0"):
        read(tmp_path / "bag")
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\0\0\0")
    with pytest.raises(MagycError, match="not a format that can be read"):
        read(tmp_path / "a.png")
    for content, words in (
        ("time,mx,my,mz\n".encode("utf-16"), "text in UTF-16; save it as UTF-8"),
        (b' {"time": 0, "magnetic_field": [0, 0, 0]}\n', "JSON is not a format of logs"),
        (b'[{"time": 0}]', "JSON is not a format of logs"),
    ):
        (tmp_path / "a.txt").write_bytes(content)
        with pytest.raises(MagycError, match=words):
            read(tmp_path / "a.txt")


def test_the_micro_sign_of_a_table_that_is_not_utf_8(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t;mag x (µT);mag y (µT);mag z (µT)", TIME, 1e6 * FIELD, separator=";")
    path.write_bytes(path.read_text(encoding="utf-8").encode("latin-1"))
    np.testing.assert_allclose(read(path).magnetic_field, FIELD, rtol=1e-12)


def test_decimal_commas(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t;mx;my;mz", TIME, FIELD, separator=";")
    path.write_text(path.read_text().replace(".", ","))
    np.testing.assert_array_equal(read(path).magnetic_field, FIELD)


def test_one_stamp_with_two_values(tmp_path: Path) -> None:
    time = TIME.copy()
    time[20] = time[19]
    with pytest.raises(MagycError, match="1 stamps occur twice with different values"):
        read(write(tmp_path / "a.csv", "t,mx,my,mz", time, FIELD))


def test_attitude_columns(tmp_path: Path) -> None:
    quaternion = np.tile([0.0, 0.6, 0.0, 0.8], (N, 1))
    path = write(tmp_path / "a.csv", "t,mx,my,mz,qw,qx,qy,qz", TIME, FIELD, quaternion[:, [3, 0, 1, 2]])
    np.testing.assert_allclose(read(path).attitude, quaternion)  # type: ignore[arg-type]


def test_what_a_driver_writes_without_a_field_is_left_out(tmp_path: Path) -> None:
    """A quarter of zeros moved the hard iron by 4 µT, unnoticed; a value of 1 T stopped the whole log."""
    field = FIELD.copy()
    field[::4] = 0
    field[5] = 1.0
    back = read(write(tmp_path / "a.csv", "t,mx,my,mz", TIME, field))
    kept = (field != 0).all(axis=1) & (np.arange(N) != 5)
    np.testing.assert_array_equal(back.magnetic_field, FIELD[kept])
    assert any(f"{-(-N // 4)} of {N} samples are zero on all axes and were left out" in n for n in back.notes)
    assert any(f"1 of {N} samples are beyond 0.01 T and were left out" in n for n in back.notes)
    with pytest.raises(MagycError, match="zero in 100% of 50 rows"):
        read(write(tmp_path / "b.csv", "t,mx,my,mz", TIME, FIELD * 0))
    with pytest.raises(MagycError, match="likely unit: µT"):
        read(write(tmp_path / "c.csv", "t,mx,my,mz", TIME, FIELD * 1e6))


@pytest.mark.parametrize(("unit", "size"), [("ms", 3), ("us", 6), ("ns", 9)])
def test_stamps_since_1970_without_a_unit(tmp_path: Path, unit: str, size: int) -> None:
    stamps = [1_700_000_000 * 10**size + k * 10 ** (size - 1) for k in range(N)]
    path = tmp_path / "a.csv"
    rows = (f"{stamp},{x!r},{y!r},{z!r}" for stamp, (x, y, z) in zip(stamps, FIELD.tolist(), strict=True))
    path.write_text("\n".join(["time,mx,my,mz", *rows]), encoding="utf-8")
    with pytest.raises(
        MagycError, match=rf"line 2: .* beyond any date in s; likely unit: {unit}; .*time_unit='{unit}'"
    ):
        read(path)
    np.testing.assert_allclose(read(path, time_unit=unit).time, np.arange(N) / 10, atol=1e-9)


def test_xio(shared_data: Path) -> None:
    path = shared_data / "xio_hand_motion.csv"
    back = read(path)
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert len(back.time) == len(table)
    np.testing.assert_allclose(back.time, table[:, 0], atol=1e-9)
    np.testing.assert_allclose(back.angular_rate, np.radians(table[:, 1:4]), rtol=1e-12)  # type: ignore[arg-type]
    np.testing.assert_allclose(back.acceleration, table[:, 4:7] * 9.80665, rtol=1e-12)  # type: ignore[arg-type]
    np.testing.assert_allclose(back.magnetic_field, table[:, 7:] * 1e-6, rtol=1e-12)
    assert back.magnetic_field_fresh.mean() == pytest.approx(0.2, abs=0.02)
    assert info(path).readable


def test_raw_counts_without_time(shared_data: Path) -> None:
    path = shared_data / "magnetometer_only.txt"
    with pytest.raises(MagycError, match="3 columns of numbers without a header"):
        read(path)
    with pytest.raises(MagycError, match="is not a field in tesla"):
        read(path, columns="mx,my,mz", rate=10)
    back = read(path, columns="mx,my,mz", rate=10, magnetic_unit=2.5e-7)
    np.testing.assert_allclose(back.magnetic_field, np.loadtxt(path) * 2.5e-7, rtol=1e-15)
    assert any("multiplied by 2.5e-07" in n for n in back.notes)


def test_a_sensor_that_no_method_asked_for_is_not_refused_for(tmp_path: Path) -> None:
    """Two accelerometers, of which nobody said which: the calibration does not need one."""
    header = "t,mx,my,mz,gx,gy,gz,imu1_acc_x,imu1_acc_y,imu1_acc_z,imu2_acc_x,imu2_acc_y,imu2_acc_z"
    path = write(tmp_path / "a.csv", header, TIME, FIELD, RATE, RATE, 2 * RATE)
    back = read(path)
    assert back.acceleration is None
    assert any("acceleration left out" in n and "name one (acceleration=)" in n for n in back.notes)
    np.testing.assert_array_equal(read(path, acceleration="imu2_acc").acceleration, 2 * RATE)
    with pytest.raises(MagycError, match="2 sets of columns could be meant"):
        read(path, acceleration="imu")


def test_pieces_are_as_the_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A table is read piece by piece; where they end decides nothing, and line numbers stay those of the file."""
    path = write(tmp_path / "a.csv", "# made by hand\nt,mx,my,mz,gx,gy,gz", TIME, FIELD, RATE)
    text = path.read_text().splitlines()
    text[20:20] = ["", "# a remark", "  "]
    path.write_text("\n".join(text) + "\n0.7,1e-5")
    whole = read(path)
    text[40] = text[40].replace(",", ",x", 1)
    wrong = tmp_path / "b.csv"
    wrong.write_text("\n".join(text))
    for size in (1, 7, 64, 1000):
        monkeypatch.setattr("magyc_gtsam.io.csv_lines._PIECE", size)
        part = read(path)
        np.testing.assert_array_equal(part.time, whole.time)
        np.testing.assert_array_equal(part.magnetic_field, whole.magnetic_field)
        assert part.notes == whole.notes
        with pytest.raises(MagycError, match="line 41: 'x.*' in column 2 is not a number"):
            read(wrong)
    assert any("the last, is incomplete" in n for n in whole.notes)


@pytest.mark.parametrize("written", ["{:.9f}", "{:.3f}", "{:+.9f}", "{:.9e}", " {:.6f} "])
def test_stamps_are_exact_however_they_are_written(tmp_path: Path, written: str) -> None:
    from decimal import Decimal

    seconds = [Decimal(k * 10_007_001) / 10**9 + (1_600_000_000 if k % 2 == 5 else 3) for k in range(N)]
    cells = [written.format(s) for s in seconds]
    rows = [f"{c},{m[0]!r},{m[1]!r},{m[2]!r}" for c, m in zip(cells, FIELD.tolist(), strict=True)]
    (tmp_path / "a.csv").write_text("t,mx,my,mz\n" + "\n".join(rows))
    expected = [int(Decimal(c.strip()) * 10**9) for c in cells]
    np.testing.assert_array_equal(np.round(read(tmp_path / "a.csv").time * 1e9), np.array(expected) - expected[0])


@pytest.mark.parametrize("name", ["(" * 100_000, "a" + " " * 100_000 + "b", "mag_" * 25_000])
def test_a_name_without_end_is_of_no_sensor(tmp_path: Path, name: str) -> None:
    """Nor is it looked through for a unit, which takes the square of its length."""
    path = write(tmp_path / "a.csv", f"t,mx,my,mz,{name}", TIME, FIELD, TIME)
    np.testing.assert_array_equal(read(path).magnetic_field, FIELD)


def test_a_table_of_very_many_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(",".join(["t"] * 50_000) + "\n" + ",".join(["1"] * 50_000) + "\n")
    with pytest.raises(MagycError, match="at most 10000 columns are read, got 50000"):
        read(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no such files there")
def test_what_can_be_read_once_only(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(MagycError, match="got a pipe or a device"):
        info(tmp_path / "pipe.csv")


def test_two_columns_of_one_name(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t,mx,my,mz,mx,my,mz", TIME, FIELD, RATE)
    with pytest.raises(MagycError, match="the columns mx and mx have the same name"):
        read(path)
    np.testing.assert_array_equal(read(path, columns="t,mx,my,mz,gx,gy,gz").angular_rate, RATE)


@pytest.mark.parametrize("stamp", ["1e999999", "1e99999999999", "9999-01-01T00:00:00", "0001-01-01", "1" * 5000])
def test_stamps_beyond_all_clocks(tmp_path: Path, stamp: str) -> None:
    path = write(tmp_path / "a.csv", "t,mx,my,mz", TIME, FIELD, tail=f"{stamp},1e-5,1e-5,1e-5\n")
    with pytest.raises(MagycError, match=f"line {N + 2}"):
        read(path)


@pytest.mark.parametrize(
    "written",
    ["2024-05-01T12:00:{:09.6f}Z", "2024-05-01 14:00:{:09.6f}+02:00", "2024-05-01T12:00:{:012.9f}"],
)
def test_calendar_dates(tmp_path: Path, written: str) -> None:
    """As every version of Python reads them, whatever its own datetime takes."""
    lines = [f"{written.format(t)},1e-5,{k}e-6,1e-5" for k, t in enumerate(TIME)]
    path = tmp_path / "a.csv"
    path.write_text("t,mx,my,mz\n" + "\n".join(lines))
    np.testing.assert_allclose(read(path).time, TIME, rtol=0, atol=1e-9)


def test_a_cell_in_quotation_marks_without_end(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "t,mx,my,mz", TIME, FIELD, tail='"' + "1" * 200_000 + ",1,1,1\n")
    with pytest.raises(MagycError, match="cannot be split into cells") as caught:
        read(path)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "option",
    [{"rate": "fast"}, {"rate": [1]}, {"rate": True}, {"rate": float("nan")}, {"columns": 5}, {"columns": ["t", 5]},
     {"time": 5}, {"time_unit": ["s"]}, {"magnetic_unit": ["T"]}, {"start": "now"}, {"end": float("nan")}],
)  # fmt: skip
def test_options_of_another_kind(tmp_path: Path, option: dict[str, object]) -> None:
    path = write(tmp_path / "a.csv", "t,mx,my,mz", TIME, FIELD)
    with pytest.raises(MagycError, match=next(iter(option)).replace("magnetic_unit", "magnetic_field")):
        read(path, **option)  # type: ignore[arg-type]


def test_gaps_and_missing_values_are_named(tmp_path: Path) -> None:
    names = "time,mx,my,mz,gx,gy,gz"
    paused = TIME + np.where(np.arange(N) >= N // 2, 3600.0, 0.0)
    described = info(write(tmp_path / "paused.csv", names, paused, FIELD, RATE))
    assert "there are no samples from 0.2 to 3600.2 s" in described.warnings
    assert [source.rate for source in described.sources] == pytest.approx([100, 100], rel=0.05)
    time = np.arange(600) * 0.1
    rate = np.column_stack([np.sign(np.sin(time)), 0 * time, 0 * time])  # rad/s
    gap = np.where(time > 30, 3600.0, 0.0)
    assert turned(time + gap, rate) == pytest.approx(turned(time, rate), abs=2.5)

    field = FIELD.copy()
    field[5:40] = np.nan
    path = write(tmp_path / "missing.csv", names, TIME, field, RATE)
    said = "m: 35 of 50 lines have no value"
    assert said in read(path).notes
    assert {said, "the magnetometer has no samples from 0.0 to 0.4 s"} & {*info(path).warnings} == {said}  # 0.36 s
    field[:] = np.where(np.arange(N)[:, None] % 3, np.nan, FIELD)  # a third of the gyroscope's rate
    assert not [
        note for note in read(write(tmp_path / "slow.csv", names, TIME, field, RATE)).notes if "lines" in note
    ]
