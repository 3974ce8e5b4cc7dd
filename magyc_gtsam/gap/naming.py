"""What is named next, what it cannot be told from, and what speaks against the names given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.fine import Fine
from magyc_gtsam.gap.noise_effects import NoiseScore
from magyc_gtsam.gap.problem import Model
from magyc_gtsam.gap.refit import Refit, without_term
from magyc_gtsam.gap.score import Projector, Score, Variant, variant
from magyc_gtsam.gap.twin import Twin

_ALIKE = 0.01  # probability below which a named effect adds something beyond its rival
_REMAINDER = np.log(20 / 0.05)  # −ln p from which a generic remainder speaks against the names given
_SHAPE = 0.08  # share of what was explained that may remain, for effects are not quite of the catalogue's form
_TRACE = 0.03  # share of an effect's statistic below which another may be its form, whatever the name
_MOST_OF = 0.7  # share of a wider family's statistic from which the simple delay is preferred
_FIRM = 0.7  # share of what a term should explain beside whatever else is missing
_MOSTLY = 0.8  # share that a term must explain of what families that hold its signature could explain
_LITTLE = 0.3  # share of a term's signature that a family which holds it may lack
_STRONG = 5.0  # thresholds that a term must pass where something else is missing too
_AHEAD = 9.0  # nats of evidence from which a rival is behind
_BEATS = (3.0, 0.05)  # nats, and share, by which a generic family must be ahead of all names: form is less
_SPAN = 2.5  # widths within which a second bump belongs to the first
LEFT = 0.2  # share of an effect's statistic that it or a rival may pick up after it
_MANY = 9  # values of one family, from which half of the data do not determine them for the other half
_SLOW = 1.0  # Hz, up to which windows of a second still show something
TIE = (3.0, 0.05)  # nats, and share of the evidence, by which one that is as good as the strongest may be behind
_TRIED = 3  # names in a tie, at most
_SHARED = 1e-4  # share of a signature that must be left beside a rival's to be tested
_CHANGING = ("hard-iron-step", "local-anomaly", "hard-iron-drift", "temperature-hard-iron")
_CHANGES = 2  # with time, that one recording may hold
NOISE_LIMIT = float(np.log(22 / 0.01))


@dataclass(frozen=True, eq=False)
class Found:
    """An effect that was added: its evidence when it was, and its rivals."""

    name: str
    statistic: float
    threshold: float
    evidence: float
    rivals: tuple[str, ...] = ()
    noise: NoiseScore | None = None


def as_found(score: NoiseScore) -> Found:
    """A noise effect that was found."""
    return Found(score.name, score.statistic, score.threshold, score.evidence, noise=score)


def term_places(found: Sequence[Found], model: Model) -> dict[int, int]:
    """{place in `found`: place among the model's terms}, in order; a model given has its own terms before them."""
    of_terms = [place for place, f in enumerate(found) if f.name in TERMS]
    given = len(model.terms) - len(of_terms)
    return {place: given + index for index, place in enumerate(of_terms)}


@dataclass(frozen=True, eq=False)
class Look:
    """One look at a model: all scores, strongest first, with the held-out gains of those that matter.

    A gain of 0 is that of a channel which explains no more than it would at other times.
    """

    refit: Refit
    scores: list[Score]
    noise: list[NoiseScore]
    fine: Fine
    innovation: Array
    projector: Projector
    gains: dict[str, float]


def loudest(now: Look, names: tuple[str, ...], noted: set[str]) -> NoiseScore | None:
    """The strongest significant effect on the noise, of the names that may be given and were not noted before."""
    options = [
        n
        for n in now.noise
        if n.significant and n.name in names and n.name not in noted and not _of_the_model(n, now)
    ]
    return max(options, key=lambda n: n.evidence, default=None)


def choices(now: Look, found: Sequence[Found], failed: set[str]) -> list[Score]:
    """The strongest significant name that held-out data confirm, and those that are as good as it."""
    terms = now.refit.model.terms
    options = []
    for score in now.scores:
        if score.generic or not score.significant or now.gains.get(score.name, 0.0) <= 0:
            continue
        held = sum(term.name == score.name for term in terms)
        if held < TERMS[score.name].most and score.name not in failed and not _shape_of(score, now.refit, found):
            options.append(score)
    options.sort(key=lambda score: -score.evidence)
    if not options:
        return []
    delay = next((o.statistic for o in options if o.name == "timing"), 0.0)
    # Any matrix holds the plain delay, which explains most of it where it is the truth.
    options = [o for o in options if not o.variant.setting.get("full") or delay <= _MOST_OF * o.statistic]
    behind = max(TIE[0], TIE[1] * options[0].evidence)
    return [o for o in options if o.evidence > options[0].evidence - behind][:_TRIED]


def _of_the_model(noise: NoiseScore, now: Look) -> bool:
    """Whether noise is the model's own: a slow tone of which a family holds some, colour of a bent reading."""
    if noise.name == "coloured-noise":
        return noise.statistic < _SHAPE * max(_weights(now.refit), default=0.0)
    if noise.name != "tone" or noise.setting["frequency"] > _SLOW:
        return False
    return any(s.generic and s.significant for s in now.scores)


def _shape_of(score: Score, current: Refit, found: Sequence[Found]) -> bool:
    """Whether a score is no more than what an effect found earlier leaves for not being quite of its form."""
    at = score.variant.setting
    for term in current.model.terms:
        near = score.name == term.name == "local-anomaly"
        if near and abs(at["time"] - term.setting["time"]) < _SPAN * (at["width"] + term.setting["width"]):
            return True
    explained = [f.statistic for f in found if f.name in TERMS] + _weights(current)
    if score.statistic < _TRACE * max(explained, default=0.0):
        return True
    if score.name == "hard-iron-step" and any(
        f.name == "hard-iron-drift" and score.statistic < f.statistic for f in found
    ):
        return True  # a slow change that is steeper here than there, not something that jumped
    if at.get("uneven"):
        return False  # no filter of all axes alike leaves something else on each
    return any(
        f.name in TERMS
        and (related(f.name, score.name) or f.name == score.name)
        and score.statistic < LEFT * f.statistic
        for f in found
    )


def related(one: str, other: str) -> bool:
    """Whether the catalogue says that one named effect is confused with another."""
    return other in TERMS[one].rivals or one in TERMS[other].rivals


def rivals_of(choice: Score, now: Look) -> tuple[str, ...]:
    """Names that this motion cannot tell from the chosen one.

    Those beside which it adds nothing, those it is known to be confused with that explain as much (nearly as much,
    where one has many shapes), and for what changes with time those whose channel is missing.
    """
    result = []
    for rival in now.scores:
        if rival.generic or rival.name == choice.name:
            continue
        behind = choice.evidence - rival.evidence
        # What has many shapes, as a drift or what comes and goes, may have had another than those tried.
        shapes = any(TERMS[s.name].many_shapes or "until" in s.variant.setting for s in (choice, rival))
        close = behind < min(_AHEAD + _SHAPE * choice.evidence, 0.5 * choice.evidence)
        # A family that holds the chosen one among much else is no rival: it pays for what it does not need.
        alike = rival.significant and behind < _AHEAD and not _adds_beyond(choice.variant, rival.variant, now)
        tied = rival.significant and behind < max(TIE[0], TIE[1] * choice.evidence)
        if alike or (related(choice.name, rival.name) and (tied or (shapes and close))):
            result.append(rival.name)
    return (*result, *_untested(choice.name, now.refit.twin))


def _untested(name: str, twin: Twin) -> list[str]:
    """What else might have changed something with time, were its channel there to tell."""
    if name not in ("hard-iron-step", "hard-iron-drift", "local-anomaly"):
        return []
    return [other for other, term in TERMS.items() if term.missing(twin) and "acceleration" not in term.channels]


def _adds_beyond(one: Variant, other: Variant, now: Look) -> bool:
    """Whether a candidate still gains when another is in the model."""
    rest = now.innovation - other.unit.T @ other.score(now.innovation)
    columns = one.unit - (one.unit @ other.unit.T) @ other.unit
    value, vector = np.linalg.eigh(columns @ columns.T)
    good = value > _SHARED
    d = (vector[:, good] / np.sqrt(value[good])).T @ (columns @ rest)
    return bool(chi2.sf(d @ d, max(len(d), 1)) < _ALIKE)


def stands(current: Refit, index: int, found: Found, now: Look, left: tuple[str, ...]) -> bool:
    """Whether a term keeps its evidence when the families that are still significant are in the model too.

    A term that is right keeps the share of its statistic that the families do not hold of its signature. Of those that
    hold most of it, it must explain the most itself: what may lie along any of so many values would hardly lie along
    the few of the term by chance.
    """
    twin = current.twin
    term = twin.model.terms[index]
    columns = twin.columns(term.name, term.setting)
    own = twin.whiten(columns)
    pull = np.zeros(len(own)) if columns.pull is None else columns.pull
    value, _ = current.value_of(index)
    without = replace(twin, model=without_term(twin.model, index))
    target = twin.residual().ravel() - value @ own  # as if the term were not there

    def explained(rows: Array, pulls: Array, beside: list[tuple[Array, Array]]) -> tuple[float, Array]:
        """The statistic of columns beside others, and their directions."""
        project = Projector(np.concatenate([b for b, _ in beside]), np.concatenate([p for _, p in beside]))
        result = variant(term.setting, rows, project, pulls)
        return _squared(result.score(project(target[None])[0])), result.unit

    beside = [(without.base_columns, without.base_pull)]
    all_of_it, alone = explained(own, pull, beside)
    holding: list[tuple[Array, Array]] = []
    for other in (s.variant for s in now.scores if s.name in left and s.name != term.name):
        _, unit = explained(other.columns, other.pull, beside[:1])
        holds = _squared(alone @ unit.T) > (1 - _LITTLE) * len(alone)
        (holding if holds else beside).append((other.columns, other.pull))
    statistic, rest = explained(own, pull, beside)
    kept = _squared(alone @ rest.T) / len(alone)
    if statistic <= max(_STRONG * found.threshold, _FIRM * kept * all_of_it):
        return False
    if not holding:
        return True
    rows, pulls = (np.concatenate(part) for part in zip(*holding, strict=True))
    more, unit = explained(rows, pulls, [*beside, (own, pull)])
    return statistic > _MOSTLY * (statistic + more - len(unit))


def _squared(values: Array) -> float:
    return float(np.vdot(values, values))


def switched(found: Sequence[Found]) -> tuple[str, ...]:
    """What changes with time, where that is so much that something else must switch or move it all."""
    changing = [f.name for f in found if f.name in _CHANGING]
    return tuple(dict.fromkeys(changing)) if len(changing) > _CHANGES else ()


def leftover(now: Look, first: Look, found: Sequence[Found], noted: set[str]) -> tuple[str, ...]:
    """What is still significant, less what the effects found may leave for not being quite of their form.

    To this belong generic families that explained the data clearly better than all names together.
    """
    explained = max([s.statistic for s in first.scores] + _weights(now.refit), default=0.0)
    named = any(f.name in TERMS for f in found)
    all_named = max(sum(f.statistic for f in found if f.name in TERMS), *_weights(now.refit), 0.0)
    if not named or any(f.name == "coloured-noise" for f in found):
        all_named = np.inf  # nothing to compare with, or statistics that are those of the colour
    result = ahead_of_names(first, found)
    for score in now.scores:
        limit = min(_REMAINDER, score.limit) if named and score.generic else score.limit
        excess = score.statistic - len(score.variant.unit)
        # A family of many values hardly gains on held-out data; where it is more than all that was named, it counts.
        many = score.generic and len(score.variant.unit) > _MANY
        more = many and score.significant and excess > all_named
        if score.significance <= limit or (now.gains.get(score.name, 0.0) <= 0 and not more):
            continue
        if found and excess < _SHAPE * explained:
            continue
        if not score.generic and _shape_of(score, now.refit, found):
            continue
        result.append(score.name)
    for noise in now.noise:
        loud = noise.evidence > NOISE_LIMIT and noise.name in ("tone", "coloured-noise")
        if loud and noise.name not in noted and not (found and noise.statistic < _SHAPE * explained):
            result.append(noise.name)
    return tuple(dict.fromkeys(result))


def _weights(current: Refit) -> list[float]:
    """What each term explains that bends the reading: the iron had followed it, so that a first look saw little."""
    terms = current.model.terms
    parts = [current.value_of(terms.index(term)) for term in current.model.bends]
    return [float(value @ np.linalg.pinv(covariance) @ value) for value, covariance in parts]


def ahead_of_names(first: Look, found: Sequence[Found]) -> list[str]:
    """The generic families that explained the data clearly better than all names together."""
    named = sum(f.evidence for f in found if f.name in TERMS)
    if not named:
        return []
    ahead = named + max(_BEATS[0], _BEATS[1] * named)
    return [
        s.name
        for s in first.scores
        if s.generic and s.significant and s.evidence > ahead and first.gains.get(s.name, 0.0) > 0
    ]
