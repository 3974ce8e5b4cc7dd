"""The algebraic ellipsoid fits and the closest points, against constructed truth and another solver."""

import numpy as np
import pytest
from scipy.optimize import linprog

from magyc_gtsam import MagycError, Recording, calibrate
from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.ellipsoid.ellipsoid import fit_ellipsoid, monomials, standardise
from magyc_gtsam.estimators.ellipsoid.kok_schon import fit_kok_schon
from magyc_gtsam.estimators.ellipsoid.l1_ellipsoid import fit_l1_ellipsoid, l1_sphere, l1_start
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.study.autocal import model_error, synthetic
from magyc_gtsam.study.efficiency import nees

FITS = {"ellipsoid": fit_ellipsoid, "kok-schon": fit_kok_schon, "l1-ellipsoid": fit_l1_ellipsoid}
MATRIX = np.array([[110.0, 12.0, -7.0], [0.0, 85.0, 9.0], [0.0, 0.0, 100.0]])
OFFSET = np.array([40.0, -300.0, 12.0])


def directions(n, seed=0):
    x = np.random.default_rng(seed).normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1)[:, None]


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e4])
@pytest.mark.parametrize("name", FITS)
def test_samples_without_noise_give_the_model_back(name, unit):
    matrix, offset = FITS[name]((directions(60) @ MATRIX.T + OFFSET) * unit)
    np.testing.assert_allclose(matrix / unit, MATRIX, atol=1e-4)
    np.testing.assert_allclose(offset / unit, OFFSET, atol=1e-4)


@pytest.mark.parametrize("name", FITS)
def test_the_axes_do_not_matter(name):
    """Sensor turned by a rotation: the same ellipsoid, turned."""
    samples = directions(200, 1) @ MATRIX.T + OFFSET + np.random.default_rng(2).normal(size=(200, 3))
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    matrix, offset = FITS[name](samples)
    turned_matrix, turned_offset = FITS[name](samples @ turn.T)
    gram = turn @ matrix @ matrix.T @ turn.T
    # The median, the only thing that turns with the axes, moves the unit-norm fit by a little of its noise.
    np.testing.assert_allclose(turned_matrix @ turned_matrix.T, gram, atol=2e-3 * np.abs(gram).max())
    np.testing.assert_allclose(turned_offset, turn @ offset, atol=0.2)


def test_outliers_spoil_the_least_squares_and_not_the_l1_fit():
    wrong = {name: [] for name in FITS}
    for seed in range(5):
        recording, truth = synthetic(seed, outliers=0.05)
        for name in FITS:
            wrong[name].append(model_error(calibrate(recording, name), truth))
    assert min(wrong["ellipsoid"]) > 0.03
    assert min(wrong["kok-schon"]) > 0.03
    assert max(wrong["l1-ellipsoid"]) < 0.005


def test_kok_schon_is_the_least_squares_fit_of_trace_one():
    samples = synthetic(4, noise=2.0)[0].magnetic_field
    matrix, offset = fit_kok_schon(samples)
    data = standardise(samples)
    phi = monomials(data.value)
    reduced = np.delete(phi, 2, axis=0)
    reduced[:2] -= phi[2]
    found = np.linalg.lstsq(reduced.T, -phi[2], rcond=None)[0]
    c11, c22, c12, c13, c23 = found[:5]
    shape = np.array([[c11, c12, c13], [c12, c22, c23], [c13, c23, 1 - c11 - c22]])
    np.testing.assert_allclose(offset, data.centre - data.unit * np.linalg.solve(shape, found[5:8]), rtol=1e-5)
    gram = np.linalg.inv(matrix @ matrix.T)
    np.testing.assert_allclose(gram / np.trace(gram), shape, atol=1e-6)


def cost_of_6(samples, matrix, offset):
    """Σ|g| of the quadric with trace C = 1."""
    shape = np.linalg.inv(matrix @ matrix.T)
    shifted = samples - offset
    return np.abs(np.einsum("ni,ij,nj->n", shifted, shape, shifted) - 1).sum() / np.trace(shape)


