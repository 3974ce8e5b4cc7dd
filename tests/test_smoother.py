"""The smoother against simulated truth: accuracy, consistency, invariance, and what it refuses."""

from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magyc_gtsam import MagycError, Recording, calibrate, methods, read, simulate
from magyc_gtsam.estimators.smoother.fit import MAX_ITERATIONS, PATIENCE, inverse_information
from magyc_gtsam.estimators.smoother.preparation import magnetometer_noise
from magyc_gtsam.estimators.smoother.residuals import window_residuals
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.simulation import AMPLITUDES, HARD_IRON, disturb
from magyc_gtsam.study.faults.catalogue import FAULTS
from magyc_gtsam.study.faults.signals import record

MICROTESLA = 1e-6
RUNS = 16
CHI2_11 = 31.3  # 99.9 % point of χ² of 11 degrees of freedom


def error(calibration, truth):
    """vech(soft iron), hard iron and bias, estimate less truth (12,)."""
    return np.concatenate(
        [
            vech(calibration.soft_iron - truth.soft_iron),
            calibration.hard_iron - truth.hard_iron,
            calibration.gyro_bias - truth.gyro_bias,
        ]
    )


def normalised(calibration, truth):
    """eᵀ Σ⁺ e: with det A = 1 the covariance has rank 11."""
    return squared(error(calibration, truth), calibration.covariance)


def squared(e, covariance):
    """eᵀ Σ⁺ e."""
    scale = np.sqrt(np.diag(covariance))
    inverse = np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-9, hermitian=True)
    return (e / scale) @ inverse @ (e / scale)


def in_sigmas(one, other):
    """Largest difference of two estimates in standard deviations of the first."""
    sigma = one.sigma
    return max(
        np.abs(one.soft_iron - other.soft_iron).max() / sigma["soft_iron"].min(),
        np.abs((one.hard_iron - other.hard_iron) / sigma["hard_iron"]).max(),
        np.abs((one.gyro_bias - other.gyro_bias) / sigma["gyro_bias"]).max(),
    )


@pytest.fixture(scope="module")
def runs():
    """{motion: [(simulation, calibration), …]}, ten minutes at 10 Hz each; the chips known to be aligned."""
    found = {}
    for i, motion in enumerate(AMPLITUDES):  # seeds of its own: recordings of one seed share their noise
        simulations = [simulate(motion, seed=RUNS * i + seed) for seed in range(RUNS)]
        found[motion] = [(s, calibrate(s.recording, misalignment=0)) for s in simulations]
    return found


@pytest.fixture(scope="module")
def wide():
    return simulate("wide", duration=300, rate=10, seed=3)


# --- accuracy and consistency ---


@pytest.mark.parametrize("motion", AMPLITUDES)
def test_without_noise_the_truth_is_found(motion):
    simulation = simulate(motion, duration=120, rate=50, seed=1, magnetometer_noise=0, gyroscope_noise=0)
    truth = simulation.truth
    calibration = calibrate(simulation.recording, noise=(1e-7, 1e-4))
    np.testing.assert_allclose(calibration.soft_iron, truth.soft_iron, atol=1e-5)
    np.testing.assert_allclose(calibration.hard_iron, truth.hard_iron, atol=1e-9)
    np.testing.assert_allclose(calibration.gyro_bias, truth.gyro_bias, atol=5e-6)
    assert calibration.delay == pytest.approx(0, abs=2e-5)
    assert calibration.field_strength == pytest.approx(truth.field_strength, rel=2e-5)


@pytest.mark.parametrize("motion", AMPLITUDES)
def test_every_run_is_accepted(runs, motion):
    for _, calibration in runs[motion]:
        assert calibration.converged, calibration.message
        assert calibration.message.startswith("converged in")
        assert calibration.observability.observable
        assert np.linalg.det(calibration.soft_iron) == pytest.approx(1)
        shape = calibration.covariance[:6, :6]
        assert np.linalg.matrix_rank(shape, tol=1e-9 * np.trace(shape)) == 5  # det A = 1


