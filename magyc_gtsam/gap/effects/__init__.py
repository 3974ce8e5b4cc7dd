"""The catalogue: one file per family of effects, one `EffectTerm` per effect that adds to a reading.

Effects on the noise (`gap.samples.noise_effects`) or on the columns (`gap.preparation.discrete`) have no regressors and
are tested there. `NAMES` lists all effects in the catalogue's order.
"""

from __future__ import annotations

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
        soft_iron.LOAD,
        soft_iron.STEP,
        alignment.MISALIGNMENT,
        alignment.TIMING,
        alignment.AXIS_DELAYS,
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
    "quantisation": "coarse steps of the magnetometer",
    "sample-hold": "repeated magnetometer values",
    "axis-order": "axes of the two sensors exchanged or turned round",
}

NAMES: tuple[str, ...] = tuple(LABELS)
# Functions of time alone, at times of one log.
MOMENTS = (
    "hard-iron-step",
    "soft-iron-step",
    "gyro-bias-step",
    "gyro-bias-drift",
    "hard-iron-drift",
    "local-anomaly",
)

__all__ = ["LABELS", "MOMENTS", "NAMES", "TERMS", "EffectTerm"]
