"""The principal axes of a group of columns, along which its likelihood is a product."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dsyevd

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError


class PrincipalAxes(NamedTuple):
    """The eigendecomposition of G (k, k): non-negative eigenvalues (k,), eigenvectors (k, k), and s along them (k,)."""

    value: Array
    vector: Array
    pull: Array


def principal(normal: Array, score: Array) -> PrincipalAxes:
    """Return the principal axes of a group with G (k, k) and s (k,).

    Raises:
        MagycError: the products are not finite.
    """
    if len(score) > 1:
        value, vector, failed = dsyevd(normal, lower=1)
        if failed:
            raise MagycError("model error: the products of a group of columns are not finite")
    else:
        value, vector = normal[0], np.ones((1, 1))
    return PrincipalAxes(np.maximum(value, 0.0), vector, score @ vector)


def stacked(groups: Sequence[PrincipalAxes]) -> tuple[Array, Array]:
    """Return the values and pulls of all f groups, (f, k) each, padded with zeros."""
    longest = max((len(group.value) for group in groups), default=0)
    value, pull = np.zeros((len(groups), longest)), np.zeros((len(groups), longest))
    for i, group in enumerate(groups):
        size = len(group.value)
        value[i, :size], pull[i, :size] = group.value, group.pull
    return value, pull
