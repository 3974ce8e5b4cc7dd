"""What the search for the most probable set of effects leaves out: it finds the same with less."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.gap.effects import iron
from magyc_gtsam.gap.evidence import node as nodes
from magyc_gtsam.gap.evidence import tree as trees
from magyc_gtsam.gap.evidence.candidates import DRIFT
from magyc_gtsam.gap.evidence.joint_fits import JointFits
from magyc_gtsam.gap.evidence.look import Look
from magyc_gtsam.gap.evidence.node import Node
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.model import field_variation as variations
from magyc_gtsam.gap.model.base import base_model
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import Refit


def base_of(recording: mg.Recording) -> Refit:
    return base_model(recording, None, short_term_noise(recording))


def drifting() -> mg.Recording:
    """A slow walk of the hard iron, and a delay."""
    base = mg.simulate("wide", 120, seed=9, delay=0.3).recording
    walk = np.random.default_rng(9).standard_normal((9, 3)).cumsum(axis=0)
    drift = 1e-6 * PchipInterpolator(np.arange(9) * 16.0, walk)(base.time - base.time[0])
    return replace(base, magnetic_field=base.magnetic_field + drift)


def completed(*given: Any) -> Tree:
    """A tree with all its sets."""
    tree = Tree(*given)
    tree.complete()
    return tree


def test_sets_that_are_grown_again_are_not_completed_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrong samples are taken out beside the sets of the first tree, and the sets without them are completed."""
    base = mg.simulate("wide", 120, seed=9, delay=0.3).recording
    field, wrong = base.magnetic_field.copy(), np.random.default_rng(9).integers(0, len(base.time), 12)
    field[wrong] += 20e-6
    trees_of: list[Tree] = []
    complete = Tree.complete
    monkeypatch.setattr(Tree, "complete", lambda self: trees_of.append(self) or complete(self))
    grown: list[Tree] = []
    grow = Tree._grow
    monkeypatch.setattr(Tree, "_grow", lambda self, frontier: grown.append(self) or grow(self, frontier))
    gap = mg.find_gap(replace(base, magnetic_field=field), candidates=("spikes", "timing", "axis-delays"))
    assert set(gap.names) == {"spikes", "timing"}
    assert len(grown) == 2
    assert trees_of == grown[1:]


def test_an_exchange_without_a_rival_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """The set that it would have fitted counts towards the most sets, as if it had been."""
    recording = mg.simulate("wide", 120, seed=9, effects=[("timing", 2.0)]).recording
    tree = completed(base_of(recording), ("timing", "axis-delays", "eddy-plane"))
    assert tree.best.names == ("timing",)
    monkeypatch.setattr(Node, "replaceable", lambda self, index: True)
    tried: list[int] = []
    monkeypatch.setattr(Tree, "less", lambda self, node, index: tried.append(index) or tree.nodes[()])
    tree._unrivalled.add(("timing", ()))
    assert not tree._exchanged()
    assert not tried
    assert tree._spared == {()}
    tree._unrivalled.clear()
    assert not tree._exchanged()
    assert tried == [0]


