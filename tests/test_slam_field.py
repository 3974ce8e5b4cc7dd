"""The heading of the field that blocks hold, against the heading of the graph's other factors; whole logs at once."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, F, H, M, X

from magyc_gtsam.factors import (
    KeyframeField,
    NativeFactors,
    keyframe_field_factor,
    mounting_prior,
    vech,
    world_field_prior,
)
from magyc_gtsam.factors.free_fit import FreeFit, free_fit
from magyc_gtsam.factors.held_field import FieldLimits, HeldField
from magyc_gtsam.factors.solver import View

ISOTROPIC = gtsam.noiseModel.Isotropic.Sigma
FIELD, UNIT, IRON = np.array([20e-6, 3e-6, 45e-6]), 50e-6, vech(np.eye(3))


def problem(*, turn=0.0, mounting=None, level=False, heading=0.004, poses=12, free=None, seed=0):
    """Attitudes with priors, known about the vertical to `heading` rad, and blocks that hold a field turned by `turn`.

    The magnetometer is mounted as `mounting` says, which the blocks do not hold.
    """
    random, time = np.random.default_rng(seed), np.linspace(-0.9, 0.0, 10)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(poses):
        tilt = 0.0 if level else 0.9
        pose = gtsam.Rot3.Ypr(2.0 * k, tilt * np.sin(k), tilt * np.cos(3 * k))
        up = pose.matrix()[2]
        spread = 0.01**2 * np.eye(3) + (heading**2 - 0.01**2) * np.outer(up, up)
        read = pose * gtsam.Rot3.Expmap(np.linalg.cholesky(spread) @ random.normal(size=3) * (heading < 0.1))
        seen = (pose * (mounting or gtsam.Rot3())).unrotate(FIELD) + 0.3e-6 * random.normal(size=(10, 3))
        block = KeyframeField.from_samples((k + time, seen), (k + time, np.zeros((10, 3))), float(k))
        held = {"mounting_key": M(0)} if free == "mounting" else {}
        held |= {"field_key": F(0)} if free == "field" else {"field": gtsam.Rot3.Rz(turn).rotate(FIELD)}
        graph.push_back(keyframe_field_factor(X(k), A(0), H(0), block, 0.3e-6, field_unit=UNIT, **held))
        graph.addPriorRot3(X(k), read, gtsam.noiseModel.Gaussian.Covariance(spread))
        values.insert(X(k), read)
    graph.addPriorVector(A(0), IRON, ISOTROPIC(6, 0.3))
    graph.addPriorPoint3(H(0), np.zeros(3), ISOTROPIC(3, 1.0))
    values.insert(A(0), IRON)
    values.insert(H(0), np.zeros(3))
    if free == "mounting":
        graph.push_back(mounting_prior(M(0)))
        values.insert(M(0), gtsam.Rot3())
    if free == "field":
        graph.push_back(world_field_prior(F(0), gtsam.Rot3.Rz(turn).rotate(FIELD), 0.2e-6, field_unit=UNIT))
        values.insert(F(0), gtsam.Rot3.Rz(turn).rotate(FIELD) / UNIT)
    return graph, values


def solved(**options):
    native = NativeFactors()
    native.solve(*problem(**options), examine=True)
    return native


@pytest.mark.parametrize("free", [None, "mounting"])
@pytest.mark.parametrize("turn", [5.0, -3.0])
def test_a_declination_that_the_other_factors_contradict_is_named(turn, free):
    native = solved(turn=np.radians(turn), free=free)
    assert native.health.status == "inconsistent"
    assert native.health.by.startswith("field ")
    assert native.health.by.endswith(
        "about the vertical from the heading of the other factors: check the declination and the axes"
    )
    assert np.degrees(native.field_error) == pytest.approx(-turn, abs=0.6)
    assert native.mounting_error is None


def test_a_field_that_is_a_variable_is_found_and_named():
    native = solved(turn=np.radians(5.0), free="field")
    assert native.health.by.startswith("field ")
    assert native.health.by.endswith("µT from its prior")
    assert native.field_error is None  # the graph's own variable says it
    assert solved(free="field").health.status == "consistent"


def test_a_prior_of_an_attitude_is_none_of_a_mounting():
    """Attitudes that are `Rot3`: what a wrong field moved them by was called a mounting's error."""
    for seed in (1, 3):
        assert "from its prior" not in solved(turn=np.radians(5.0), heading=0.01, seed=seed).health.by