def test_the_covariance_is_honest(runs):
    """What noise leaves open: a mean NEES of 11 degrees of freedom, inside its 95 % band over all runs, its 99 % band
    for each motion. What an instrument may do is covered beside it (test_model_error_physical.py)."""
    means = {
        motion: np.mean([squared(error(c, simulation.truth), c.noise_covariance) for simulation, c in pairs])
        for motion, pairs in runs.items()
    }
    deviation = np.sqrt(2 * 11 / RUNS)
    assert np.mean(list(means.values())) == pytest.approx(11, abs=1.96 * deviation / np.sqrt(len(means)))
    for motion, mean in means.items():
        assert mean == pytest.approx(11, abs=2.58 * deviation), motion


def test_what_an_instrument_may_do_widens_the_covariance_by_little(runs):
    """These simulated instruments have none of it: the mean NEES of 11 falls by less than 2 on every motion."""
    for simulations in runs.values():
        found = [(c, error(c, s.truth)) for s, c in simulations]
        noise, whole = (
            np.mean([squared(e, getattr(c, name)) for c, e in found])
            for name in ("noise_covariance", "covariance")
        )
        assert noise - 2.0 < whole < noise


def test_the_covariance_of_short_data_is_honest_too():
    """What noise leaves open: without what it is widened by, for levels estimated from little, mean NEES is 12.5."""
    scores, widening = [], []
    for motion in AMPLITUDES:
        for seed in range(7000, 7016):
            simulation = simulate(motion, duration=90, seed=seed)
            calibration = calibrate(simulation.recording, misalignment=0)
            scores.append(squared(error(calibration, simulation.truth), calibration.noise_covariance))
            widening.append(calibration.diagnostics["widening"])
    assert np.mean(scores) == pytest.approx(11, abs=2.58 * np.sqrt(2 * 11 / len(scores)))
    assert np.mean(widening) == pytest.approx(1.09, abs=0.03)
    known = calibrate(simulation.recording, noise=(1e-6, 5e-3))
    assert known.diagnostics["widening"] == 1.0


def test_the_gyroscope_is_not_taken_for_quieter_than_its_samples_are():
    """The magnetometer's noise hides it; by the likelihood alone the least of the ten is 0.68 of the truth."""
    levels = []
    for seed in range(400, 410):
        noise = {"magnetometer_noise": 0.5e-6, "gyroscope_noise": 3e-3}
        fine = simulate("wide", 200, 50, seed=seed, **noise).recording
        slower = (fine.time[::3], fine.magnetic_field[::3])
        levels.append(
            calibrate(Recording.from_streams(slower, (fine.time, fine.angular_rate))).noise["angular_rate"]
        )
    assert min(levels) > 0.75 * 3e-3


@pytest.mark.parametrize("share", [0.1, 0.5])
@pytest.mark.parametrize("motion", AMPLITUDES)
def test_the_covariance_is_honest_where_samples_are_lost(motion, share):
    """Each sensor loses its own; with plain trapezoids over the holes the mean NEES of half lost is 40.

    A pitch with a period of 1.8 s loses a tenth of the turn rate with half of the samples, and is refused.
    """
    scores = []
    for seed in range(5):
        simulation = simulate(motion, seed=seed)
        recording, random = simulation.recording, np.random.default_rng(seed)
        m, g = (random.random(len(recording.time)) >= share for _ in range(2))
        lossy = Recording.from_streams(
            (recording.time[m], recording.magnetic_field[m]), (recording.time[g], recording.angular_rate[g])
        )
        calibration = calibrate(lossy, misalignment=0)
        if "10% of its turn rate is lost" not in calibration.message:
            assert calibration.trusted, calibration.message
            scores.append(normalised(calibration, simulation.truth))
    assert len(scores) >= 4
    assert np.mean(scores) == pytest.approx(11, abs=3 * np.sqrt(2 * 11 / len(scores)))


@pytest.mark.parametrize("motion", AMPLITUDES)
def test_the_error_is_as_small_as_the_bound(runs, motion):
    """Root-mean-square hard-iron error against the covariance without noise in it: that at the truth's noise."""
    errors = [error(calibration, simulation.truth)[6:9] for simulation, calibration in runs[motion]]
    bounds = [
        np.trace(calibrate(simulation.recording, noise=(1e-6, 5e-3)).covariance[6:9, 6:9])
        for simulation, _ in runs[motion][:10]
    ]
    efficiency = np.sqrt(np.mean(np.sum(np.square(errors), axis=1)) / np.mean(bounds))
    assert efficiency < 1.1 + 2 * 0.5 / np.sqrt(RUNS)  # two standard deviations of the estimated ratio


