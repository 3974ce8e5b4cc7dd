"""Robust kernels that start wide and narrow as the residuals of the blocks decrease (`kernels.narrowed`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import gtsam

from magyc_gtsam.factors.guard import factor_details
from magyc_gtsam.factors.kernels import narrowed
from magyc_gtsam.factors.keyframe_factor import BlockDetails

_RECENT = 40  # number of latest blocks whose misfit sets a kernel's width while a graph grows
_SETTLED = 0.01  # relative change of the width from which the estimate is computed again


class RobustBlock(NamedTuple):
    """A block of samples with a kernel."""

    factor: gtsam.NonlinearFactor
    details: BlockDetails


def robust_blocks(factors: Iterable[gtsam.NonlinearFactor]) -> list[RobustBlock]:
    """Return those of the factors that are blocks of samples with a kernel."""
    pairs = ((factor, factor_details(factor)) for factor in factors)
    return [
        RobustBlock(factor, details)
        for factor, details in pairs
        if isinstance(details, BlockDetails) and details.robust is not None
    ]


def narrow(blocks: Sequence[RobustBlock], values: gtsam.Values) -> bool:
    """Set the width of all kernels of a batch from the misfit at `values`; return whether it changed."""
    for factor, _ in blocks:
        factor.error(values.extract(list(factor.keys())))  # sets `details.misfit`
    width = narrowed([details.misfit for _, details in blocks])
    changed = any(abs(details.width / width - 1.0) > _SETTLED for _, details in blocks)
    for _, details in blocks:
        details.width = width
    return changed


class WarmUp:
    """The blocks of a growing graph whose kernels are still wide, and the latest blocks, whose misfit sets the width.

    Attributes:
        width: the width at present.
    """

    def __init__(self) -> None:
        self.width = 1.0
        self._robust: list[BlockDetails] = []

    def add(self, block: RobustBlock, point: gtsam.Values) -> None:
        """Add a block, whose misfit is that at `point`, the values of its keys."""
        block.factor.error(point)  # sets `misfit`
        self._robust.append(block.details)

    def narrow(self) -> None:
        """Set the width of all kernels from the misfit of the latest blocks at their last evaluation."""
        if not self._robust:
            return
        self.width = narrowed([details.misfit for details in self._robust[-_RECENT:]])
        for details in self._robust:
            details.width = self.width
        if self.width == 1.0:  # earlier blocks are no longer needed
            del self._robust[:-_RECENT]
