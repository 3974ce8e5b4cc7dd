"""The time of a step and its standard deviation, from the profile likelihood."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.field_variation import field_variation
from magyc_gtsam.gap.model.refit import Refit, without_term
from magyc_gtsam.gap.model.variants import Projector, variants

_REACH = 60.0  # s on each side
_FEWEST = 12  # windows on each side


def step_time_sigma(refitted: Refit, index: int) -> float:
    """Return the standard deviation of the time of the model's step `index`, s, profiled over all other parameters."""
    twin = refitted.twin
    term = twin.model.terms[index]
    value, _ = refitted.value_of(index)
    variation = field_variation(twin)

    def whitened(rows: Array) -> Array:
        """Whiten for the variation of the field, which makes the time of a change less certain."""
        return variation.whiten(rows) if variation.evident else rows

    own = twin.whiten(twin.columns(term.name, term.setting))
    without = replace(twin, model=without_term(twin.model, index))
    project = Projector(whitened(without.base_columns), without.base_score_bias)
    target = project(whitened((twin.residual().ravel() - value @ own)[None]))[0]  # the residual without the step
    edges = 0.5 * (twin.time[1:] + twin.time[:-1])
    at = int(np.argmin(np.abs(edges - term.setting["time"])))
    window = float(np.median(np.diff(twin.time)))
    reach = max(_FEWEST, round(_REACH / window))
    times = edges[max(at - reach, 0) : at + reach + 1]
    settings = [{**term.setting, "time": float(time)} for time in times]
    scores = [one.score(target) for one in variants(twin, project, term.name, settings, whitened)]
    profile = np.array([float(d @ d) for d in scores])
    weight = np.exp(0.5 * (profile - profile.max()))
    weight /= weight.sum()
    spread = float(weight @ (times - weight @ times) ** 2)
    return float(np.sqrt(spread + window**2 / 12))  # the position of a step within a window is unknown
