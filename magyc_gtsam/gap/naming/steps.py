"""Steps of the hard iron, whose times are resolved to windows: two that are one jump, and samples that are not wrong.

A window in which the hard iron jumps by d reads a share s of the jump. Two steps at its edges, with the values s d and
(1 - s) d, describe that exactly, and so two may be found. The values of two separate jumps are parallel only by
chance. The comparison is between one jump at a free time and two jumps; the second costs the prior odds of another name
and the search over its time. The samples of the window are a mixture of both fields and are left out of the fit.

Samples between a step and the edge of the window that represents it have an error of the whole step. To leave them out
does no harm, but they are no evidence of wrong samples.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.model.base import problem_of
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.model.refit import Refit, refit, without_term
from magyc_gtsam.gap.naming.named import Named, term_places
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import fine_innovations
from magyc_gtsam.gap.samples.wrong_samples import spikes
from magyc_gtsam.recording import Recording

_STEP = "hard-iron-step"
_EDGED = (_STEP, "local-anomaly")  # which begin and end between two samples, unless they have a width
_SHARES = np.linspace(0.0, 1.0, 51)
_BESIDE = 1.5 * RULES.window  # s, on each side of a step: more than the longest window


def with_one_jump(result: Named, short_term: SensorNoise) -> Named:
    """Return the named effects with one step in place of every two that are one jump inside a window."""
    places = {index: place for place, index in term_places(result.found, result.fitted.model).items()}
    fitted = result.fitted
    terms, centres = fitted.model.terms, fitted.twin.time
    steps = sorted((i for i in places if terms[i].name == _STEP), key=lambda i: terms[i].setting["time"])
    for first, second in pairwise(steps):
        start, end = (terms[i].setting["time"] for i in (first, second))
        inside = np.flatnonzero((start < centres) & (centres < end))
        if len(inside) != 1:
            continue
        share = _share(fitted, first, second)
        if share is None:
            continue
        samples = fitted.twin.problem.samples
        ends = np.append(samples.starts, len(samples.magnetometer_time))
        mixed = samples.magnetometer_time[ends[inside[0]] : ends[inside[0] + 1]]
        fresh = result.recording.magnetic_field_fresh & ~np.isin(result.recording.time, mixed)
        recording = replace(result.recording, magnetic_field_fresh=fresh)
        one = replace(terms[first], setting={"time": float(mixed[-1] - share * np.ptp(mixed))})
        model = replace(fitted.model, terms=(*terms[:first], one, *terms[first + 1 :]))
        ahead = refit(problem_of(recording), without_term(model, second), short_term)
        if not ahead.converged:
            continue
        found = tuple(one for place, one in enumerate(result.found) if place != places[second])
        again = replace(result, recording=recording, fitted=ahead, found=found)
        return with_one_jump(again, short_term)
    return result


def _share(fitted: Refit, first: int, second: int) -> float | None:
    """Return the share of a single jump that the first of two steps has; None if two jumps are likelier."""
    both = np.concatenate([fitted.rows_of(first), fitted.rows_of(second)])
    value = np.concatenate([fitted.value_of(first)[0], fitted.value_of(second)[0]])
    precision = np.linalg.inv(fitted.covariance[np.ix_(both, both)])
    costs = [_cost(share, value, precision) for share in _SHARES]
    search = np.log(fitted.twin.n)
    best = int(np.argmin(costs))
    return float(_SHARES[best]) if costs[best] < search - PRIOR.named else None


def _cost(share: float, value: Array, precision: Array) -> float:
    """Return the misfit (nats) of two values (6,) to the nearest pair `share` d and (1 − `share`) d."""
    columns = np.concatenate([share * np.eye(3), (1 - share) * np.eye(3)])
    jump = np.linalg.solve(columns.T @ precision @ columns, columns.T @ precision @ value)
    miss = value - columns @ jump
    return float(0.5 * miss @ precision @ miss)


def without_samples_of_steps(recording: Recording, result: Named) -> Named:
    """Return the named effects without spikes that are samples of a step; `recording`: with all its samples."""
    if _has_spikes(recording, result.recording, result.fitted.model):
        return result
    found = tuple(one for one in result.found if one.name != "spikes")
    probabilities = {name: each for name, each in result.probabilities.items() if name != "spikes"}
    return replace(result, found=found, probabilities=probabilities)


def _has_spikes(before: Recording, after: Recording, model: Model) -> bool:
    """Return whether wrong samples are significant away from steps; True if none next to a step was left out."""
    terms = [term for term in model.terms if term.name in _EDGED and "width" not in term.setting]
    times = np.array([term.setting[end] for term in terms for end in ("time", "until") if end in term.setting])
    left_out = before.magnetic_field_fresh & ~after.magnetic_field_fresh
    near = (np.abs(before.time[:, None] - times) < _BESIDE).any(axis=1)
    if not (left_out & near).any():
        return True
    fine = fine_innovations(replace(before, magnetic_field_fresh=before.magnetic_field_fresh & ~near), model)
    return spikes(fine.innovation, fine.level, 0.0).significant