@pytest.mark.parametrize("one_sided", [False, True])
def test_the_l1_program_reaches_the_minimum_that_a_linear_program_does(one_sided):
    samples = synthetic(5, samples=200, outliers=0.1, one_sided=one_sided)[0].magnetic_field / 1e-6
    n = len(samples)
    phi = monomials(standardise(samples).value).T
    both = np.block([[phi, -np.eye(n)], [-phi, -np.eye(n)]])
    program = linprog(
        np.concatenate([np.zeros(10), np.ones(n)]),
        both,
        np.zeros(2 * n),
        np.concatenate([[1, 1, 1], np.zeros(7 + n)])[None],
        [1.0],
        bounds=[(None, None)] * 10 + [(0, None)] * n,
    )
    unit = standardise(samples).unit
    least = cost_of_6(samples, *fit_l1_ellipsoid(samples)) / unit**2
    assert least == pytest.approx(program.fun, rel=1e-6)
    start = cost_of_6(samples, *l1_start(standardise(samples))) / unit**2
    assert least <= start < 1.05 * least
    sphere, centre = l1_sphere(standardise(samples))
    np.testing.assert_allclose(sphere, sphere[0, 0] * np.eye(3), atol=1e-9 * sphere[0, 0])
    assert np.linalg.norm(centre - fit_l1_ellipsoid(samples)[1]) < 60


def test_a_hyperboloid_is_refused_with_a_reason():
    """Flared like a trumpet: no ellipsoid comes near."""
    angle, height = np.random.default_rng(6).uniform([[0, -1]], [[2 * np.pi, 1]], (300, 2)).T
    radius = np.sqrt(1 + 4 * height**2)
    field = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1) * 40e-6
    recording = Recording(np.arange(300.0), field)
    with pytest.raises(MagycError, match=r"'ellipsoid' failed: .*not an ellipsoid"):
        calibrate(recording, "ellipsoid")


@pytest.mark.parametrize("name", FITS)
def test_a_known_field_strength_sets_the_scale(name):
    recording, truth = synthetic(7)
    calibration = calibrate(recording, name, field_strength=50e-6)
    assert calibration.field_strength == 50e-6
    np.testing.assert_allclose(
        calibration.soft_iron * 50e-6, truth.soft_iron * truth.field_strength, atol=0.01 * truth.field_strength
    )


@pytest.mark.parametrize("name", FITS)
def test_the_covariance_is_honest(name):
    """NEES of 24 runs with the scale fixed: 8 degrees of freedom."""
    consistency = []
    for seed in range(24):
        recording, truth = synthetic(seed, samples=500)
        estimate = calibrate(recording, name)
        deviation = np.concatenate(
            [vech(estimate.soft_iron - truth.soft_iron), estimate.hard_iron - truth.hard_iron]
        )
        consistency.append(nees(deviation, estimate.covariance))
    assert np.mean(consistency) == pytest.approx(8, abs=2.6 * np.sqrt(2 * 8 / 24))


def test_closest_points_are_on_the_ellipsoid_along_its_normal_and_closest():
    rng = np.random.default_rng(8)
    far = np.concatenate([directions(150, 9) * rng.uniform(0.02, 3, (150, 1)), [[0.0, 0.0, 0.0]]])
    samples = (far @ MATRIX.T + OFFSET).T
    turned = MATRIX @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    found = closest_points(turned, OFFSET, samples)
    np.testing.assert_allclose(np.linalg.norm(found.direction, axis=0), 1, atol=1e-9)
    points = turned @ found.direction + OFFSET[:, None]
    np.testing.assert_allclose(points + found.normal * found.distance, samples, atol=1e-7)
    slope = np.linalg.solve(turned.T, found.direction)
    np.testing.assert_allclose(slope / np.linalg.norm(slope, axis=0), found.normal, atol=1e-7)
    others = turned @ directions(20_000, 10).T + OFFSET[:, None]
    for sample, distance in zip(samples.T, found.distance, strict=True):
        assert np.abs(distance) <= np.linalg.norm(others - sample[:, None], axis=0).min() + 1e-9
    again = closest_points(turned * 1.02, OFFSET + 1, samples, found.multiplier)
    np.testing.assert_allclose(
        again.distance, closest_points(turned * 1.02, OFFSET + 1, samples).distance, atol=1e-8
    )


def test_closest_points_at_the_centre_and_on_the_plane_of_the_longer_axes():
    samples = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.5]]).T
    distance = closest_points(np.diag([3.0, 2.0, 1.0]), np.zeros(3), samples).distance
    x = 3 * 0.1 / (9 - 1)  # a² x / (a² − c²) of the foot point, by hand
    second = np.hypot(3 * x - 0.1, np.sqrt(1 - x**2))
    np.testing.assert_allclose(np.abs(distance), [1.0, second, 0.5], rtol=1e-7)
