"""Samples near a sudden change, which are no evidence of wrong samples.

The time of a change is determined to a fraction of a window; the samples between it and the true one have an error of
the whole change. To leave them out does no harm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.naming.named import Named
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import fine_innovations
from magyc_gtsam.gap.samples.wrong_samples import spikes
from magyc_gtsam.recording import Recording

_EDGED = ("hard-iron-step", "local-anomaly")  # which begin and end between two samples, unless they have a width
_BESIDE = 1.5 * RULES.window  # s, on each side of a step: more than the longest window


def without_samples_of_steps(recording: Recording, result: Named) -> Named:
    """Return the named effects without spikes that are samples of a step; `recording`: with all its samples."""
    if _has_spikes(recording, result.recording, result.fitted.model):
        return result
    found = tuple(one for one in result.found if one.name != "spikes")
    probabilities = {name: each for name, each in result.probabilities.items() if name != "spikes"}
    return replace(result, found=found, probabilities=probabilities)


def _has_spikes(before: Recording, after: Recording, model: Model) -> bool:
    """Return whether wrong samples are significant away from steps; True if none next to a step was left out."""
    away = away_from_steps(before, model)
    left_out = before.magnetic_field_fresh & ~after.magnetic_field_fresh
    if not (left_out & ~away.magnetic_field_fresh).any():
        return True
    fine = fine_innovations(away, model)
    return spikes(fine.innovation, fine.level, 0.0).significant


def away_from_steps(recording: Recording, model: Model) -> Recording:
    """Return a recording without the samples of the field next to the sudden changes of a model."""
    terms = [term for term in model.terms if term.name in _EDGED and "width" not in term.setting]
    times = np.array([term.setting[end] for term in terms for end in ("time", "until") if end in term.setting])
    near = (np.abs(recording.time[:, None] - times) < _BESIDE).any(axis=1)
    return replace(recording, magnetic_field_fresh=recording.magnetic_field_fresh & ~near)
