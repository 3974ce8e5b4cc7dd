"""The gap of a recording: verdict, effects, calibration, and the remaining misfit."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap.effects import LABELS, MOMENTS, TERMS
from magyc_gtsam.gap.effects.world import ANOMALY
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.model.field_variation import field_variation
from magyc_gtsam.gap.model.refit import Refit, determined, refit, tempered, widened, without_term
from magyc_gtsam.gap.naming.named import Found, Named, as_found, term_places
from magyc_gtsam.gap.outcome.corrected import as_calibration, given_strength, unmoved
from magyc_gtsam.gap.outcome.described import describe
from magyc_gtsam.gap.outcome.doubt import DISTURBED, doubted, left_open, remedy, with_doubt
from magyc_gtsam.gap.outcome.hypotheses import hypotheses
from magyc_gtsam.gap.outcome.judged import judged
from magyc_gtsam.gap.outcome.metrics import measure
from magyc_gtsam.gap.outcome.moved import against, contradiction, moved
from magyc_gtsam.gap.outcome.unsure import doubt_whether, in_brief, which
from magyc_gtsam.gap.outcome.verdict import absent, among, manoeuvre, place_of, sentence_of, unseen, verdict
from magyc_gtsam.gap.outcome.worth import pays
from magyc_gtsam.gap.result import Doubt, Effect, Gap, Moved, Untested
from magyc_gtsam.gap.samples.fine import Fine, fine_innovations
from magyc_gtsam.gap.samples.noise_effects import NoiseScore


def nothing_tested(base: Refit, reason: str, doubt: Doubt, calibration: Calibration | None) -> Gap:
    """Return a gap with the verdict "not enough information".

    Args:
        base: the model without effects.
        reason: why nothing was tested, in full.
        doubt: the same in few words, with a remedy.
        calibration: the given calibration, if any.
    """
    strength = given_strength(calibration)
    fitted = as_calibration(replace(base, converged=False), strength)
    sentence = f"not enough information: {reason}; nothing was tested"
    fitted = doubted(replace(fitted, message=sentence), doubt)
    metrics = measure(base.twin, fitted)
    return Gap(
        verdict="not enough information",
        sentence=sentence,
        effects=(),
        untested=(),
        hypotheses=(),
        before=metrics,
        after=metrics,
        moved=(),
        calibration=fitted,
        base=fitted,
        next_manoeuvre=remedy(doubt, "to learn anything"),
        doubt=doubt,
        diagnostics={"windows": base.twin.n, "leftover": []},
    )


def gap_of(
    result: Named,
    short_term: SensorNoise,
    calibration: Calibration | None,
    names: tuple[str, ...],
    discrete: tuple[NoiseScore, ...],
) -> Gap:
    """Return the gap.

    Args:
        result: the effects that are named, and the model with them.
        short_term: noise of the sensors between neighbouring samples.
        calibration: the given calibration, if any.
        names: candidates.
        discrete: scores of effects that were corrected beforehand (held samples, exchanged axes).
    """
    strength = given_strength(calibration)
    first, plain = result.first, widened(result.fitted)
    base, last = widened(first.refit), widened(tempered(plain.twin.problem, result.fitted, short_term))
    found = (*(as_found(score) for score in discrete if score.significant), *result.found)
    known, added = _other_terms(calibration, found)
    places = term_places(found, plain.model)
    open_places = {place: index for place, index in places.items() if not determined(plain, index)}
    unpaid = _not_worthwhile(result, last, {p: i for p, i in places.items() if p not in open_places})
    open_places |= unpaid
    # Without its correction the covariance includes what it moves; not for what changes the instrument at some time.
    allowed = {place for place in unpaid if found[place].name not in MOMENTS or found[place].name == ANOMALY.name}
    word = verdict(found, result.leftover, open_places.keys() - allowed)
    turned = tuple(term for term in added if term.name == "axis-order")  # already corrected in the fitted data
    started = as_calibration(base, strength, (*known, *turned))
    plainly, untrusted = judged(started, base, first.recording, strength)
    before = after = measure(first.refit.twin, started, first.fine)
    used, effects, shifted = plainly, tuple[Effect, ...](), tuple[Moved, ...]()
    if word in ("closed", "open"):
        corrected, fine = _corrected(result, last, open_places.values(), short_term)
        final = unmoved(started, as_calibration(corrected, strength, (*known, *added)))
        if result.found and len(open_places) < len(found):
            after = measure(corrected.twin, final, fine, cleaned=result.recording)
            before = replace(before, open_loop=replace(before.open_loop, floor=after.open_loop.floor))
        used, untrusted = judged(final, corrected, result.recording, strength, last if allowed else None)
        effects = describe(found, last, corrected, used, result.probabilities, open_places, unpaid)
        shifted = moved(plainly, used)
    untested = _untested(names, base)
    tested = hypotheses(result, names, found, word, discrete)
    absence = absent(result.leftover, result.unsure, base.twin, among(names))
    sentence = sentence_of(word, effects, absence)
    if word == "none":
        given = [] if calibration is None else [term.name for term in calibration.terms]
        if calibration is not None and calibration.delay:
            given.append("timing")
        sentence = f"{sentence}; {unseen(tested, len(untested), given)}"
    contradicted = () if calibration is None else against(calibration, plainly)
    if contradicted and word == "none":
        word = "closed"  # by the refit: the given calibration was the model, and the data contradict it
    wanted = manoeuvre(tested, result.fitted.twin, found, result.leftover, open_places)
    if result.unsure and wanted is not None and not wanted.separates:
        wanted = which(result.unsure) or wanted
    gap = Gap(
        verdict=word,
        sentence=contradiction(contradicted) + sentence,
        effects=effects,
        untested=untested,
        hypotheses=tested,
        before=before,
        after=after,
        moved=contradicted
        + tuple(row for row in shifted if row.name not in {known.name for known in contradicted}),
        calibration=used,
        base=plainly,
        next_manoeuvre=wanted,
        diagnostics={"windows": first.refit.twin.n, "leftover": list(result.leftover)},
        probabilities=result.probabilities,
    )
    if word in ("none", "closed"):
        if untrusted is None:
            return gap
        return replace(gap, doubt=untrusted, next_manoeuvre=remedy(untrusted, "to trust the calibration"))
    if result.tree.best.disturbed:
        return with_doubt(replace(gap, next_manoeuvre=remedy(DISTURBED, "to name anything else")), DISTURBED)
    if result.unsure and not effects:
        return with_doubt(gap, doubt_whether(result.unsure))
    missing = place_of(result.leftover[0], base.twin) if result.leftover else ""
    missing = in_brief(result.unsure) if result.unsure else missing
    return with_doubt(gap, left_open(effects, list(open_places), missing, wanted))


def _not_worthwhile(result: Named, last: Refit, places: Mapping[int, int]) -> dict[int, int]:
    """Return the terms (place: index) whose correction is not worthwhile, if the field evidently varies."""
    if not places:
        return {}
    twin = result.fitted.twin
    variation = field_variation(twin)
    if not variation.evident:
        return {}
    weak = {}
    for place, index in places.items():
        without = widened(refit(twin.problem, without_term(last.model, index), None))
        if not pays(last, without, index, variation):
            weak[place] = index
    return weak


def _other_terms(
    calibration: Calibration | None, found: Sequence[Found]
) -> tuple[tuple[Term, ...], tuple[Term, ...]]:
    """Return the terms outside the fit: those of the given calibration that were not found again, and those found."""
    again = {f.name for f in found}
    known = tuple(
        t
        for t in (calibration.terms if calibration is not None else ())
        if t.name == "tone" or (t.side is None and t.name not in again)
    )
    added = tuple(
        Term(f.name, f.noise.value, np.diag(f.noise.sigma**2), f.noise.setting)
        for f in found
        if f.noise is not None and f.name != FIELD_VARIATION
    )
    return known, added


def _corrected(
    result: Named, last: Refit, open_places: Collection[int], short_term: SensorNoise
) -> tuple[Refit, Fine]:
    """Return the model without the terms that are not corrected, and its innovations sample by sample."""
    corrected, first, problem = last, result.first, result.fitted.twin.problem
    if 0 < len(open_places) == len(last.model.terms) and problem is first.refit.twin.problem:
        return widened(first.refit), first.fine  # no correction: the first model is unchanged
    if open_places:
        model = last.model
        for index in sorted(open_places, reverse=True):
            model = without_term(model, index)
        corrected = widened(refit(problem, model, short_term))
    return corrected, fine_innovations(result.recording, corrected.model)


def _untested(names: tuple[str, ...], base: Refit) -> tuple[Untested, ...]:
    """Return the effects whose channel the recording lacks."""
    return tuple(
        Untested(
            n,
            LABELS[n],
            f"no {' or '.join(TERMS[n].missing(base.twin))} in the recording, or not in half of it, or it is constant",
        )
        for n in names
        if n in TERMS and TERMS[n].missing(base.twin)
    )
