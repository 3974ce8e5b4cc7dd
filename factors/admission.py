"""Admission of blocks to a graph: at once, or once its heading is settled; until then they and their variables wait."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import gtsam
import numpy as np

from magyc_gtsam.factors.alignment import AlignmentLimits, CoarseAlignment, HeadingVerdict
from magyc_gtsam.factors.calibration_before import calibration_before
from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.heading_pull import HeadingPull, known_heading, linearized_near, solved_turn
from magyc_gtsam.factors.health import CHECK_AXES, Health, HealthStatus
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array


@dataclass(eq=False)
class Admission:
    """The changes to the blocks of a graph in one update.

    Attributes:
        entering: factors that enter now.
        leaving: factors that leave the graph and wait.
        pull: prior that turns the graph from now on.
        remove: slots of factors that leave the graph for good, besides those of `leaving`.
        turned: whether the graph is being or has been turned, which invalidates all earlier verdicts.
    """

    entering: list[Delivered]
    leaving: list[Delivered] = field(default_factory=list)
    pull: HeadingPull | None = None
    remove: list[int] = field(default_factory=list)
    turned: bool = False


class HeadingContradiction(NamedTuple):
    """A heading of the blocks that the other factors contradict: its angle from theirs, rad, and since when, s."""

    angle: float
    since: float


class AdmissionControl:
    """Keeps blocks waiting while the coarse alignment contradicts the heading, and turns the graph by a prior.

    Args:
        limits: limits of the coarse alignment; None lets every block enter at once.

    Attributes:
        waiting: factors that wait.
        entered: whether blocks have entered.
        pull: prior that turns the graph while they wait; `pull_slot` is its slot in the solver, `since` when in s the
            first such prior came.
        contradiction: why no prior turns the graph any more, although the blocks' heading is far from its own; None
            while the other factors do not contradict the blocks.
    """

    def __init__(self, limits: AlignmentLimits | None) -> None:
        self._alignment = None if limits is None else CoarseAlignment(limits)
        self.waiting: list[Delivered] = []
        self.entered = limits is None
        self.pull: HeadingPull | None = None
        self.pull_slot = -1
        self.contradiction: HeadingContradiction | None = None
        self.since = float("nan")
        self._resisted = 0  # consecutive blocks at which the other factors contradicted the prior
        self._values = gtsam.Values()
        self._prior: tuple[Array, Array] | None = None

    def admit(
        self, view: View, fresh: list[Delivered], delivered: list[Delivered], others: gtsam.NonlinearFactorGraph
    ) -> Admission:
        """Decide which blocks enter and leave in an update that brings the factors `fresh` and `others`."""
        alignment = self._alignment
        blocks = [each for each in fresh if each.is_block] if fresh else fresh
        if alignment is None or not blocks:
            return self._as_before(fresh, blocks)
        for each in blocks:
            assert each.details is not None
            alignment.add(each.details)
        last = blocks[-1].details
        assert last is not None
        if self._prior is None:
            self._prior = calibration_before(view, others, last)
        if alignment.full and self.entered:
            self._alignment = None
            return Admission(fresh)
        point = view.values(alignment.needed)
        verdict = alignment.judge(point, *self._prior) if alignment.due else HeadingVerdict.UNDECIDED
        resisted = self._resists(view, last.block.time)
        if verdict is HeadingVerdict.NEAR and not resisted and not self._turning(view):
            admission = Admission(self.waiting + fresh, remove=self._without_pull(), turned=not self.entered)
            self._alignment, self.entered, self.waiting = None, True, []
            self.contradiction = None
            return admission
        if self.contradiction is not None and self.pull is not None:  # the graph is left to its other factors
            self.waiting += blocks
            entering = [each for each in fresh if each not in blocks]
            return Admission(entering, remove=self._without_pull(), turned=True)
        if verdict is HeadingVerdict.FAR or (
            verdict is HeadingVerdict.APART and self.entered and alignment.apart >= alignment.limits.persistence
        ):
            leaving = [each for each in delivered if each.details is not None]
            self.waiting += leaving + blocks
            self.entered = False
            admission = Admission([each for each in fresh if each not in blocks], leaving, turned=True)
            if verdict is HeadingVerdict.APART:  # the graph alone, or later blocks, will decide
                return admission
            if self.contradiction is None:
                self.since = last.block.time if self.pull is None else self.since
                admission.remove += self._without_pull()
                assert alignment.profile is not None
                turn = alignment.profile.best, alignment.limits.pull
                self.pull = admission.pull = HeadingPull.of(point, last.attitude_key, *turn)
            return admission
        undecided = verdict is HeadingVerdict.UNDECIDED and self.contradiction is None
        if undecided and not self.entered and self.pull is None and self._sure(view, point):
            self.entered = True
            entering, self.waiting = self.waiting + fresh, []
            return Admission(entering)
        return self._as_before(fresh, blocks)

    def _as_before(self, fresh: list[Delivered], blocks: list[Delivered]) -> Admission:
        """Admit the fresh factors where blocks have entered before; otherwise keep their blocks waiting."""
        if self.entered:
            return Admission(fresh)
        self.waiting += blocks
        return Admission([each for each in fresh if each not in blocks])

    def _resists(self, view: View, time: float) -> bool:
        """Return whether the other factors contradict the prior, which becomes a contradiction if it lasts."""
        assert self._alignment is not None
        profile = self._alignment.profile
        if self.pull is None:
            if self.contradiction is not None and profile is not None:
                self.contradiction = self.contradiction._replace(angle=profile.best)
            return False
        angle = self.pull.resisted(view) if self.pull_slot >= 0 else None
        self._resisted = 0 if angle is None else self._resisted + 1
        if angle is not None and self._resisted >= self._alignment.limits.resisted:
            self.contradiction = HeadingContradiction(angle, time)
        return angle is not None

    def _without_pull(self) -> list[int]:
        """Return the slot of the prior that turns the graph, which is to be removed, if there is one."""
        slots = [] if self.pull is None else [self.pull_slot]
        self.pull, self.pull_slot = None, -1
        return slots

    def _sure(self, view: View, point: gtsam.Values) -> bool:
        """Whether the graph's own heading is certain enough, at the last pose that the solver holds."""
        assert self._alignment is not None
        key, limits = self._held(view), self._alignment.limits
        sigma = None if key is None else known_heading(view, point, key)
        if key is None or sigma is None or sigma >= limits.confident:
            return False
        turn = solved_turn(view, key)
        return turn is not None and turn < limits.steady

    def _turning(self, view: View) -> bool:
        """Whether the graph has not settled at the heading at which the blocks would enter."""
        assert self._alignment is not None
        key = self._held(view)
        if key is None or self.entered:
            return False
        turn = solved_turn(view, key) if linearized_near(view, key) else np.inf
        return turn is not None and turn > self._alignment.limits.near

    def _held(self, view: View) -> int | None:
        """Return the key of the last attitude that the solver holds; None where there is none."""
        assert self._alignment is not None
        held = [key for key in self._alignment.attitudes if not view.new.exists(key) and view.exists(key)]
        return held[-1] if held else None

    @property
    def health(self) -> Health:
        """The health of a graph while blocks wait."""
        if self.contradiction is not None:
            angle, since = self.contradiction
            text = f"heading by the blocks {abs(np.degrees(angle)):.0f}° from that of the other factors"
            return Health(HealthStatus.INCONSISTENT, f"{text}, so that no block enters: {CHECK_AXES}", since)
        if self.pull is not None:
            return Health(HealthStatus.WAITING, "a prior turns the graph to the heading of the blocks", self.since)
        return Health(HealthStatus.WAITING)

    @property
    def defers(self) -> bool:
        """Whether blocks or variables are waiting."""
        return bool(self.waiting) or not self._values.empty()

    @property
    def changing(self) -> list[object]:
        """The objects that an update changes."""
        return [self] if self._alignment is None else [self, self._alignment]

    def joined(self, new: gtsam.Values) -> gtsam.Values:
        """Return new values together with those that are kept until their factor enters."""
        if self._values.empty():
            return new
        result = gtsam.Values(self._values)
        result.insert(new)
        return result

    def covered(self, new: gtsam.Values, pushed: gtsam.NonlinearFactorGraph) -> gtsam.Values:
        """Return those of the `joined` values that a factor of this update uses; keep the others."""
        if not self.defers:
            return new
        used, result = set(pushed.keyVector()), gtsam.Values(new)
        self._values = gtsam.Values(new)
        for key in list(new.keys()):
            (self._values if key in used else result).erase(key)
        return result

    def placed(self, slot: int) -> None:
        """Record the slot of the prior that turns the graph; −1 where its attitude has already left the solver."""
        self.pull_slot = slot
        if slot < 0:
            self.pull = None

    def forget(self, view: View) -> None:
        """Remove the factors on keys that have left the solver."""
        self.waiting = [each for each in self.waiting if all(map(view.exists, each.factor.keys()))]
        if self._alignment is not None:
            self._alignment.drop([key for key in self._alignment.needed if not view.exists(key)])
