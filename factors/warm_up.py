"""Robust kernels that start wide and narrow as the residuals of the blocks decrease."""

from __future__ import annotations

from collections.abc import Sequence

from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.kernels import narrowed
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View

_RECENT = 40  # number of latest blocks whose misfit sets a kernel's width


class WarmUp:
    """The blocks whose kernels are still wide, and the latest blocks, whose misfit sets the width."""

    def __init__(self) -> None:
        self._robust: list[BlockDetails] = []

    def narrow(self, view: View, fresh: Sequence[Delivered] = ()) -> None:
        """Set the width of all kernels, including those of new blocks, from the misfit of the latest blocks."""
        for each in fresh:
            if each.details is not None and each.details.robust is not None:
                each.factor.error(view.values(each.factor.keys()))  # sets `misfit`
                self._robust.append(each.details)
        if not self._robust:
            return
        width = narrowed([details.misfit for details in self._robust[-_RECENT:]])
        for details in self._robust:
            details.width = width
        if width == 1.0:  # earlier blocks are no longer needed
            del self._robust[:-_RECENT]