def test_only_sets_that_are_kept_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a drift a number of modes that is less probable than another one needs no look at all candidates."""
    looks: list[Look] = []

    class Counted:
        @staticmethod
        def of(*given: object) -> Look:
            looks.append(Look.of(*given))  # type: ignore[arg-type]
            return looks[-1]

    monkeypatch.setattr(nodes, "Look", Counted)
    tree = completed(base_of(drifting()), (DRIFT, "timing"))
    assert len(looks) == len(tree.nodes)


def test_a_set_that_no_candidate_makes_probable_is_not_looked_at() -> None:
    """A candidate explains no more than what the set leaves."""
    tree = completed(base_of(drifting()), (DRIFT, "timing"))
    assert all(each.log <= node.most for node in tree.nodes.values() for each in node.found.values())
    near, far = (
        replace(tree.nodes[(DRIFT,)], names=("cubic",), log=tree.best.log - tree.nodes[(DRIFT,)].most - nats)
        for nats in (0.0, PRIOR.certain)
    )
    for node, looked in ((far, False), (near, True)):
        tree.nodes[node.key] = node
        tree._deepened()
        assert tree.outline
        assert ("_look" in node.__dict__) == looked


def test_a_set_without_a_fit_is_not_fitted_with_other_numbers_of_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = completed(base_of(drifting()), (DRIFT, "timing"))
    node = tree.nodes[(DRIFT,)]
    tried: list[float] = []
    monkeypatch.setattr(JointFits, "fit", lambda self, model, known: tried.append(model.terms[0].setting["order"]))
    assert tree.child(node, node.found["timing"]) is None
    assert tried == [node.fit.model.terms[0].setting["order"]] == [12.0]
    assert (DRIFT, "timing") in tree.refused


def test_an_effect_is_not_exchanged_where_the_set_without_it_has_no_minimum(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As beside strong vibration, which ended with an error."""
    tree = completed(base_of(drifting()), (DRIFT, "timing"))
    best = tree.best
    assert best.key == (DRIFT, "timing")

    def failing(*given: object) -> Refit:
        raise mg.MagycError("no minimum")

    monkeypatch.setattr(trees, "refit", failing)
    monkeypatch.setattr(Node, "replaceable", lambda self, index: True)
    tree.nodes = {best.key: best}
    assert not tree._exchanged()
    assert tree.nodes == {best.key: best}


def test_an_outline_gives_the_same_tree_again() -> None:
    """Of the same readings, from the sets that were probable; without the columns of the tree before."""
    base, names = base_of(drifting()), (DRIFT, "timing", "hard-iron-step")
    first = completed(base, names)
    again = completed(base, names, (), first.outline)
    assert again.best.key == first.best.key
    assert again.best.log == pytest.approx(first.best.log, abs=0.1)
    assert again.refused >= first.outline.refused