def test_noise_is_estimated(runs):
    for motion in AMPLITUDES:
        magnetometer = np.mean([c.noise["magnetic_field"] for _, c in runs[motion]])
        gyroscope = np.mean([c.noise["angular_rate"] for _, c in runs[motion]])
        assert magnetometer == pytest.approx(1e-6, rel=0.02), motion
        assert gyroscope == pytest.approx(5e-3, rel=0.05), motion


def test_delay_without_a_delay(runs):
    """In its own sigmas it is standard normal."""
    scores = np.array([c.delay / c.delay_sigma for motion in AMPLITUDES for _, c in runs[motion]])
    count = len(scores)
    assert abs(scores.mean()) < 3 / np.sqrt(count)
    assert np.mean(scores**2) == pytest.approx(1, abs=3 * np.sqrt(2 / count))


# --- invariance ---


def test_turning_the_sensor_turns_the_result(wide):
    """Soft iron R A Rᵀ, hard iron R h, bias R b; the windows are the same."""
    r = Rotation.from_rotvec([0.3, -1.2, 0.8]).as_matrix()
    recording = wide.recording
    turned = Recording(recording.time, recording.magnetic_field @ r.T, recording.angular_rate @ r.T)
    one, other = calibrate(recording), calibrate(turned)
    np.testing.assert_allclose(other.soft_iron, r @ one.soft_iron @ r.T, atol=1e-5)
    np.testing.assert_allclose(other.hard_iron, r @ one.hard_iron, atol=1e-9)
    np.testing.assert_allclose(other.gyro_bias, r @ one.gyro_bias, atol=1e-6)
    # What the instrument may do beyond its noise (a bend, a dead zone) is of its own axes, and does not turn.
    before, after = (c.noise_covariance[6:9, 6:9] for c in (one, other))
    np.testing.assert_allclose(after, r @ before @ r.T, rtol=0.02, atol=1e-17)


def test_the_clock_may_start_anywhere(wide):
    """Stamps rounded to 0.2 µs move the estimate by a small share of its sigma."""
    recording = wide.recording
    later = calibrate(replace(recording, time=recording.time + 1.7e9))
    assert in_sigmas(calibrate(recording), later) < 0.15


def test_a_stronger_field_scales_field_and_hard_iron(wide):
    recording = wide.recording
    one, two = calibrate(recording), calibrate(replace(recording, magnetic_field=1.3 * recording.magnetic_field))
    np.testing.assert_allclose(two.soft_iron, one.soft_iron, atol=1e-6)
    np.testing.assert_allclose(two.hard_iron, 1.3 * one.hard_iron, rtol=1e-4)
    assert two.field_strength == pytest.approx(1.3 * one.field_strength)


def test_gyroscope_rate_and_magnetometer_rate_may_differ():
    """Gyroscope at 50 Hz, every fifth magnetometer sample: as all at 50 Hz, within what the rest would tell."""
    simulation = simulate("wide", duration=300, rate=50, seed=5, magnetometer_noise=1e-7, gyroscope_noise=1e-3)
    recording = simulation.recording
    apart = Recording.from_streams(
        (recording.time[::5], recording.magnetic_field[::5]), (recording.time, recording.angular_rate)
    )
    calibration = calibrate(apart)
    assert len(apart.magnetometer.time) == 3000
    assert calibration.noise["magnetic_field"] == pytest.approx(1e-7, rel=0.1)
    assert normalised(calibration, simulation.truth) < CHI2_11
    assert in_sigmas(calibration, calibrate(recording)) < 4


