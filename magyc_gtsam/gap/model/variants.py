"""Candidates prepared for a score test: projected on the complement of the base model's columns, and orthonormal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, islice

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.twin import Twin, together

_AT_ONCE = 100_000  # numbers prepared at once, so that they stay in the processor's cache
_DEPENDENT = 1e-6  # smallest share of a column's square that must remain after the projection


@dataclass(frozen=True, eq=False)
class Variant:
    """A candidate at one setting.

    Attributes:
        setting: of the grid search.
        columns: (k, 3n) whitened.
        unit: (r, 3n) orthonormal rows that span the projected columns; r ≤ k.
        back: (k, r) matrix from the score d to the expected value.
        left: share of the columns that remains after the projection, 0 to 1.
        score_bias: (k,) score bias of the columns.
        offset: (r,) score bias of `unit`.
    """

    setting: Mapping[str, float]
    columns: Array
    unit: Array
    back: Array
    left: float
    score_bias: Array
    offset: Array

    def score(self, innovation: Array) -> Array:
        """Return the score d (r,) of projected innovations."""
        return self.unit @ innovation - self.offset


class Projector:
    """The projection on the complement of the base model's columns (q, 3n), which have a score bias (q,)."""

    def __init__(self, base: Array, score_bias: Array | None = None) -> None:
        scale = np.linalg.norm(base, axis=1)
        scale = np.where(scale > 0, scale, 1.0)
        q, r = np.linalg.qr((base / scale[:, None]).T)
        self._q = q[:, np.abs(np.diag(r)) > 1e-9]
        scaled = np.zeros(len(base)) if score_bias is None else score_bias / scale
        self._score_bias = np.linalg.lstsq(r.T, scaled, rcond=1e-9)[0][np.abs(np.diag(r)) > 1e-9]

    def __call__(self, rows: Array) -> Array:
        result: Array = rows - (rows @ self._q) @ self._q.T
        return result

    def shared_score_bias(self, rows: Array) -> Array:
        """Return the part of the score bias of rows that the projection removes with the base model's columns."""
        result: Array = (rows @ self._q) @ self._score_bias
        return result


def variant(
    setting: Mapping[str, float], columns: Array, project: Projector, score_bias: Array | None = None
) -> Variant:
    """Prepare one candidate from its whitened columns."""
    score_bias = np.zeros(len(columns)) if score_bias is None else score_bias
    return ready([setting], columns[None], project, score_bias[None])[0]


def ready(
    settings: Sequence[Mapping[str, float]], columns: Array, project: Projector, score_bias: Array
) -> list[Variant]:
    """Prepare candidates with equally many columns (s, k, 3n) and score biases (s, k) together."""
    count, width, rows = columns.shape
    size = np.sqrt(np.einsum("skn,skn->sk", columns, columns))
    kept = size > 0
    scale = np.where(kept, size, 1.0)
    flat = (columns / scale[..., None]).reshape(-1, rows)
    free = project(flat).reshape(columns.shape)
    shared = project.shared_score_bias(flat).reshape(count, width) * scale
    value, vector = np.linalg.eigh(free @ free.swapaxes(1, 2))
    good = value > _DEPENDENT
    root = vector / np.sqrt(np.where(good, value, 1.0))[:, None]
    unit = root.swapaxes(1, 2) @ free
    back = root / scale[..., None]
    left = np.sqrt(np.einsum("skn,skn->s", free, free) / np.maximum(kept.sum(axis=1), 1))
    offset = np.einsum("ski,sk->si", back, score_bias - shared)
    result = []
    for i, setting in enumerate(settings):
        own = slice(None) if good[i].all() else good[i]
        result.append(
            Variant(
                setting, columns[i], unit[i, own], back[i][:, own], float(left[i]), score_bias[i], offset[i, own]
            )
        )
    return result


def determined(one: Variant, within: float) -> Variant:
    """Remove directions of the values whose standard deviation exceeds `within`: they could take absurd values."""
    if not np.isfinite(within):
        return one
    value, sigma, d = np.linalg.svd(one.back, full_matrices=False)
    kept = sigma <= within
    return replace(one, unit=d[kept] @ one.unit, back=(value * sigma)[:, kept], offset=d[kept] @ one.offset)


def variants(
    twin: Twin,
    project: Projector,
    name: str,
    settings: list[dict[str, float]],
    whiten: Callable[[Array], Array] = lambda rows: rows,
) -> list[Variant]:
    """Prepare a named effect at several settings, adjacent ones with equally many columns together.

    `whiten` is applied to the columns, which are white with respect to the noise of the sensors, before `project`.
    """
    made = ((setting, TERMS[name].regressors(twin, setting)) for setting in settings)
    result: list[Variant] = []
    for count, alike in groupby(made, key=lambda each: len(each[1].window)):
        while some := list(islice(alike, max(_AT_ONCE // (3 * twin.n * count), 1))):
            rows = whiten(twin.whiten(together([part for _, part in some]))).reshape(len(some), count, -1)
            score_bias = np.array(
                [np.zeros(count) if part.score_bias is None else part.score_bias for _, part in some]
            )
            result += ready([setting for setting, _ in some], rows, project, score_bias)
    return result
