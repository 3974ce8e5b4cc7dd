"""One `NativeFactors` and what its user does with the solver: other solvers, batches, marginals, removals, copies."""

import copy
import pickle
import re

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import A, F, H, X
from test_slam_field import ISOTROPIC, problem

from magyc_gtsam.factors import MagycError, NativeFactors
from magyc_gtsam.factors.solver import View


def parts(poses=10):
    """The problem in steps: the calibration, then a pose with its block in each."""
    graph, values = problem(poses=poses)
    first = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for key, value in ((A(0), values.atVector(A(0))), (H(0), values.atPoint3(H(0)))):
        first[1].insert(key, value)
    for i in (2 * poses, 2 * poses + 1):
        first[0].push_back(graph.at(i))
    steps = [first]
    for k in range(poses):
        step = gtsam.NonlinearFactorGraph(), gtsam.Values()
        step[0].push_back(graph.at(2 * k))
        step[0].push_back(graph.at(2 * k + 1))
        step[1].insert(X(k), values.atRot3(X(k)))
        steps.append(step)
    return steps


def begun(steps, count):
    native, isam = NativeFactors(alignment=None), gtsam.ISAM2()
    for step in steps[:count]:
        native.update(isam, *step)
    return native, isam


def in_place(native, isam):
    """Whether the slot of each quadratic has it."""
    held = isam.getFactorsUnsafe()
    return all(held.at(each.slot) is each.native for each in native._delivered)


def test_another_solver_is_refused():
    """The slots of one would have been removed from the other."""
    steps = parts()
    native, isam = begun(steps, 5)
    for other in (gtsam.ISAM2(), gtsam.ISAM2(isam)):
        with pytest.raises(MagycError, match="another solver .* give each solver a NativeFactors"):
            native.update(other, *steps[5])
        with pytest.raises(MagycError, match="another solver"):
            native.settle(other)
    native.update(isam, *steps[5])
    assert len(native) == 5


@pytest.mark.parametrize("before", [0, 3])
def test_a_solved_batch_goes_on_in_a_solver(before):
    """Its quadratics were taken to have the slots of the batch, so that renewing one removed another's factor."""
    native, isam, steps = NativeFactors(), gtsam.ISAM2(), parts(12)
    other, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k in range(before):
        other.addPriorPoint3(F(k), np.zeros(3), ISOTROPIC(3, 1.0))
        values.insert(F(k), np.zeros(3))
    isam.update(other, values)
    solved = native.solve(*problem(poses=10))
    with pytest.raises(MagycError, match="no update after solve"):
        native.settle(isam)
    native.update(isam, *solved)
    for step in steps[11:]:
        native.update(isam, *step)
    native.settle(isam)
    assert len(native) == 12
    assert in_place(native, isam)
    assert isam.getFactorsUnsafe().nrFactors() == before + 2 * 12 + 2
    assert native.health.status == "consistent"


def test_a_batch_can_be_solved_again_but_not_after_updates():
    steps, native = parts(), NativeFactors()
    for poses in (6, 10):  # the second graph does not know what the first one's alignment did
        native.solve(*problem(poses=poses))
        assert len(native) == poses
    used, _ = begun(steps, 4)
    with pytest.raises(MagycError, match="a batch after updates"):
        used.solve(*problem())
    assert len(used) == 3


def test_variables_that_are_marginalised_beside_a_direct_update_are_forgotten():
    """As many variables came as had gone, and nothing was noticed."""
    steps = parts()
    native, isam = begun(steps, 7)
    gone, pose = gtsam.KeyList(), gtsam.NonlinearFactorGraph()
    gone.push_back(X(0))
    isam.marginalizeLeaves(gone)
    pose.push_back(steps[7][0].at(1))
    isam.update(pose, steps[7][1])
    for step in steps[8:]:
        native.update(isam, *step)
    native.settle(isam)
    assert len(native) == 8
    assert in_place(native, isam)


def test_a_block_that_the_user_removes_is_forgotten():
    steps = parts()
    native, isam = begun(steps, 7)
    isam.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), [native._delivered[2].slot])
    for step in steps[7:]:
        native.update(isam, *step)
    native.settle(isam)
    assert len(native) == 9
    assert in_place(native, isam)


def test_a_block_that_is_given_twice_is_refused():
    """A graph that was not emptied after its update; the block would have counted twice."""
    steps = parts()
    native, isam = begun(steps, 4)
    with pytest.raises(MagycError, match=r"block on x2 at 1\.\d s is in the graph already: .* empty `graph`"):
        native.update(isam, steps[3][0])
    assert len(native) == 3


@pytest.mark.parametrize("way", [copy.deepcopy, pickle.dumps])
def test_it_cannot_be_saved_but_the_graph_of_its_solver_can(way):
    native, isam = begun(parts(), 7)
    with pytest.raises(MagycError, match="cannot be copied or saved: save the solver's graph and values"):
        way(native)
    loaded = gtsam.NonlinearFactorGraph()
    loaded.deserialize(isam.getFactorsUnsafe().serialize())
    values = isam.calculateEstimate()
    assert loaded.error(values) == pytest.approx(isam.getFactorsUnsafe().error(values))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((gtsam.Values(),), "the solver is a Values"),
        ((gtsam.IncrementalFixedLagSmoother(5.0), 3.0), "`timestamps` is a float; give {key: s}"),
    ],
)
def test_what_is_no_solver_or_no_time_stamps_is_named(arguments, said):
    graph, values = parts()[0]
    with pytest.raises(MagycError, match=re.escape(said)):
        NativeFactors().update(arguments[0], graph, values, *arguments[1:])


@pytest.mark.parametrize("smoother", [False, True])
def test_what_marginalised_variables_leave_is_taken_where_it_was_linearised(smoother):
    """Taken to be about the estimate it contradicted the graph: right mountings were called 1.7° off in a smoother."""
    steps = parts(16)
    native, solver = NativeFactors(), gtsam.IncrementalFixedLagSmoother(5.0) if smoother else gtsam.ISAM2()
    for k, step in enumerate(steps):
        keys = [A(0), H(0), *([X(k - 1)] if k else [])]
        native.update(solver, *step, {key: float(k) for key in keys} if smoother else None)
        if not smoother and k == 10:
            gone = gtsam.KeyList()
            for i in range(6):
                gone.push_back(X(i))
            solver.marginalizeLeaves(gone)
    native.settle(solver, {A(0): 16.0, H(0): 16.0} if smoother else None)
    view = View(solver)
    graph, values = view.factors(), view.estimate()
    raw, placed = (
        np.abs(each.linearize(values).optimize().vector([A(0), H(0)])).max()
        for each in (graph, view.placed(graph))
    )
    assert placed < 1e-5
    assert raw > 10 * placed