def test_field_strength_fixes_the_scale(wide):
    """A known field: the soft iron takes the scale, and the covariance has full rank."""
    relative = calibrate(wide.recording)
    absolute = calibrate(wide.recording, field_strength=40e-6)
    ratio = relative.field_strength / 40e-6
    np.testing.assert_allclose(absolute.soft_iron, ratio * relative.soft_iron, rtol=1e-9)
    np.testing.assert_array_equal(absolute.hard_iron, relative.hard_iron)
    assert absolute.field_strength == 40e-6
    strength = np.linalg.norm(absolute.apply(wide.recording.magnetic_field), axis=1)
    assert np.median(strength) == pytest.approx(40e-6, rel=2e-3)
    scale = np.sqrt(np.diag(absolute.covariance))
    assert np.linalg.eigvalsh(absolute.covariance / np.outer(scale, scale))[0] > 1e-4
    # The soft iron's truth is then A·F/40 µT, and the covariance covers its scale as well.
    truth = wide.truth
    e = error(absolute, replace(truth, soft_iron=truth.soft_iron * truth.field_strength / 40e-6))
    assert e @ np.linalg.solve(absolute.covariance, e) < 32.9  # 99.9 % of χ² of 12


def test_options_reach_the_fit(wide):
    given = calibrate(wide.recording, noise=(2e-6, 1e-2), robust=False, window=0.5, turn=0.1)
    assert given.noise == {"magnetic_field": 2e-6, "angular_rate": 1e-2}
    assert given.diagnostics["trusted_share"] == 1.0
    assert given.diagnostics["windows"] > 600
    assert given.configuration == {
        "window": 0.5, "turn": 0.1, "robust": False, "delay": None, "noise": [2e-6, 1e-2],
        "misalignment": "auto",
    }  # fmt: skip
    again = calibrate(wide.recording, **given.configuration)
    np.testing.assert_array_equal(again.covariance, given.covariance)


# --- delay ---


@pytest.mark.parametrize("delay", [0.03, -0.02])
def test_delay_is_recovered(delay):
    simulation = simulate("wide", duration=200, rate=50, seed=2, delay=delay)
    calibration = calibrate(simulation.recording)
    assert calibration.delay_sigma < 3e-3
    assert calibration.delay == pytest.approx(delay, abs=4 * calibration.delay_sigma)
    assert normalised(calibration, simulation.truth) < CHI2_11


def test_delay_can_be_fixed():
    simulation = simulate("wide", duration=200, rate=50, seed=4, delay=0.03, magnetometer_noise=2e-7)
    known, wrong = (calibrate(simulation.recording, delay=d, noise=(2e-7, 5e-3)) for d in (0.03, 0.0))
    assert (known.delay, wrong.delay) == (0.03, 0.0)
    assert known.delay_sigma is None
    assert known.configuration["delay"] == 0.03
    assert normalised(known, simulation.truth) < CHI2_11
    assert wrong.diagnostics["cost"] > 1.2 * known.diagnostics["cost"]


def test_the_delay_that_is_found_can_be_given(monkeypatch):
    """Stamps 1.3 s late gave a trusted delay, which was refused where it was given."""
    recording = simulate("wide", duration=200, rate=10, seed=4, delay=1.3).recording
    found = calibrate(recording)
    assert found.trusted
    assert found.delay == pytest.approx(1.3, abs=4 * found.delay_sigma)
    assert calibrate(recording, delay=found.delay).trusted
    with pytest.raises(MagycError, match="delay must be above -10 and below 10 s"):
        calibrate(recording, delay=10.0)
    monkeypatch.setattr("magyc_gtsam.estimators.smoother.reasons.MOST_DELAY", 1.0)
    late = calibrate(recording)
    assert not late.trusted
    assert late.message.startswith("the magnetometer lags by 1.3 s, at most 1 s is tolerated: give both sensors")


# --- hard iron, disturbances ---


@pytest.mark.parametrize("motion", AMPLITUDES)
@pytest.mark.parametrize("seed", range(2))
def test_a_hard_iron_ten_times_the_field_and_a_large_bias(motion, seed):
    """The start h = 0 falls into a false minimum there."""
    simulation = simulate(
        motion, seed=seed, hard_iron=[100e-6, -150e-6, 410e-6], gyro_bias=np.array([45, -40, 45]) * 1e-3
    )
    calibration = calibrate(simulation.recording)
    assert calibration.converged, calibration.message
    assert normalised(calibration, simulation.truth) < CHI2_11


