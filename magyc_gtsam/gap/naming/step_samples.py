"""Samples next to a step of the hard iron, which are not wrong: the time of a step is resolved to a window.

Samples between the step and the edge of the window that represents it have an error of the whole step. To leave them
out does no harm, but they are no evidence of wrong samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.naming.found import less
from magyc_gtsam.gap.naming.named import Named
from magyc_gtsam.gap.samples.fine import fine_innovations
from magyc_gtsam.gap.samples.wrong_samples import spikes
from magyc_gtsam.recording import Recording

_WINDOW = 1.5  # s, on each side of a step: more than the longest window


def without_samples_of_steps(recording: Recording, result: Named) -> Named:
    """Return the named effects without spikes that are samples of a step; `recording`: with all its samples."""
    if _has_spikes(recording, result.recording, result.fitted.model):
        return result
    spiky = {place for place, one in enumerate(result.found) if one.name == "spikes"}
    probabilities = {name: each for name, each in result.probabilities.items() if name != "spikes"}
    return replace(result, found=less(result.found, spiky), probabilities=probabilities)


def _has_spikes(before: Recording, after: Recording, model: Model) -> bool:
    """Return whether wrong samples are significant away from steps; True if none next to a step was left out."""
    terms = [term for term in model.terms if term.name == "hard-iron-step"]
    times = np.array([term.setting[end] for term in terms for end in ("time", "until") if end in term.setting])
    left_out = before.magnetic_field_fresh & ~after.magnetic_field_fresh
    near = (np.abs(before.time[:, None] - times) < _WINDOW).any(axis=1)
    if not (left_out & near).any():
        return True
    fine = fine_innovations(replace(before, magnetic_field_fresh=before.magnetic_field_fresh & ~near), model)
    return spikes(fine.innovation, fine.level, 0.0).significant
