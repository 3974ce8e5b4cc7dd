"""The gap workflow says what it could not have seen, what contradicts what it was given, how well it knows a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magyc_gtsam as mg
from magyc_gtsam import cli
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.gap import prepared
from magyc_gtsam.gap.preparation.discrete import noiseless
from magyc_gtsam.gap.result import Gap
from magyc_gtsam.io import write_mcap
from magyc_gtsam.report import gap_verdict
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.scoring import score
from magyc_gtsam.study.faults.signals import record

# What a response that is not straight may be taken for; that each is found among all is in `test_gap_rates`.
BENDS = ["saturation", "cubic", "hysteresis", "eddy-plane", "timing", "misalignment"]


@pytest.fixture(scope="module")
def clean() -> mg.Recording:
    return mg.simulate("wide", 120, seed=4).recording


@pytest.fixture(scope="module")
def nothing(clean: mg.Recording) -> Gap:
    return mg.find_gap(clean)


@pytest.fixture(scope="module")
def late() -> mg.Recording:
    """With a delay of twice the published strength."""
    return mg.simulate("wide", 120, seed=5, effects=[("timing", 2.0)]).recording


def test_silence_says_what_it_could_not_have_heard() -> None:
    """Level turns cannot show what comes of acceleration, and the words say so."""
    gap = mg.find_gap(mg.simulate("moderate", 120, seed=2, effects=["g-sensitivity"]).recording)
    assert gap.verdict == "none"
    assert "could not have shown" in gap.sentence
    blind = {h.name: h.label for h in gap.hypotheses if h.status == "not enough information"}
    assert "g-sensitivity" in blind
    assert any(label in gap.sentence for label in blind.values())
    assert gap_verdict.title(gap) == "Nothing was found missing"


def test_a_calibration_that_is_given_is_tested(clean: mg.Recording, nothing: Gap) -> None:
    same = mg.find_gap(clean, calibration=nothing.calibration)
    assert same.moved == ()
    assert "does not fit" not in same.sentence
    wrong = replace(nothing.calibration, hard_iron=nothing.calibration.hard_iron + [20e-6, 0, 0])
    gap = mg.find_gap(clean, calibration=wrong)
    assert gap.sentence.startswith("the calibration given does not fit these data, hard iron x is off by −20")
    assert (same.verdict, gap.verdict) == ("none", "closed")
    assert gap.moved[0].name == "hard iron x"
    assert gap.moved[0].after - gap.moved[0].before == pytest.approx(-20, abs=0.1)


def test_a_term_of_another_log_is_contradicted(clean: mg.Recording, late: mg.Recording) -> None:
    found = mg.find_gap(late, candidates=["timing", "eddy-plane"])
    assert found.names == ("timing",)
    gap = mg.find_gap(clean, calibration=found.calibration, candidates=["timing", "eddy-plane"])
    assert any(row.name.startswith("magnetometer delay") for row in gap.moved)
    assert "does not fit" in gap.sentence


def test_where_the_search_begins_does_not_decide() -> None:
    """Without g-sensitivity in its model `calibrate` takes some of it for a delay, which is none beside it."""
    recording = mg.simulate("wide", 120, seed=50, effects=[("g-sensitivity", 4.0)]).recording
    begun = mg.calibrate(recording)
    candidates = ["g-sensitivity", "timing", "misalignment", "gyro-scale", "hard-iron-drift"]
    gap = mg.find_gap(recording, calibration=begun, candidates=candidates)
    assert gap.names == mg.find_gap(recording, candidates=candidates).names == ("g-sensitivity",)
    (late,) = (term for term in gap.calibration.terms if term.name == "timing")
    assert abs(late.value[0]) < 3 * late.sigma[0]
    assert abs(begun.delay) > 2 * abs(late.value[0])


def test_a_calibration_with_its_effects_closes_the_gap_again() -> None:
    """A saturation too, whose form leaves something beside it."""
    recording = mg.simulate("wide", 120, seed=60).recording
    level = 0.94 * np.abs(recording.magnetic_field).max()
    clipped = replace(recording, magnetic_field=np.clip(recording.magnetic_field, -level, level))
    gap = mg.find_gap(clipped, candidates=BENDS)
    assert gap.names == ("saturation",)
    (term,) = (each for each in gap.calibration.terms if each.name == "saturation")
    assert dict(term.setting) == {"level": level, "fall": 0.0}  # where readings are cut off, and at once
    assert mg.find_gap(clipped, calibration=gap.calibration, candidates=BENDS).verdict == "none"


CLOCK = ["timing", "clock-drift", "eddy-plane", "gyro-scale", "hard-iron-drift"]


def drifting(recording: mg.Recording, growth: float, late: float = 0.0) -> mg.Recording:
    """Stamp the magnetometer late, by `late` s halfway and by `growth` s more at the end than at the beginning."""
    assert recording.angular_rate is not None
    share = (recording.time - recording.time[0]) / (recording.time[-1] - recording.time[0])
    stamps = recording.time + late + growth * (share - 0.5)
    return mg.Recording.from_streams((stamps, recording.magnetic_field), (recording.time, recording.angular_rate))


@pytest.mark.parametrize(("growth", "late"), [(-0.36, 0.0), (0.12, 0.35)])
def test_clocks_that_drift_apart_are_named_and_corrected(growth: float, late: float) -> None:
    recording = mg.simulate("wide", 300, seed=100).recording
    gap = mg.find_gap(drifting(recording, growth, late), candidates=CLOCK)
    assert gap.verdict == "closed"
    found = {effect.name: effect for effect in gap.effects}
    assert found.keys() == {"clock-drift"} | ({"timing"} if late else set())
    drift = found["clock-drift"]
    assert abs(drift.value[0] - 1e3 * growth) < 3 * drift.sigma[0] < 60
    assert f"clock {'gains' if growth > 0 else 'loses'} 0." in drift.sentence
    assert not drift.ambiguous_with  # least of all with a channel that is not logged
    assert gap.calibration.trusted, gap.calibration.message


def test_a_clock_drift_that_calibrate_measured_is_taken_out() -> None:
    late = drifting(mg.simulate("wide", 120, seed=101).recording, -0.36)
    measured = mg.calibrate(late).diagnostics["clock_drift"][0]
    gap = mg.find_gap(late, mg.calibrate(late, clock_drift=measured), candidates=CLOCK)
    assert gap.verdict == "none", gap.sentence
    assert gap.calibration.trusted, gap.calibration.message
    assert gap.calibration.configuration["clock_drift"] == measured


def test_another_log_may_contradict(
    clean: mg.Recording, late: mg.Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_mcap(tmp_path / "clean.mcap", clean)
    write_mcap(tmp_path / "late.mcap", late)
    log, another, out = (str(tmp_path / name) for name in ("late.mcap", "clean.mcap", "out"))
    assert cli.main(["gap", log, "--validate", another, "--output", out, "--quiet"]) == 1
    assert "does not hold on clean.mcap" in capsys.readouterr().err


def test_the_time_of_a_step_has_a_sigma() -> None:
    """Over weak and strong steps, errors in sigmas; and the words carry it."""
    errors: list[float] = []
    sigmas: dict[bool, list[float]] = {False: [], True: []}  # by whether the step is strong
    for seed in range(904, 910):
        simulation = mg.simulate("wide", 100, seed=seed, effects=[("hard-iron-step", 2.0 + 3.0 * (seed % 2))])
        gap = mg.find_gap(simulation.recording, candidates=["hard-iron-step"])
        truth = next(a.drawn["time"] for a in simulation.effects if a.name == "hard-iron-step")
        for effect in gap.effects:
            if effect.name == "hard-iron-step" and len(gap.effects) == 1:
                errors.append((effect.setting["time"] - truth) / effect.setting["time_sigma"])
                sigmas[bool(seed % 2)].append(effect.setting["time_sigma"])
                assert " ± " in effect.sentence.partition(" µT at ")[2]
    assert len(errors) >= 5
    assert 0.2 < np.sqrt(np.mean(np.square(errors))) < 1.8
    assert np.median(sigmas[False]) > np.median(sigmas[True])  # by 4 to 99 % on three sets of seeds


def test_restricted_candidates_are_not_called_a_catalogue(late: mg.Recording) -> None:
    gap = mg.find_gap(late, candidates=["hard-iron-step"])
    assert gap.verdict == "unknown"
    assert "among the candidates" in gap.sentence
    assert "catalogue" not in gap.sentence


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"recording": "x.mcap"}, r"mg\.find_gap: 'x\.mcap' is a file; read it first"),
        ({"calibration": "x.yaml"}, "calibration: a Calibration is needed, got str"),
        ({"simulated": 3}, "simulated: expected a Recording, got a int"),
        ({"candidates": "timing"}, "a list of names is needed"),
        ({"candidates": []}, "a list of names is needed"),
        ({"candidates": 5}, "a list of names is needed"),
    ],
)
def test_wrong_arguments_are_named(clean: mg.Recording, arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(mg.MagycError, match=said):
        mg.find_gap(**{"recording": clean, **arguments})


def test_a_simulator_that_stands_still_is_refused(clean: mg.Recording) -> None:
    with pytest.raises(mg.MagycError, match="simulated: "):
        mg.find_gap(clean, simulated=mg.simulate("tiny", 15, seed=1).recording)


@pytest.mark.parametrize("kind", [np.float64, np.float32])
@pytest.mark.parametrize("gyroscope_noise", [0.0, 5e-3])
def test_without_noise_nothing_is_tested(kind: type, gyroscope_noise: float) -> None:
    """Against exact arithmetic the rounding itself would be a tone or coloured noise."""
    clean = mg.simulate("wide", 120, seed=1, magnetometer_noise=0.0, gyroscope_noise=gyroscope_noise).recording
    assert clean.angular_rate is not None
    rounded = replace(
        clean, magnetic_field=clean.magnetic_field.astype(kind), angular_rate=clean.angular_rate.astype(kind)
    )
    gap = mg.find_gap(rounded)
    assert gap.verdict == "not enough information"
    assert "no measurable noise" in gap.sentence
    assert "give the simulated sensors the noise of the real ones" in gap.sentence
    assert gap.effects == gap.hypotheses == ()


def test_coarse_readings_that_seldom_change_are_no_exact_ones() -> None:
    smooth = mg.simulate("survey", 120, rate=100, seed=1, magnetometer_noise=0.0).recording
    coarse = replace(smooth, magnetic_field=np.round(smooth.magnetic_field / 3e-6) * 3e-6)
    assert noiseless(smooth)
    assert not noiseless(coarse)


def test_little_noise_is_enough() -> None:
    quiet = mg.simulate("wide", 120, seed=1, magnetometer_noise=1e-9, gyroscope_noise=1e-5).recording
    assert mg.find_gap(quiet).verdict == "none"


def test_a_small_misalignment_is_as_probable_as_the_sensors_show() -> None:
    """0.3° of good sensors is more certain than of others."""
    hidden = [("misalignment", 0.12)]
    candidates = ["misalignment", "timing", "eddy-plane", "gyro-scale", "cubic", "hard-iron-drift"]
    plain = mg.find_gap(mg.simulate("wide", seed=2, effects=hidden).recording, candidates=candidates)
    assert plain.names == ("misalignment",)
    better = {"magnetometer_noise": 1e-7, "gyroscope_noise": 5e-4}
    fine = mg.simulate("wide", 120, seed=2, effects=hidden, **better).recording  # type: ignore[arg-type]
    good = mg.find_gap(fine, candidates=candidates)
    assert good.names == ("misalignment",)
    assert good.effects[0].probability > plain.effects[0].probability > 0.9


def test_a_core_is_not_guessed_beyond_what_was_read() -> None:
    """Of the foot of a knee alone any share might be lost beyond it, and the field would be anything.

    The largest readings are corrected to 0.4 %, with the level and the knee that the whole model shows.
    """
    hidden = {"seed": 24, "effects": ["saturation"]}
    gap = mg.find_gap(mg.simulate("wide", 150, **hidden).recording, candidates=BENDS)  # type: ignore[arg-type]
    assert gap.names == ("saturation",)
    quiet = mg.simulate("wide", 150, magnetometer_noise=1e-12, **hidden).recording  # type: ignore[arg-type]
    strength = np.linalg.norm(gap.calibration.apply(quiet), axis=1)
    assert np.abs(strength / np.median(strength) - 1).max() < 0.006


def test_a_reading_that_bends_evenly_is_a_cubic() -> None:
    """A wide knee explains as much with one value; so little loss is no saturation's."""
    recording = mg.simulate("wide", 150, seed=3).recording
    field = recording.magnetic_field
    bent = replace(recording, magnetic_field=field - 2.5e-6 * (field / 50e-6) ** 3)
    gap = mg.find_gap(bent, candidates=BENDS)
    assert gap.names == ("cubic",)


