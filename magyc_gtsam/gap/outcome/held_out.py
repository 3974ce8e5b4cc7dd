"""How well a model predicts blocks of a recording that it was not fitted to."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.field_variation import FieldVariation
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES


def held_out(twin: Twin, innovation: Array, base: Array, variation: FieldVariation | None) -> float:
    """Return the log-likelihood per window (nats) on blocks that were not fitted, of what has columns (q, 3n).

    A variation of the field is whitened; its determinant, which all models share, is left out.
    """
    block = interleaved(twin.time, RULES.block)
    flat = innovation.ravel()
    if variation is not None:
        flat, base = variation.whiten(flat[None])[0], variation.whiten(base)
    size = np.maximum(np.linalg.norm(base, axis=1), 1e-300)[:, None]
    square = 0.0
    for fold in (0, 1):
        train, test = block != fold, block == fold
        solution = np.linalg.lstsq((base[:, train] / size).T, flat[train], rcond=1e-8)[0]
        error = flat[test] - solution @ (base[:, test] / size)
        square += float(error @ error)
    sigma = twin.chain.window_sigma * 1e6  # density per µT³, for a number of readable size
    constant = 1.5 * np.log(2 * np.pi) + 3 * np.log(sigma) + 0.5 * twin.log_determinant()
    return -float(constant[1:].mean()) - 0.5 * square / twin.n


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
