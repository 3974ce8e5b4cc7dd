"""Refinement of the grid search: the setting that explains most, and neighbours that explain as much there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.model.variants import Projector, Variant, variant, variants
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.scores.neighbours import neighbours
from magyc_gtsam.gap.scores.null import surprises
from magyc_gtsam.gap.scores.score import Score
from magyc_gtsam.gap.search.naming import Look

_FEW = 20  # settings up to which a neighbour is tested at all of them


def nearer(sharp: Score, now: Look) -> tuple[str, ...]:
    """Return the parts of generic families and the neighbours that explain the data as well as an effect.

    If neither is clearly better, another effect may hide the difference. Each is then compared together with the other
    effect with which it explains most.
    """
    name, best = sharp.name, sharp.variant
    twin, term = now.refit.twin, TERMS[name]
    grid = term.settings(twin)
    settings = [dict(best.setting), *(grid if len(grid) <= _FEW else []), *term.refined(twin, best.setting)[:_FEW]]
    closest: dict[str, Variant] = {}
    for setting in settings:
        if len(twin.columns(name, setting).window) != len(best.columns):
            continue  # a different form of the same effect
        for family in neighbours(twin, name, setting):
            columns = family.columns(twin)
            if len(columns.window) != len(best.columns):
                continue  # its rank is higher, so that it could contain any other missing effect
            tried = variant(setting, twin.whiten(columns), now.projector, columns.score_bias)
            known = closest.setdefault(family.name, tried)
            if surprise(tried, now.innovation) > surprise(known, now.innovation):
                closest[family.name] = tried
    own = surprise(best, now.innovation)
    parts = tuple(
        s.name
        for s in now.scores
        if s.name in term.alike
        and "width" in s.variant.setting
        and s.evidence > sharp.evidence - RULES.clearly
        and now.gains.get(s.name, 0.0) > 0
    )
    if parts:
        return parts
    ahead = RULES.clearly - term.loose * own
    even = {
        n: tried
        for n, tried in closest.items()
        if surprise(tried, now.innovation) > own - ahead and not _same(best, tried, now.innovation)
    }
    if not even:
        return ()
    paired = _paired(name, best, now)
    return tuple(n for n, tried in even.items() if _paired(name, tried, now) > paired - ahead)


def _same(one: Variant, other: Variant, innovation: Array) -> bool:
    """Return whether two variants explain the same part of the data in this recording."""
    first, second = (v.unit.T @ v.score(innovation) for v in (one, other))
    return float(first @ second) ** 2 > RULES.same * float(first @ first) * float(second @ second)


def _paired(name: str, tried: Variant, now: Look) -> float:
    """Return the largest nats of a variant together with another significant effect that is not its rival."""
    twin = now.refit.twin
    base, score_bias, residual = twin.base_columns, twin.base_score_bias, twin.residual().ravel()
    most = surprise(tried, now.innovation)
    for other in now.scores:
        if other.generic or other.name in (name, *TERMS[name].rivals) or not other.significant:
            continue
        if now.gains.get(other.name, 0.0) > 0:
            project = Projector(
                np.concatenate([base, other.variant.columns]),
                np.concatenate([score_bias, other.variant.score_bias]),
            )
            beside = variant(tried.setting, tried.columns, project, tried.score_bias)
            together = surprise(other.variant, now.innovation) + surprise(beside, project(residual[None])[0])
            most = max(most, together)
    return most


def surprise(tried: Variant, innovation: Array) -> float:
    d = tried.score(innovation)
    return float(surprises(np.array([[d @ d]]), np.array([len(d)]))[0, 0])


def _sharpest(choice: Score, refitted: Refit, innovation: Array, projector: Projector) -> Variant:
    """Return the setting near the best grid point that explains most."""
    best = choice.variant
    for _ in range(2):
        near = TERMS[choice.name].refined(refitted.twin, best.setting)
        if not near:
            break
        many = variants(refitted.twin, projector, choice.name, near)
        best = many[int(np.argmax([surprise(v, innovation) for v in many]))]
    return best


def sharpened(score: Score, refitted: Refit, innovation: Array, projector: Projector) -> Score:
    """Return a score at the best setting near its grid point."""
    if not score.statistic:
        return score  # the motion does not determine it
    best = _sharpest(score, refitted, innovation, projector)
    d = best.score(innovation)
    gain = float(d @ d) / score.statistic
    more = surprise(best, innovation) - surprise(score.variant, innovation)
    return replace(
        score,
        variants=(*score.variants, best),
        best=len(score.variants),
        statistic=float(d @ d),
        evidence=score.evidence + more,
        significance=score.significance * gain,
        expected=-best.back @ d,
        covariance=best.back @ best.back.T,
    )
