"""`autocal`: its algebra against the paper's, its minimum against GTSAM's, its results against simulated truth."""

from dataclasses import replace
from functools import partial

import gtsam
import numpy as np
import pytest

from magyc_gtsam import MagycError, Recording, calibrate, cli, simulate
from magyc_gtsam.closest_point import closest_points
from magyc_gtsam.estimators.autocal import fit as autocal_fit
from magyc_gtsam.estimators.autocal.autocal import covariance, inliers
from magyc_gtsam.estimators.autocal.fit import autocal
from magyc_gtsam.estimators.autocal.graph import refine_graph
from magyc_gtsam.factors import KERNELS
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.sphere import SHAPES, sphere_error
from magyc_gtsam.simulation import disturb
from magyc_gtsam.study import autocal as study
from magyc_gtsam.study.autocal import model_error, synthetic, triangular
from magyc_gtsam.study.efficiency import nees
from magyc_gtsam.study.rows import study_rows

MICROTESLA = 1e-6
K = np.array([1.1, 0.1, -0.05, 0.9, 0.07, 1.0])
B = np.array([0.2, -0.3, 0.1])


def samples(n=40, seed=0, noise=0.05):
    """(3, n) near the ellipsoid of K and B."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(3, n))
    x /= np.linalg.norm(x, axis=0)
    return autocal_fit.triangle(K) @ x + B[:, None] + noise * rng.normal(size=(3, n))


@pytest.mark.parametrize("name", KERNELS)
def test_curvature_is_the_slope_of_the_influence(name):
    kernel, k, step = KERNELS[name], 1.3, 1e-6
    e = np.array([0.1, 0.5, 1.0, 1.7, 3.0, 10.0])
    influence = [kernel.weight(e + s, k) * (e + s) for s in (step, -step)]
    np.testing.assert_allclose(kernel.curvature(e, k), (influence[0] - influence[1]) / (2 * step), atol=1e-6)


def test_the_schur_complement_leaves_the_residual_along_the_normal():
    """(33) with explicit 2×2 blocks, from the sphere factor's own Jacobians, weighted as least squares."""
    value = samples()
    points = closest_points(autocal_fit.triangle(K), B, value)
    information, gradient = np.zeros((9, 9)), np.zeros(9)
    for m, x in zip(value.T, points.direction.T, strict=True):
        residual, (on_x, on_k, on_b) = sphere_error(SHAPES["triangular"], m, x, K, B, True)
        on_p = np.hstack([on_k, on_b])
        on_tangent = on_x @ gtsam.Unit3(x).basis()
        block = np.linalg.inv(on_tangent.T @ on_tangent)
        left = np.eye(3) - on_tangent @ block @ on_tangent.T
        information += on_p.T @ left @ on_p
        gradient += on_p.T @ left @ residual
    jacobian = autocal_fit._jacobian(points)
    np.testing.assert_allclose(jacobian @ jacobian.T, information, atol=1e-10)
    np.testing.assert_allclose(-jacobian @ points.distance, gradient, atol=1e-10)


def test_the_jacobian_is_the_derivative_of_the_distances():
    value, parameters = samples(), np.concatenate([K, B])
    jacobian = autocal_fit._jacobian(autocal_fit._closest(parameters, value))
    for i, step in enumerate(1e-6 * np.eye(9)):
        ahead, behind = (autocal_fit._closest(parameters + s * step, value).distance for s in (1, -1))
        np.testing.assert_allclose(-jacobian[i], (ahead - behind) / 2e-6, atol=1e-7)


@pytest.mark.parametrize("name", KERNELS)
def test_the_gtsam_graph_has_the_same_minimum(name):
    """From a start that is a percent off; l1, whose cost has no curvature, ends where steps win nothing."""
    field = synthetic(3, samples=50, outliers=0.1)[0].magnetic_field / MICROTESLA
    arrays = autocal(field, name)
    graph = refine_graph(
        field, arrays.matrix * 1.01, arrays.offset + 1, name, sigma=arrays.sigma, width=arrays.width
    )
    assert arrays.converged
    assert graph.converged, graph.message
    tolerance = 2e-3 if name == "l1" else 1e-5  # units, where a parameter's own deviation is about 0.5
    assert graph.cost == pytest.approx(arrays.cost, rel=1e-6 if name == "l1" else 1e-9)
    np.testing.assert_allclose(graph.matrix, arrays.matrix, atol=tolerance)
    np.testing.assert_allclose(graph.offset, arrays.offset, atol=tolerance)


def test_the_graph_is_an_option_of_the_method():
    recording, _ = synthetic(4, samples=40)
    array, graph = (calibrate(recording, "autocal", solver=solver) for solver in ("array", "graph"))
    np.testing.assert_allclose(graph.soft_iron, array.soft_iron, atol=1e-6)
    np.testing.assert_allclose(graph.hard_iron, array.hard_iron, atol=1e-10)
    np.testing.assert_allclose(graph.covariance, array.covariance, rtol=1e-3, atol=1e-18)
    assert graph.configuration["solver"] == "graph"


