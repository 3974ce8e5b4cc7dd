"""The effects that are named, as values and sigmas in their units, with a sentence."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.axes import axes_words
from magyc_gtsam.estimators.smoother.reasons import MOST_UNEXPLAINED
from magyc_gtsam.gap.effects import LABELS, TERMS
from magyc_gtsam.gap.evidence.node import FIELD_VARIATION
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.naming.named import Found, term_places
from magyc_gtsam.gap.outcome.doubt import DISTURBED
from magyc_gtsam.gap.outcome.step_time import step_time_sigmas
from magyc_gtsam.gap.result import Effect
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.recording.axes import OWN_AXES

FIELD_VARIES = "field of the place that varies"
_TONE = ("cos x", "cos y", "cos z", "sin x", "sin y", "sin z")
_OPEN = "named, not corrected: this motion does not determine all of its values"
# Coloured noise passes for a varying field in the model that is corrected, whose noise is white.
_UNPAID = (
    "named, not corrected: in a varying field or correlated noise the correction does not improve the prediction of "
    "held-out data"
)


def sentences(effects: Sequence[Effect]) -> list[str]:
    """Return a sentence for each effect, of several tones one in the place of the first."""
    tones = [effect for effect in effects if effect.name == "tone"]
    if len(tones) < 2:
        return [effect.sentence for effect in effects]
    frequencies = enumerated([f"{effect.setting['frequency']:.2f}" for effect in tones])
    sizes = enumerated([f"{float(np.linalg.norm(effect.value)):.2g}" for effect in tones])
    together = f"tones of {frequencies} Hz, {sizes} {tones[0].unit}, are on the magnetometer"
    return [
        together if effect is tones[0] else effect.sentence
        for effect in effects
        if effect.name != "tone" or effect is tones[0]
    ]


def enumerated(values: Sequence[str]) -> str:
    """Return two values or more in words."""
    return f"{', '.join(values[:-1])} and {values[-1]}"


def _noise_sentence(noise: NoiseScore, gyroscope_axes: str) -> str:
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
        resolution = (
            f"the magnetometer's resolution is {value * 1e6:.2g} µT, {setting['ratio']:.1f} times its noise"
        )
        if "truncated" not in setting:
            return resolution
        return (
            f"{resolution}, and its readings are truncated towards zero instead of rounded: before they are "
            "calibrated, half a step is to be added to positive and subtracted from negative ones"
        )
    if noise.name == FIELD_VARIATION:
        varies = f"the field of the place varies by {value * 1e6:.2g} µT along the way and with attitude"
        if setting["share"] > MOST_UNEXPLAINED:
            most = f"more than {MOST_UNEXPLAINED:.0%} of its strength"
            return f"{varies}, {most}: smaller effects cannot be told; {DISTURBED.action}"
        return f"{varies}: sigmas allow for it, and no calibration takes it out"
    if noise.name == "sample-hold":
        return f"the magnetometer repeats {setting['share']:.0%} of its rows; held rows were left out"
    without = ", without gyroscope_axes=" if gyroscope_axes == OWN_AXES else ""
    return f"the sensors' axes differ: read the gyroscope as {axes_words(gyroscope_axes)}{without}"


def describe(
    found: Sequence[Found],
    refitted: Refit,
    corrected: Refit,
    calibration: Calibration,
    probabilities: Mapping[str, float],
    uncorrected: Container[int],
    unpaid: Container[int],
) -> tuple[Effect, ...]:
    """Return the effects as values.

    Args:
        found: the effects.
        refitted: the model that contains them.
        corrected: the model with those that are corrected.
        calibration: of `corrected`, with the model error in the covariance of its terms.
        probabilities: of all names.
        uncorrected: places in `found` of effects that are named only.
        unpaid: places of those among them whose correction gains nothing.
    """
    indices, times = term_places(found, refitted.model), step_time_sigmas(refitted)
    applied, count = [place for place in indices if place not in uncorrected], len(corrected.model.terms)
    terms = dict(zip(applied, calibration.terms[count - len(applied) : count], strict=True))
    effects = []
    for place, one in enumerate(found):
        if one.noise is None:
            index, term = indices[place], TERMS[one.name]
            value, covariance = refitted.value_of(index)
            sigma = terms[place].sigma if place in terms else np.sqrt(np.diag(covariance))
            setting = dict(refitted.model.terms[index].setting)
            if index in times:
                setting["time_sigma"] = times[index]
            rows = term.rows(refitted.twin, setting)
            unit, scale, parameters = term.unit, term.scale, term.names(len(value), rows)
            sentence = term.sentence(value * scale, sigma * scale, setting, rows)
        else:
            value, sigma, setting = one.noise.value, one.noise.sigma, dict(one.noise.setting)
            unit, scale = one.noise.shown
            parameters = _TONE if one.name == "tone" else ("",) * len(value)
            sentence = _noise_sentence(one.noise, refitted.twin.problem.recording.gyroscope_axes)
        if place in uncorrected:
            sentence = f"{sentence} ({_UNPAID if place in unpaid else _OPEN})"
        effects.append(
            Effect(
                one.name,
                LABELS.get(one.name, FIELD_VARIES),
                value * scale,
                sigma * scale,
                parameters,
                unit,
                setting,
                one.rivals,
                one.statistic,
                place not in uncorrected,
                sentence,
                probabilities.get(one.name, 0.0),
            )
        )
    return tuple(effects)
