"""Tests of blocks against the rest of their graph, and of the variables that priors hold."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from scipy.special import chdtrc

from magyc_gtsam.factors.block_fit import BlockFit, block_fit
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.free_fit import free_fit, holds_field
from magyc_gtsam.factors.heading_pull import heading_axis, rotation_of
from magyc_gtsam.factors.health import CHECK_AXES, HealthLimits, Monitor
from magyc_gtsam.factors.held_field import FieldLimits, HeldField
from magyc_gtsam.factors.held_mounting import HeldMounting, MountingLimits
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.solver import View
from magyc_gtsam.factors.variables import Array, key_name

_EVERY = 4  # blocks between two checks of the variables that priors hold
_QUIET = 4  # blocks not judged after waiting blocks have entered, until their quadratics are renewed
_QUIET_AFTER = 3  # blocks not judged after those of a disturbance were removed
_LEAST_SOFT_IRON = 0.1  # eigenvalue of a soft iron where the field is known; 0.8 to 1.2 in instruments
_NEARLY_ZERO = "the readings do not follow the field, as those of a dead, stuck or shielded sensor"
_UNJUDGED = "blocks have entered and are not judged yet: the heading may be off by far more than its sigma"
_UNEXAMINED = "no block is judged without examine=True"
_LOOKS = 8, 100, 4  # range of the numbers of updates with blocks at which blocks that are not judged are looked at
_EARLY = 15  # number of updates with blocks up to which quadratics that are far from settled postpone the judging


class Examiner:
    """Passes each block's fit to a monitor.

    Attributes:
        monitor: derives the health from the fits.
        additions: number of times that blocks have entered since the start or the last restart, judged or not.
        quiet: number of coming blocks that are not judged.
        later: blocks that entered several at a time, e.g. a whole log, to be judged once the graph has settled.
    """

    def __init__(self, limits: HealthLimits) -> None:
        self.monitor = Monitor(limits)
        self.mounting, self.field = HeldMounting(MountingLimits()), HeldField(FieldLimits())
        self.additions = self.quiet = 0
        self.later: list[Delivered] = []
        self._blocks = 0
        self._held: dict[int, gtsam.NonlinearFactor] = {}

    @property
    def changing(self) -> list[object]:
        """The objects that an update changes before it judges."""
        return [self, self.monitor]

    def restart(self) -> None:
        """Discard all fits, because the graph has been turned."""
        self.monitor, self.additions, self.quiet, self.later = Monitor(self.monitor.limits), 0, 0, []
        self.mounting, self.field = HeldMounting(self.mounting.limits), HeldField(self.field.limits)

    def note_priors(self, holding: list[gtsam.NonlinearFactor]) -> None:
        """Store the priors that may hold a mounting, a delay or a field."""
        for factor in holding:
            self._held[factor.keys()[0]] = factor

    @property
    def owes(self) -> bool:
        """Whether an update that adds no block has blocks to judge or to remove."""
        return bool(self.monitor.over or self.later)

    def judge(
        self, entered: list[Delivered], view: View, delivered: list[Delivered], *, waited: bool = False
    ) -> None:
        """Examine the factors that have entered, unless judging is suspended.

        Args:
            entered: the factors that have entered.
            view: view of the solver.
            delivered: all factors that the solver holds.
            waited: whether some of them waited for the heading; the next ones are then not judged either.
        """
        if waited:
            self.settling()
        self.additions += 1
        for details in (each.details for each in entered if each.details is not None):
            self.mounting.blocks += details.freed is not None
            self.field.blocks += holds_field(details)
            self.monitor.unjudged = self.monitor.unjudged or (_UNJUDGED, details.block.time)
        self.check_soft_irons(entered, view)
        if not self.quiet:
            if len(entered) > 1:  # one step from a start that may be far off is no estimate to judge them at
                self.later += entered
            else:
                self._judge_now(entered, view, delivered)
        self.quiet = max(self.quiet - len(entered), 0)
        self._look(view, delivered)

    def judge_late(self, view: View, delivered: list[Delivered], *, settled: bool) -> None:
        """Examine the blocks that entered several at a time, once quadratics are settled or were stale for long."""
        if self.later and (settled or self.additions >= _EARLY):
            blocks, self.later = self.later, []
            self._judge_now(sorted(blocks, key=_time), view, delivered)

    def _judge_now(self, blocks: Sequence[Delivered], view: View, delivered: list[Delivered]) -> None:
        """Examine blocks, and what they hold where that is due."""
        for each in blocks:
            self._examine(each, view, self.mounting)

    def _look(self, view: View, delivered: list[Delivered]) -> None:
        """Solve the graph with what its blocks hold free where that is due.

        Before any block has been judged, as while the graph goes on turning to wrong axes, only for large angles.
        """
        judged, early = bool(self.monitor.fits), self.mounting.early | self.field.early
        if not judged:
            early = self.additions in range(*_LOOKS)
        if judged and (self.monitor.open or self.monitor.over):  # an offset looks like a turned mounting
            return
        if judged and (self.mounting.due or self.field.due):
            self._free(view, delivered)
        elif early:
            self._free(view, delivered, gross=True)

    def settling(self) -> None:
        """Leave the next blocks unjudged, until the quadratics are renewed."""
        self.quiet = _QUIET

    def postpone(self) -> None:
        """Leave the next blocks unjudged because quadratics are stale, in the first updates and without an offset."""
        if self.additions < _EARLY and not self.monitor.open:
            self.settling()

    def judge_batch(
        self, blocks: list[Delivered], graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *, fits: bool
    ) -> None:
        """Examine a batch at its solution: its soft irons, and with `fits` all blocks and the mounting they hold."""
        self.restart()
        self.check_soft_irons(blocks, View(values))
        if fits:
            solved = gtsam.ISAM2()
            solved.update(graph, values)
            view = View(solved)
            for each in blocks:
                self._examine(each, view, None)
            self._free(view, blocks)
        else:
            times = [each.details.block.time for each in blocks if each.details is not None]
            self.monitor.unjudged = (_UNEXAMINED, min(times)) if times else None

    def check_soft_irons(self, blocks: Sequence[Delivered], view: View) -> None:
        """Report the soft irons of these blocks that no magnetometer has: not positive definite, or nearly zero."""
        latest = {each.details.soft_iron_key: each.details for each in blocks if each.details is not None}
        for key, details in latest.items():
            if view.exists(key):
                least = float(np.linalg.eigvalsh(unvech(view.values([key]).atVector(key)))[0])
                limit = 0.0 if details.field is None else _LEAST_SOFT_IRON  # its scale is known with the field
                text = (
                    f"soft iron {key_name(key)} with the eigenvalue {least:.2g}, which must be above {limit:g}: "
                )
                text += CHECK_AXES if least <= 0 else _NEARLY_ZERO
                # In stale quadratics it may be small for some blocks.
                wrong = least <= (0.0 if self.quiet else limit)
                self.monitor.hold(f"soft iron {key}", wrong, text, details.block.time)

    def disturbed(self, delivered: list[Delivered]) -> list[Delivered]:
        """Return the blocks inside disturbances that have ended since the last call; the next blocks are not judged."""
        spans, self.monitor.over = self.monitor.over, []
        if spans:
            self.quiet = _QUIET_AFTER
        return [each for each in delivered if each.within(spans)] if spans else []

    def _examine(self, each: Delivered, view: View, mounting: HeldMounting | None) -> None:
        """Compute the NIS of a block that has entered, and check the variables that priors hold after every few
        blocks.
        """
        details = each.details
        keys = list(each.factor.keys())
        if details is None or not all(map(view.exists, keys)):
            return
        covariance = view.covariance(keys)
        if covariance is None:
            return
        point = view.values(keys)
        gram, free = each.products(point)
        zero = point.zeroVectors()
        sizes = [zero.at(key).size for key in keys]
        start = sum(sizes[: keys.index(details.hard_iron_key)])
        unit, turn = details.field_unit, np.eye(3)
        if free is not None and mounting is not None:
            axis = heading_axis(point, details.attitude_key)
            mounting.add(free, axis, covariance, counts=not self.monitor.open)
            if mounting.wrong:
                gram, covariance = mounting.considered(free, covariance)
                point, turn = self._moved(point, keys, sizes)
        nis, freedom, scatter, offset, spread = block_fit(
            gram[:-1, :-1],
            gram[:-1, -1],
            float(gram[-1, -1]),
            covariance,
            3 * details.block.samples,
            slice(start, start + 3),
        )
        self.monitor.add(
            BlockFit(
                details.block.time,
                nis,
                freedom,
                scatter,
                offset * unit,
                float(np.sqrt(max(np.trace(spread), 0.0))) * unit,
                unvech(point.atVector(details.soft_iron_key)),
                point.atPoint3(details.hard_iron_key) * unit,
                turn.T @ details.mean_turn @ _body_field(details, point),
                details.mean_field,
                (details.soft_iron_key, details.hard_iron_key),
            )
        )
        self._blocks += 1
        if self._blocks % _EVERY == 0:
            for key in set(details.held_keys(keys)) & set(self._held):
                self._examine_held(view, key, details)

    def _moved(self, point: gtsam.Values, keys: list[int], sizes: list[int]) -> tuple[gtsam.Values, Array]:
        """Return a block's values with the mounting free, and the estimated rotation (3, 3) of the mounting."""
        mean, step = self.mounting.mean, gtsam.VectorValues()
        parts = np.split(-self.mounting.shift @ mean, np.cumsum(sizes)[:-1])
        for key, part in zip(keys, parts, strict=True):
            step.insert(key, part)
        return point.retract(step), gtsam.Rot3.Expmap(mean).matrix()

    def _free(self, view: View, delivered: list[Delivered], *, gross: bool = False) -> None:
        """Solve the graph with mounting and field free and report the verdict to the monitor, or of large angles only.

        Where one explains the data far better than the other, only that one is named. A field turned by little is named
        only in place of a mounting.
        """
        mounting, field = self.mounting, self.field
        fit = free_fit(view, delivered, (mounting.limits.prior, field.limits.prior))
        if fit is not None:
            mounting.determined(fit)
        if gross and not (fit is not None and (mounting.gross_by(fit) or field.gross_by(fit))):
            return
        mounting.solved(fit)
        field.solved(fit)
        if fit is None:
            return
        better, clear = field.evidence - mounting.evidence, np.log(field.limits.evidence)
        turned = field.certain and (mounting.certain or field.turn > field.limits.least) and better > -clear
        mounting.conclude(mounting.certain and better < clear, fit.time)
        field.conclude(turned, fit.time)
        text = f"mounting {np.degrees(mounting.turn):.1f}° from what the blocks hold"
        # The solution is linear, so that of a large angle it says no more than that it is large.
        turn = "more than 30" if field.turn > field.limits.gross else f"{np.degrees(field.turn):.1f}"
        angle = f"field {turn}° about the vertical from the heading of the other factors"
        if field.wrong and mounting.wrong:
            text += f", or {angle}"
        self.monitor.hold("mounting held", mounting.wrong, text, mounting.since)
        alone = field.wrong and not mounting.wrong
        self.monitor.hold("field held", alone, f"{angle}: check the declination and the axes", field.since)

    def _examine_held(self, view: View, key: int, details: BlockDetails) -> None:
        """Test whether the data have moved a mounting, a delay or a field from its prior by more than both allow."""
        covariance, prior = view.covariance([key]), self._held[key]
        if covariance is None:
            return
        augmented = prior.linearize(view.values([key])).augmentedInformation()
        before = np.linalg.inv(augmented[:-1, :-1])
        moved = before @ augmented[:-1, -1]
        weight, axes = np.linalg.eigh(before - covariance)
        seen = weight > 0.1 * np.diag(before).max()  # directions whose variance the data have reduced
        distance = float(np.sum((axes.T[seen] @ moved) ** 2 / weight[seen]))
        if key == details.field_key:
            text = f"field {np.linalg.norm(moved) * details.field_unit * 1e6:.1f} µT from its prior"
        elif len(moved) == 3:
            text = f"mounting {np.degrees(np.linalg.norm(moved)):.1f}° from its prior"
        else:
            text = f"delay {abs(float(moved[0])) * 1e3:.1f} ms from its prior"
        moved_away = bool(seen.any() and chdtrc(int(seen.sum()), distance) < self.monitor.limits.held)
        self.monitor.hold(gtsam.DefaultKeyFormatter(key), moved_away, text, details.block.time)


def _time(each: Delivered) -> float:
    """Return the time of a block in s; 0 for other factors, which are not judged."""
    return 0.0 if each.details is None else each.details.block.time


def _body_field(details: BlockDetails, point: gtsam.Values) -> Array:
    """Return the world's field (3,) in T, in the body frame at a block's keyframe."""
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
