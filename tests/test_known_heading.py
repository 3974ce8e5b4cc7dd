"""A known heading as a fact: it tells the rotation of the chips about the vertical on a level vehicle."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fact_slopes import check_slope
from scipy.spatial.transform import Rotation

from magyc_gtsam import Calibration, MagycError, Recording, calibrate, cli, simulate
from magyc_gtsam.estimators.smoother.heading import HeadingFact, heading_fact
from magyc_gtsam.estimators.smoother.options import KnownHeading
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.study.known import heading_error, skewed

DEGREE = np.pi / 180


def with_heading(simulation, off=0.0, seed=0):
    """The recording with a channel `course`, once a second, noisy, and off by some degrees; and the declination."""
    recording = simulation.recording
    ahead = Rotation.from_quat(recording.attitude).apply([1.0, 0.0, 0.0])  # north, east, down
    course = np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])) + off
    course += np.random.default_rng(seed).normal(size=len(course))
    course[np.arange(len(course)) % 10 != 0] = np.nan
    declination = float(np.arctan2(simulation.field[1], simulation.field[0]))
    return replace(recording, channels={"course": course % 360}, attitude=None), declination


def test_its_slope_is_the_derivative_of_the_heading_of_the_chain():
    """On all parameters, skew included, the directions at their best for each."""
    simulation = simulate("low", 200, seed=3)
    recording, declination = with_heading(simulation)
    fit = fit_field_chain(recording, misalignment=DEGREE)
    (fact,) = heading_fact(recording, KnownHeading("course", DEGREE, declination))
    fit = replace(fit, chain=replace(fit.chain, facts=(*fit.chain.facts, fact)))

    check_slope(fit, HeadingFact)


def test_on_a_level_vehicle_the_heading_is_nearer_to_the_truth_and_its_sigma_smaller():
    """On 30 boards as they are believed to be 0.28° instead of 0.53°, at a mean NEES of 11.1."""
    off, stated = {"alone": [], "told": []}, {"alone": [], "told": []}
    for seed in range(6):
        simulation = skewed("level", 1.2, seed)
        recording, declination = with_heading(simulation, seed=seed)
        told = {"heading": ("course", 0.2 * DEGREE), "declination": declination}
        for way, options in (("alone", {}), ("told", told)):
            calibration = calibrate(recording, **options)
            off[way].append(heading_error(simulation, 1.2, seed, calibration))
            stated[way].append(calibration.observability.heading_sigma)
        assert calibration.diagnostics["heading"]["used"]
    assert np.linalg.norm(off["told"]) < 0.7 * np.linalg.norm(off["alone"])
    assert np.mean(stated["told"]) < 0.8 * np.mean(stated["alone"])
    assert np.linalg.norm(off["told"]) < 2 * np.linalg.norm(stated["told"])


def test_a_course_that_is_no_heading_is_said_and_not_used():
    recording, declination = with_heading(simulate("level", 300, seed=1), off=90.0)
    told = calibrate(recording, heading="course", declination=declination)
    assert not told.diagnostics["heading"]["used"]
    assert "the heading by the field and by 'course' differ by -" in told.message
    np.testing.assert_allclose(told.hard_iron, calibrate(recording).hard_iron, atol=1e-7)


def test_the_configuration_is_enough_to_run_again(tmp_path):
    recording, declination = with_heading(simulate("level", 300, seed=2))
    first = calibrate(recording, heading="course", declination=declination)
    first.save(tmp_path / "cal.yaml")
    again = calibrate(recording, **Calibration.load(tmp_path / "cal.yaml").configuration)
    np.testing.assert_array_equal(again.covariance, first.covariance)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"heading": "yaw"}, "no channel 'yaw' with one value a row; its channels: course"),
        ({"heading": 3}, "neither the name of a channel nor"),
        ({"heading": (3, 0.1)}, "3 is not the name of a channel"),
        ({"heading": ("course", -1.0)}, "its sigma must be above 0 and below"),
        ({"declination": 0.1}, "no use without a heading"),
    ],
)
def test_what_makes_no_sense_is_refused(options, said):
    recording, _ = with_heading(simulate("level", 60, seed=1))
    with pytest.raises(MagycError, match=said):
        calibrate(recording, **options)


def test_without_an_accelerometer_nothing_says_which_way_is_up():
    recording, _ = with_heading(simulate("level", 60, seed=1))
    with pytest.raises(MagycError, match="without an accelerometer nothing says which way is up"):
        calibrate(replace(recording, acceleration=None), heading="course")


def test_the_command_takes_it(tmp_path: Path, capsys) -> None:
    simulation = simulate("level", 300, seed=4)
    recording, _ = with_heading(simulation)
    columns = np.column_stack(
        [
            recording.time,
            recording.magnetic_field * 1e6,
            recording.angular_rate,
            recording.acceleration,
            recording.channels["course"],
        ]
    )
    log = tmp_path / "log.csv"
    names = "time,mag_x,mag_y,mag_z,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z,course"
    np.savetxt(log, columns, delimiter=",", header=names, comments="")
    said = f"calibrate {log} -o {tmp_path}/out --magnetic-unit uT --angular-unit rad/s --heading course --quiet"
    assert cli.main(said.split()) == 2
    assert "--heading: the compass points to magnetic north; give --location" in capsys.readouterr().err
    place = ["--location", "47.5", "19", "--date", "2026-03-01", "--heading-sigma", "0.5"]
    assert cli.main([*said.split(), *place]) in (0, 1)
    chosen = Calibration.load(tmp_path / "out" / "calibration.yaml").configuration
    assert chosen["heading"] == ["course", pytest.approx(0.5 * DEGREE)]
    assert np.degrees(chosen["declination"]) == pytest.approx(5.6, abs=0.5)
    assert cli.main([*said.replace("--heading course", "--heading-sigma 1").split()]) == 2


def test_a_late_magnetometer_is_compared_with_the_heading_at_its_own_time():
    """The heading was taken at the stamp: 2.8° off on a vehicle that turns at 0.25 rad/s, 0.2 s late."""
    time = np.arange(0, 120, 0.1)
    angle = 0.25 * time
    tilt = 0.5 * np.sin(0.4 * time)
    attitude = Rotation.from_euler("zy", np.column_stack([angle, tilt]))
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec() / 0.1
    late = Rotation.from_euler("zy", np.column_stack([0.25 * (time - 0.2), 0.5 * np.sin(0.4 * (time - 0.2))]))
    random = np.random.default_rng(1)
    field = late.inv().apply([20e-6, 0, 40e-6]) + random.normal(0, 3e-7, (len(time), 3))
    middle = 0.5 * (rate[1:] + rate[:-1]) + random.normal(0, 2e-3, (len(time) - 2, 3))
    down = attitude.inv().apply([0, 0, -9.81])[1:-1]
    course = np.degrees(angle[1:-1]) % 360
    recording = Recording(time[1:-1], field[1:-1], middle, acceleration=down, channels={"course": course})
    found = calibrate(recording, heading=("course", DEGREE), declination=0.0)
    assert found.delay == pytest.approx(0.2, abs=0.01)
    assert abs(found.diagnostics["heading"]["measured_deg"]) < 0.3
