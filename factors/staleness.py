"""Selection of the quadratics that an update checks for staleness."""

from __future__ import annotations

from collections.abc import Sequence

from magyc_gtsam.factors.delivered import Delivered

_UNSETTLED = 1.0  # standard deviations


class Staleness:
    """Selects the latest quadratics with each new block, all of them occasionally, and stale ones at every update.

    A quadratic is linearised at the predicted attitude, before the update that adds it. It is therefore checked in
    the next update, where its variables are still at the root of iSAM2's tree and renewing it costs little. Later
    only new blocks move old attitudes and the calibration much. All quadratics from the oldest one that was stale by
    more than a standard deviation onwards are checked in each update until none is; all quadratics are checked each
    time their number has grown by a factor.

    Args:
        recent: number of quadratics that count as the latest ones.
        growth: factor of their number between two checks of all of them.

    Attributes:
        reach: number of quadratics from the oldest one that was stale by more than a standard deviation at the last
            check up to the newest.
        entered: number of quadratics that entered in the last update.
    """

    def __init__(self, recent: int, growth: float) -> None:
        self.recent, self.growth = recent, growth
        self.reach = self.entered = 0
        self._next = 2.0

    @property
    def unsettled(self) -> bool:
        """Whether a quadratic was stale by more than a standard deviation at the last check."""
        return self.reach > 0

    @property
    def pending(self) -> bool:
        """Whether an update that adds no block has quadratics to check."""
        return self.unsettled or self.entered > 0

    def due(self, delivered: list[Delivered], entering: int) -> list[Delivered]:
        """Return the quadratics to check in an update.

        Args:
            delivered: all quadratics in the solver, oldest first.
            entering: number of quadratics that the update adds.
        """
        newest, self.entered = self.entered, entering
        if newest and not (entering or self.unsettled):
            return delivered[-newest:]
        if len(delivered) < self._next:
            return delivered[-max(self.recent, self.reach + newest if self.unsettled else 0) :]
        self._next = self.growth * len(delivered)
        return list(delivered)

    def found(self, shifts: Sequence[float]) -> None:
        """Record the staleness, in standard deviations, of each checked quadratic, oldest first."""
        stale = [i for i, shift in enumerate(shifts) if shift > _UNSETTLED]
        self.reach = len(shifts) - stale[0] if stale else 0
