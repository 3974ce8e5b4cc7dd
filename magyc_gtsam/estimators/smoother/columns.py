"""Columns (Jacobians) on the reading and on the gyroscope's links, of effects that a model lacks and of its terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class UnmodelledColumns(NamedTuple):
    """Columns per unit amplitude: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad; None stands for zeros.

    With `axis` (k,), the columns of the windows act on one axis of the sensor each, and are (k, n), or (k / 3, n) if
    each row is the profile of three columns, one per axis.
    """

    window: Array | None
    link: Array | None
    axis: np.ndarray | None = None

    @classmethod
    def axis_by_axis(cls, window: Array) -> UnmodelledColumns:
        """Return columns of the windows (3q, n) T that act on x, y, z, x, …"""
        return cls(window, None, np.arange(len(window)) % 3)

    @classmethod
    def on_each_axis(cls, profiles: Array) -> UnmodelledColumns:
        """Return columns of the windows with profiles (q, n) T: of the first on x, y and z, of the second on x, …"""
        return cls(profiles, None, np.arange(3 * len(profiles)) % 3)

    @property
    def size(self) -> int:
        """The number of columns k."""
        one = next((part for part in (self.axis, self.window, self.link) if part is not None), ())
        return len(one)

    @property
    def one_by_one(self) -> UnmodelledColumns:
        """The same columns, with a row of the windows for each."""
        if self.window is None or self.axis is None or len(self.window) == len(self.axis):
            return self
        return self._replace(window=np.repeat(self.window, 3, axis=0))

    @property
    def on_all_axes(self) -> UnmodelledColumns:
        """The same columns, those of the windows (k, 3, n)."""
        if self.window is None or self.axis is None:
            return self
        whole = np.zeros((len(self.axis), 3, self.window.shape[1]))
        whole[np.arange(len(whole)), self.axis] = self.one_by_one.window
        return UnmodelledColumns(whole, self.link)

    def less(self, other: UnmodelledColumns) -> UnmodelledColumns:
        """Return the differences to the columns of another group on the same sensors and axes."""
        window = None if self.window is None or other.window is None else self.window - other.window
        link = None if self.link is None or other.link is None else self.link - other.link
        return UnmodelledColumns(window, link, self.axis)

    def only(self, kept: np.ndarray) -> UnmodelledColumns:
        """Return the columns with those that are not `kept` ((k,) bool) set to zero."""
        window, link = (None if part is None else (kept * part.T).T for part in self.one_by_one[:2])
        return UnmodelledColumns(window, link, self.axis)

    def mixed(self, matrix: Array) -> UnmodelledColumns:
        """Return the linear combinations of the columns given by the rows of `matrix` (k, k)."""
        window, link, _ = self.on_all_axes
        return UnmodelledColumns(
            *(None if part is None else np.tensordot(matrix, part, 1) for part in (window, link))
        )


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
    """Concatenate the columns of groups that act on the same sensors, all with `axis` or none."""
    rows = (group.one_by_one for group in groups)
    parts = ([part for part in each if part is not None] for each in zip(*rows, strict=True))
    return UnmodelledColumns(*(np.concatenate(part) if part else None for part in parts))
