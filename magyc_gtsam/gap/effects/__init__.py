"""The catalogue: one file per family of effects, one `EffectTerm` per effect that adds to a reading.

Effects on the noise (`gap.samples.noise_effects`) or on the columns (`gap.preparation.discrete`) have no regressors and
are tested there. `NAMES` lists all effects in the catalogue's order.
"""

from __future__ import annotations

from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.factors.effects.dated import MOMENTS
from magyc_gtsam.gap.effects import alignment, gyroscope, iron, response, soft_iron, world
from magyc_gtsam.gap.effects.term import EffectTerm

TERMS: dict[str, EffectTerm] = {
    term.name: term
    for term in (
        iron.MOTOR_CURRENT,
        iron.SQUARED,
        iron.TEMPERATURE,
        iron.STEP,
        iron.DRIFT,
        soft_iron.TEMPERATURE_GAIN,
        soft_iron.GAIN_DRIFT,
        soft_iron.LOAD,
        soft_iron.STEP,
        alignment.MISALIGNMENT,
        alignment.TIMING,
        alignment.AXIS_DELAYS,
        alignment.CLOCK_DRIFT,
        alignment.EDDY_PLANE,
        gyroscope.SCALE,
        gyroscope.QUADRATIC,
        gyroscope.TEMPERATURE,
        gyroscope.BIAS_STEP,
        gyroscope.BIAS_DRIFT,
        gyroscope.G_SENSITIVITY,
        world.GRADIENT,
        world.ANOMALY,
        response.SATURATION,
        response.CUBIC,
        response.HYSTERESIS,
    )
}

LABELS: dict[str, str] = {name: term.label for name, term in TERMS.items()} | {
    "coloured-noise": "time-correlated magnetometer noise",
    "spikes": "single wrong samples",
    "tone": "steady tone (mains or switching supply)",
    "quantisation": "steps of the magnetometer",
    "sample-hold": "repeated magnetometer values",
    "axis-order": "axes of the two sensors exchanged or turned round",
}

NAMES: tuple[str, ...] = tuple(LABELS)
# What causes each effect, how it acts on the readings, and what resembles it.
PHYSICS: dict[str, str] = {name: term.physics for name, term in TERMS.items()} | {
    "coloured-noise": "A magnetometer's noise, or that of a supply near it, grows at low frequencies. Neighbouring "
    "readings then share most of their error, so that averaging helps less. Slow drifts and a field that varies along "
    "the way resemble it.",
    "spikes": "Bus errors, relays and passing currents make single readings wrong. A few such readings would move a "
    "least-squares fit. Many of them are another distribution of the noise.",
    "tone": "Mains and switching supplies add a field that alternates. Sampled more slowly than it alternates, it "
    "appears at another frequency. A line at the frequency of the motion is due to the motion.",
    "quantisation": "A magnetometer of few bits, or a log of few digits, has coarse steps. The rounding error repeats "
    "where the field changes slowly, and averaging does not remove it. Finer noise than the steps cannot be seen. "
    "Digits that are cut off instead of rounded move every reading by half a step towards zero, whatever the noise.",
    "sample-hold": "A magnetometer that is slower than the log repeats its last value until the next one. The readings "
    "are old by a varying time, on average by half of its period. A delay resembles it where the period is short.",
    "axis-order": "Drivers and mountings exchange the axes of a sensor or turn them round. The two sensors then state "
    "turns that do not belong together. No small error of alignment resembles it.",
}


def sudden(name: str, setting: Setting) -> bool:
    """Return whether an effect changes at once, so that its time is determined to a fraction of a window."""
    return name in MOMENTS and "width" not in setting


def nested(one: str, other: str) -> bool:
    """Return whether one of two effects of the catalogue is the general case of the other."""
    return one in TERMS and other in TERMS and (one in TERMS[other].contains or other in TERMS[one].contains)


__all__ = ["LABELS", "MOMENTS", "NAMES", "PHYSICS", "TERMS", "EffectTerm", "nested", "sudden"]
