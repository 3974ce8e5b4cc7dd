"""Robust kernels that start wide and narrow as the blocks come to fit."""

from __future__ import annotations

from collections.abc import Sequence

from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.kernels import narrowed
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View

_RECENT = 40  # blocks by whose misfit a kernel's width is set


class WarmUp:
    """The blocks whose kernels are still wide, and the last ones, by whose misfit the width is set."""

    def __init__(self) -> None:
        self._robust: list[BlockDetails] = []

    def narrow(self, view: View, fresh: Sequence[Delivered] = ()) -> None:
        """Set the width of all kernels, those of new blocks among them, by how the last blocks fit."""
        for each in fresh:
            if each.details is not None and each.details.robust is not None:
                each.factor.error(view.values(each.factor.keys()))  # sets `misfit`
                self._robust.append(each.details)
        if not self._robust:
            return
        width = narrowed([details.misfit for details in self._robust[-_RECENT:]])
        for details in self._robust:
            details.width = width
        if width == 1.0:  # those before need no more care
            del self._robust[:-_RECENT]
