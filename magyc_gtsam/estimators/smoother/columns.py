"""Columns (Jacobians) on the reading and on the gyroscope's links, of effects that a model lacks and of its terms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array


class UnmodelledColumns(NamedTuple):
    """Columns per unit amplitude: of the windows (k, 3, n) T, of the links (k, 3, n − 1) rad; None stands for zeros."""

    window: Array | None
    link: Array | None

    @property
    def size(self) -> int:
        """The number of columns k."""
        one = self.window if self.window is not None else self.link
        return 0 if one is None else len(one)

    @property
    def dense(self) -> UnmodelledColumns:
        """The columns as arrays of windows and links; here the object itself."""
        return self

    def less(self, other: UnmodelledColumns) -> UnmodelledColumns:
        """Return the differences to the columns of another group on the same sensors."""
        window = None if self.window is None or other.window is None else self.window - other.window
        link = None if self.link is None or other.link is None else self.link - other.link
        return UnmodelledColumns(window, link)

    def only(self, kept: np.ndarray) -> UnmodelledColumns:
        """Return the columns with those that are not `kept` ((k,) bool) set to zero."""
        share = kept[:, None, None]
        return UnmodelledColumns(
            None if self.window is None else share * self.window, None if self.link is None else share * self.link
        )

    def mixed(self, matrix: Array) -> UnmodelledColumns:
        """Return the linear combinations of the columns given by the rows of `matrix` (k, k)."""
        parts = [None if part is None else np.tensordot(matrix, part, 1) for part in self]
        return UnmodelledColumns(*parts)


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


@dataclass(frozen=True, eq=False)
class Products:
    """Columns of the windows that are the products of q profiles with b axes, at 1/q of the work of dense columns.

    Attributes:
        profiles: (q, n).
        axes: (b, 3, n) T per unit.
    """

    profiles: Array
    axes: Array

    @property
    def size(self) -> int:
        """The number of columns, k = q b."""
        return len(self.profiles) * len(self.axes)

    @property
    def window(self) -> Array:
        """(k, 3, n) as in `UnmodelledColumns`."""
        columns = self.profiles[:, None, None, :] * self.axes
        return columns.reshape(self.size, *self.axes.shape[1:])

    @property
    def link(self) -> Array | None:
        """None, because the columns act on the magnetometer."""
        return None

    @property
    def dense(self) -> UnmodelledColumns:
        """The columns as arrays of windows and links."""
        return UnmodelledColumns(self.window, None)


@dataclass(frozen=True, eq=False)
class RateErrors:
    """Columns of the links caused by errors of the rate, integrated for many groups at once.

    Attributes:
        turned: (k, 3, n) rad/s per unit, in the integrated world.
        links: maps such errors to columns of the links, (k, 3, n − 1) rad.
    """

    turned: Array
    links: Callable[[Array], Array]

    @property
    def size(self) -> int:
        """The number of columns k."""
        return len(self.turned)

    @property
    def window(self) -> Array | None:
        """None, because the columns act on the gyroscope."""
        return None

    @property
    def link(self) -> Array:
        """(k, 3, n − 1) as in `UnmodelledColumns`."""
        return self.links(self.turned)

    @property
    def dense(self) -> UnmodelledColumns:
        """The columns as arrays of windows and links."""
        return UnmodelledColumns(None, self.link)


Columns = UnmodelledColumns | Products | RateErrors


def joined(groups: Sequence[Columns]) -> UnmodelledColumns:
    """Concatenate the columns of groups that act on the same sensors."""
    errors = [group for group in groups if isinstance(group, RateErrors)]
    integrated: Iterator[Array] = iter(())
    if errors:
        every = errors[0].links(np.concatenate([each.turned for each in errors]))
        integrated = iter(np.split(every, np.cumsum([each.size for each in errors[:-1]])))
    windows = [group.window for group in groups]
    links = [next(integrated) if isinstance(group, RateErrors) else group.link for group in groups]
    parts = ([part for part in each if part is not None] for each in (windows, links))
    return UnmodelledColumns(*(np.concatenate(part) if part else None for part in parts))
