"""What the search for the most probable set of effects leaves out: it finds the same with less."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import magyc_gtsam as mg
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
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


def test_a_set_without_a_fit_is_not_fitted_with_other_numbers_of_modes(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = completed(base_of(drifting()), (DRIFT, "timing"))
    node = tree.nodes[(DRIFT,)]
    tried: list[float] = []
    monkeypatch.setattr(JointFits, "fit", lambda self, model, known: tried.append(model.terms[0].setting["order"]))
    assert tree._child(node, node.found["timing"]) is None
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


@pytest.mark.parametrize("coloured", [False, True])
@pytest.mark.parametrize("in_world", [False, True])
def test_the_climb_over_amplitudes_ends_where_the_whole_grid_does(
    monkeypatch: pytest.MonkeyPatch, in_world: bool, coloured: bool
) -> None:
    twin = base_of(drifting()).twin
    climbed = variations.field_variation(twin, in_world, coloured)
    count = len(variations._AMPLITUDES)
    monkeypatch.setattr(
        variations, "_climbed", lambda log_of, _, courses: max(range(1 + courses * count), key=log_of)
    )
    whole = variations.field_variation(twin, in_world, coloured)
    assert climbed.gain == pytest.approx(whole.gain)
    assert (climbed.along, climbed.attitude, climbed.period) == (whole.along, whole.attitude, whole.period)
    assert (climbed.colour, climbed.colour_period) == (whole.colour, whole.colour_period)
