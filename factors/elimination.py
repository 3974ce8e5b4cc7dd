"""Elimination order of iSAM2 that puts soft and hard iron in a clique of their own, before the newest poses.

By default iSAM2 orders the keys of all new factors last, so that soft and hard iron share a clique with poses. A
clique counts as changed as a whole: each time these poses move, all poses of that calibration are solved for again.
In updates that renew older blocks iSAM2's own order is better, since it shortens the path to them.
"""

from __future__ import annotations

import gtsam

from magyc_gtsam.factors.delivered import Delivered


def eliminated_last(
    others: gtsam.NonlinearFactorGraph, entering: list[Delivered], renewed: list[Delivered]
) -> list[set[int]]:
    """Return groups of keys that iSAM2 eliminates last, in this order; an empty list where its own order is better.

    Args:
        others: the other factors of the update.
        entering, renewed: the blocks whose quadratics the update adds.
    """
    placed = entering + renewed
    newest = set(others.keyVector()) if placed else set()
    if not placed or any(each.details is None or each.details.attitude_key not in newest for each in placed):
        return []
    calibrations = {
        key
        for each in entering
        if each.details is not None
        for key in (each.details.soft_iron_key, each.details.hard_iron_key)
    }
    return [calibrations, newest - calibrations]
