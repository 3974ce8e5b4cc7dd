"""Refusal of blocks of two magnetometers in one `NativeFactors`, and of blocks that are given twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.factors.delivered import Delivered
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.keyframe_factor import BlockDetails
from magyc_gtsam.factors.variables import key_name

_NEIGHBOURS = 8  # newest blocks of each kind whose samples a new block's may overlap


def expect_one_sensor(fresh: Sequence[Delivered], *before: Sequence[Delivered]) -> None:
    """Raise an error where blocks of two calibrations, or of two mountings, overlap in time, or a block comes twice.

    The samples of one sensor follow each other: when its calibration gets a new node, or its mounting changes, the next
    block begins where the last one ends. Two sensors, two vehicles and two clocks overlap.

    Args:
        fresh: the new factors of one `NativeFactors`, in any order.
        before: its earlier ones, oldest first: those in the graph, and those that wait.

    Raises:
        MagycError: as said.
    """
    if not fresh:
        return
    known = [each for held in before for each in held[-_NEIGHBOURS:]]
    twice = [
        new.details for new in fresh for old in known if new.details is not None and new.details is old.details
    ]
    if twice:
        raise MagycError(
            f"native factors: the block on {key_name(twice[0].attitude_key)} at {twice[0].block.time:.1f} s is in the "
            "graph already: give each factor once, and empty `graph` after an update"
        )
    blocks = [each.details for each in [*known, *fresh] if each.details is not None]
    last: BlockDetails | None = None  # the block that reaches furthest
    for each in sorted(blocks, key=_begin):
        if last is not None and _begin(each) < last.block.span[1] and not _alike(last, each):
            raise MagycError(
                f"native factors: {_both(last, each)} overlap at {_begin(each):.1f} s, as of two magnetometers, "
                "vehicles or clocks: give each a NativeFactors of its own"
            )
        if last is None or each.block.span[1] > last.block.span[1]:
            last = each


def _begin(details: BlockDetails) -> float:
    """Return the stamp of a block's first sample, in s."""
    return details.block.span[0]


def _alike(first: BlockDetails, second: BlockDetails) -> bool:
    """Whether two blocks may be of the same sensor at the same time."""
    same = first.soft_iron_key == second.soft_iron_key and first.hard_iron_key == second.hard_iron_key
    return same and np.array_equal(first.block.body_R_sensor, second.block.body_R_sensor)


def _both(first: BlockDetails, second: BlockDetails) -> str:
    """Return two blocks by what tells them apart."""
    names = [f"{key_name(each.soft_iron_key)}, {key_name(each.hard_iron_key)}" for each in (first, second)]
    if names[0] == names[1]:
        return f"blocks of two mountings on {names[0]}"
    return f"blocks on {names[0]} and on {names[1]}"