@pytest.mark.parametrize("name", KERNELS)
def test_no_step_lowers_the_cost(name):
    field = synthetic(5, outliers=0.1)[0].magnetic_field / MICROTESLA
    fit = autocal(field, name)
    tuning = autocal_fit.relative_width(name, fit.width / fit.sigma)

    def cost(matrix, offset):
        distance = closest_points(matrix, offset, field.T).distance
        return KERNELS[name].loss(np.abs(distance) / fit.sigma, tuning).sum()

    assert cost(fit.matrix, fit.offset) == pytest.approx(fit.cost, rel=1e-9)
    rng = np.random.default_rng(6)
    for size in (0.01, 0.1, 1.0):
        for _ in range(10):
            step = size * rng.normal(size=(3, 4))
            assert cost(fit.matrix + np.triu(step[:, :3]), fit.offset + step[:, 3]) > fit.cost * (1 - 1e-7)


@pytest.mark.parametrize("name", KERNELS)
def test_a_tenth_of_outliers_does_no_harm(name):
    for seed in range(3):
        recording, truth = synthetic(seed, outliers=0.1)
        calibration = calibrate(recording, "autocal", kernel=name)
        assert calibration.converged, calibration.message
        assert model_error(calibration, truth) < 0.004
        assert calibration.noise["magnetic_field"] == pytest.approx(MICROTESLA, rel=0.1)


def test_half_of_the_samples_outliers_and_all_on_one_side():
    """The L1 ellipsoid is useless here; the L1 sphere is not."""
    for seed in range(4):
        recording, truth = synthetic(seed, outliers=0.5, one_sided=True)
        assert model_error(calibrate(recording, "autocal"), truth) < 0.04


@pytest.mark.parametrize("outliers", [0.0, 0.1])
@pytest.mark.parametrize("name", KERNELS)
def test_the_covariance_is_honest(name, outliers):
    """NEES of 30 runs with the scale fixed: 8 degrees of freedom, all samples on one side."""
    consistency = []
    for seed in range(30):
        recording, truth = synthetic(seed, outliers=outliers, one_sided=True)
        estimate = calibrate(recording, "autocal", kernel=name)
        deviation = np.concatenate(
            [vech(estimate.soft_iron - truth.soft_iron), estimate.hard_iron - truth.hard_iron]
        )
        assert estimate.covariance.shape == (9, 9)
        consistency.append(nees(deviation, estimate.covariance))
    assert np.mean(consistency) == pytest.approx(8, abs=2.6 * np.sqrt(2 * 8 / 30))


def test_disturbances_that_last_are_counted_once():
    """A second of ten disturbed samples is one event: taken as ten, the covariance would be too small."""
    consistency = []
    for seed in range(12):
        simulation = simulate("wide", seed=seed)
        estimate = calibrate(disturb(simulation.recording, 0.05, seed=seed), "autocal")
        deviation = np.concatenate(
            [
                vech(estimate.soft_iron - simulation.truth.soft_iron),
                estimate.hard_iron - simulation.truth.hard_iron,
            ]
        )
        consistency.append(nees(deviation, estimate.covariance))
    assert 4 < np.mean(consistency) < 12


@pytest.mark.parametrize("name", KERNELS)
def test_units_and_order_do_not_matter(name):
    field = synthetic(8, outliers=0.05)[0].magnetic_field
    order = np.random.default_rng(9).permutation(len(field))
    first = autocal(field, name)
    other = autocal(np.asfortranarray(field[order] * 1e7), name)
    np.testing.assert_allclose(other.matrix / 1e7, first.matrix, atol=1e-4 * first.sigma)
    np.testing.assert_allclose(other.offset / 1e7, first.offset, atol=1e-4 * first.sigma)
    np.testing.assert_allclose(
        covariance(other, name) / 1e14, covariance(first, name), rtol=1e-3, atol=1e-6 * first.sigma**2
    )


def test_noise_and_width_can_be_given():
    recording, truth = synthetic(10, noise=2.0, outliers=0.05)
    given = calibrate(recording, "autocal", noise=(2 * MICROTESLA, 1.0), kernel="huber")
    assert given.noise["magnetic_field"] == pytest.approx(2 * MICROTESLA)
    assert given.diagnostics["kernel_width"] == pytest.approx(2 * np.sqrt(3) * MICROTESLA)
    narrow = calibrate(recording, "autocal", width=1 * MICROTESLA)
    assert narrow.diagnostics["kernel_width"] == pytest.approx(MICROTESLA)
    assert narrow.configuration["width"] == MICROTESLA
    for calibration in (given, narrow):
        assert model_error(calibration, truth) < 0.01


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kernel": "tukey"}, "robust kernel 'tukey' unknown"),
        ({"width": 0}, "width: must be above 0 and below 1e-3 T, got 0"),
        ({"solver": "ceres"}, "solver: 'ceres' is not one of array, graph"),
        ({"noise": 1e-6}, "noise: must be a pair"),
    ],
)
def test_wrong_options_are_refused(options, words):
    with pytest.raises(MagycError, match=words):
        calibrate(synthetic(0)[0], "autocal", **options)


