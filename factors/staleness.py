"""Which quadratics are looked at in an update: whether the estimate has moved away from where they were made."""

from __future__ import annotations

from collections.abc import Sequence

from magyc_gtsam.factors.delivered import Delivered

_UNSETTLED = 1.0  # standard deviations


class Staleness:
    """Looks at the last quadratics with each block, at all now and then, and at every update until they are settled.

    A quadratic is made where its attitude is predicted, before the update that it enters by; so it is looked at in the
    next one, where its variables are still at the root of iSAM2's tree and renewing it costs little. Later only blocks
    move old attitudes and the calibration much. From the oldest quadratic on that was stale by more than a standard
    deviation they are looked at in each update until none is; all are, each time that their number has grown by a
    factor.

    Args:
        recent: number of quadratics that count as the last ones.
        growth: factor of their number between two looks at all of them.

    Attributes:
        reach: number of quadratics from the oldest on that was stale by more than a standard deviation at the last
            look.
        entered: number of quadratics that entered in the last update.
    """

    def __init__(self, recent: int, growth: float) -> None:
        self.recent, self.growth = recent, growth
        self.reach = self.entered = 0
        self._next = 2.0

    @property
    def unsettled(self) -> bool:
        """Whether a quadratic was stale by more than a standard deviation at the last look."""
        return self.reach > 0

    @property
    def pending(self) -> bool:
        """Whether to look at some in an update that brings no block."""
        return self.unsettled or self.entered > 0

    def due(self, delivered: list[Delivered], entering: int) -> list[Delivered]:
        """Those to look at in an update by which `entering` more enter, of all that are delivered, oldest first."""
        newest, self.entered = self.entered, entering
        if newest and not (entering or self.unsettled):
            return delivered[-newest:]
        if len(delivered) < self._next:
            return delivered[-max(self.recent, self.reach + newest if self.unsettled else 0) :]
        self._next = self.growth * len(delivered)
        return list(delivered)

    def found(self, shifts: Sequence[float]) -> None:
        """By how many standard deviations each of those was stale, oldest first."""
        stale = [i for i, shift in enumerate(shifts) if shift > _UNSETTLED]
        self.reach = len(shifts) - stale[0] if stale else 0
