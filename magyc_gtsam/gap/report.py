"""From a search to words: effects, hypotheses, the verdict and the next manoeuvre."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence

import numpy as np

from magyc_gtsam.estimators.smoother.axes import Arrangement
from magyc_gtsam.gap.clocks import APART, CLOCK_DRIFT
from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.evidence.tree import FIELD_VARIATION
from magyc_gtsam.gap.naming import Found, Look, term_places
from magyc_gtsam.gap.neighbours import label_of, product_of
from magyc_gtsam.gap.noise_effects import NoiseScore
from magyc_gtsam.gap.refit import Refit
from magyc_gtsam.gap.result import Effect, Hypothesis, Manoeuvre, Status, Verdict
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.score import Score
from magyc_gtsam.gap.step_time import step_time_sigma

FIELD_VARIES = "field of the place that varies"
_IN_TESLA = ("tone", "coloured-noise", "spikes", "quantisation", FIELD_VARIATION)
_TONE = ("cos x", "cos y", "cos z", "sin x", "sin y", "sin z")
_OPEN = "named, not corrected: this motion does not determine all of its values"
_UNSURE = "named, not corrected: an unrecorded channel may be the cause"
_IMPROBABLE = "named, not corrected: beside all else that may be there it is improbable"
_UNPAID = (
    "named, not corrected: in a varying field the correction does not improve the prediction of held-out data"
)
_VETOED = (
    "significant, but it does not improve the prediction of held-out data",
    "significant, but its channel, shifted in time, would explain as much",
)
_SPELLED = 3  # effects named one by one


def verdict(effects: Sequence[Effect], left: Sequence[str], last: Look, catalogue: str) -> tuple[Verdict, str]:
    """One word, and one sentence for a navigator.

    Args:
        effects: what was found.
        left: names of what is left over.
        last: the last look, in which that is.
        catalogue: what the names were chosen from, in words.
    """
    if not effects and not left:
        return "none", "the model and the data agree"
    if left:
        where = _place(left, last, catalogue)
        firm = [effect.sentence for effect in effects if effect.name in TERMS or effect.name == "axis-order"]
        if firm:
            return "open", f"{'; '.join(firm)}; beside that, {where}"
        return "unknown", f"{where}; nothing was changed"
    # What moves the heading comes before what concerns the noise.
    ordered = sorted(effects, key=lambda effect: effect.name not in TERMS and effect.name != "axis-order")
    word: Verdict = "closed" if all(effect.applied for effect in ordered) else "open"
    return word, "; ".join(effect.sentence for effect in ordered)


def unseen(hypotheses: Sequence[Hypothesis], untested: int) -> str:
    """What a verdict that nothing was found does not say: what is too small, and could not have been seen."""
    blind = [h.label for h in hypotheses if h.status == "not enough information" and h.name in TERMS]
    parts = [
        f"a possible “{h.label}” is too weak to be distinguished from other weak effects"
        for h in hypotheses
        if h.status == "slight"
    ]
    if blind:
        named = ", ".join(blind[:_SPELLED])
        more = f" and {len(blind) - _SPELLED} more" if len(blind) > _SPELLED else ""
        parts.append(f"this motion could not have shown every relevant value of {named}{more}")
    if untested:
        parts.append(f"{untested} effects could not be tested, because their channel is not in the log")
    return "; ".join(parts) or "every relevant value of the tested effects would have been detected"


def place_of(left: Sequence[str], last: Look) -> str:
    """Where the strongest of what is left lives, in words."""
    names = set(left)
    for score in last.scores:
        if score.name in names and score.generic:
            return f"an effect that varies with {score.place} is missing"
    label = next((LABELS.get(name) or label_of(name) for name in left if name in LABELS or product_of(name)), "")
    return f"an effect similar to “{label}” is missing" if label else "something is missing"


def _place(left: Sequence[str], last: Look, catalogue: str) -> str:
    """The same, with why it has no name."""
    if CLOCK_DRIFT in left:
        return APART
    where = place_of(left, last)
    return f"{where}, but of a different form" if "similar to" in where else f"{where}, and it is not {catalogue}"


def _setting(refitted: Refit, index: int) -> dict[str, float]:
    """What was searched over, with the deviation of a time."""
    term = refitted.model.terms[index]
    if term.name != "hard-iron-step":
        return dict(term.setting)
    return {**term.setting, "time_sigma": step_time_sigma(refitted, index)}


def _noise_sentence(noise: NoiseScore) -> str:
    value, setting = float(noise.value[0]), noise.setting
    if noise.name == "tone":
        size = float(np.linalg.norm(noise.value))
        return f"a tone of {setting['frequency']:.2f} Hz, {size * 1e6:.2g} µT, is on the magnetometer"
    if noise.name == "coloured-noise":
        return (
            f"the magnetometer's noise is correlated over {setting['correlation_time']:.2g} s "
            f"({value * 1e6:.2g} µT): there are fewer independent samples than rows"
        )
    if noise.name == "spikes":
        return f"{setting['count']:.0f} single magnetometer samples are wrong by {value * 1e6:.2g} µT and were left out"
    if noise.name == "quantisation":
        return f"the magnetometer's resolution is {value * 1e6:.2g} µT, {setting['ratio']:.1f} times its noise"
    if noise.name == FIELD_VARIATION:
        return (
            f"the field of the place varies by {value * 1e6:.2g} µT along the way and with attitude: sigmas allow "
            "for it, and no calibration takes it out"
        )
    if noise.name == "sample-hold":
        return f"the magnetometer repeats {setting['share']:.0%} of its rows; held rows were left out"
    arrangement = Arrangement(noise.value.reshape(3, 3), "", 1 - setting["explained"])
    return f"the sensors' axes differ: read the gyroscope as {arrangement.axes}"


def describe(
    found: Sequence[Found], refitted: Refit, uncorrected: Container[int], unpaid: Container[int] = ()
) -> tuple[Effect, ...]:
    """The effects as values; `uncorrected` are the places of what is named only, `unpaid` of what gains nothing."""
    indices = term_places(found, refitted.model)

    def why(place: int, one: Found) -> str:
        if place not in uncorrected:
            return ""
        if one.improbable:
            return _IMPROBABLE
        return _UNPAID if place in unpaid else _UNSURE if one.unsure else _OPEN

    return tuple(_described(f, refitted, indices.get(i), why(i, f)) for i, f in enumerate(found))


def _described(found: Found, refitted: Refit, index: int | None, why: str) -> Effect:
    """An effect; `index` is its place among the model's terms, None for what is no term; `why` it is not corrected."""
    if found.noise is not None:
        sentence = _noise_sentence(found.noise)
        value, sigma, setting = found.noise.value, found.noise.sigma, found.noise.setting
        unit, scale = ("µT", 1e6) if found.name in _IN_TESLA else ("", 1.0)
        parameters = _TONE if found.name == "tone" else ("",) * len(value)
    else:
        assert index is not None
        value, covariance = refitted.value_of(index)
        sigma, setting = np.sqrt(np.diag(covariance)), _setting(refitted, index)
        term = TERMS[found.name]
        rows = term.rows(refitted.twin, setting)
        unit, scale, parameters = term.unit, term.scale, term.names(len(value), rows)
        sentence = term.sentence(value * scale, sigma * scale, setting, rows)
    return Effect(
        found.name,
        LABELS.get(found.name, FIELD_VARIES),
        value * scale,
        sigma * scale,
        parameters,
        unit,
        dict(setting),
        found.rivals,
        found.statistic,
        found.threshold,
        not why,
        f"{sentence} ({why})" if why else sentence,
    )


