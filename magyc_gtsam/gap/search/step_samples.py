"""Samples next to a step of the hard iron, which are not wrong: a step is known to a window, not to a sample.

Those between the step and the window's edge that stands for it are off by all of it. Left out they do no harm, but they
are no evidence of wrong samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.evidence.answer import Answer
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.search.naming import less
from magyc_gtsam.gap.search.search import Search
from magyc_gtsam.recording import Recording

_WINDOW = 1.5  # s, the longest


def without_samples_of_steps(recording: Recording, result: Search, said: Answer) -> tuple[Search, Answer]:
    """What was found in a recording, and its posterior, without spikes that are a step's own samples."""
    terms = [term for term in result.last.refit.model.terms if term.name == "hard-iron-step"]
    times = np.array([term.setting[end] for term in terms for end in ("time", "until") if end in term.setting])
    if not _others(recording, result.recording, times):
        found = {place for place, one in enumerate(result.found) if one.name == "spikes"}
        result = replace(result, found=less(result.found, found))
    if not _others(recording, said.recording, times):
        posterior: dict[tuple[tuple[str, ...], bool], float] = {}
        for (names, unknown), probability in said.posterior.items():
            key = tuple(name for name in names if name != "spikes"), unknown
            posterior[key] = posterior.get(key, 0.0) + probability
        said = replace(said, posterior=posterior)
    return result, said


def _others(before: Recording, after: Recording, times: Array) -> bool:
    """Whether samples were left out that are not next to a step, or none was at all."""
    left_out = before.time[before.magnetic_field_fresh & ~after.magnetic_field_fresh]
    if not len(left_out) or not len(times):
        return True
    away = np.abs(left_out[:, None] - times).min(axis=1) > _WINDOW
    return int(away.sum()) >= RULES.least_spikes
