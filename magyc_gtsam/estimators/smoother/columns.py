"""Columns of the reading and of the gyroscope's links: of what a model lacks, and of its terms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class UnmodelledColumns(NamedTuple):
    """Unmodelled columns per unit: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad; None is zero."""

    window: Array | None
    link: Array | None

    @property
    def size(self) -> int:
        """k."""
        one = self.window if self.window is not None else self.link
        return 0 if one is None else len(one)

    @property
    def dense(self) -> UnmodelledColumns:
        """Themselves."""
        return self

    def less(self, other: UnmodelledColumns) -> UnmodelledColumns:
        """By how much each differs from another's on the same sensors."""
        window = None if self.window is None or other.window is None else self.window - other.window
        link = None if self.link is None or other.link is None else self.link - other.link
        return UnmodelledColumns(window, link)

    def only(self, kept: np.ndarray) -> UnmodelledColumns:
        """With zeros in place of those that are not kept, (k,) bool."""
        share = kept[:, None, None]
        return UnmodelledColumns(
            None if self.window is None else share * self.window, None if self.link is None else share * self.link
        )

    def mixed(self, matrix: Array) -> UnmodelledColumns:
        """Mixtures of the columns, by a matrix (k, k)."""
        parts = [None if part is None else np.tensordot(matrix, part, 1) for part in self]
        return UnmodelledColumns(*parts)


class EstimatedTerms(NamedTuple):
    """Parameters of a model beyond θ, which the chain's windows and links are corrected by.

    columns: by what a unit of each of m changes the residual; value (m,); precision (m,): with which each was held to 0
    beforehand; families: names of those of the model error that they stand for.
    """

    columns: UnmodelledColumns
    value: Array
    precision: Array
    families: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Products:
    """Columns of the windows, profile by profile, each along each of some axes: a q-th of the work of any others.

    profiles (q, n); axes (b, 3, n) T per unit.
    """

    profiles: Array
    axes: Array

    @property
    def size(self) -> int:
        """k = q b."""
        return len(self.profiles) * len(self.axes)

    @property
    def window(self) -> Array:
        """(k, 3, n) as `UnmodelledColumns` has them."""
        columns = self.profiles[:, None, None, :] * self.axes
        return columns.reshape(self.size, *self.axes.shape[1:])

    @property
    def link(self) -> Array | None:
        """None: they are on the magnetometer."""
        return None

    @property
    def dense(self) -> UnmodelledColumns:
        """The same as any columns."""
        return UnmodelledColumns(self.window, None)


@dataclass(frozen=True, eq=False)
class RateErrors:
    """Columns of the links by errors of the rate, which are integrated for many groups at once.

    turned (k, 3, n) rad/s per unit, in the integrated world; links: what the links have of such errors,
    (k, 3, n − 1) rad.
    """

    turned: Array
    links: Callable[[Array], Array]

    @property
    def size(self) -> int:
        """k."""
        return len(self.turned)

    @property
    def window(self) -> Array | None:
        """None: they are on the gyroscope."""
        return None

    @property
    def link(self) -> Array:
        """(k, 3, n − 1) as `UnmodelledColumns` has them."""
        return self.links(self.turned)

    @property
    def dense(self) -> UnmodelledColumns:
        """The same as any columns."""
        return UnmodelledColumns(None, self.link)


Columns = UnmodelledColumns | Products | RateErrors


def joined(groups: Sequence[Columns]) -> UnmodelledColumns:
    """Columns of one group after the other, on the same sensors."""
    errors = [group for group in groups if isinstance(group, RateErrors)]
    integrated: Iterator[Array] = iter(())
    if errors:
        every = errors[0].links(np.concatenate([each.turned for each in errors]))
        integrated = iter(np.split(every, np.cumsum([each.size for each in errors[:-1]])))
    windows = [group.window for group in groups]
    links = [next(integrated) if isinstance(group, RateErrors) else group.link for group in groups]
    parts = ([part for part in each if part is not None] for each in (windows, links))
    return UnmodelledColumns(*(np.concatenate(part) if part else None for part in parts))
