"""Blocks on a calibration that the graph holds exactly, and blocks of two sensors."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, B, H, X

from magyc_gtsam.factors import KeyframeField, MagycError, NativeFactors, keyframe_field_factor, vech
from magyc_gtsam.factors.solver import View

ISOTROPIC, EXACT = gtsam.noiseModel.Isotropic.Sigma, gtsam.noiseModel.Constrained.All
DOWN, UNIT = np.array([20e-6, 0.0, 45e-6]), 50e-6
IRON = vech(np.eye(3))


def pose(k):
    return gtsam.Rot3.Ypr(2.0 * k, 0.9 * np.sin(k), 0.9 * np.cos(3 * k))


def block(k, end=None, mounting=None, offset=0.0):
    """A second of samples at the attitude k."""
    end = float(k) if end is None else end
    time = np.linspace(end - 0.9, end, 20)
    field = np.tile((pose(k) * (mounting or gtsam.Rot3())).unrotate(DOWN) + [offset, 0, 0], (20, 1))
    return KeyframeField.from_samples(
        (time, field), (time, np.zeros((20, 3))), end, body_R_sensor=mounting or gtsam.Rot3()
    )


def at(k, calibration=0, **options):
    """A block's factor, and the prior and the value of its attitude."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(
        keyframe_field_factor(X(k), A(calibration), H(calibration), block(k, **options), 0.5e-6, field=DOWN,
                              field_unit=UNIT)
    )  # fmt: skip
    graph.addPriorRot3(X(k), pose(k), ISOTROPIC(3, 0.01))
    values.insert(X(k), pose(k))
    return graph, values


def held(kind, wrong=(0.0, 0.0, 0.0)):
    """A calibration, held."""
    graph, values, wrong = gtsam.NonlinearFactorGraph(), gtsam.Values(), np.array(wrong)
    if kind == "equality":
        graph.push_back(gtsam.NonlinearEqualityPoint3(H(0), wrong))
        graph.addPriorVector(A(0), IRON, EXACT(6))
    else:
        model = (lambda n: ISOTROPIC(n, 1e-6)) if kind == "tight" else EXACT
        graph.addPriorVector(A(0), IRON, model(6))
        graph.addPriorPoint3(H(0), wrong, model(3))
    values.insert(A(0), IRON)
    values.insert(H(0), wrong)
    return graph, values


def in_steps(solver, kind, wrong):
    """The calibration first, then a block in each update."""
    native = NativeFactors()
    stamped = not isinstance(solver, gtsam.ISAM2)
    native.update(solver, *held(kind, wrong), {A(0): 0.0, H(0): 0.0} if stamped else None)
    for k in range(1, 13):
        native.update(solver, *at(k), {key: float(k) for key in (X(k), A(0), H(0))} if stamped else None)
    return native


@pytest.mark.parametrize("kind", ["exact", "equality"])
def test_a_calibration_held_in_an_earlier_update_is_judged_as_one_of_a_very_small_sigma(kind):
    """3 µT off, it was taken for a calibration with a sigma of 50 µT, and called consistent."""
    wrong = np.array([0.06, 0.0, 0.0])
    tight, exact = (in_steps(gtsam.ISAM2(), each, wrong) for each in ("tight", kind))
    assert len(exact.fits) == len(tight.fits) > 1
    assert str(exact.health) == str(tight.health)
    assert exact.health.status == "suspect"
    for one, other in zip(exact.fits, tight.fits, strict=True):
        np.testing.assert_allclose(one.offset, other.offset, atol=1e-9)
        assert one.nis == pytest.approx(other.nis, rel=1e-4)
    for native in (tight, exact):  # what the coarse alignment knows
        assert np.diag(native._admission._prior[1]).min() > 1e9


@pytest.mark.parametrize("smoother", [gtsam.IncrementalFixedLagSmoother, gtsam.BatchFixedLagSmoother])
def test_a_calibration_that_is_held_stays_so_in_a_smoother(smoother):
    """Its prior is marginalised with the first poses."""
    wrong = np.array([0.06, 0.0, 0.0])
    exact, tight = (in_steps(smoother(5.0), kind, wrong) for kind in ("exact", "tight"))
    assert str(exact.health) == str(tight.health)
    assert exact.health.status == "suspect"


