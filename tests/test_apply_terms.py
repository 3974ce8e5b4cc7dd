"""Terms of a calibration where a user meets them: `apply` on a log, exports, and channels as logs name them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import magyc_gtsam as mg
from magyc_gtsam.cli.app import application
from magyc_gtsam.factors.effects.signals import Signals, channels_by_kind
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import write_mcap


@pytest.mark.parametrize("effect", ["hard-iron-step", "motor-current", "temperature-gyro", "misalignment"])
def test_apply_takes_out_what_gap_found(effect: str, tmp_path: Path) -> None:
    """On the command line as in Python, from a file to a file."""
    log, out = tmp_path / "log.mcap", tmp_path / "out.mcap"
    write_mcap(log, mg.simulate("wide", 100, seed=8, effects=[(effect, 4.0)]).recording)
    recording = mg.read(log)
    gap = mg.find_gap(recording, candidates=[effect])
    assert [e.name for e in gap.effects] == [effect]
    gap.calibration.save(tmp_path / "cal.yaml")
    done = CliRunner().invoke(
        application(), ["apply", str(tmp_path / "cal.yaml"), str(log), "--output", str(out), "--quiet"]
    )
    assert done.exit_code in (0, 1), done.output
    applied = mg.read(out)
    np.testing.assert_allclose(applied.magnetic_field, gap.calibration.apply(recording), atol=1e-12)
    np.testing.assert_allclose(applied.angular_rate, gap.calibration.apply_gyroscope(recording), atol=1e-9)
    without = replace(gap.calibration, terms=())
    assert (
        max(
            np.abs(applied.magnetic_field - without.apply(recording)).max() / 1e-7,
            np.abs(applied.angular_rate - without.apply_gyroscope(recording)).max() / 1e-3,
        )
        > 1
    )


@pytest.mark.parametrize("way", [["out.mcap"], ["out.mcap", "--stamps", "log"], ["out.csv"]])
def test_a_delay_is_taken_from_the_stamps(way: list[str], tmp_path: Path) -> None:
    """Interpolated to the gyroscope's stamps the noise was correlated, in which gap found an unknown effect."""
    log, out = tmp_path / "log.mcap", tmp_path / way[0]
    write_mcap(log, mg.simulate("wide", 100, seed=8, effects=[("timing", 4.0)]).recording, epoch=10**18)
    recording = mg.read(log)
    gap = mg.find_gap(recording, candidates=["timing"])
    gap.calibration.save(tmp_path / "cal.yaml")
    command = ["apply", str(tmp_path / "cal.yaml"), str(log), "--output", str(out), "--quiet", *way[1:]]
    done = CliRunner().invoke(application(), command)
    assert done.exit_code == 0, done.output
    applied = mg.read(out, stamps=way[2] if way[1:] else "header")
    late = gap.calibration.delay
    assert late > 0.1
    still = replace(gap.calibration, terms=()).apply(recording)
    np.testing.assert_array_equal(gap.calibration.apply(recording), still)  # in Python, too, no value changes
    time, field = applied.magnetometer
    first = 0.1 if out.suffix == ".csv" else 0.0  # s, a table begins where both sensors have samples
    since = time - applied.gyroscope.time[0] + late + first
    row = np.round(10 * since).astype(int)
    np.testing.assert_allclose(since, row / 10, atol=1e-6)
    np.testing.assert_allclose(field, still[row], atol=1e-12)
    assert len(row) >= len(still) - 3
    if way != ["out.mcap"]:
        return
    again = mg.find_gap(applied)
    assert (again.verdict, gap.verdict) == ("none", "closed"), (again.sentence, again.probabilities)


@pytest.mark.parametrize(
    ("name", "value", "setting"),
    [
        ("cubic", [250e-6, -4e-6, 20e-6], {}),
        ("saturation", [0.75], {"level": 30e-6}),
        ("saturation", [0.75], {"level": 30e-6, "fall": 4e-6}),
        ("saturation", [0.75], {"level": 24e-6, "fall": 12e-6}),
    ],
)
def test_a_reading_that_is_bent_much_is_straightened(
    name: str, value: list[float], setting: dict[str, float]
) -> None:
    """Also where the field's change is read as several times it, or as a quarter of it."""
    random = np.random.default_rng(0)
    soft_iron = np.eye(3) + 0.05 * (lambda m: m + m.T)(random.normal(size=(3, 3)))
    hard_iron = np.array([5e-6, -3e-6, 8e-6])
    field = random.normal(size=(500, 3))
    field *= 45e-6 / np.linalg.norm(field, axis=1)[:, None]
    term = Term(name, value, np.zeros((len(value),) * 2), setting)
    straight = (soft_iron @ field.T) + hard_iron[:, None]
    at = Signals(np.zeros(500), field=soft_iron @ field.T, hard_iron=hard_iron)
    reading = (straight + term.evaluate(at)).T
    assert np.abs(reading - straight.T).max() > 10e-6
    np.testing.assert_allclose(
        mg.Calibration(soft_iron, hard_iron, terms=(term,)).apply(reading), field, atol=1e-11
    )


