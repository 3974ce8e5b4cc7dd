"""What single samples show, and what a motion leaves open: tones, held rows, scales named but not corrected."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.effects import NAMES, TERMS
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates
from magyc_gtsam.gap.evidence.weighing import weigh
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import determined, refit, with_term
from magyc_gtsam.gap.naming.named import Found, term_places
from magyc_gtsam.gap.outcome.described import sentences
from magyc_gtsam.gap.outcome.metrics import heading_error
from magyc_gtsam.gap.preparation.discrete import settled
from magyc_gtsam.gap.samples.fine import NOISE_LIMIT
from magyc_gtsam.gap.samples.noise_effects import NoiseScore, coloured_noise, sample_hold, tone


def test_a_tone_faster_than_the_windows_is_sized_and_taken_out() -> None:
    base = mg.simulate("wide", duration=200, seed=31).recording
    cosine, sine = np.array([3e-7, -1e-7, 2e-7]), np.array([-1e-7, 2e-7, 0.5e-7])
    phase = 2 * np.pi * 3.98 * base.time[:, None]
    humming = replace(base, magnetic_field=base.magnetic_field + cosine * np.cos(phase) + sine * np.sin(phase))
    gap = mg.find_gap(humming)
    assert gap.names == ("tone",)
    (effect,) = gap.effects
    assert effect.setting["frequency"] == pytest.approx(3.98, abs=2e-3)
    assert effect.sigma.max() < 0.05  # µT; means over windows of a second would know it to 1.6
    assert sentences([effect]) == [effect.sentence]
    harmonic = replace(effect, value=0.5 * effect.value, setting={"frequency": 7.96})
    (both,) = sentences([effect, harmonic])
    assert re.fullmatch(r"tones of 3\.98 and 7\.96 Hz, 0\.4\d and 0\.2\d µT, are on the magnetometer", both)
    # Phase and frequency hang together: what counts is what is taken out.
    (term,) = gap.calibration.terms
    taken = np.concatenate([term.value[:3], term.value[3:]])
    turn = 2 * np.pi * term.setting["frequency"] * base.time[:, None]
    left = taken[:3] * np.cos(turn) + taken[3:] * np.sin(turn) - cosine * np.cos(phase) - sine * np.sin(phase)
    assert np.sqrt((left**2).mean()) < 0.03e-6
    assert gap.after.heading is not None
    assert gap.before.heading is not None
    without = replace(gap.calibration, terms=())
    assert gap.after.heading == pytest.approx(heading_error(base, without), rel=3e-3)  # the tone is taken out once
    assert mg.find_gap(humming, calibration=gap.calibration).verdict == "none"


@pytest.mark.parametrize(("frequency", "lost"), [(0.7, 0.05), (3.1, 0.2), (4.77, 0.2)])
def test_a_line_keeps_its_phase_over_lost_rows_and_holes(frequency: float, lost: float) -> None:
    """Numbered as if none were lost its phase would wander; the level of white noise stays what it is."""
    silent = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        every = 50 + np.arange(6000) / 10
        time = every[(random.random(6000) > lost) & (np.abs(every - 350) > 20)]
        white = random.standard_normal((3, len(time)))
        silent.append(tone(white, time, 1e-6, NOISE_LIMIT))
        line = np.array([0.3, 0.0, -0.1])[:, None] * np.cos(2 * np.pi * frequency * time)
        found = tone(white + line, time, 1e-6, NOISE_LIMIT)
        assert found.significant
        assert found.setting["frequency"] == pytest.approx(frequency, abs=1e-3)
        assert found.value[0] == pytest.approx(0.32e-6, rel=0.4)
        numbered = np.arange(len(time)) * (time[-1] - time[0]) / len(time)
        assert tone(white + line, numbered, 1e-6, NOISE_LIMIT).evidence < 0.2 * found.evidence
    assert not any(one.significant for one in silent)
    assert np.mean([one.evidence for one in silent]) == pytest.approx(0.6, abs=1.0)


def test_the_pattern_of_the_stamps_is_no_line() -> None:
    """Where rows are lost in a pattern, a constant is a line at its frequencies, what is slow one beside it, and so is
    what depends on the row of the pattern, where that itself has little power."""
    kept = np.tile(np.isin(np.arange(20), (1, 2, 6, 7, 12, 17), invert=True), 600)
    time = np.flatnonzero(kept) / 285.7
    white = np.random.default_rng(1).standard_normal((3, len(time)))
    constant = np.array([0.6, -0.3, 0.2])[:, None] * (1 + np.sin(2 * np.pi * 0.31 * time))
    line = np.array([0.0, 0.2, 0.0])[:, None] * np.cos(2 * np.pi * 23.1 * time)
    found = tone(white + constant + line, time, 1e-6, NOISE_LIMIT, 1.0)
    assert found.significant
    assert found.setting["frequency"] == pytest.approx(23.1, abs=0.02)
    after_a_hole = np.array([[0.5], [0.0], [0.2]]) * (np.diff(np.flatnonzero(kept), prepend=-1) > 1)
    row_by_row = 0.5 * np.tile(np.random.default_rng(2).standard_normal((3, 14)), 600)
    for other in (constant, after_a_hole, row_by_row):
        assert not tone(white + other, time, 1e-6, NOISE_LIMIT, 1.0).significant


def test_noise_along_one_axis_is_no_line() -> None:
    """The power of one axis has a longer tail than the mean of three."""
    white = [np.random.default_rng(seed).standard_normal((3, 6000)) for seed in range(60)]
    misfit = [np.array([[0.3], [0.3], [1.7]]) * one for one in white]
    evidence = [
        [tone(v, np.arange(6000) / 10, 1e-6, NOISE_LIMIT).evidence for v in each] for each in (white, misfit)
    ]
    assert np.mean(evidence[1]) == pytest.approx(np.mean(evidence[0]), abs=0.3)
    line = np.array([[0.05], [0.0], [0.0]]) * np.cos(2 * np.pi * 3.1 * np.arange(6000) / 10)
    found = tone(misfit[0] + line, np.arange(6000) / 10, 1e-6, NOISE_LIMIT)
    assert found.significant
    loud = tone(misfit[0] + 8 * line, np.arange(6000) / 10, 1e-6, NOISE_LIMIT)
    assert loud.value[0] == pytest.approx(0.4e-6, rel=0.1)
    assert tone(np.zeros((3, 6000)), np.arange(6000) / 10, 1e-6, NOISE_LIMIT).significant is False


def test_at_half_the_rate_there_is_no_line() -> None:
    """There a line meets its own mirror image: how much of it is seen is a matter of its phase."""
    kept = np.tile(np.isin(np.arange(20), (1, 2, 6, 7, 12, 17), invert=True), 600)
    time = np.flatnonzero(kept) / 285.7
    white = np.random.default_rng(1).standard_normal((3, len(time)))

    def found(frequency: float) -> NoiseScore:
        line = np.array([0.0, 0.12, 0.08])[:, None] * np.cos(2 * np.pi * frequency * time)
        return tone(white + line, time, 1e-6, NOISE_LIMIT)

    half = 0.5 * 285.7
    assert found(0.99 * half).significant
    assert not found(half - 0.5 / time[-1]).significant


def test_axes_that_pause_together_are_not_held() -> None:
    """A coarse reading repeats on every axis while nothing moves, now and then; a hold repeats all the time."""
    random = np.random.default_rng(2)
    row = np.arange(6000)
    moving = (row < 3600) | (row // 20 % 2 == 0)  # in the end pauses of 2 s
    field = 1e-6 * np.cumsum(np.where(moving[:, None], random.integers(-2, 3, (6000, 3)), 0), axis=0)
    rate = random.standard_normal((6000, 3))
    paused = mg.Recording(row / 10, field, rate)
    assert (~paused.magnetic_field_fresh).mean() > 0.2
    assert not sample_hold(paused).significant
    held = mg.Recording(paused.time, field[row // 2 * 2], rate)
    assert sample_hold(held).significant
    assert sample_hold(held).statistic == pytest.approx(0.5, abs=0.05)


def test_a_resonance_of_the_noise_is_no_line() -> None:
    radius, turn = 0.97, 2 * np.pi * 0.17 / 10
    named = 0
    for seed in range(10):
        white = np.random.default_rng(seed).standard_normal((3, 6000))
        ringing = lfilter([1.0], [1, -2 * radius * np.cos(turn), radius**2], white, axis=1)
        v = ringing / ringing.std() + white
        v /= v.std()
        assert coloured_noise(v, 10.0, 1e-6, NOISE_LIMIT).evidence > 100
        named += tone(v, np.arange(6000) / 10, 1e-6, NOISE_LIMIT).significant
    assert named == 0


def test_a_slower_stream_holds_nothing() -> None:
    """A magnetometer with an entry in every seventh row of the gyroscope's, at the gyroscope's own stamps."""
    fine = mg.simulate("multi", duration=120, seed=4, rate=70.0).recording
    assert fine.angular_rate is not None
    gyroscope = fine.time, fine.angular_rate
    slow = mg.Recording.from_streams((fine.time[::7], fine.magnetic_field[::7]), gyroscope)
    assert slow.angular_rate_fresh.all()
    assert not sample_hold(slow).significant
    gap = mg.find_gap(slow)
    assert gap.verdict == "none"
    fresh = slow.magnetic_field_fresh
    by_hand = mg.Recording(slow.time, slow.magnetic_field, slow.angular_rate, magnetic_field_fresh=fresh)
    assert not sample_hold(by_hand).significant
    # One that repeats its own entries is held, whatever the gyroscope's stamps; the gyroscope's samples stay its own.
    repeated = np.repeat(fine.magnetic_field[::14], 2, axis=0)[: len(fine.time[::7])]
    held = mg.Recording.from_streams((fine.time[::7] + 0.003, repeated), gyroscope)
    assert sample_hold(held).setting["share"] == pytest.approx(0.5, abs=0.01)
    assert sample_hold(held).significant
    own, _ = settled(held, NAMES)
    assert len(fine.time) - 40 < len(own.gyroscope.time) <= len(fine.time)


def test_coarse_steps_are_no_hold() -> None:
    recording = mg.simulate("wide", duration=120, seed=4).recording
    coarse = replace(
        recording, magnetic_field=np.round(recording.magnetic_field / 6e-6) * 6e-6, magnetic_field_fresh=None
    )
    assert (~coarse.magnetic_field_fresh).mean() > 0.3
    assert not sample_hold(coarse).significant


def test_coarse_steps_of_a_motion_that_comes_and_goes_are_no_hold() -> None:
    """All axes repeat together more often than by chance where a motion is slow and fast by turns of five seconds."""
    random = np.random.default_rng(3)
    row = np.arange(4000)
    speed = np.where(row // 250 % 2 == 0, 0.9, 0.15)[:, None]  # of noise and motion, in steps
    field = 2e-6 * np.round(np.cumsum(speed * random.standard_normal((4000, 3)), axis=0))
    coarse = mg.Recording(row / 50, field, random.standard_normal((4000, 3)))
    assert (~coarse.magnetic_field_fresh).mean() > 0.2
    assert not sample_hold(coarse).significant


@pytest.mark.parametrize("rate", [1, 5, 50])
def test_a_hold_is_found_at_any_rate(rate: int) -> None:
    """One row in ten repeats the one before it."""
    random = np.random.default_rng(4)
    row = np.arange(600)
    field = 5e-5 * random.standard_normal((600, 3))[row - (row % 10 == 9)]
    held = sample_hold(mg.Recording(row / rate, field, random.standard_normal((600, 3))))
    assert held.significant
    assert held.statistic == pytest.approx(0.1, abs=0.01)


def test_a_fitted_scale_leaves_no_score_bias() -> None:
    """Beside a scale that is in the model the rest of the matrix is expected at nothing, on level motion as well."""
    statistics = []
    for seed in range(5):
        recording = mg.simulate("moderate", duration=300, seed=seed).recording
        short_term = short_term_noise(recording)
        base = base_model(recording, None, short_term)
        scaled = refit(
            base.twin.problem, with_term(base.model, Active("gyro-scale", {"z": 1.0}, np.zeros(1))), short_term
        )
        twin = scaled.twin
        made = Candidates.at(twin, "gyro-scale", [{}])
        rest = weigh(made, Beside.of_model(twin))["gyro-scale"]
        statistics.append(rest.statistic)
        left = np.linalg.eigvalsh(rest.information) > 1e-7 * np.diag(made.batches[0].gram[0]).max()
        assert left.sum() == 5
    assert np.mean(statistics) < 10
    assert max(statistics) < chi2.isf(1e-4, 5)


def test_terms_of_a_given_calibration_keep_their_places() -> None:
    base = mg.simulate("wide", duration=120, seed=32, delay=0.08).recording
    candidates = ["timing", "hard-iron-step", "hard-iron-drift", "eddy-plane"]
    late = mg.find_gap(base, candidates=candidates).calibration
    jump = np.array([-2e-6, 1e-6, 3e-6]) * (base.time > 90)[:, None]
    stepped = replace(base, magnetic_field=base.magnetic_field + jump)
    gap = mg.find_gap(stepped, calibration=late, candidates=candidates)
    assert gap.names == ("hard-iron-step",)
    np.testing.assert_allclose(gap.effects[0].value, [-2, 1, 3], atol=0.3)
    assert [t.name for t in gap.calibration.terms] == ["timing", "hard-iron-step"]
    assert gap.calibration.delay == pytest.approx(0.08, abs=0.02)


def test_places_of_terms_count_those_that_were_given() -> None:
    recording = mg.simulate("wide", 120, seed=1).recording
    model = base_model(recording, None, short_term_noise(recording)).model
    for name in ("timing", "cubic", "misalignment"):
        model = with_term(model, Active(name, {}, np.zeros(1 if name == "timing" else 3)))
    found = [Found(name, 50.0, 20.0) for name in ("spikes", "cubic", "misalignment")]
    assert term_places(found, model) == {1: 1, 2: 2}


def test_what_the_motion_leaves_open_is_named_and_not_corrected() -> None:
    """Level turns know the difference of the level axes' scales, and hardly their sum."""
    simulation = mg.simulate("moderate", seed=5, effects=[("gyro-scale", 2.0)])
    candidates = ["gyro-scale", "gyro-quadratic", "misalignment", "timing"]
    gap = mg.find_gap(simulation.recording, candidates=candidates)
    assert gap.names == ("gyro-scale",)
    (effect,) = gap.effects
    assert not effect.applied
    assert "not corrected" in effect.sentence
    assert "not corrected" in gap.sentence
    assert gap.verdict == "open"
    assert gap.calibration.terms == ()
    assert gap.next_manoeuvre is not None
    assert gap.next_manoeuvre.separates == ("gyro-scale",)
    turned = mg.simulate("wide", 120, seed=5, effects=[("gyro-scale", 2.0)])
    wide = mg.find_gap(turned.recording, candidates=candidates)
    assert wide.verdict == "closed"
    assert wide.effects[0].applied
    matrix = np.array(turned.effects[0].drawn["matrix"])
    truth = 1e3 * matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    assert np.abs(truth).max() > 20
    # The value is a share of the true rate, which the matrix of the simulator scales to what is read.
    np.testing.assert_allclose(wide.effects[0].value, truth, atol=5 * wide.effects[0].sigma.max() + 2)


