"""Blocks that have entered and are not judged yet, wrong axes meanwhile, and starts at iSAM2's own settings."""

import math
import sys
from pathlib import Path

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from scipy.spatial.transform import Rotation

from magyc_gtsam.factors import HealthLimits, NativeFactors
from magyc_gtsam.factors.block_fit import BlockFit
from magyc_gtsam.factors.examination import Examiner
from magyc_gtsam.factors.heading_pull import HeadingPull, solved_turn
from magyc_gtsam.factors.held_field import FieldLimits, HeldField
from magyc_gtsam.factors.solver import View

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from slam_vehicles import FIELD, Graph, Vehicle

ISOTROPIC = gtsam.noiseModel.Isotropic.Sigma


def unjudged(look):
    return look.health.status == "waiting" and not look.waiting


@pytest.mark.parametrize(("kind", "seed"), [("ship", 470), ("submarine", 471)])
def test_a_mounting_that_was_forgotten_is_said_within_8_blocks(kind, seed):
    """The graph went on turning, so that no block was judged for 30 updates: 42° off at 0.1°, and no alarm."""
    turned = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    looks = Graph(Vehicle(kind, seed, 80, mounting=turned)).run()
    wrong = [look for look in looks if look.wrong and not look.waiting]
    assert len(wrong) > 10
    assert not [look for look in wrong if look.health.status == "consistent"]
    silent = [look for look in wrong if unjudged(look)]
    assert len(silent) <= 8
    assert wrong[-1].health.status == "inconsistent"


def test_what_is_not_judged_is_said():
    looks = Graph(Vehicle("car", 470, 40)).run()
    waits = [str(look.health) for look in looks if unjudged(look)]
    assert waits
    first = next(look.time for look in looks if not look.waiting)
    for said in waits:
        assert said.startswith(
            "waiting: blocks have entered and are not judged yet: the heading may be off by far more"
        )
    # the first block of those that waited
    assert float(waits[0].split()[-2]) <= first
    assert str(looks[-1].health) == "consistent"


@pytest.mark.parametrize(("kind", "seed"), [("multirotor", 470), ("car", 471), ("rover", 470)])
def test_a_start_half_a_turn_off_ends_right_at_isam2s_own_settings(kind, seed):
    """Blocks entered at the old heading, which iSAM2 had not linearised anew, and the soft iron was called negative."""
    looks = Graph(Vehicle(kind, seed, 90), heading=3.1, prior=1.5, skip=10, threshold=0.1).run()
    assert {str(look.health.status) for look in looks} == {"waiting", "consistent"}
    assert not [look for look in looks if look.wrong and look.health.status == "consistent"]
    assert looks[-1].health.status == "consistent"


def test_a_declination_of_30_degrees_is_said_before_all_60_blocks():
    turned = Rotation.from_euler("z", 30, degrees=True).apply(FIELD)
    looks = Graph(Vehicle("multirotor", 471, 90), world=turned).run()
    consistent = [look for look in looks if look.health.status == "consistent"]
    assert len(consistent) < 15
    assert looks[-1].health.by.startswith("field ")


@pytest.mark.parametrize("size", [1.0, 2.0])
def test_positions_whose_errors_last_turn_no_field(size):
    vehicle, errors = Vehicle("submarine", 472, 120), []
    error, kept = np.zeros(3), math.exp(-1 / 30)
    for each in vehicle.fix_errors:
        error = kept * error + math.sqrt(1 - kept**2) * each
        errors.append(size * error)
    vehicle.fix_errors = np.array(errors)
    looks = Graph(vehicle).run()
    assert {str(look.health.status) for look in looks} <= {"waiting", "consistent"}


def test_the_angle_that_counts_falls_with_the_number_of_blocks():
    field, angles = HeldField(FieldLimits()), []
    for field.blocks in range(1, 61):
        if field.early:
            angles.append((field.blocks, round(math.degrees(field.large))))
    assert angles == [(20, 15), (30, 10), (45, 7)]