def test_a_loop_that_forgets_is_a_hysteresis() -> None:
    """A loop of another form than the catalogue's (Dahl's), which forgets where it turned back."""
    recording = mg.simulate("wide", 120, seed=8).recording
    field = recording.magnetic_field
    loop = np.zeros(3)
    loops = []
    for step in np.diff(field, axis=0, prepend=field[:1]):
        loop = loop + step / (0.6 * np.ptp(field)) * (1 - np.sign(step) * loop)
        loops.append(loop)
    gap = mg.find_gap(
        replace(recording, magnetic_field=field + 1e-6 * np.array([1.2, 1.9, 1.8]) * np.array(loops))
    )
    assert gap.names == ("hysteresis",)


def test_noise_that_cannot_measure_a_misfit_is_not_enough(
    clean: mg.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of readings that were interpolated onto the rows; it was an error about terms, of which there are none."""
    monkeypatch.setattr(prepared, "short_term_noise", lambda recording: SensorNoise(1e-14, 1e-5))
    gap = mg.find_gap(clean)
    assert gap.verdict == "not enough information"
    assert gap.doubt is not None
    assert "interpolated onto the rows" in gap.doubt.cause
    assert not gap.calibration.trusted


@pytest.mark.parametrize("seed", [35103, 35110, 35111])
def test_what_a_walk_has_beyond_a_drift_is_in_the_sigmas(seed: int) -> None:
    """Six of 16 results were wrong at the end of the log, by up to 4.7 sigmas."""
    fault = FAULTS["offset-walk"]
    log = record("low", seed, fault, fault.strong, "offset-walk")
    gap = mg.find_gap(log.recording("walk"))
    assert "hard-iron-drift" in gap.names
    assert score(gap.calibration, end=float(log.field_time[-1])).outcome == "right and trusted"


def test_a_log_too_long_for_the_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the search, which would take 0.15 GB for five minutes, if it were done in 0.1 GB."""
    assert prepared.memory() > 1e8
    monkeypatch.setattr(prepared, "memory", lambda: 1e8)
    with pytest.raises(mg.MagycError, match=r"memory.*choose an interval of at most 0\.1 h \(start=, end=\)"):
        mg.find_gap(mg.simulate("wide", 300, seed=1).recording)