@pytest.mark.parametrize("seed", range(2))
def test_a_start_without_a_minimum_is_given_up(seed):
    """Where no field explains the readings, and never where one does; beside a calibration that is no answer."""
    recording = simulate("wide", seed=seed, duration=60.0).recording
    order = np.random.default_rng(seed).permutation(len(recording.time))
    shuffled = replace(recording, magnetic_field=recording.magnetic_field[order])
    fit = fit_field_chain(shuffled)
    assert not fit.converged
    assert fit.iterations <= PATIENCE + 3 * MAX_ITERATIONS
    with pytest.raises(MagycError, match="no minimum within"):
        fit_field_chain(shuffled, brief=True)
    whole, brief = fit_field_chain(recording), fit_field_chain(recording, brief=True)
    assert brief.converged
    np.testing.assert_array_equal(brief.state.parameters, whole.state.parameters)


def test_disturbed_windows_are_weighed_down(runs):
    """20 % of all seconds disturbed by up to 50 µT, two runs of each motion: nearly as good as without."""
    ratios = []
    for seed in range(2):
        for motion in AMPLITUDES:
            simulation, undisturbed = runs[motion][seed]
            # The chips are known to be aligned in both, for a skew that is asked for costs information of its own.
            calibration = calibrate(disturb(simulation.recording, seed=seed), misalignment=0)
            assert calibration.converged, calibration.message
            assert 0.6 < calibration.diagnostics["trusted_share"] < 0.9
            e = error(calibration, simulation.truth)[6:9]
            ratios.append(e @ np.linalg.solve(undisturbed.covariance[6:9, 6:9], e) / 3)
    # 1.3 in the root mean square, and two standard deviations of so few runs.
    assert np.sqrt(np.mean(ratios)) < 1.3 + 2 * np.sqrt(2 / 24)


def test_disturbed_stretches_are_reported(wide):
    recording = wide.recording
    field = recording.magnetic_field.copy()
    for start, end in ((100, 110), (200, 204)):
        field[(recording.time >= start) & (recording.time < end)] += [20e-6, 0, 10e-6]
    calibration = calibrate(replace(recording, magnetic_field=field))
    # A single window may be called disturbed by chance.
    longer, shorter = (stretch for stretch in calibration.diagnostics["disturbed"] if stretch[1] > stretch[0])
    np.testing.assert_allclose(longer, [100, 110], atol=1.0)
    np.testing.assert_allclose(shorter, [200, 204], atol=1.0)
    assert in_sigmas(calibrate(recording), calibration) < 1
    # Without robust weights they pull the estimate.
    assert in_sigmas(calibrate(recording), calibrate(replace(recording, magnetic_field=field), robust=False)) > 3


@pytest.mark.parametrize("seed", [912, 2173])
def test_an_axis_whose_sign_was_wrong_for_a_while_is_no_minimum_of_its_own(seed):
    """A descent from the whole log leads to a hard iron that is off by 7 and 9 µT, a quarter's to the right one."""
    fault = FAULTS["sign-flips"]
    calibration = calibrate(record("low", seed, fault, fault.strong, "sign-flips").recording("flipped"))
    assert calibration.trusted
    assert 0.65 < calibration.diagnostics["trusted_share"] < 0.75
    assert np.abs((calibration.hard_iron - HARD_IRON) / calibration.sigma["hard_iron"]).max() < 4


def test_a_recording_that_is_disturbed_for_the_most_part_is_not_trusted(wide):
    calibration = calibrate(disturb(wide.recording, share=0.8))
    assert not calibration.converged
    assert "disturbed" in calibration.message or "unexplained" in calibration.message


# --- what is refused ---


def still(seconds=60, rate=20, seed=0):
    rng = np.random.default_rng(seed)
    n = seconds * rate
    return {
        "time": np.arange(n) / rate,
        "magnetic_field": np.array([20e-6, 5e-6, -40e-6]) + 5e-7 * rng.normal(size=(n, 3)),
        "angular_rate": 2e-3 * rng.normal(size=(n, 3)),
        "acceleration": np.tile([0, 0, -9.81], (n, 1)),
    }


