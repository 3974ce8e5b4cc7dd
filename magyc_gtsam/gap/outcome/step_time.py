"""The time of a step and its standard deviation, from the profile likelihood."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.candidates import Candidates
from magyc_gtsam.gap.evidence.weighing import information_of
from magyc_gtsam.gap.model.field_variation import FieldVariation, field_variation
from magyc_gtsam.gap.model.refit import Refit, without_term

_REACH = 60.0  # s on each side
_FEWEST = 12  # windows on each side


def step_time_sigmas(refitted: Refit) -> dict[int, float]:
    """Return {index of each step of a model: standard deviation of its time, s}, profiled over all other parameters."""
    steps = [index for index, term in enumerate(refitted.model.terms) if term.name == "hard-iron-step"]
    if not steps:
        return {}
    variation = field_variation(refitted.twin)  # it makes the time of a change less certain
    return {index: _sigma(refitted, index, variation if variation.evident else None) for index in steps}


def _sigma(refitted: Refit, index: int, variation: FieldVariation | None) -> float:
    twin = refitted.twin
    term = twin.model.terms[index]
    value, _ = refitted.value_of(index)
    own = twin.whiten(twin.columns(term.name, term.setting))
    rows = replace(twin, model=without_term(twin.model, index)).base_columns
    beside = Beside.of_varying(twin.residual().ravel() - value @ own, rows, np.zeros(len(rows)), variation)
    edges = 0.5 * (twin.time[1:] + twin.time[:-1])
    at = int(np.argmin(np.abs(edges - term.setting["time"])))
    window = float(np.median(np.diff(twin.time)))
    reach = max(_FEWEST, round(_REACH / window))
    times = edges[max(at - reach, 0) : at + reach + 1]
    settings = [{**term.setting, "time": float(time)} for time in times]
    candidates = Candidates.at(twin, term.name, settings)
    seen, (batch,) = beside.see(candidates.columns, candidates.score_bias), candidates.batches
    inverse = np.linalg.pinv(information_of(batch, beside.noise, seen.reach), hermitian=True)
    score = seen.score[batch.rows]
    profile = np.einsum("bk,bkl,bl->b", score, inverse, score)
    weight = np.exp(0.5 * (profile - profile.max()))
    weight /= weight.sum()
    spread = float(weight @ (times - weight @ times) ** 2)
    return float(np.sqrt(spread + window**2 / 12))  # the position of a step within a window is unknown
