"""Samples next to a step of the hard iron, which are not wrong: the time of a step is resolved to a window.

Samples between the step and the edge of the window that represents it have an error of the whole step. To leave them
out does no harm, but they are no evidence of wrong samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.gap.evidence.answer import Answer
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.samples.fine import fine_innovations
from magyc_gtsam.gap.samples.wrong_samples import spikes
from magyc_gtsam.gap.search.found import less
from magyc_gtsam.gap.search.search import Search
from magyc_gtsam.recording import Recording

_WINDOW = 1.5  # s, on each side of a step: more than the longest window


def without_samples_of_steps(recording: Recording, result: Search, said: Answer) -> tuple[Search, Answer]:
    """Return a search and its posterior without spikes that are samples of a step."""
    model = result.last.refit.model
    if not _has_spikes(recording, result.recording, model):
        found = {place for place, one in enumerate(result.found) if one.name == "spikes"}
        result = replace(result, found=less(result.found, found))
    if not _has_spikes(recording, said.recording, model):
        posterior: dict[tuple[tuple[str, ...], bool], float] = {}
        for (names, unknown), probability in said.posterior.items():
            key = tuple(name for name in names if name != "spikes"), unknown
            posterior[key] = posterior.get(key, 0.0) + probability
        said = replace(said, posterior=posterior)
    return result, said


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