def test_a_still_recording_is_not_trusted():
    calibration = calibrate(Recording(**still()))
    assert not calibration.converged
    assert not calibration.observability.observable
    assert calibration.message.startswith("too little motion (")
    assert "iron along" in calibration.message
    worst = calibration.observability.weak[0]
    assert worst.sigma > 100 * worst.limit


def test_turning_level_leaves_the_vertical_weak():
    """Without pitch and roll the hard iron along z cannot be told from the vertical field."""
    time = np.arange(6000) / 20
    rng = np.random.default_rng(0)
    attitude = Rotation.from_rotvec(np.outer(0.3 * time, [0, 0, 1]))
    world = np.array([20e-6, 0, 43e-6])
    recording = Recording(
        time,
        attitude.inv().apply(world) + [3e-6, 2e-6, 1e-6] + 5e-7 * rng.normal(size=(6000, 3)),
        np.array([0, 0, 0.3]) + 3e-3 * rng.normal(size=(6000, 3)),
        acceleration=np.tile([0, 0, -9.81], (6000, 1)),
    )
    calibration = calibrate(recording)
    assert not calibration.converged
    assert calibration.message.startswith("too little motion")
    assert any("hard iron along" in weakness.what for weakness in calibration.observability.weak)
    assert any("pitch or roll" in weakness.remedy for weakness in calibration.observability.weak)
    # Wrong as it may be, it is no surer of itself than it should be.
    assert (np.abs(calibration.hard_iron - [3e-6, 2e-6, 1e-6]) < 10 * calibration.sigma["hard_iron"]).all()


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], "x ← y, y ← x, z ← z"),
        ([[-1, 0, 0], [0, 1, 0], [0, 0, -1]], "x ← −x, y ← y, z ← −z"),
    ],
)
def test_axes_that_disagree_are_named(wide, matrix, words):
    recording = wide.recording
    with pytest.raises(MagycError, match="axes of gyroscope and magnetometer disagree") as caught:
        calibrate(replace(recording, angular_rate=recording.angular_rate @ matrix))
    assert words in str(caught.value)


def test_a_noisy_magnetometer_hides_no_exchanged_axes() -> None:
    """3 µT of noise are a half of what single samples a quarter of a radian apart change by."""
    recording = simulate("wide", 600, seed=5, magnetometer_noise=3e-6, gyroscope_noise=1e-2).recording
    assert calibrate(recording).converged
    turned = recording.angular_rate @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    with pytest.raises(MagycError, match="x ← y, y ← −x, z ← z"):
        calibrate(replace(recording, angular_rate=turned))


def test_degrees_for_radians_are_named(wide):
    """At low rates deg/s pass the constructor's limit."""
    recording = wide.recording.between(0, 60)
    with pytest.raises(MagycError, match="deg/s"):
        calibrate(replace(recording, angular_rate=np.rad2deg(recording.angular_rate)))


def test_too_short():
    with pytest.raises(MagycError, match=r"windows .* at least 8 are needed: record longer"):
        calibrate(Recording(**still(seconds=4)))


def test_a_magnetometer_alone_is_not_enough():
    data = still()
    with pytest.raises(MagycError, match="no angular rate"):
        calibrate(Recording(data["time"], data["magnetic_field"]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "magic"}, "'magic' is not one of smoother"),
        ({"colour": "red"}, "'smoother' has no option 'colour'; it has .*delay"),
        (
            {"field_strength": 0.5},
            r"field_strength: must be that of the Earth, .* \(8e-06 to 0.000175 T is accepted\), got 0.5 T",
        ),
    ],
)
def test_unknown_options(wide, options, words):
    with pytest.raises(MagycError, match=words):
        calibrate(wide.recording, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"window": 0.0}, {"window": -1.0}, {"turn": 0.0}, {"noise": (0.0, 1e-3)}, {"noise": (1e-6, -1.0)},
        {"noise": 1e-6}, {"delay": np.nan}, {"robust": "huber"},
    ],
)  # fmt: skip
def test_impossible_options(wide, options):
    (name,) = options
    with pytest.raises(MagycError, match=name):
        calibrate(wide.recording, **options)


