"""Conversion of Python factors to native ones that enter once the heading is settled, are renewed, and monitored.

GTSAM hands each Python factor a copy of all `Values`, at a cost that grows with the graph. `NativeFactors` gives it a
`LinearContainerFactor` instead, a quadratic without Python, and replaces that once it is stale: when its gradient at
the present estimate differs from the Python factor's own by more than `tolerance` standard deviations.

    native.update(isam, graph, values)               # instead of isam.update(graph, values)
    native.health                                    # consistent, suspect or inconsistent, with the cause
    graph, values = native.solve(graph, values)      # a batch
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gtsam

from magyc_gtsam.factors.admission import AdmissionControl
from magyc_gtsam.factors.alignment import AlignmentLimits
from magyc_gtsam.factors.batch import best_solution
from magyc_gtsam.factors.block_fit import BlockFit
from magyc_gtsam.factors.delivered import Delivered, Sorted, sorted_factors
from magyc_gtsam.factors.elimination import eliminated_last
from magyc_gtsam.factors.examination import Examiner
from magyc_gtsam.factors.health import UNJUDGED, Health, HealthLimits
from magyc_gtsam.factors.intake import NotSaved, expect_options, expect_problem, expect_values, unchanged_on_error
from magyc_gtsam.factors.one_sensor import expect_one_sensor
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.factors.residence import Residence, present
from magyc_gtsam.factors.solver import Solver, View, new_slots, update_solver, with_factors
from magyc_gtsam.factors.staleness import Staleness
from magyc_gtsam.factors.turned_start import Optimize
from magyc_gtsam.factors.variables import Array
from magyc_gtsam.factors.warm_up import WarmUp, robust_blocks


class NativeFactors(NotSaved):
    """Magnetometer factors in iSAM2, a fixed-lag smoother or a batch.

    Args:
        tolerance: standard deviations, of each variable given one factor alone, by which that factor's stale gradient
            may shift the variable.
        growth: factor of the number of factors between two checks of all of them.
        recent: number of latest blocks that are checked at each update with a new block, and at every update until
            they are settled.
        quadratic: False keeps the Python factors as they are, for graphs that stay small; alignment and health do not
            change.
        alignment: limits of the coarse alignment; None lets every block enter at once.
        health: limits of the health; None judges no block. Blocks of a disturbance that has ended leave the graph.

    Attributes:
        replaced: number of replacements so far.
        withdrawn: number of blocks removed because they were disturbed.
        settled: whether the last `solve` ended at a minimum, with no kernel narrowing (`optimize`: no stale quadratic).
    """

    def __init__(
        self,
        tolerance: float = 0.05,
        growth: float = 2.0,
        *,
        recent: int = 4,
        quadratic: bool = True,
        alignment: AlignmentLimits | None = AlignmentLimits(),  # noqa: B008 (frozen)
        health: HealthLimits | None = HealthLimits(),  # noqa: B008 (frozen)
    ) -> None:
        expect_options(tolerance, growth, recent, quadratic, alignment, health)
        self.tolerance, self.quadratic = tolerance, quadratic
        self.replaced = 0
        self.withdrawn = 0
        self.settled = False
        self._alignment, self._admission = alignment, AdmissionControl(alignment)
        self._examiner = None if health is None else Examiner(health)
        self._delivered: list[Delivered] = []
        self._residence = Residence()
        self._kernels = WarmUp()
        self._staleness = Staleness(recent, growth)

    def __len__(self) -> int:
        return len(self._delivered) + len(self._admission.waiting)

    @property
    def waiting(self) -> int:
        """Number of blocks that wait for the heading."""
        return len(self._admission.waiting)

    @property
    def health(self) -> Health:
        """The agreement of the blocks with the rest of the graph, and the cause of any contradiction."""
        if self.waiting:
            return self._admission.health
        return UNJUDGED if self._examiner is None else self._examiner.monitor.health

    @property
    def mounting_error(self) -> Array | None:
        """Rotation θ (3,) in rad for which ᵇRₛ Exp(θ) is the blocks' correct mounting; None where it is not wrong."""
        return None if self._examiner is None else self._examiner.mounting.error

    @property
    def mounting_sigma(self) -> Array | None:
        """Standard deviations (3,) in rad of θ by the graph, below which no error is found; None before a solution."""
        return None if self._examiner is None else self._examiner.mounting.sigma

    @property
    def field_error(self) -> float | None:
        """Angle ψ in rad about the world's z for which Rz(ψ) f is the correct field; None where it is not wrong."""
        error = None if self._examiner is None else self._examiner.field.error
        return None if error is None else float(error[0])

    @property
    def fits(self) -> tuple[BlockFit, ...]:
        """The fits of the last blocks, oldest first."""
        return () if self._examiner is None else tuple(self._examiner.monitor.fits)

    def update(
        self,
        solver: Solver,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values | None = None,
        timestamps: Mapping[int, float] | None = None,
    ) -> Any:
        """Update a solver with new factors, replacing the Python ones among them by native ones.

        Args:
            solver: `ISAM2`, `IncrementalFixedLagSmoother` or `BatchFixedLagSmoother`.
            graph: the new factors; it is not changed. In the solver the other factors come first, in their order.
            values: the new variables.
            timestamps: {key: s}, for a fixed-lag smoother.

        Returns:
            The result of the solver's own `update`.

        Raises:
            MagycError: errors of the factors; an unsupported solver, or another one than before; arguments of another
                type; a variable without a value; blocks of two sensors, or twice the same; new keys of a smoother
                without a time stamp. The blocks that wait are then those of before.
        """
        values = gtsam.Values() if values is None else values
        expect_problem(graph, values)
        graph, self._delivered = self._residence.entered(solver, graph, self._delivered)
        new = sorted_factors(graph)
        if new.holding and self._examiner is not None:
            self._examiner.note_priors(new.holding)
        if new.fresh or self._pending:
            result = self._update_blocks(solver, new, values, timestamps)
        else:
            result = update_solver(solver, graph, values, timestamps, [])
        self._residence.note(solver)
        return result

    @one_thread
    def settle(self, solver: Solver, timestamps: Mapping[int, float] | None = None, *, rounds: int = 20) -> int:
        """Update until no quadratic is stale, e.g. after a loop closure or for a final result; return the rounds
        needed.

        Args:
            solver: as in `update`.
            timestamps: {key: s} of the keys that must stay in a fixed-lag smoother.
            rounds: largest number of rounds.
        """
        self._residence.expect(solver, settling=True)
        for count in range(rounds):
            view = View(solver)
            self._forget(view)
            renewed = self._renew(self._delivered, view)
            if not renewed:
                if self._examiner is not None:
                    self._examiner.judge_late(view, self._delivered, settled=True)
                return count
            graph = with_factors(gtsam.NonlinearFactorGraph(), [each.native for each in renewed])
            remove = [each.slot for each in renewed]
            result = update_solver(solver, graph, gtsam.Values(), timestamps, remove)
            self._place(solver, result, renewed)
        return rounds

    @one_thread
    def solve(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        optimize: Optimize | None = None,
        *,
        rounds: int = 50,
        examine: bool = False,
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Solve a batch; return its graph, with the Python factors as quadratics at the solution, and the solution.

        Args:
            graph, values: the whole problem; neither is changed.
            optimize: (graph, values) → values; default Levenberg–Marquardt. For `GncLMOptimizer` call
                `setAllowNonNoiseModelFactors(True)` and pass the indices of the quadratics, which are the last ones,
                and of the odometry as known inliers.
            rounds: largest number of rounds of optimising and renewing.
            examine: whether to judge each block at the solution, for `health`; takes some milliseconds per block.

        Raises:
            MagycError: a variable of the graph has no value; blocks of two sensors; a batch after updates.
        """
        expect_problem(graph, values)
        self._residence.expect(None)
        expect_values(graph.keyVector(), values.exists)
        new = sorted_factors(graph)
        expect_one_sensor(new.fresh)
        limits, tolerance, quadratic = self._alignment, self.tolerance, self.quadratic
        own, fresh, values, self.settled, replaced = best_solution(
            new, values, limits, optimize, rounds=rounds, tolerance=tolerance, quadratic=quadratic
        )
        self._delivered = self._residence.batch = fresh
        self.replaced += replaced
        if self._examiner is not None:
            self._examiner.note_priors(new.holding)
            self._examiner.judge_batch(fresh, own, values, fits=examine)
        return own, values

    @property
    def _pending(self) -> bool:
        """Whether an update that adds no block has work to do."""
        owes = self._examiner is not None and self._examiner.owes
        return owes or self._staleness.pending or self._admission.defers

    @one_thread
    def _update_blocks(
        self, solver: Solver, new: Sorted, values: gtsam.Values, timestamps: Mapping[int, float] | None
    ) -> Any:
        """Update with new blocks, waiting blocks, or blocks that have to be examined."""
        fresh, examiner = new.fresh, self._examiner
        view = View(solver, self._admission.joined(values))
        expect_values(new.keys, view.exists)
        self._forget(view)
        expect_one_sensor(fresh, self._delivered, self._admission.waiting)
        parts = [self, self._kernels, self._staleness, *self._admission.changing]
        with unchanged_on_error(*parts, *([] if examiner is None else examiner.changing)) as keep:
            for block in robust_blocks(each.factor for each in fresh):
                self._kernels.add(block, view.values(block.factor.keys()))
            self._kernels.narrow()
            disturbed = [] if examiner is None else examiner.disturbed(self._delivered)
            if disturbed:
                self._delivered = [each for each in self._delivered if each not in disturbed]
                self.withdrawn += len(disturbed)
            remove = [each.slot for each in disturbed]
            admission = self._admission.admit(view, fresh, self._delivered, new.others)
            entering = admission.entering
            if admission.turned and examiner is not None:
                examiner.restart()
            if admission.leaving:
                self._delivered = [each for each in self._delivered if each not in admission.leaving]
            due = self._staleness.due(self._delivered, len(entering))
            keep(due)
            renewed = self._renew(due, view)
            remove += [each.slot for each in admission.leaving + renewed] + admission.remove
            for each in entering if self.quadratic else []:
                each.make(view)
            self._delivered += entering
            placed = entering + renewed
            pull = [] if admission.pull is None else [admission.pull.factor]
            pushed = with_factors(new.others, [*pull, *(each.native for each in placed)])
            last = eliminated_last(new.others, entering, renewed)
            added = self._admission.covered(view.new, pushed)
            result = update_solver(solver, pushed, added, timestamps, remove, last)
        if pushed is not new.others:
            self._place(solver, result, placed, pull)
        if examiner is not None:
            examiner.judge_late(View(solver), self._delivered, settled=not self._staleness.unsettled)
            if entering and self._admission.entered:
                judged, waited = [each for each in entering if each.slot >= 0], len(entering) > len(fresh)
                examiner.judge(judged, View(solver), self._delivered, waited=waited)
        return result

    def _forget(self, view: View) -> None:
        """Forget the factors on keys that have left a smoother or were marginalised, and those that others removed."""
        if self._residence.changed(view):
            self._delivered = present(view, self._delivered)
            self._admission.forget(view)

    def _renew(self, delivered: list[Delivered], view: View) -> list[Delivered]:
        """Renew the stale quadratics and return them; Python factors are relinearised by the solver itself."""
        if self.quadratic:
            before = [each.native for each in delivered]
            shifts = [each.renew(view, self.tolerance) for each in delivered]
            renewed = [each for each, native in zip(delivered, before, strict=True) if each.native is not native]
        else:
            shifts, renewed = [each.lag(view) for each in delivered], []
        self.replaced += len(renewed)
        self._staleness.found(shifts)
        if self._staleness.unsettled and self._examiner is not None:
            self._examiner.postpone()
        return renewed

    def _place(
        self, solver: Solver, result: Any, placed: list[Delivered], pull: Sequence[gtsam.NonlinearFactor] = ()
    ) -> None:
        """Store the slots of the factors that were pushed last: the prior that turns the graph, and the quadratics."""
        slots = new_slots(solver, result, [*pull, *(each.native for each in placed)])
        if pull:
            self._admission.placed(slots.pop(0))
        for each, slot in zip(placed, slots, strict=True):
            each.slot = slot
        if -1 in slots:  # an attitude that left a smoother in this very update
            self._delivered = [each for each in self._delivered if each.slot >= 0]