def test_a_turned_mounting_is_no_turned_field():
    native = solved(mounting=gtsam.Rot3.Rz(np.radians(4.0)))
    assert native.health.by.startswith("mounting ")
    assert "field" not in native.health.by
    assert native.field_error is None
    assert native.mounting_error[2] == pytest.approx(np.radians(4.0), abs=0.01)


def test_on_a_level_vehicle_both_are_named():
    native = solved(turn=np.radians(5.0), level=True)
    assert native.health.by.startswith("mounting ")
    assert ", or field " in native.health.by
    assert np.degrees(native.field_error) == pytest.approx(-5.0, abs=0.6)


@pytest.mark.parametrize("options", [{}, {"turn": 0.02}, {"turn": 0.09, "heading": 1.0}])
def test_a_field_is_not_named_where_it_is_right_or_nothing_else_knows_the_heading(options):
    native = solved(**options)
    assert native.health.status == "consistent"
    assert native.field_error is None


def test_the_fit_is_that_of_graphs_solved_with_turned_fields():
    """The curvature and the slope of the least error over ψ, from three solutions."""
    step, errors = 0.01, []
    for turn in (-step, 0.0, step):
        graph, values = problem(turn=turn, poses=6)
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setRelativeErrorTol(1e-14)
        parameters.setAbsoluteErrorTol(1e-10)
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        errors.append(graph.error(values))
        if turn == 0.0:
            native = NativeFactors()
            made, found = native.solve(graph, values)
            isam = gtsam.ISAM2()
            isam.update(made, found)
            fit = free_fit(View(isam), native._delivered, (0.1, 0.1))
    assert fit.information[3, 3] == pytest.approx((errors[2] - 2 * errors[1] + errors[0]) / step**2, rel=0.03)
    assert fit.score[3] == pytest.approx((errors[0] - errors[2]) / (2 * step), rel=0.03)


def test_a_field_is_tried_again_sooner_where_there_is_a_doubt():
    limits = FieldLimits()
    for score, again in ((0.0, 2.0), (4.0, 1.25)):
        field, sigma = HeldField(limits), np.radians(0.5)
        field.blocks = limits.first - 1
        assert not field.due
        field.blocks = limits.first
        assert field.due
        information = np.diag(np.full(4, sigma**-2))
        field.solved(FreeFit(information, np.full(4, score / sigma), np.zeros((9, 4)), np.zeros(3), 1.0))
        field.blocks = int(again * limits.first) - 1
        assert not field.due
        field.blocks += 1
        assert field.due
        assert not field.certain


def test_a_whole_log_in_one_update_is_judged_once_it_has_settled():
    """One step from a start that is far off, every block was a disturbance."""
    graph, values = problem(poses=20)
    for k in range(20):
        values.update(X(k), gtsam.Rot3.Rz(0.3) * values.atRot3(X(k)))
    native, isam = NativeFactors(), gtsam.ISAM2()
    native.update(isam, graph, values)
    assert native.health.status == "waiting"
    for _ in range(6):
        native.update(isam, gtsam.NonlinearFactorGraph())
    assert native.health.status == "consistent"
    assert len(native.fits) == 20
    assert [fit.time for fit in native.fits] == sorted(fit.time for fit in native.fits)


def test_a_whole_log_is_judged_when_it_is_settled_by_hand():
    graph, values = problem(poses=20, turn=np.radians(5.0))
    native, isam = NativeFactors(), gtsam.ISAM2()
    native.update(isam, graph, values)
    native.settle(isam)
    assert len(native.fits) == 20


@pytest.mark.parametrize(("skip", "waiting"), [(1, 0), (1000, 1)])
def test_a_heading_that_is_not_linearised_anew_is_not_sure(skip, waiting):
    """With GTSAM's default of ten updates, blocks entered at a heading that was still turning."""
    graph, values = problem(poses=1)
    settings = gtsam.ISAM2Params()
    settings.relinearizeSkip = skip
    isam, native = gtsam.ISAM2(settings), NativeFactors()
    wrong, start, known, block = (
        gtsam.Rot3.Rz(1.0) * values.atRot3(X(0)),
        *(gtsam.NonlinearFactorGraph() for _ in "abc"),
    )
    start.addPriorRot3(X(0), wrong, ISOTROPIC(3, 1.0))
    for i in (2, 3):
        start.push_back(graph.at(i))
    values.update(X(0), wrong)
    native.update(isam, start, values)
    known.push_back(graph.at(1))
    for _ in range(3):
        native.update(isam, known)
    block.push_back(graph.at(0))
    native.update(isam, block)
    assert native.waiting == waiting