@pytest.mark.parametrize("setting", [{"level": 40e-6}, {"level": 40e-6, "fall": 2e-6}])
def test_what_nothing_reads_stays_where_it_comes_closest(setting: dict[str, float]) -> None:
    """Above the top of a response that turns round, where a plain Newton's step runs away."""
    term = Term("saturation", [1.8], [[0.01]], setting)
    reading = np.linspace(20e-6, 60e-6, 400)[:, None] * np.array([1.0, 0.0, 0.0])
    field = mg.Calibration(np.eye(3), np.zeros(3), terms=(term,)).apply(reading)
    np.testing.assert_allclose(field[reading[:, 0] < 30e-6], reading[reading[:, 0] < 30e-6], atol=1e-7)
    np.testing.assert_allclose(field[reading[:, 0] > 42e-6, 0], 40e-6, atol=3e-6)


@pytest.mark.parametrize(("size", "setting"), [(0.15, {}), (-0.25, {"level": 3.0})])
def test_a_rate_that_is_bent_much_is_straightened(size: float, setting: dict[str, float]) -> None:
    """A scale that grows with the rate, found in slow turns, applied in fast ones; where it is less, up to a level."""
    rate = np.random.default_rng(0).normal(size=(3, 500)) * 3.0
    term = Term("gyro-quadratic", [size] * 3, np.zeros((3, 3)), setting)
    reading = (rate + term.evaluate(Signals(np.zeros(500), rate=rate))).T
    calibration = mg.Calibration(np.eye(3), np.zeros(3), np.array([1e-3, 0.0, 2e-3]), terms=(term,))
    np.testing.assert_allclose(calibration.apply_gyroscope(reading + calibration.gyro_bias), rate.T, atol=1e-10)


def test_exports_say_what_they_do_not_hold() -> None:
    """And exchanged axes are a rotation, the bias written in the gyroscope's own."""
    order = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    plain = mg.calibrate(mg.simulate("wide", 120, seed=1).recording)
    term = Term("axis-order", order.ravel(), np.zeros((9, 9)), {})
    turned = replace(plain, terms=(term, Term("spikes", [1e-6], [[1e-14]])))  # which no reading has any more
    rate = np.array([[0.1, -0.2, 0.3]])
    subtracted = rate - turned.apply_gyroscope(rate)
    for target in ("px4", "ardupilot", "vectornav", "ros"):
        text = turned.export(target)
        assert "LIMIT: not included" not in text
        assert "LIMIT: not included" not in plain.export(target)
        mirrored = replace(plain, terms=(Term("axis-order", -order.ravel(), np.zeros((9, 9)), {}),))
        assert mirrored.export(target).startswith("# LIMIT: not included: axis-order.")
    lines = [
        line.split("\t") for line in turned.export("px4").splitlines() if "CAL_GYRO0" in line and "\t" in line
    ]
    written = {line[2]: float(line[3]) for line in lines}
    np.testing.assert_allclose([written[f"CAL_GYRO0_{a}OFF"] for a in "XYZ"], subtracted[0], atol=1e-7)


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1.0, -1.0]), np.eye(3)[[1, 0, 2]]])
def test_a_mirrored_gyroscope_does_not_turn_the_field(matrix: np.ndarray) -> None:
    """Its axes are no frame; turned into them by half a turn, the heading of a calibration was 174° wrong."""
    random = np.random.default_rng(0)
    field, rate = random.normal(size=(5, 3)) * 3e-5, random.normal(size=(5, 3))
    plain = mg.Calibration(np.diag([1.1, 0.9, 1.0]), np.array([5e-6, 0.0, 1e-6]), np.array([1e-3, 0.0, 2e-3]))
    mirrored = replace(plain, terms=(Term("axis-order", matrix.ravel(), np.zeros((9, 9)), {}),))
    np.testing.assert_allclose(mirrored.apply(field), plain.apply(field))
    np.testing.assert_allclose(mirrored.apply_gyroscope(rate), plain.apply_gyroscope(rate @ matrix.T))


