"""The posterior of one recording: the tree of sets of effects, with effects on the noise and coloured noise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import DELAY, SensorNoise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.candidates import COLOUR
from magyc_gtsam.gap.evidence.colour import colour_of
from magyc_gtsam.gap.evidence.node import Node
from magyc_gtsam.gap.evidence.noise import log_odds, singles_of, without
from magyc_gtsam.gap.evidence.posterior import (
    Set,
    SetWeight,
    normalised,
    sensor_variation,
    summed,
    weights,
)
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.model.base import problem_of
from magyc_gtsam.gap.model.problem import Model, Problem
from magyc_gtsam.gap.model.root import root
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.samples.first import First
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.recording import Recording

_ROUNDS = 3  # of removing effects on single samples
_LINES = 4  # removed in each round, at most


@dataclass(frozen=True, eq=False)
class Answer:
    """The posterior of one recording.

    Attributes:
        recording: without the effects on single samples.
        tree: of the sets.
        posterior: {(names, True if an unknown effect is present): probability}.
        left_out: the effects on single samples that were taken out of the recording.
    """

    recording: Recording
    tree: Tree
    posterior: dict[Set, float]
    left_out: tuple[NoiseScore, ...] = ()


def answer(
    first: First, short_term: SensorNoise, names: Sequence[str], settled: Sequence[NoiseScore] = ()
) -> Answer:
    """Return the posterior of a recording, from its model without effects.

    Args:
        first: that model, with the terms of a given calibration.
        short_term: noise of the sensors between neighbouring samples.
        names: candidates.
        settled: tests of the effects that were corrected before.

    Raises:
        TooSmoothError: the noise from sample to sample cannot measure the misfit.
    """
    allowed = tuple(name for name in names if name in TERMS or name == COLOUR)
    said: dict[str, float] = {s.name: PRIOR.certain for s in settled if s.significant}
    base = first.refit
    recording, problem, level = first.recording, base.twin.problem, short_term
    left_out: list[NoiseScore] = []
    steps = first.steps[0]
    stepped = steps.significant and steps.name in names
    if stepped:  # certain, and they would be taken for a non-linear reading
        said[steps.name] = PRIOR.certain
        recording, white = first.without_steps()
        problem = problem_of(recording)
        # Steps wider than the noise hide it in the differences of successive samples.
        level = short_term._replace(magnetometer=max(short_term.magnetometer, white))
    taken_beside: dict[str, Counter[str]] = {}  # the most probable set beside which an effect was taken out
    tree: Tree | None = None
    for turn in range(_ROUNDS):
        start = root(problem, _bare(base.model, level))
        tree = Tree(start, allowed, base.model.terms, tree)
        before, model = recording, tree.best.fit.model
        if stepped and not turn:  # once more, with a better model
            recording, _ = first.without_steps(model)
            problem = problem_of(recording)
        fine, found = singles_of(recording, model)
        for name in ("spikes", *("tone",) * _LINES):
            score, known = found[name], said.get(name, -np.inf)
            odds = log_odds(score)
            form = name == "spikes" and score.statistic < PRIOR.form_of_field * tree.best.of_field
            # Rounding moves a reading by up to a step, and rarely where the reading is far from the next one.
            rounded = stepped and name == "spikes" and score.value[0] < steps.value[0]
            # Effects that are there no longer were some of the wrong samples, which they hid.
            hidden = name in taken_beside and bool(taken_beside[name] - Counter(tree.best.names))
            known_too = known > 0 and name != "tone" and not hidden
            if name not in names or known_too or odds < PRIOR.hardly_single or form or rounded:
                continue
            said[name] = max(odds, known)
            if odds > 0:
                taken_beside[name] = Counter(tree.best.names)
                recording, taken = without(recording, model, fine, score)
                left_out = _with(left_out, taken)
                problem = problem_of(recording)
                fine, found = singles_of(recording, model)
        if recording is before or _same(tree.best, problem):
            break
    assert tree is not None
    return Answer(recording, tree, _posterior(tree, said, COLOUR in names), tuple(left_out))


def _with(scores: list[NoiseScore], one: NoiseScore) -> list[NoiseScore]:
    """Return the scores with one more, wrong samples together with those that were taken out before."""
    before = next((each for each in scores if each.name == one.name == "spikes"), None)
    if before is None:
        return [*scores, one]
    count = np.array([before.setting["count"], one.setting["count"]])
    square = count @ np.array([before.value[0], one.value[0]]) ** 2 / count.sum()
    both = replace(
        before,
        statistic=before.statistic + one.statistic,
        evidence=before.evidence + one.evidence,
        value=np.array([np.sqrt(square)]),
        sigma=np.array([np.sqrt(square / (6 * count.sum()))]),
        setting={key: before.setting[key] + one.setting[key] for key in ("share", "count")},
        rows=None,
    )
    return [both if each is before else each for each in scores]


def _same(node: Node, problem: Problem) -> bool:
    """Return whether a set leaves the same of other readings, to a nat: a tone is averaged away by the windows."""
    before, after = node.fit.twin.residual(), Twin.of(problem, node.fit.model, node.fit.twin).residual()
    noise = 1.0 if node.variation is None else node.variation.noise
    return before.shape == after.shape and float(((after - before) ** 2).sum()) < noise**2


def _bare(model: Model, level: SensorNoise) -> Model:
    """Return a model without its effects, with the sensors' own noise."""
    free, parameters = model.free.copy(), model.parameters.copy()
    free[DELAY], parameters[DELAY] = False, 0.0
    return Model(parameters, free, level)


def _posterior(tree: Tree, said: dict[str, float], coloured: bool) -> dict[Set, float]:
    each = list(weights(tree))
    if coloured and "quantisation" not in said:
        for node in tree.nodes.values():
            if node.variation is not None:
                continue
            left = node.beside.left()
            power = float(left @ left) - tree.fits.freedom
            if power > PRIOR.form * node.explained:
                colour, key = colour_of(left), node.present
                with_colour = tuple(sorted((*key, COLOUR)))
                each.append(SetWeight(with_colour, node.log + PRIOR.named + colour.alike))
                log = node.log + PRIOR.unknown - PRIOR.one_of_families + colour.one_way
                each.append(SetWeight(key, log, power))
    models = summed(each, sensor_variation(tree))
    for name, odds in said.items():  # beside every set
        there = {(tuple(sorted((*key, name))), unknown): log + odds for (key, unknown), log in models.items()}
        if name == "spikes" and odds > 0:  # or a part of the unknown effect
            for (key, unknown), log in models.items():
                if unknown:
                    models[key, unknown] = float(np.logaddexp(log, log + odds))
        models |= there
    models[(), False] += PRIOR.nothing
    return normalised(models)
