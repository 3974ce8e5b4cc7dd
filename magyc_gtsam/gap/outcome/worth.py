"""A test whether a correction is worthwhile in a varying field: its prediction of held-out data, and its field.

A real effect need not be worth its correction. The improvement by its value can be less than the added variance of the
parameters that are estimated with it, and in a room an effect explains much of the variation of the room's field.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import MOMENTS, TERMS
from magyc_gtsam.gap.model.field_variation import FieldVariation
from magyc_gtsam.gap.model.projector import Projector
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES


def pays(with_it: Refit, without: Refit, index: int, variation: FieldVariation) -> bool:
    """Return whether correcting the term `index` of a model is expected to improve the prediction and the field.

    Args:
        with_it, without: the model with and without the term, at their minima.
        index: of the term.
        variation: of the field, which is part of both hypotheses.
    """
    return predicts(with_it, index, variation) and expected(with_it, without, index) > 0


def predicts(with_it: Refit, index: int, variation: FieldVariation) -> bool:
    """Return whether the term `index` of a model improves the prediction of data that it was not fitted to."""
    tried = len(TERMS[with_it.model.terms[index].name].settings(with_it.twin)) * len(TERMS)
    # The best of many settings and effects gains something by chance, because the data helped to choose it.
    return min(predicted(with_it, index, variation)) > np.log(tried)


def predicted(with_it: Refit, index: int, variation: FieldVariation) -> tuple[float, float]:
    """Return the gain (nats) on held-out blocks: on alternate blocks, and on the other half of the recording."""
    twin = with_it.twin
    rows, own = twin.base_columns, with_it.rows_of(index)
    value, _ = with_it.value_of(index)
    residual = variation.whiten((twin.residual().ravel() - value @ rows[own])[None])
    # Other terms at a time of their own are held to the whole recording: one half may contain nothing of them.
    terms = [active for active in twin.model.estimated for _ in active.value]
    local = np.array([False] * int(twin.model.free.sum()) + [term.name in MOMENTS for term in terms])
    local[own] = False
    others = np.delete(np.arange(len(rows)), own)
    beside = Projector(variation.whiten(rows[local]))
    base, columns = (beside(variation.whiten(rows[i])) for i in (others[~local[others]], own))
    residual = beside(residual)[0]
    term = twin.model.terms[index]
    length = min(TERMS[term.name].block(term.setting), twin.duration / RULES.blocks)
    in_turn = held_out_gain(base, columns, residual, interleaved(twin.time, length))
    if term.name in MOMENTS:  # one half does not predict the other
        return in_turn, in_turn
    return in_turn, held_out_gain(base, columns, residual, interleaved(twin.time, 0.5001 * twin.duration))


def expected(with_it: Refit, without: Refit, index: int) -> float:
    """Return the mean square error of the calibrated field without the correction, less that with it, T².

    With d the difference of the two fields and V the variance that the correction adds, E|d|² = bias² + V. Therefore
    the gain, bias² − V, is |d|² − 2 V.
    """
    iron = np.arange(9)
    more, rows = _field_columns(with_it.twin), np.concatenate([iron, with_it.rows_of(index)])
    less = _field_columns(without.twin)[iron]
    value, _ = with_it.value_of(index)
    change = with_it.model.parameters[:9] - without.model.parameters[:9]
    shift = np.einsum("p,pin->in", np.concatenate([change, value]), more[rows])
    added = _variance(more[rows], with_it.covariance[np.ix_(rows, rows)])
    added -= _variance(less, without.covariance[np.ix_(iron, iron)])
    return float((shift**2).sum(axis=0).mean()) - 2 * max(added, 0.0)


def _variance(columns: Array, covariance: Array) -> float:
    """Return the variance of a field with columns (p, 3, n), mean over the windows, T²."""
    return float(np.einsum("pin,pq,qin->", columns, covariance, columns, optimize=True)) / columns.shape[2]


def _field_columns(twin: Twin) -> Array:
    """Return the columns (q, 3, n) of the free parameters, then of the terms, on the windows, T per unit."""
    base = twin.reduced.on_parameters[np.flatnonzero(twin.model.free)] / twin.chain.window_scale
    return np.concatenate([base, *(twin.columns(t.name, t.setting).window for t in twin.model.estimated)])


def held_out_gain(base: Array, columns: Array, residual: Array, block: Array) -> float:
    """Return the gain in log-likelihood (nats) of adding columns, on blocks of rows that were not fitted.

    Args:
        base: (q, rows) whitened.
        columns: (k, rows) whitened.
        residual: (rows,) whitened.
        block: (rows,) 0 or 1.
    """
    gain = 0.0
    design = np.concatenate([base, columns])
    size = np.maximum(np.sqrt(np.einsum("pn,pn->p", design, design)), 1e-300)[:, None]
    design = design / size
    for fold in (0, 1):
        train, test = block != fold, block == fold
        seen = design[:, train]
        normal, score = seen @ seen.T, seen @ residual[train]
        normal[np.diag_indices_from(normal)] += 1e-9
        errors = []
        for count in (len(base), len(design)):
            solution = np.linalg.solve(normal[:count, :count], score[:count])
            errors.append(residual[test] - solution @ design[:count, test])
        gain += 0.5 * float(errors[0] @ errors[0] - errors[1] @ errors[1])
    return gain


def interleaved(time: Array, length: float) -> Array:
    """Return alternately 0 and 1 (3n,) in blocks of `length` s, for innovations stacked axis by axis."""
    return np.tile(np.floor((time - time[0]) / length).astype(int) % 2, 3)
