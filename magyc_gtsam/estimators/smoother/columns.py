"""Columns (Jacobians) on the reading and on the gyroscope's links, of effects that a model lacks and of its terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class UnmodelledColumns(NamedTuple):
    """Columns per unit amplitude: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad; None stands for zeros.

    The windows of columns that act on one axis of the sensor each, on x, y, z, x, …, are (k / `per_row`, n): every row
    is that of one column, or the profile of three.
    """

    window: Array | None
    link: Array | None
    per_row: int = 0

    @classmethod
    def axis_by_axis(cls, window: Array) -> UnmodelledColumns:
        """Return columns of the windows (3q, n) T that act on x, y, z, x, …"""
        return cls(window, None, 1)

    @classmethod
    def on_each_axis(cls, profiles: Array) -> UnmodelledColumns:
        """Return columns of the windows with profiles (q, n) T: of the first on x, y and z, of the second on x, …"""
        return cls(profiles, None, 3)

    @property
    def size(self) -> int:
        """The number of columns k."""
        if self.window is not None:
            return len(self.window) * (self.per_row or 1)
        return 0 if self.link is None else len(self.link)

    @property
    def on_all_axes(self) -> UnmodelledColumns:
        """The same columns, those of the windows (k, 3, n)."""
        if self.window is None or not self.per_row:
            return self
        whole, column = np.zeros((self.size, 3, self.window.shape[1])), np.arange(self.size)
        whole[column, column % 3] = self.window[column // self.per_row]
        return UnmodelledColumns(whole, self.link)

    def less(self, other: UnmodelledColumns) -> UnmodelledColumns:
        """Return the differences to the columns of another group on the same sensors and axes."""
        window = None if self.window is None or other.window is None else self.window - other.window
        link = None if self.link is None or other.link is None else self.link - other.link
        return UnmodelledColumns(window, link, self.per_row)

    def only(self, kept: np.ndarray) -> UnmodelledColumns:
        """Return the columns with those that are not `kept` ((k,) bool) set to zero."""
        window, link = (None if part is None else (kept * part.T).T for part in self.on_all_axes[:2])
        return UnmodelledColumns(window, link)

    def mixed(self, matrix: Array) -> UnmodelledColumns:
        """Return the linear combinations of the columns given by the rows of `matrix` (k, k)."""
        window, link = (None if part is None else np.tensordot(matrix, part, 1) for part in self.on_all_axes[:2])
        return UnmodelledColumns(window, link)


class EstimatedTerms(NamedTuple):
    """Parameters of the model beyond θ, with which the chain's windows and links are corrected.

    Attributes:
        columns: change of the residual per unit of each of the m parameters.
        value: (m,) estimates.
        precision: (m,) inverse variance of the zero-mean prior of each.
        families: names of the families of the model error that they replace.
    """

    columns: UnmodelledColumns
    value: Array
    precision: Array
    families: tuple[str, ...] = ()


def joined(groups: Sequence[UnmodelledColumns]) -> UnmodelledColumns:
    """Concatenate the columns of groups that act on the same sensors."""
    whole = [group.on_all_axes[:2] for group in groups]
    window, link = ([part for part in each if part is not None] for each in zip(*whole, strict=True))
    return UnmodelledColumns(np.concatenate(window) if window else None, np.concatenate(link) if link else None)