@pytest.mark.parametrize("first", [X(0), H(0)], ids=["x", "h"])
def test_the_covariance_of_what_a_constraint_holds_is_zero(first):
    """In some orders of elimination GTSAM adds its unit pivot to the variances of the others."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.addPriorPoint3(X(0), np.zeros(3), ISOTROPIC(3, 0.5))
    graph.addPriorPoint3(
        H(0), np.ones(3), gtsam.noiseModel.Constrained.MixedSigmas(1e3, np.array([0.0, 0.2, 0.0]))
    )
    graph.addPriorPoint3(B(0), np.zeros(3), ISOTROPIC(3, 1.0))  # looks the same
    graph.push_back(gtsam.BetweenFactorPoint3(X(0), H(0), np.ones(3), ISOTROPIC(3, 0.1)))
    for key in (X(0), H(0), B(0)):
        values.insert(key, np.ones(3))
    groups = gtsam.KeyGroupMap()
    groups.insert2(first, 1)
    isam = gtsam.ISAM2()
    isam.update(graph, values, [], groups)
    found = View(isam).covariance([X(0), H(0), B(0)])
    given = np.diag([1 / (1 / 0.5**2 + 1 / 0.1**2)] * 3 + [0.0] * 3 + [1.0] * 3)
    precision = np.array([[1 / 0.5**2 + 1 / 0.1**2, -1 / 0.1**2], [-1 / 0.1**2, 1 / 0.2**2 + 1 / 0.1**2]])
    given[np.ix_([1, 4], [1, 4])] = np.linalg.inv(precision)
    np.testing.assert_allclose(found, given, atol=1e-9)


@pytest.mark.parametrize("way", ["update", "solve"])
@pytest.mark.parametrize("apart", [0.0, 0.5])
def test_blocks_of_two_magnetometers_are_refused_with_the_remedy(way, apart):
    """At one time, or in turns; they waited for ever."""
    graph, values, native, isam = *held("tight"), NativeFactors(), gtsam.ISAM2()
    for key, value in ((A(1), IRON), (H(1), np.zeros(3))):
        graph.push_back(type(graph.at(0 if key == A(1) else 1))(key, value, ISOTROPIC(len(value), 1.0)))
        values.insert(key, value)
    for part in (at(1), at(2, calibration=1, end=1.0 + apart)):
        graph.push_back(part[0])
        values.insert(part[1])
    with pytest.raises(MagycError, match=r"blocks on a0, h0 and on a1, h1 overlap at .* NativeFactors of its own"):
        native.update(isam, graph, values) if way == "update" else native.solve(graph, values)
    assert len(native) == 0


def test_a_block_of_another_magnetometer_is_refused_beside_those_before():
    native, isam = NativeFactors(), gtsam.ISAM2()
    native.update(isam, *held("tight"))
    native.update(isam, *at(1))
    graph, values = at(2, end=1.5, mounting=gtsam.Rot3.Rz(1.0))
    with pytest.raises(MagycError, match=r"blocks of two mountings on a0, h0 overlap at 0\.6 s"):
        native.update(isam, graph, values)
    assert len(native) == 1
    native.update(isam, *at(2))  # goes on


def test_a_new_node_of_the_calibration_is_no_second_magnetometer():
    native, isam = NativeFactors(alignment=None), gtsam.ISAM2()
    native.update(isam, *held("tight"))
    native.update(isam, *at(1))
    graph, values = at(2, calibration=1)
    graph.addPriorVector(A(1), IRON, ISOTROPIC(6, 0.1))
    graph.addPriorPoint3(H(1), np.zeros(3), ISOTROPIC(3, 0.1))
    values.insert(A(1), IRON)
    values.insert(H(1), np.zeros(3))
    native.update(isam, graph, values)
    assert len(native) == 2