def test_the_registry():
    assert "smoother" in methods()
    assert methods()["smoother"].needs == ("angular_rate",)
    assert signature(calibrate).parameters["method"].default == "smoother"


# --- progress and residuals ---


@pytest.mark.parametrize("hard", [False, True])
def test_progress_ascends_to_one(wide, hard):
    recording = disturb(wide.recording, share=0.3) if hard else wide.recording
    seen = []
    calibrate(recording, progress=seen.append)
    assert seen[0] == 0.0
    assert seen[-1] == 1.0
    assert seen == sorted(seen)
    assert len(seen) > 3


def test_window_residuals_are_white_with_their_sigma(wide):
    calibration = calibrate(wide.recording)
    residuals = window_residuals(wide.recording, calibration)
    n = len(residuals.time)
    assert residuals.magnetic_field.shape == (n, 3)
    assert residuals.link.shape == (n - 1, 3)
    assert (np.diff(residuals.time) > 0).all()
    # The directions absorb nearly two of a window's three, and give back two of a link's two.
    window = np.sum((residuals.magnetic_field / residuals.magnetic_sigma[:, None]) ** 2)
    link = np.sum((residuals.link / residuals.link_sigma[:, None]) ** 2)
    freedom = 3 * n + 2 * (n - 1) - 2 * n - 13
    assert window + link == pytest.approx(freedom, abs=4 * np.sqrt(2 * freedom))
    assert window > n - 13
    assert residuals.magnetic_weight.min() > 0.5


def test_window_residuals_show_what_the_calibration_misses(wide):
    calibration = calibrate(wide.recording)
    off = replace(calibration, hard_iron=calibration.hard_iron + np.array([5e-6, 0, 0]))
    good, bad = (window_residuals(wide.recording, c) for c in (calibration, off))
    assert np.square(bad.magnetic_field).sum() > 2 * np.square(good.magnetic_field).sum()
    with pytest.raises(MagycError, match="no gyroscope bias"):
        window_residuals(wide.recording, replace(calibration, gyro_bias=None, covariance=None))


@pytest.mark.parametrize("rows", [1, 2, 5, 10])
def test_the_noise_of_a_stream_that_was_interpolated_is_seen(rows):
    """Second differences are zero but at the samples themselves; with a noise of 0.1 nT all windows were rejected."""
    value = 30e-6 + 1e-6 * np.random.default_rng(5).standard_normal((4000, 3))
    row = np.arange(rows * 3999 + 1) / rows
    between = np.stack([np.interp(row, np.arange(4000), axis) for axis in value.T], axis=1)
    noise = magnetometer_noise(Recording(0.1 * row, between))
    assert 0.6e-6 / rows < noise < 1.2e-6


@pytest.mark.filterwarnings("error")
def test_a_parameter_without_information_has_an_infinite_variance():
    """Without a warning, which a hopeless descent on a real log printed."""
    covariance = inverse_information(np.diag([4.0, 0.0, 1e-12]), np.ones(3, dtype=bool))
    np.testing.assert_allclose(covariance, np.diag([0.25, np.inf, 1e12]))


@pytest.mark.parametrize("share", [1e-3, 1e-10, 1e-16])
def test_a_covariance_is_bounded_along_a_direction_that_is_hardly_determined(share):
    """By the eigenvalue s, as a share of each parameter's information, but at least by 1e-15."""
    information = np.array([[4.0, 2 - 2 * share], [2 - 2 * share, 1.0]])
    covariance = inverse_information(information, np.ones(2, dtype=bool))
    along = np.array([2.0, -1.0])
    assert along @ covariance @ along == pytest.approx(2 / max(share, 1e-15), rel=1e-5)


def test_a_descent_does_not_end_before_a_direction_that_is_hardly_determined():
    """The last samples of the survey change the sigmas by nothing; they were thirteen times as wide with them."""
    survey = read(Path(__file__).parents[1] / "datasets" / "lawn_mower_survey.mcap", channels=())
    whole, shorter = calibrate(survey), calibrate(survey.between(0.0, 599.5))
    assert np.diag(whole.covariance) == pytest.approx(np.diag(shorter.covariance), rel=0.1)
    assert whole.hard_iron == pytest.approx(shorter.hard_iron, abs=0.1e-6)
