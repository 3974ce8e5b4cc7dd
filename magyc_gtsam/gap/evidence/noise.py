"""Effects on single samples beside a model: their log odds, and the readings without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import Fine, fine_innovations, single_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.samples.tones import heard, silenced
from magyc_gtsam.recording import Recording


def log_odds(score: NoiseScore) -> float:
    """Return the log odds of an effect on single samples, from its gain in likelihood beyond chance."""
    # Bound for the p-value of the largest of many lines: −ln(e p ln(1/p)) (Sellke, Bayarri and Berger 2001).
    of_search = 1 + np.log(max(score.evidence, 1.0)) + RULES.unsure_line if score.name == "tone" else 0.0
    gain = score.evidence - of_search
    return float(min(gain + PRIOR.named, 2 * PRIOR.certain)) if score.significant else -PRIOR.certain


def singles_of(recording: Recording, model: Model) -> tuple[Fine, dict[str, NoiseScore]]:
    """Return the tests of the effects on single samples beside a model."""
    fine = fine_innovations(recording, model)
    return fine, {score.name: score for score in single_scores(recording, fine, 0.0)}


def without(recording: Recording, model: Model, fine: Fine, score: NoiseScore) -> tuple[Recording, NoiseScore]:
    """Return the recording without an effect on single samples, and the effect with the value taken out."""
    if score.name == "tone":
        line = heard(recording, model, score.setting["frequency"])
        return silenced(recording, [line]), replace(
            score, value=line.value, sigma=line.sigma, setting=line.setting
        )
    assert score.rows is not None
    wrong = np.isin(recording.time, fine.time[score.rows])
    return replace(recording, magnetic_field_fresh=recording.magnetic_field_fresh & ~wrong), score
