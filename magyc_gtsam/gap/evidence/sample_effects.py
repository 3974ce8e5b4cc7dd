"""Effects on single samples, taken out of the readings beside the most probable set: wrong samples and tones.

A tone is a steady line of the spectrum, which is gone when it is taken out. Lines that never end are none: those that
remain in the place of one that was taken out are of a signal whose frequency or amplitude changes, or of a misfit with
heavy tails, and a comb has more lines than any hum. They are put back. If the windows show them, something unknown is
present; otherwise they are noise, which the windows average away.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap.evidence.node import Node
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.base import problem_of
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import Fine, fine_innovations, single_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore, in_place_of
from magyc_gtsam.gap.samples.tones import heard, silenced
from magyc_gtsam.recording import Recording

_LINES = 4  # taken out at most; a hum has one to three


class SampleEffects:
    """The readings of a recording, without the effects on single samples found so far.

    Attributes:
        recording: without them.
        left_out: these effects.
        said: {name: log odds} of those that were tested.
        unsteady: log odds of lines that never end, of which something unknown is the cause, by what the windows show.
    """

    def __init__(
        self, recording: Recording, names: Sequence[str], said: dict[str, float], step: float | None
    ) -> None:
        """Begin with all readings.

        Args:
            recording: with its steps corrected.
            names: candidates.
            said: of the effects that were corrected before.
            step: T, of readings in steps; None without.
        """
        self.recording, self.said, self.unsteady = recording, said, -np.inf
        self.left_out: list[NoiseScore] = []
        self._names, self._step, self._endless = names, step, False
        self._beside: dict[str, Counter[str]] = {}  # the most probable set beside which an effect was taken out

    def take_out(self, best: Node) -> None:
        """Take out what is found beside the most probable set of effects."""
        model = best.fit.model
        fine, found = singles_of(self.recording, model)
        for name in ("spikes", *("tone",) * (_LINES + 1)):
            score, known = found[name], self.said.get(name, -np.inf)
            odds = _log_odds(score)
            if name not in self._names or not score.significant or self._passed(score, known, best):
                continue
            if name == "tone" and odds > 0 and sum(one.name == name for one in self.left_out) == _LINES:
                without_lines, self._endless = self.recording, True
                self._put_back(score, float(fine.time[-1] - fine.time[0]))
                seen = change(best, *(left_by(best, each) for each in (without_lines, self.recording)))
                self.unsteady = min(odds, seen + PRIOR.named)
                return
            self.said[name] = max(odds, known)
            if odds > 0:
                self._beside[name] = Counter(best.names)
                self.recording, taken = _without(self.recording, model, fine, score)
                self.left_out = _with(self.left_out, taken)
                fine, found = singles_of(self.recording, model)

    def _passed(self, score: NoiseScore, known: float, best: Node) -> bool:
        """Return whether an effect is explained otherwise, or was taken out before."""
        if score.name == "tone":
            return self._endless
        form = score.statistic < best.formless
        # Rounding moves a reading by up to a step, and rarely where the reading is far from the next one.
        rounded = self._step is not None and score.value[0] < self._step
        # Effects that are there no longer were some of the wrong samples, which they hid.
        hidden = score.name in self._beside and bool(self._beside[score.name] - Counter(best.names))
        return bool((known > 0 and not hidden) or form or rounded)

    def _put_back(self, more: NoiseScore, duration: float) -> None:
        """Put lines back among the readings: those that are not alone in their place, or all if each is."""
        lines = [one for one in self.left_out if one.name == "tone"]
        every = [one.setting["frequency"] for one in (*lines, more)]
        near = [in_place_of(np.array(every), f, 1 / duration).sum() > 1 for f in every]
        back = [one for one, shared in zip(lines, near[:-1], strict=True) if shared or not any(near)]
        terms = [Term(one.name, -one.value, np.diag(one.sigma**2), one.setting) for one in back]
        self.recording = silenced(self.recording, terms)  # of the opposite sign
        self.left_out = [one for one in self.left_out if not any(one is line for line in back)]
        if len(back) == len(lines):
            del self.said["tone"]


def _log_odds(score: NoiseScore) -> float:
    """Return the log odds of an effect on single samples, from its gain in likelihood beyond chance."""
    # Bound for the p-value of the largest of many lines: −ln(e p ln(1/p)) (Sellke, Bayarri and Berger 2001).
    of_search = 1 + np.log(max(score.evidence, 1.0)) + RULES.unsure_line if score.name == "tone" else 0.0
    gain = score.evidence - of_search
    return float(min(gain + PRIOR.named, 2 * PRIOR.certain)) if score.significant else -PRIOR.certain


def singles_of(recording: Recording, model: Model) -> tuple[Fine, dict[str, NoiseScore]]:
    """Return the tests of the effects on single samples beside a model."""
    fine = fine_innovations(recording, model)
    return fine, {score.name: score for score in single_scores(recording, fine, 0.0)}


def _without(recording: Recording, model: Model, fine: Fine, score: NoiseScore) -> tuple[Recording, NoiseScore]:
    """Return the recording without an effect on single samples, and the effect with the value taken out."""
    if score.name == "tone":
        line = heard(recording, model, score.setting["frequency"])
        return silenced(recording, [line]), replace(
            score, value=line.value, sigma=line.sigma, setting=line.setting
        )
    assert score.rows is not None
    wrong = np.isin(recording.time, fine.time[score.rows])
    return replace(recording, magnetic_field_fresh=recording.magnetic_field_fresh & ~wrong), score


def left_by(node: Node, recording: Recording) -> Array:
    """Return what a set leaves of other readings (3, n), innovations in units of the noise."""
    return Twin.of(problem_of(recording), node.fit.model, node.fit.twin).residual()


def change(node: Node, one: Array, other: Array) -> float:
    """Return the nats by which innovations differ, at the noise of a set: windows average most of a tone away."""
    noise = 1.0 if node.variation is None else node.variation.noise
    return 0.5 * float(((one - other) ** 2).sum()) / noise**2 if one.shape == other.shape else np.inf


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
