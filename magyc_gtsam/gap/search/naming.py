"""The next effect to name, and its rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import NAMES, TERMS
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.model.variants import Projector, Variant
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import Fine, fine_innovations, noise_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.score import Score
from magyc_gtsam.gap.search.found import Found, term_places
from magyc_gtsam.recording import Recording

_OF_TIME = ("hard-iron-step", "hard-iron-drift", "local-anomaly")  # functions of time alone
_IN_TIME = "time:sensor"  # families of any change of the hard iron with time
NOISE_LIMIT = float(np.log(len(NAMES) / RULES.family_wise))


@dataclass(frozen=True, eq=False)
class Look:
    """The score tests of a model, strongest first, with the held-out gains of the relevant ones.

    A gain of 0 marks a channel that fails the circular-shift test. Tests of single samples are computed on demand.
    """

    recording: Recording
    refit: Refit
    scores: list[Score]
    innovation: Array
    projector: Projector
    gains: dict[str, float]

    @property
    def tested(self) -> tuple[str, ...]:
        """Return the effects of the catalogue that were tested."""
        return tuple(score.name for score in self.scores if score.name in TERMS)

    @cached_property
    def fine(self) -> Fine:
        """Return the innovations sample by sample."""
        return fine_innovations(self.recording, self.refit.model)

    @cached_property
    def noise(self) -> list[NoiseScore]:
        """Return the scores of the effects on single samples."""
        return noise_scores(self.recording, self.fine, NOISE_LIMIT)


def loudest(now: Look, names: tuple[str, ...], noted: set[str]) -> NoiseScore | None:
    """Return the strongest significant effect on the noise among `names` that was not noted before."""
    options = [
        n
        for n in now.noise
        if n.significant and n.name in names and n.name not in noted and not _of_misfit(n, now)
    ]
    return max(options, key=lambda n: n.evidence, default=None)


def choices(now: Look, found: Sequence[Found], failed: set[str]) -> list[Score]:
    """Return the strongest significant effect that held-out data confirm, and equal alternatives.

    An effect is left out if it adds nothing to a stronger one that is only the deviation of an earlier effect from its
    form.
    """
    terms, shadow = now.refit.model.terms, _remainder(now, found)
    options: list[Score] = []
    shapes: list[Score] = []
    for score in now.scores:
        if score.generic or not score.significant or now.gains.get(score.name, 0.0) <= 0:
            continue
        if score.evidence < min(shadow, RULES.weak) and not untested(score.name, now.refit.twin):
            continue
        if faint(score, found):
            continue
        held = sum(term.name == score.name for term in terms)
        if held < TERMS[score.name].most and score.name not in failed:
            (shapes if shape_of(score, now.refit, found) else options).append(score)
    options = [
        one
        for one in sorted(options, key=lambda score: -score.evidence)
        if all(shape.evidence < one.evidence or _adds_beyond(one.variant, shape.variant, now) for shape in shapes)
    ]
    if not options:
        return []
    delay = next((o.statistic for o in options if o.name == "timing"), 0.0)
    # Every full matrix contains the plain delay, which explains most of its statistic if it is the cause.
    options = [o for o in options if not o.variant.setting.get("full") or delay <= RULES.most_of * o.statistic]
    behind = max(RULES.tie[0], RULES.tie[1] * options[0].evidence)
    tied = [o for o in options if (1 + TERMS[o.name].between) * o.evidence > options[0].evidence - behind]
    return tied[: RULES.tried]


def faint(score: Score, found: Sequence[Found]) -> bool:
    """Return whether an effect hardly passes beside coloured noise, where its threshold depends on a colour model."""
    coloured = any(f.name == "coloured-noise" for f in found)
    return coloured and (1 + TERMS[score.name].between) * score.statistic < RULES.beside_colour * score.threshold


def _remainder(now: Look, found: Sequence[Found]) -> float:
    """Return the nats that a change with time may leave if a channel is missing that it may have followed.

    Such a change has no form of the catalogue: a step in the place of a motor's current leaves a remainder, also a
    function of time.
    """
    twin = now.refit.twin
    if not any(set(untested(f.name, twin)) & set(f.rivals) for f in found):
        return 0.0
    in_time = (s.evidence for s in now.scores if s.significant and s.name.startswith(_IN_TIME))
    return max(in_time, default=0.0)


def any_change(sharp: Score, now: Look) -> bool:
    """Return whether a channel that an effect may have followed is missing, and other changes explain as much.

    An effect that follows an unrecorded depth or temperature may resemble a passed object where the channel is large,
    or a drift on level turns. For steps and drifts, changes in the sensor's axes do not count: they are such changes.
    """
    if not untested(sharp.name, now.refit.twin):
        return False
    own = _IN_TIME if sharp.name in ("hard-iron-step", "hard-iron-drift") else ()
    return any(
        s.generic
        and s.significant
        and s.name.startswith("time:")
        and not s.name.startswith(own)
        and s.evidence > sharp.evidence - RULES.ahead
        for s in now.scores
    )


def _of_misfit(noise: NoiseScore, now: Look) -> bool:
    """Return whether noise is part of the misfit: a slow tone beside a significant family, or colour of a bent term."""
    if noise.name == "coloured-noise":
        return noise.statistic < RULES.shape * max(weights(now.refit), default=0.0)
    if noise.name != "tone" or noise.setting["frequency"] > RULES.slow:
        return False
    return any(s.generic and s.significant for s in now.scores)


def shape_of(score: Score, current: Refit, found: Sequence[Found]) -> bool:
    """Return whether a score is only the deviation of an effect found earlier from its form."""
    at = score.variant.setting
    for term in current.model.terms:
        near = score.name == term.name == "local-anomaly"
        if near and abs(at["time"] - term.setting["time"]) < RULES.span * (at["width"] + term.setting["width"]):
            return True
    places = term_places(found, current.model)
    most = max([f.statistic for f in found if f.name in TERMS] + weights(current), default=0.0)
    if score.statistic < RULES.trace * most:
        return True
    for place, index in places.items():
        one, rough = found[place], TERMS[found[place].name].rough
        if not related(one.name, score.name) and one.name != score.name:
            continue
        if at.get("uneven") and not rough:
            continue  # a filter common to all axes leaves no different remainder on each
        if score.statistic < RULES.left * max(one.statistic, current.weight_of(index) if rough else 0.0):
            return True
    return False


def with_forms(found: tuple[Found, ...], now: Look) -> tuple[Found, ...]:
    """Add to the rivals of each effect the names that are only its deviation from its form."""
    result = list(found)
    for score in now.scores:
        if score.generic or not score.significant or now.gains.get(score.name, 0.0) <= 0:
            continue
        places = [i for i, f in enumerate(result) if f.name in TERMS and related(f.name, score.name)]
        if not places or any(f.name == score.name for f in result) or not shape_of(score, now.refit, found):
            continue
        place = max(places, key=lambda i: result[i].statistic)
        rivals = tuple(dict.fromkeys((*result[place].rivals, score.name)))
        result[place] = replace(result[place], rivals=rivals)
    return tuple(result)


def related(one: str, other: str) -> bool:
    """Return whether two named effects are confused with each other according to the catalogue."""
    return other in TERMS[one].rivals or one in TERMS[other].rivals


def rivals_of(choice: Score, now: Look) -> tuple[str, ...]:
    """Return the names that this motion cannot distinguish from the chosen one.

    These are effects beside which it adds nothing; effects with which it is known to be confused and that explain as
    much (nearly as much if one of them has many shapes); for a change with time, effects whose channel is missing; and
    for a drift, effects that are too slow for this recording.
    """
    result = []
    for rival in now.scores:
        if rival.generic or rival.name == choice.name:
            continue
        behind = choice.evidence - rival.evidence
        # An effect of many shapes, such as a drift or a step that ends, may have another one than those of the grid.
        shapes = any(TERMS[s.name].many_shapes or "until" in s.variant.setting for s in (choice, rival))
        close = behind < min(RULES.ahead + RULES.shape * choice.evidence, RULES.close_rival * choice.evidence)
        # A family that contains the chosen effect among much else is not a rival: its rank is higher than needed.
        alike = rival.significant and behind < RULES.ahead and not _adds_beyond(choice.variant, rival.variant, now)
        tied = rival.significant and behind < max(RULES.tie[0], RULES.tie[1] * choice.evidence)
        if alike or (related(choice.name, rival.name) and (tied or (shapes and close))):
            result.append(rival.name)
    return tuple(dict.fromkeys((*result, *untested(choice.name, now.refit.twin), *_too_slow(choice.name, now))))


def untested(name: str, twin: Twin) -> list[str]:
    """Return the effects whose missing channel might explain a change with time."""
    if name not in _OF_TIME:
        return []
    return [other for other, term in TERMS.items() if term.missing(twin) and "acceleration" not in term.channels]


def _too_slow(name: str, now: Look) -> list[str]:
    """Return the rivals of an effect of many shapes that are too slow to be distinguished in this recording."""
    if not TERMS[name].many_shapes:
        return []
    time = now.refit.twin.time
    open_ones = {score.name for score in now.scores} - {term.name for term in now.refit.model.terms}
    return [
        other
        for other in TERMS[name].rivals
        if other in open_ones and 2 * TERMS[other].slowest > float(time[-1] - time[0])
    ]


def _adds_beyond(one: Variant, other: Variant, now: Look) -> bool:
    """Return whether a candidate is still significant when another is in the model."""
    rest = now.innovation - other.unit.T @ other.score(now.innovation)
    columns = one.unit - (one.unit @ other.unit.T) @ other.unit
    value, vector = np.linalg.eigh(columns @ columns.T)
    good = value > RULES.shared
    d = (vector[:, good] / np.sqrt(value[good])).T @ (columns @ rest)
    return bool(chi2.sf(d @ d, max(len(d), 1)) < RULES.alike)


def weights(current: Refit) -> list[float]:
    """Return the Wald statistic of each non-linear term; the iron followed it, so that its first score was small."""
    terms = current.model.terms
    return [current.weight_of(terms.index(term)) for term in current.model.bends]