def test_channels_are_known_by_words_not_by_letters() -> None:
    rows = np.zeros(3)
    kind = {
        "current": ("motor_current_A", "batteryCurrent", "BAT.Curr", "amps", "throttle0", "ESC Amp"),
        "temperature": ("temp", "IMU.Temp", "imuTemp", "water_temperature"),
        "position": ("depth", "position_x", "gps.altitude"),
        None: ("timestamp_sample", "sample_count", "attempt", "template", "lamp", "device_timestamp", "swamp"),
    }
    for expected, names in kind.items():
        for name in names:
            assert list(channels_by_kind({name: rows})) == ([expected] if expected else []), name


def test_a_channel_that_stands_still_beside_one_that_moves() -> None:
    """It tells nothing and is left alone; gaps of the other are filled. Where more currents flow, it is refused."""
    recording = mg.simulate("wide", 100, seed=3, effects=[("motor-current", 4.0)]).recording
    gone = recording.channels["current"].copy()
    gone[700:720] = np.nan
    both = replace(recording, channels={"current": gone, "current_of_light": np.full(len(recording.time), 0.5)})
    gap = mg.find_gap(both, candidates=["motor-current"])
    assert [effect.name for effect in gap.effects] == ["motor-current"]
    assert np.isfinite(gap.calibration.apply(both)).all()
    alone = mg.find_gap(recording, candidates=["motor-current"])
    np.testing.assert_allclose(gap.calibration.apply(recording), alone.calibration.apply(recording), atol=5e-8)
    with pytest.raises(mg.MagycError, match="same channels"):
        alone.calibration.apply(both)


def test_a_channel_that_is_not_there_is_not_replaced_by_another() -> None:
    """The third row of a position is no depth."""
    recording = mg.simulate("wide", 60, seed=3).recording
    term = Term("field-gradient", [1e-3], [[1e-8]], {"reference_2": 10.0})
    calibration = replace(mg.calibrate(recording), terms=(term,))
    depth = np.linspace(0, 20, len(recording.time))
    with pytest.raises(mg.MagycError, match="same channels"):
        calibration.apply(replace(recording, channels={"depth": depth}))
    position = np.column_stack([np.zeros_like(depth), np.zeros_like(depth), depth])
    assert np.isfinite(calibration.apply(replace(recording, channels={"position": position}))).all()


@pytest.mark.parametrize(
    ("name", "setting"), [("saturation", {"level": 4e-5, "knee": 0.0}), ("hysteresis", {"width": 1e-5})]
)
def test_a_term_of_an_earlier_form_is_refused(name: str, setting: dict[str, float]) -> None:
    """Its values would be taken for those of the present form."""
    saved = {"name": name, "value": [1.0], "covariance": [[1.0]], "setting": setting}
    with pytest.raises(MagycError, match="has an earlier form"):
        Term.from_dict(saved)


def test_a_term_without_a_setting_that_it_needs_is_no_internal_error() -> None:
    recording = mg.simulate("wide", 60, seed=3).recording
    plate = Term("eddy-plane", [1e-3] * 3, 1e-8 * np.eye(3))
    with pytest.raises(MagycError, match="setting 'x' is missing"):
        replace(mg.calibrate(recording), terms=(plate,)).apply(recording)


def test_another_units_calibration_is_noticed(tmp_path: Path) -> None:
    """It was applied without a word, with a strength that varied by a quarter."""
    own = mg.simulate("wide", 120, seed=1).recording
    other = mg.simulate("wide", 120, seed=2, hard_iron=np.array([-25e-6, 20e-6, -15e-6])).recording
    write_mcap(tmp_path / "log.mcap", own)
    for recording, said in ((own, False), (other, True)):
        mg.calibrate(recording).save(tmp_path / "calibration.yaml")
        arguments = ["apply", str(tmp_path / "calibration.yaml"), str(tmp_path / "log.mcap")]
        done = CliRunner().invoke(application(), [*arguments, "-o", str(tmp_path / "out.csv")])
        assert done.exit_code == 0
        assert ("is the log of the calibration's instrument" in " ".join(done.output.split())) == said