def test_a_vehicle_that_hardly_turns_is_not_trusted():
    calibration = calibrate(simulate("tiny", seed=1).recording, "autocal")
    assert not calibration.converged
    assert calibration.message


def test_a_recording_of_mostly_outliers_is_not_trusted():
    recording, _ = synthetic(11, outliers=0.9)
    calibration = calibrate(recording, "autocal", noise=(MICROTESLA, 1.0))
    assert not calibration.converged
    assert "outliers" in calibration.message


def test_inliers_are_told_from_outliers():
    clean, _ = synthetic(12)
    recording, _ = synthetic(12, outliers=0.1)
    hit = (recording.magnetic_field != clean.magnetic_field).any(axis=1)
    calibration = calibrate(recording, "autocal")
    mask = inliers(recording, calibration)
    assert mask[~hit].all()
    assert (~mask[hit]).mean() > 0.85  # the others were pushed along the ellipsoid
    assert calibration.diagnostics["outliers"] == (~mask).sum()
    np.testing.assert_array_equal(inliers(recording.magnetic_field, calibration), mask)
    assert inliers(recording, calibration, limit=1.0).all()
    assert inliers(clean, calibrate(clean, "ellipsoid")).all()


def test_samples_that_the_sensor_held_are_left_out():
    recording, _ = synthetic(13, samples=300)
    held = np.repeat(recording.magnetic_field, 3, axis=0)
    thrice = Recording(np.arange(900) / 300, held)
    assert inliers(thrice, calibrate(thrice, "autocal")).shape == (300,)
    np.testing.assert_allclose(
        calibrate(thrice, "autocal").hard_iron, calibrate(recording, "autocal").hard_iron, atol=1e-12
    )


def test_the_triangular_model_has_the_gram_of_the_calibration():
    _, truth = synthetic(14)
    matrix = triangular(truth)
    assert np.allclose(matrix, np.triu(matrix))
    assert (np.diag(matrix) > 0).all()
    gram = truth.soft_iron @ truth.soft_iron * truth.field_strength**2
    np.testing.assert_allclose(matrix @ matrix.T, gram, rtol=1e-10, atol=1e-20)


def rows_of(units, names):
    return study_rows("autocal", partial(study.worked, names=names), units)


def test_one_sided_data_with_outliers_spoil_the_l2_methods_only():
    """What the paper blames for the failures on its real tracks (section III-C3)."""
    names = ("ellipsoid", "kok-schon", "autocal, cauchy", "autocal, geman-mcclure")
    rows = rows_of(study.units(4, ("one-sided",), (0.03,)), names)
    scores = study.method_scores(rows, "one-sided")[0.03]
    for name in names[:2]:
        assert scores[name].median > 0.1
    for name in names[2:]:
        assert scores[name].median < 0.01
        assert scores[name].failed == 0


def test_the_smoother_bears_the_same_disturbances():
    names = ("ellipsoid", "kok-schon", "autocal, cauchy")
    rows = rows_of(study.units(2, ("vehicle",), (0.03,)), names)
    scores = study.method_scores(rows, "vehicle")[0.03]
    assert scores["ellipsoid"].median > 0.1
    assert scores["kok-schon"].median > 0.1
    assert scores["autocal, cauchy"].median < 0.06
    assert scores["smoother"].median < 0.006


def test_the_command_prints_the_tables(monkeypatch, capsys, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    small = replace(study.PARTS["outliers"], title="A small one", values=(0.0, 0.3))
    monkeypatch.setattr(study, "PARTS", {"outliers": small})
    monkeypatch.setattr(
        study, "VARIANTS", {name: study.VARIANTS[name] for name in ("ellipsoid", "autocal, cauchy")}
    )
    assert cli.main(["study", "autocal", "--runs", "1", "--workers", "1", "-o", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "A small one" in printed
    assert "(100%)" in next(line for line in printed.splitlines() if line.startswith("ellipsoid"))
    assert "%" not in next(line for line in printed.splitlines() if line.startswith("autocal, cauchy"))
    assert len(parquet.read_table(tmp_path / "autocal.parquet").to_pylist()) == 4
    assert "<svg" in (tmp_path / "autocal.svg").read_text(encoding="utf-8")
