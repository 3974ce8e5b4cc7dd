"""The posterior of one recording: the tree of sets of effects, with effects on the noise and coloured noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.candidates import COLOUR
from magyc_gtsam.gap.evidence.colour import colour_of
from magyc_gtsam.gap.evidence.coloured import beside_colour, coloured, in_place_of_noise, noise_left_by
from magyc_gtsam.gap.evidence.node import Node
from magyc_gtsam.gap.evidence.posterior import Set, SetWeight, normalised, summed, weights
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.sample_effects import SampleEffects, change, left_by
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.model.base import problem_of, root
from magyc_gtsam.gap.model.colour import ColouredNoise
from magyc_gtsam.gap.model.refit import without_delay
from magyc_gtsam.gap.samples.first import First
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.recording import Recording

_ROUNDS = 3  # of taking out effects on single samples
_SAME = 0.5  # nats by which the innovations of the windows change, below which the sets are not grown again


@dataclass(frozen=True, eq=False)
class Answer:
    """The posterior of one recording.

    Attributes:
        recording: without the effects on single samples.
        tree: of the sets.
        posterior: {(names, True if an unknown effect is present): probability}.
        left_out: the effects on single samples that were taken out of the recording.
        unsteady: log odds of something unknown with spectral lines that never end.
    """

    recording: Recording
    tree: Tree
    posterior: dict[Set, float]
    left_out: tuple[NoiseScore, ...] = ()
    unsteady: float = -np.inf


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
    steps, recording, problem, level = first.stepless(names, short_term)
    if steps is not None:  # certain, and they would be taken for a non-linear reading
        said[steps.name] = PRIOR.certain
    singles = SampleEffects(recording, names, said, None if steps is None else float(steps.value[0]))
    outline, turn = None, 0
    bare = without_delay(replace(base.model, noise=level, terms=()))
    while True:
        tree = Tree(root(problem, bare), allowed, base.model.terms, outline)
        turn, grown, before = turn + 1, tree.best, singles.recording
        if steps is not None and turn == 1:  # once more, with a better model
            singles.recording, _ = first.without_steps(grown.fit.model)
        changed = _taken_out(singles, grown, before)
        if not changed or turn == _ROUNDS:  # sets that are grown again need not be completed
            tree.complete()
            changed = tree.best is not grown and _taken_out(singles, tree.best, singles.recording)
        if not changed or turn == _ROUNDS:
            possible = [name for name in allowed if name != COLOUR or "quantisation" not in said]
            models, noise = _weighed(tree, possible)
            if noise is not None:
                white = tree.nodes[()].fit
                del tree, grown  # as large as the next one
                tree = coloured(noise, white, possible, base.model.terms)
                for key, log in beside_colour(tree).items():
                    models[key] = float(np.logaddexp(models.get(key, -np.inf), log))
            posterior = _posterior(models, said, singles.unsteady)
            return Answer(singles.recording, tree, posterior, tuple(singles.left_out), singles.unsteady)
        problem, outline = problem_of(singles.recording), tree.outline
        del tree  # as large as the next one


def _taken_out(singles: SampleEffects, best: Node, before: Recording) -> bool:
    """Take out what single samples show beside a set; return whether this leaves others of its innovations."""
    singles.take_out(best)
    recording = singles.recording
    return recording is not before and change(best, best.fit.twin.residual(), left_by(best, recording)) >= _SAME


def _weighed(tree: Tree, names: Sequence[str]) -> tuple[dict[Set, float], ColouredNoise | None]:
    """Return {set: log weight}, and the coloured noise if it is there more probably than not.

    With it, the sets with coloured noise are left out, which were grown by white noise.
    """
    each, with_colour, instead = list(weights(tree)), list[tuple[SetWeight, Node]](), list[SetWeight]()
    for node in tree.nodes.values() if COLOUR in names else ():
        left = node.beside.left()
        if node.variation is None and float(left @ left) - tree.fits.freedom > PRIOR.form * node.explained:
            one, unknown = in_place_of_noise(node, colour_of(left))
            with_colour.append((one, node))
            instead.append(unknown)
    models = summed([*each, *(one for one, _ in with_colour), *instead])
    likely = np.logaddexp.reduce([-np.inf, *(one.log for one, _ in with_colour)])
    if likely > np.logaddexp.reduce(list(models.values())) - np.log(2):
        _, best = max(with_colour, key=lambda found: found[0].log)
        return summed(each), noise_left_by(best)
    return models, None


def _posterior(models: dict[Set, float], said: dict[str, float], unsteady: float) -> dict[Set, float]:
    for name, odds in said.items():  # beside every set
        models |= {(tuple(sorted((*key, name))), unknown): log + odds for (key, unknown), log in models.items()}
    if np.isfinite(unsteady):
        for (key, unknown), log in list(models.items()):
            if not unknown:
                models[key, True] = float(np.logaddexp(models.get((key, True), -np.inf), log + unsteady))
    models[(), False] += PRIOR.nothing
    return normalised(models)