def test_a_prior_holds_what_the_data_do_not() -> None:
    recording = mg.simulate("moderate", duration=300, seed=6).recording
    short_term = short_term_noise(recording)
    base = base_model(recording, None, short_term)
    scaled = refit(base.twin.problem, with_term(base.model, Active("gyro-scale", {}, np.zeros(6))), short_term)
    _, covariance = scaled.value_of(0)
    prior = TERMS["gyro-scale"].prior
    assert 0.5 * prior < np.sqrt(np.linalg.eigvalsh(covariance)[-1]) <= prior
    assert not determined(scaled, 0)
    late = refit(base.twin.problem, with_term(base.model, Active("timing", {}, np.zeros(1))), short_term)
    assert determined(late, 0)


def test_a_drift_that_looks_like_a_step_is_a_drift() -> None:
    candidates = ["hard-iron-step", "hard-iron-drift", "local-anomaly", "timing"]
    base = mg.simulate("wide", duration=120, seed=33).recording
    share = (base.time - base.time[0]) / 200
    drift = np.array([0.8e-6, -0.5e-6, 0.3e-6]) * np.tanh(8 * (share - 0.5))[:, None]
    gap = mg.find_gap(replace(base, magnetic_field=base.magnetic_field + drift), candidates=candidates)
    assert gap.names == ("hard-iron-drift",)
