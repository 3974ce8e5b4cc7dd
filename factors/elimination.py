"""Where iSAM2 eliminates soft and hard iron: before the newest poses, in a clique of their own.

By itself iSAM2 puts the keys of all new factors last, so that soft and hard iron share a clique with poses. A clique
counts as changed as a whole: each time that these poses move, all poses of that calibration are solved for again. Where
older blocks are renewed iSAM2's own order is the better one, since it shortens the way to them.
"""

from __future__ import annotations

import gtsam

from magyc_gtsam.factors.delivered import Delivered


def eliminated_last(
    others: gtsam.NonlinearFactorGraph, entering: list[Delivered], renewed: list[Delivered]
) -> list[set[int]]:
    """Groups of keys that iSAM2 eliminates after all others, one after the other; empty where its own order is better.

    Args:
        others: the other factors of an update.
        entering, renewed: the blocks whose quadratics come with it.
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