def turned_track(heading, *, fixes=True):
    """A track along a circle, known from odometry and positions, whose attitudes start turned by `heading`."""
    graph, values, pose = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.Pose3()
    step = gtsam.Pose3(gtsam.Rot3.Rz(0.2), np.array([2.0, 0, 0]))
    wrong = gtsam.Pose3(gtsam.Rot3.Rz(heading), np.zeros(3))
    graph.addPriorPose3(X(0), wrong, gtsam.noiseModel.Diagonal.Sigmas(np.r_[0.1, 0.1, 2.0, 1, 1, 1]))
    for k in range(8):
        values.insert(
            X(k), gtsam.Pose3(wrong.rotation() * pose.rotation(), wrong.rotation().rotate(pose.translation()))
        )
        if fixes:
            graph.push_back(gtsam.GPSFactor(X(k), pose.translation(), ISOTROPIC(3, 1.0)))
        if k < 7:
            graph.push_back(gtsam.BetweenFactorPose3(X(k), X(k + 1), step, ISOTROPIC(6, 0.01)))
            pose = pose.compose(step)
    isam = gtsam.ISAM2()
    isam.update(graph, values)
    return isam


def test_a_heading_at_which_the_graph_will_not_stay_is_no_known_heading():
    assert solved_turn(View(turned_track(3.0)), X(7)) > math.radians(3)
    assert solved_turn(View(turned_track(0.01)), X(7)) < math.radians(3)
    assert solved_turn(View(turned_track(3.0, fixes=False)), X(7)) == pytest.approx(0.0, abs=1e-6)


def test_a_contradicted_prior_says_how_far_the_other_factors_are_from_it():
    """The graph's own distance from the prior, which holds it there, was reported: 3° in place of 58°."""
    isam, graph = turned_track(0.0), gtsam.NonlinearFactorGraph()
    pull = HeadingPull.of(isam.calculateEstimate(), X(7), math.radians(40), math.radians(2))
    graph.push_back(pull.factor)
    isam.update(graph, gtsam.Values())
    for _ in range(20):
        isam.update()
    held = isam.calculateEstimatePose3(X(7)).rotation()
    assert pull.resisted(View(isam)) == pytest.approx(math.radians(40), abs=math.radians(8))
    assert abs((held * gtsam.Rot3(pull.target).inverse()).yaw()) < math.radians(38)


@pytest.mark.parametrize(("kind", "known"), [("ship", True), ("car", False)])
def test_how_well_a_mounting_could_be_judged_is_said(kind, known):
    """5° about a level axis: found on a ship that tilts by 4°, and taken for 8 µT of iron on a car that tilts by 1°."""
    turned = Rotation.from_euler("y", 5, degrees=True).as_matrix()
    graph = Graph(Vehicle(kind, 450, 126, mounting=turned))
    health, sigma = graph.run()[-1].health, np.degrees(graph.native.mounting_sigma)
    assert graph.looks[0].health.status == "waiting"
    assert graph.looks[-1].iron > 7.0
    assert (health.by.startswith("mounting ") and sigma[:2].max() < 0.5) == known
    assert (health.status == "consistent" and 0.8 < sigma[:2].min() < 2.0) == (not known)


def test_nothing_is_said_of_a_mounting_that_no_block_holds():
    native = NativeFactors()
    assert native.mounting_sigma is None
    assert NativeFactors(health=None).mounting_sigma is None
    assert str(NativeFactors(health=None).health) == "waiting: no block is judged (health=None)"


def test_an_offset_that_is_not_identified_is_no_turned_mounting(monkeypatch):
    """Of eight dives a step of 5 µT was named a mounting that is 7 to 9° off in three, at 45 blocks."""
    examiner, looks = Examiner(HealthLimits()), []
    monkeypatch.setattr(examiner, "_free", lambda *_, gross=False: looks.append(gross))
    offset, seen = np.array([5e-6, 0.0, 0.0]), np.array([2e-5, 1e-5, -3e-5])
    for k in range(1, 46):
        shift = offset if k > 40 else np.zeros(3)
        nis = 300.0 if k > 40 else 3.0
        fit = BlockFit(2.0 * k, nis, 3, 1.0, shift, 1e-7, np.eye(3), np.zeros(3), seen, seen + shift, (0, 1))
        examiner.monitor.add(fit)
        examiner.mounting.blocks = examiner.field.blocks = examiner.additions = k
        examiner._look(None, [])
    assert examiner.monitor.open
    assert looks == [True, True]  # at 20 and 30 blocks