def hypotheses(
    look: Look,
    names: Sequence[str],
    found: Sequence[Found],
    word: Verdict,
    discrete: Sequence[NoiseScore],
    left: Sequence[str] = (),
    slight: Sequence[str] = (),
) -> tuple[Hypothesis, ...]:
    """Every candidate with its evidence, strongest first.

    `discrete` are those that were settled before the look, `left` names that count in spite of a veto, `slight` what
    would explain the data, and is too small and too weak to be named.
    """
    named = {f.name for f in found} if word in ("closed", "open") else set()
    rivals = {r for f in found for r in f.rivals} if word in ("closed", "open") else set()
    result = [(s.evidence, _hypothesis(s, look, named, rivals, left, slight)) for s in look.scores]
    result += [(n.evidence, _noise_hypothesis(n, named)) for n in (*discrete, *look.noise) if n.name in names]
    return tuple(h for _, h in sorted(result, key=lambda pair: -pair[0]))


def _hypothesis(
    score: Score, look: Look, named: set[str], rivals: set[str], left: Sequence[str], slight: Sequence[str]
) -> Hypothesis:
    term = TERMS.get(score.name)
    power = score.power(look.refit.twin) if term else 1.0
    matters = score.smallest(look.refit.twin) if term else 0.0
    gain = look.gains.get(score.name, np.nan)
    scale = term.scale if term else 1.0
    status: Status
    if score.name in named:
        status, words = "named", "named"
    elif score.significant and not gain > 0 and score.name not in left:
        status, words = "vetoed", _VETOED[gain == 0]
    elif score.significant and score.name in slight:
        status, words = "slight", "significant, but so small that any other weak effect may pass for it"
    elif score.significant and score.name in rivals:
        status, words = "ambiguous", "this motion cannot tell it from the effect that was named"
    elif score.significant and (named or slight):
        status, words = "explained", "significant until other effects are in the model"
    elif score.significant:
        status, words = "significant", "significant"
    elif term and power < RULES.would_be_found:
        status, words = (
            "not enough information",
            f"the smallest effect that matters ({matters * scale:.2g} {term.unit}) would be found with "
            f"probability {power:.0%} only",
        )
    else:
        status, words = "rejected", "not significant, though what matters would have been found"
    sigma = np.sqrt(np.diag(score.covariance))
    return Hypothesis(
        name=score.name,
        label=term.label if term else f"anything in {score.place}",
        generic=score.generic,
        statistic=score.statistic,
        threshold=score.threshold,
        significant=score.significant,
        parameters=len(score.expected),
        expected=score.expected * scale,
        sigma=sigma * scale,
        unit=term.unit if term else "",
        setting=dict(score.variant.setting),
        power=power,
        matters=matters * scale,
        held_out_gain=gain,
        status=status,
        sentence=words,
    )