def test_candidates_that_the_linear_model_does_not_order_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside one that was added, within the nats by which the linear model may be wrong."""
    names = (DRIFT, "hard-iron-step", "timing", "soft-iron-step", "local-anomaly")
    usual = completed(base_of(drifting()), names)
    monkeypatch.setattr(trees, "PRIOR", replace(PRIOR, alike=1e3))
    more = completed(base_of(drifting()), names)
    assert usual.nodes.keys() < more.nodes.keys()
    assert more.best.log == usual.best.log


def whole_grid(
    log_of: Callable[[tuple[int, int]], float], _: tuple[int, int], courses: int, shares: int
) -> tuple[int, int]:
    count = 1 + courses * len(variations._AMPLITUDES)
    return max(((place, share) for place in range(count) for share in range(shares)), key=log_of)


def with_attitude() -> mg.Recording:
    """A field that varies with attitude more than along the way, as where an arm turns the sensor."""
    base = mg.simulate("wide", 120, seed=3).recording
    assert base.attitude is not None
    to_world = Rotation.from_quat(base.attitude)
    heading = to_world.as_euler("zyx")[:, 0]
    world = 1e-6 * np.stack([np.sin(2 * heading), np.cos(3 * heading), np.sin(heading)], axis=1)
    walk = np.random.default_rng(3).standard_normal((9, 3))
    world += 0.3e-6 * PchipInterpolator(np.arange(9) * 16.0, walk)(base.time - base.time[0])
    return replace(base, magnetic_field=base.magnetic_field + to_world.inv().apply(world))


@pytest.mark.parametrize("log", [drifting, with_attitude])
@pytest.mark.parametrize("coloured", [False, True])
@pytest.mark.parametrize("in_world", [False, True])
def test_the_climb_over_amplitudes_ends_where_the_whole_grid_does(
    monkeypatch: pytest.MonkeyPatch, in_world: bool, coloured: bool, log: Callable[[], mg.Recording]
) -> None:
    twin = base_of(log()).twin
    climbed = variations.field_variation(twin, in_world, coloured)
    monkeypatch.setattr(variations, "_climbed", whole_grid)
    whole = variations.field_variation(twin, in_world, coloured)
    assert climbed.gain == pytest.approx(whole.gain)
    assert (climbed.along, climbed.attitude, climbed.period) == (whole.along, whole.attitude, whole.period)
    assert (climbed.colour, climbed.colour_period) == (whole.colour, whole.colour_period)


def test_the_amplitude_along_the_way_is_climbed_with_that_of_the_attitude_as_it_is() -> None:
    """On a ridge of one amplitude of the attitude, as in rooms, neither amplitude nor share alone leads on."""

    def log_of(here: tuple[int, int]) -> float:
        amplitude, share = (here[0] - 1) // 3, here[1]
        return -10.0 * abs(amplitude + share - 4) - share - (here[0] - 1) % 3 if here[0] else -99.0

    assert variations._climbed(log_of, (1 + 3 * 1, 3), 3, 4) == (1 + 3 * 4, 0)


def test_what_is_evident_is_added_before_effects_are_exchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    """And once more afterwards, since an exchange leaves sets that may become better."""
    tree = Tree(base_of(drifting()), (DRIFT, "timing"))
    said, better = list[str](), iter([True, False, True, False, False, False])

    def step(name: str) -> Callable[[Tree], bool]:
        return lambda self: said.append(name) or next(better)

    monkeypatch.setattr(Tree, "_deepened", step("more"))
    monkeypatch.setattr(Tree, "_exchanged", step("other"))
    tree.complete()
    assert said == ["more", "more", "other", "more", "other", "more"]


def test_what_was_added_to_a_set_is_added_to_one_that_is_as_probable(monkeypatch: pytest.MonkeyPatch) -> None:
    """The linear model tells the gain beside another name to some nats only."""
    names, jump = (DRIFT, "timing", "hard-iron-step"), "hard-iron-step"
    for alike, wanted in ((0.0, False), (1e6, True)):
        tree = completed(base_of(drifting()), names)
        assert tree.best.key == (DRIFT, "timing")
        bare = tree.nodes[()]
        rival = tree.child(bare, bare.found[jump])
        assert rival is not None
        tree.nodes = {one.key: one for one in (bare, tree.nodes[(DRIFT,)], rival, tree.best)}
        monkeypatch.setattr(trees, "PRIOR", replace(PRIOR, alike=alike))
        tree._deepened()
        assert ((jump, "timing") in tree.nodes) is wanted
        monkeypatch.undo()


def test_settings_are_refined_within_the_range_that_is_searched() -> None:
    """A drift that is over in a second is a change; a current that is a minute late is any function of time."""
    twin = base_of(drifting()).twin
    line = iron.drifts(twin)[0]
    constants, lags = {7.0}, {3.0}
    for _ in range(6):
        constants |= {
            s["constant"] for each in constants for s in iron.warming_nearby(twin, line | {"constant": each})
        }
        lags |= {s["lag"] for each in lags for s in iron._circuits_nearby(twin, {"lag": each})}
    assert 6.0 <= min(constants) < 7.0
    assert 0.5 <= min(lags) < 1.0
    assert 3.0 < max(lags) <= 6.0


def test_a_straight_line_becomes_the_course_of_what_warms_up_at_the_minimum() -> None:
    """Beside no other effect it is as probable; what it leaves was named a drift of the hard iron."""
    base = mg.simulate("wide", 120, seed=4).recording
    since = base.time - base.time[0]
    warmed = 1 + np.array([0.05, -0.04, 0.04]) * (1 - np.exp(-since / 40.0))[:, None]
    first = base_of(replace(base, magnetic_field=base.magnetic_field * warmed))
    fits = JointFits.of(first, ("gain-drift",))
    line = Active("gain-drift", iron.drifts(first.twin)[0], np.zeros(3))
    fit = fits.fit(replace(first.model, terms=(line,)), first.twin)
    assert fit is not None
    node = fits.settled(fits.node(("gain-drift",), fit, 0.0))
    assert 20.0 < node.fit.model.terms[0].setting["constant"] < 80.0
