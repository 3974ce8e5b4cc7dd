"""Python factors delivered as native ones, entered when the heading is settled, renewed, and watched.

GTSAM hands each Python factor a copy of all `Values`, so that one of them costs more the larger the graph is.
`NativeFactors` gives the graph a `LinearContainerFactor` instead, a quadratic that GTSAM evaluates by itself
without Python, keeps the Python factor aside, and replaces the quadratic when it has grown stale: when its
gradient at the present estimate differs from the factor's own by more than `tolerance` standard deviations.

    native = NativeFactors()
    graph.push_back(keyframe_field_factor(...))
    native.update(isam, graph, values)               # instead of isam.update(graph, values)
    native.health                                    # consistent, suspect or inconsistent, and by what

A batch: `graph, values = native.solve(graph, values)`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from magyc_gtsam.factors.alignment import AlignmentLimits, CoarseAlignment, Verdict, heading_sigma, rotation_of
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.guard import factor_details
from magyc_gtsam.factors.health import BlockFit, Health, HealthLimits, Monitor, Word, block_fit
from magyc_gtsam.factors.kernels import narrowed
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import Solver, View, update_solver
from magyc_gtsam.factors.variables import Array

_VAGUE = np.diag(
    np.r_[np.full(6, 1 / 0.5**2), np.full(3, 1.0)]
)  # of soft and hard iron, the latter times the field
_NO_IRON = np.r_[1.0, 0, 0, 1, 0, 1, 0, 0, 0]
_QUIET = 4  # blocks after those that had waited, until their quadratics are renewed, that are not judged
_UNSETTLED, _EARLY = 1.0, 30  # standard deviations by which quadratics are stale, so that the first blocks wait
_RECENT_KERNELS = 40  # blocks by whose misfit a kernel's width is set
_EVERY = 4  # blocks between two looks at what priors hold


@dataclass(eq=False)
class _Delivered:
    """A Python factor, the quadratic that stands for it, and the quadratic's slot in the solver's graph."""

    factor: gtsam.NonlinearFactor
    details: BlockDetails | None
    native: gtsam.NonlinearFactor
    slot: int = -1
    made_at: tuple[Array, Array] | None = None  # attitude (3, 3) and calibration (9,) of the quadratic


def native_factor(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.LinearContainerFactor:
    """The factor's quadratic at `point`, which must hold its keys: native, picklable, free of Python.

    Of a `field_chain_factor` at its solution it is the whole log's marginal, a prior for the next mission.
    """
    return gtsam.LinearContainerFactor(_square_root(factor, point), point)


class NativeFactors:
    """Magnetometer factors in iSAM2, a fixed-lag smoother or a batch.

    Args:
        tolerance: standard deviations, of each variable given one factor alone, by which that factor's
            stale gradient may shift the variable.
        growth: of the number of factors between two checks of all of them.
        recent: blocks that are checked at each update that brings one; early on, one of them at every other update.
        quadratic: False leaves the Python factors as they are, for graphs that stay small; alignment and health
            are the same.
        alignment: limits of the coarse alignment; None lets every block enter at once.
        health: limits of the word; None computes no NIS. Blocks of a disturbance that is over leave the graph.

    Attributes:
        replaced: number of replacements so far.
        withdrawn: number of blocks taken out again because a disturbance lay on them.
        health: the word at present.
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
        if not (tolerance > 0 and growth > 1):
            raise MagycError(f"native factors: tolerance {tolerance} must be above 0, growth {growth} above 1")
        if recent < 1:
            raise MagycError(f"native factors: recent {recent}; at least 1 block must be checked")
        self.tolerance, self.growth, self.recent, self.quadratic = tolerance, growth, recent, quadratic
        self.replaced = 0
        self.withdrawn = 0
        self._alignment = None if alignment is None else CoarseAlignment(alignment)
        self._monitor = None if health is None else Monitor(health)
        self._delivered: list[_Delivered] = []
        self._waiting: list[_Delivered] = []
        self._held_values = gtsam.Values()
        self._entered = alignment is None
        self._pull: gtsam.NonlinearFactor | None = None
        self._pull_slot = -1
        self._prior: tuple[Array, Array] | None = None
        self._held: dict[int, gtsam.NonlinearFactor] = {}
        self._next = 2.0
        self._turn = 0
        self._quiet = self._judged = 0
        self._robust: list[BlockDetails] = []
        self._blocks = 0

    def __len__(self) -> int:
        return len(self._delivered) + len(self._waiting)

    @property
    def waiting(self) -> int:
        """Number of blocks that wait for the heading."""
        return len(self._waiting)

    @property
    def health(self) -> Health:
        """Whether the blocks agree with the rest of the graph, and what does not."""
        if self._monitor is None or self._waiting:
            return Health(Word.WAITING if self._waiting else Word.CONSISTENT)
        return self._monitor.health

    @property
    def fits(self) -> tuple[BlockFit, ...]:
        """How the last blocks fitted, oldest first."""
        return () if self._monitor is None else tuple(self._monitor.fits)

    def update(
        self,
        solver: Solver,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values | None = None,
        timestamps: Mapping[int, float] | None = None,
    ) -> Any:
        """Update a solver with new factors, the Python ones among them delivered as native ones.

        Args:
            solver: `ISAM2`, `IncrementalFixedLagSmoother` or `BatchFixedLagSmoother`.
            graph: the new factors; it is not changed. In the solver the others come first, in their order.
            values: the new variables.
            timestamps: {key: s}, of a fixed-lag smoother.

        Returns:
            What the solver's own `update` returns.

        Raises:
            MagycError: as the factors; a solver of another kind; new keys of a smoother without a time stamp.
        """
        view = View(solver, values)
        pushed, fresh = self._sorted(graph)
        remove: list[int] = []
        self._forget(view)
        self._warm_up(view, fresh)
        remove += self._disturbed()
        entering = self._align(view, fresh, pushed, remove)
        renewed = [each for each in self._to_check(bool(fresh)) if self._renewed(each, view)]
        remove += [each.slot for each in renewed]
        for each in entering:
            self._make(each, view)
        self._delivered += entering
        first = pushed.size()
        for each in entering + renewed:
            pushed.push_back(each.native)
        new = self._covered(view.new, pushed, solver)
        result, slots = update_solver(solver, pushed, new, timestamps, remove)
        self._place(solver, entering + renewed, slots, first)
        if self._monitor is not None and self._entered:
            self._quiet = _QUIET if len(entering) > len(fresh) else self._quiet
            for each in [] if self._quiet else entering:
                self._judged += 1
                self._examine(each, View(solver))
            self._quiet = max(self._quiet - len(entering), 0)
        return result

    def settle(self, solver: Solver, timestamps: Mapping[int, float] | None = None, *, rounds: int = 20) -> int:
        """Update until no quadratic is stale, as after a loop closure or for a final result; the rounds needed.

        Args:
            solver: as in `update`.
            timestamps: {key: s} of the keys that must stay in a fixed-lag smoother.
            rounds: at most.
        """
        for count in range(rounds):
            view = View(solver)
            renewed = [each for each in self._delivered if self._renewed(each, view)]
            if not renewed:
                return count
            graph = gtsam.NonlinearFactorGraph()
            for each in renewed:
                graph.push_back(each.native)
            remove = [each.slot for each in renewed]
            _, slots = update_solver(solver, graph, gtsam.Values(), timestamps, remove)
            self._place(solver, renewed, slots, 0)
        return rounds

    def solve(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        optimize: Callable[[gtsam.NonlinearFactorGraph, gtsam.Values], gtsam.Values] | None = None,
        *,
        rounds: int = 20,
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """A batch: its graph with the Python factors as quadratics at the solution, and the solution.

        Args:
            graph, values: the whole problem; neither is changed.
            optimize: (graph, values) → values; default Levenberg–Marquardt. For `GncLMOptimizer` call
                `setAllowNonNoiseModelFactors(True)` and give the indices of the quadratics, which are the last
                ones, and of the odometry as known inliers.
            rounds: of optimising and renewing, at most.
        """
        run = optimize or (lambda g, v: gtsam.LevenbergMarquardtOptimizer(g, v).optimize())
        own, fresh = self._sorted(graph)
        for each in fresh:
            if each.details is not None and self._alignment is not None and not each.details.on_direction:
                self._alignment.add(each.details)
        if self._alignment is not None and len(self._alignment):
            prior = _calibration_before(View(values), own, self._alignment.last)
            for _ in range(self._alignment.limits.persistence):
                verdict = self._alignment.judge(values, *prior)
            if verdict is Verdict.FAR:
                values = self._turned(own, values, fresh[-1], run)
        first = own.size()
        self._delivered, self._entered = fresh, True
        self._warm_up(View(values), fresh)
        for i, each in enumerate(fresh):
            self._make(each, View(values))
            each.slot = first + i
            own.push_back(each.native)
        for _ in range(rounds):
            values = run(own, values)
            self._warm_up(View(values), [])
            stale = [each for each in fresh if self._renewed(each, View(values))]
            if not stale:
                break
            for each in stale:
                own.replace(each.slot, each.native)
        return own, values

    # --- what enters -----------------------------------------------------------------------------------------

    def _sorted(self, graph: gtsam.NonlinearFactorGraph) -> tuple[gtsam.NonlinearFactorGraph, list[_Delivered]]:
        """The caller's other factors, and the Python ones."""
        others, fresh = gtsam.NonlinearFactorGraph(), []
        for i in range(graph.size()):
            factor = graph.at(i)
            details = factor_details(factor)
            if details is None:
                others.push_back(factor)
                if isinstance(factor, gtsam.PriorFactorRot3 | gtsam.PriorFactorDouble):
                    self._held[factor.keys()[0]] = factor
                continue
            fresh.append(_Delivered(factor, details if isinstance(details, BlockDetails) else None, factor))
        return others, fresh

    def _align(
        self, view: View, fresh: list[_Delivered], pushed: gtsam.NonlinearFactorGraph, remove: list[int]
    ) -> list[_Delivered]:
        """The blocks that enter now; a prior that turns the graph goes into `pushed`, what must go into `remove`."""
        alignment = self._alignment
        blocks = [each for each in fresh if each.details is not None and not each.details.on_direction]
        if alignment is None or not blocks:
            if self._entered:
                return fresh
            self._waiting += blocks
            return [each for each in fresh if each not in blocks]
        for each in blocks:
            assert each.details is not None
            alignment.add(each.details)
        last = blocks[-1].details
        assert last is not None
        if self._prior is None:
            self._prior = _calibration_before(view, pushed, last)
        if alignment.full and self._entered:
            self._alignment = None
            return fresh
        point = view.values(alignment.needed)
        verdict = alignment.judge(point, *self._prior) if alignment.due else Verdict.UNDECIDED
        if verdict is Verdict.NEAR:
            if not self._entered:
                self._restart_monitor()
            self._alignment, self._entered = None, True
            if self._pull is not None:
                remove.append(self._pull_slot)
                self._pull = None
            entering, self._waiting = self._waiting + fresh, []
            return entering
        if verdict is Verdict.FAR:
            for each in self._delivered:
                if each.details is not None:
                    remove.append(each.slot)
                    self._waiting.append(each)
            self._delivered = [each for each in self._delivered if each.details is None]
            self._entered = False
            self._restart_monitor()
            if self._pull is not None:
                remove.append(self._pull_slot)
            pull = alignment.pull(point, last.attitude_key)
            self._pull, self._pull_slot = pull, -1
            pushed.push_back(pull)
        elif not self._entered and self._pull is None and self._sure(view, point, last.attitude_key):
            self._entered = True
            entering, self._waiting = self._waiting + fresh, []
            return entering
        if self._entered:
            return fresh
        self._waiting += blocks
        return [each for each in fresh if each not in blocks]

    def _restart_monitor(self) -> None:
        if self._monitor is not None:
            self._monitor, self._judged = Monitor(self._monitor.limits), 0

    def _sure(self, view: View, point: gtsam.Values, key: int) -> bool:
        """Whether the graph itself is sure of its heading, at the last pose that the solver holds."""
        assert self._alignment is not None
        held = [each for each in self._alignment.attitudes if not view.new.exists(each) and view.exists(each)]
        if not held:
            return False
        covariance = view.covariance(held[-1:])
        if covariance is None:
            return False
        return heading_sigma(point, held[-1], covariance) < self._alignment.limits.confident

    def _turned(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        last: _Delivered,
        run: Callable[[gtsam.NonlinearFactorGraph, gtsam.Values], gtsam.Values],
    ) -> gtsam.Values:
        """The values of a batch after its other factors and a prior on the heading."""
        assert self._alignment is not None
        assert last.details is not None
        turning = gtsam.NonlinearFactorGraph()
        turning.push_back(graph)
        turning.push_back(self._alignment.pull(values, last.details.attitude_key))
        loose = gtsam.noiseModel.Isotropic.Sigma
        for key in {last.details.soft_iron_key, last.details.hard_iron_key} - set(turning.keyVector()):
            turning.addPriorVector(key, values.atVector(key), loose(values.atVector(key).size, 1.0))
        known = set(turning.keyVector())
        start = gtsam.Values(values)
        for key in list(values.keys()):
            if key not in known:
                start.erase(key)
        found = run(turning, start)
        result = gtsam.Values(values)
        result.update(found)
        return result

    def _covered(self, new: gtsam.Values, pushed: gtsam.NonlinearFactorGraph, solver: Solver) -> gtsam.Values:
        """The new values that a factor of this update stands on; others are kept until theirs enters."""
        if not self._waiting and self._held_values.empty():
            return new
        self._held_values.insert(new)
        used, result = set(pushed.keyVector()), gtsam.Values()
        result.insert(self._held_values)
        for key in list(self._held_values.keys()):
            (self._held_values if key in used else result).erase(key)
        return result

    def _forget(self, view: View) -> None:
        """Drop what stands on keys that have left a fixed-lag smoother."""
        if isinstance(view.solver, gtsam.ISAM2 | gtsam.Values):
            return
        self._delivered = [each for each in self._delivered if all(map(view.exists, each.factor.keys()))]
        gone = [each for each in self._waiting if not all(map(view.exists, each.factor.keys()))]
        if gone:
            self._waiting = [each for each in self._waiting if each not in gone]
        if self._alignment is not None:
            self._alignment.drop([key for key in self._alignment.needed if not view.exists(key)])

    def _disturbed(self) -> list[int]:
        """The slots of blocks in disturbances that are over, which leave the graph."""
        if self._monitor is None or not self._monitor.over:
            return []
        spans = [self._monitor.over.pop() for _ in range(len(self._monitor.over))]

        def inside(each: _Delivered) -> bool:
            return each.details is not None and any(
                first <= each.details.block.time < last for first, last in spans
            )

        gone = [each for each in self._delivered if inside(each)]
        self._delivered = [each for each in self._delivered if not inside(each)]
        self.withdrawn += len(gone)
        self._quiet = 3
        return [each.slot for each in gone]

    # --- what is renewed -------------------------------------------------------------------------------------

    def _to_check(self, brings_a_block: bool) -> list[_Delivered]:
        """All factors each time that their number has grown, else the last ones, one of them between blocks."""
        if not self._delivered or not self.quadratic:
            return []
        if len(self._delivered) >= self._next:
            self._next = self.growth * len(self._delivered)
            return list(self._delivered)
        last = self._delivered[-self.recent :]
        if brings_a_block or self._judged >= _EARLY:
            return last if brings_a_block else []
        self._turn += 1
        return [last[self._turn % len(last)]]

    def _make(self, delivered: _Delivered, view: View) -> None:
        """The quadratic at the present estimate."""
        if self.quadratic:
            point = view.values(delivered.factor.keys())
            delivered.native = native_factor(delivered.factor, point)
            delivered.made_at = _place_of(delivered.details, point)

    def _renewed(self, delivered: _Delivered, view: View) -> bool:
        """Whether the quadratic was stale; it is a new one then."""
        if not self.quadratic:
            return False
        point = view.values(delivered.factor.keys())
        if self._moved_little(delivered, point):
            return False
        exact = _square_root(delivered.factor, point)
        shift = _shift(exact, delivered.native.linearize(point))
        watching = self._monitor is not None and self._monitor.open
        if shift > _UNSETTLED and self._judged < _EARLY and not watching:
            self._quiet = _QUIET
        if shift <= self.tolerance:
            return False
        delivered.native = gtsam.LinearContainerFactor(exact, point)
        delivered.made_at = _place_of(delivered.details, point)
        self.replaced += 1
        return True

    def _moved_little(self, delivered: _Delivered, point: gtsam.Values) -> bool:
        """Whether the block is certainly fresh: its residual is bilinear in attitude and calibration, so that what a
        quadratic lacks is at most of second order in what they have moved."""
        details, made_at = delivered.details, delivered.made_at
        if details is None or made_at is None or details.width != 1.0 or len(delivered.factor.keys()) > 3:
            return False
        here = _place_of(details, point)
        if here is None:
            return False
        angle = 0.5 * float(np.sum((here[0] - made_at[0]) ** 2))  # squared, to second order
        iron = float(np.linalg.norm(here[1][:6] - made_at[1][:6]))
        assert details.field is not None  # else `_place_of` is None
        lost = np.linalg.norm(details.field) * (0.5 * angle + np.sqrt(angle) * iron)  # T
        return bool(lost * np.sqrt(details.block.samples) < self.tolerance * details.sigma)

    def _place(self, solver: Solver, placed: list[_Delivered], slots: list[int] | None, first: int) -> None:
        """Learn the slots of what was pushed."""
        if slots is None and isinstance(solver, gtsam.BatchFixedLagSmoother):  # look them up
            factors = solver.getFactors()
            for i in reversed(range(factors.size())):
                if not factors.exists(i):
                    continue
                factor = factors.at(i)
                for each in placed:
                    if factor is each.native:
                        each.slot = i
                if factor is self._pull:
                    self._pull_slot = i
            return
        assert slots is not None
        for i, each in enumerate(placed):
            each.slot = slots[first + i]
        if self._pull is not None and self._pull_slot < 0:
            self._pull_slot = slots[first - 1]

    def _warm_up(self, view: View, fresh: list[_Delivered]) -> None:
        """Kernels start wide and narrow as the blocks come to fit."""
        for each in fresh:
            if each.details is not None and each.details.robust is not None:
                each.factor.error(view.values(each.factor.keys()))  # sets `misfit`
                self._robust.append(each.details)
        robust = self._robust
        if not robust:
            return
        width = narrowed([details.misfit for details in robust[-_RECENT_KERNELS:]])
        for details in robust:
            details.width = width

    # --- what is watched -------------------------------------------------------------------------------------

    def _examine(self, each: _Delivered, view: View) -> None:
        """The NIS of a block that has entered, and at times what priors hold."""
        details, monitor = each.details, self._monitor
        keys = list(each.factor.keys())
        if details is None or monitor is None or not all(map(view.exists, keys)):
            return
        covariance = view.covariance(keys)
        if covariance is None:
            return
        point = view.values(keys)
        augmented = each.native.linearize(point).augmentedInformation()
        zero = point.zeroVectors()
        sizes = [zero.at(key).size for key in keys]
        start = sum(sizes[: keys.index(details.hard_iron_key)])
        unit = details.field_unit
        nis, freedom, scatter, offset, spread = block_fit(
            augmented[:-1, :-1],
            augmented[:-1, -1],
            float(augmented[-1, -1]),
            covariance,
            3 * details.block.samples,
            slice(start, start + 3),
        )
        monitor.add(
            BlockFit(
                details.block.time,
                nis,
                freedom,
                scatter,
                offset * unit,
                float(np.sqrt(max(np.trace(spread), 0.0))) * unit,
                unvech(point.atVector(details.soft_iron_key)),
                point.atPoint3(details.hard_iron_key) * unit,
                (details.block.design[:, :, :3] @ _body_field(details, point)).mean(axis=0),
                details.block.field.mean(axis=0),
            )
        )
        self._blocks += 1
        if self._blocks % _EVERY == 0:
            for key in set(keys) & set(self._held):
                self._examine_held(view, key, details.block.time)

    def _examine_held(self, view: View, key: int, time: float) -> None:
        """Whether the data have moved a mounting or a delay from its prior by more than both allow."""
        assert self._monitor is not None
        covariance, prior = view.covariance([key]), self._held[key]
        if covariance is None:
            return
        linear = gtsam.JacobianFactor(gtsam.HessianFactor(prior.linearize(view.values([key]))))
        augmented = linear.augmentedInformation()
        before = np.linalg.inv(augmented[:-1, :-1])
        moved = before @ augmented[:-1, -1]
        weight, axes = np.linalg.eigh(before - covariance)
        seen = weight > 0.1 * np.diag(before).max()  # where the data know better than the prior
        distance = float(np.sum((axes.T[seen] @ moved) ** 2 / weight[seen]))
        if len(moved) == 3:
            text = f"mounting {np.degrees(np.linalg.norm(moved)):.1f}° from its prior"
        else:
            text = f"delay {abs(float(moved[0])) * 1e3:.1f} ms from its prior"
        self._monitor.hold(gtsam.DefaultKeyFormatter(key), distance, int(seen.sum()), text, time)


def _calibration_before(
    view: View, graph: gtsam.NonlinearFactorGraph, details: BlockDetails
) -> tuple[Array, Array]:
    """Mean (9,) and information (9, 9) of soft and hard iron before any block: of the solver, or of new priors."""
    keys = [details.soft_iron_key, details.hard_iron_key]
    strength = 50e-6 if details.field is None else float(np.linalg.norm(details.field))
    unit = np.r_[np.ones(6), np.full(3, details.field_unit / strength)]
    information = 1e-3 * _VAGUE * unit * unit[:, None]
    right = information @ _NO_IRON
    point = view.values(keys)
    start = np.r_[point.atVector(keys[0]), point.atPoint3(keys[1])]
    if not any(map(view.new.exists, keys)):
        covariance = view.covariance(keys)
        if covariance is not None:
            known = np.linalg.inv(covariance)
            return np.linalg.solve(information + known, right + known @ start), information + known
    priors = gtsam.NonlinearFactorGraph()
    for i in range(graph.size()):
        if set(graph.at(i).keys()) <= set(keys):
            priors.push_back(graph.at(i))
    if priors.size() and set(priors.keyVector()) == set(keys):
        ordering = gtsam.Ordering()
        for key in keys:
            ordering.push_back(key)
        known, gradient = priors.linearize(point).hessian(ordering)
        information, right = information + known, right + gradient + known @ start
    else:
        information, right = 1e3 * information, 1e3 * right
    return np.linalg.solve(information, right), information


def _place_of(details: BlockDetails | None, point: gtsam.Values) -> tuple[Array, Array] | None:
    """Attitude and calibration at which a block with a known field is linearised."""
    if details is None or details.field is None or details.on_direction:
        return None
    calibration = np.r_[point.atVector(details.soft_iron_key), point.atPoint3(details.hard_iron_key)]
    return rotation_of(point, details.attitude_key), calibration


def _body_field(details: BlockDetails, point: gtsam.Values) -> Array:
    """(3,) T, the world's field in the body frame at a block's keyframe."""
    if details.on_direction:
        assert details.field is not None
        result: Array = point.atUnit3(details.attitude_key).point3() * details.field
        return result
    if details.field is None:
        assert details.field_key is not None
        field = point.atPoint3(details.field_key) * details.field_unit
    else:
        field = details.field
    return rotation_of(point, details.attitude_key).T @ field


def _square_root(factor: gtsam.NonlinearFactor, point: gtsam.Values) -> gtsam.JacobianFactor:
    """The factor's linearisation in as few rows as its keys have columns, and one for the rest."""
    return gtsam.JacobianFactor(gtsam.HessianFactor(factor.linearize(point)))


def _shift(exact: gtsam.GaussianFactor, stale: gtsam.GaussianFactor) -> float:
    """Largest difference of two gradients, in standard deviations of each variable given the factor alone."""
    first, second = exact.augmentedInformation(), stale.augmentedInformation()
    information: Array = np.diag(first)[:-1]
    difference = np.abs(first[:-1, -1] - second[:-1, -1])[information > 0]
    return float((difference / np.sqrt(information[information > 0])).max())