def _noise_hypothesis(noise: NoiseScore, named: set[str]) -> Hypothesis:
    scale = 1e6 if noise.name in _IN_TESLA else 1.0
    status: Status
    if noise.name in named:
        status, words = "named", "named"
    elif noise.significant:
        status, words = (
            ("explained", "significant until the effects above were added") if named else ("significant",) * 2
        )
    else:
        of_form = "not significant" if noise.statistic < noise.threshold else "strong, but not of its form"
        status, words = "rejected", of_form
    return Hypothesis(
        name=noise.name,
        label=LABELS[noise.name],
        generic=False,
        statistic=noise.statistic,
        threshold=noise.threshold,
        significant=noise.significant,
        parameters=len(noise.value),
        expected=noise.value * scale,
        sigma=noise.sigma * scale,
        unit="µT" if scale > 1 else "",
        setting=dict(noise.setting),
        power=1.0,
        matters=0.0,
        held_out_gain=np.nan,
        status=status,
        sentence=words,
    )


def manoeuvre(look: Look, found: Sequence[Found], word: Verdict, uncorrected: Iterable[int]) -> Manoeuvre | None:
    """The motion that determines what is named only, separates an effect from its rivals, or finds the unseen."""
    for place in uncorrected:
        one = found[place]
        motion = TERMS[one.name].motion
        if one.unsure:
            channels = dict.fromkeys(c for rival in one.rivals for c in TERMS[rival].missing(look.refit.twin))
            motion = f"log the {' and the '.join(channels)} as well"
        return Manoeuvre((one.name,), motion, f"to correct “{LABELS[one.name]}”: {motion}")
    for f in found:
        if f.rivals and f.name in TERMS and word in ("closed", "open"):
            names = (f.name, *f.rivals)
            needed = TERMS[f.rivals[0]].missing(look.refit.twin)
            motion = f"log the {needed[0]} as well" if needed else TERMS[f.name].motion
            labels = " from ".join(LABELS.get(n, FIELD_VARIES) for n in names[:2])
            return Manoeuvre(names, motion, f"to distinguish {labels}: {motion}")
    if word == "unknown":
        motion = (
            "repeat the recording with every channel logged (currents, temperature, depth), at the same motion"
        )
        return Manoeuvre((), motion, f"to identify the effect: {motion}")
    blind = [s for s in look.scores if s.name in TERMS and s.power(look.refit.twin) < RULES.would_be_found]
    if blind:
        weakest = min(blind, key=lambda s: s.power(look.refit.twin))
        motion = TERMS[weakest.name].motion
        return Manoeuvre(
            tuple(s.name for s in blind), motion, f"to test for “{TERMS[weakest.name].label}”: {motion}"
        )
    return None
