"""What a history assumes of an instrument between its logs: each number with its unit and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class HistoryModel:
    """The random walk of hard iron, its jumps, and how much instruments and logs differ.

    Attributes:
        walk: µT per √day (per √log where the logs have no dates), median of the prior of the walk's deviation.
        walk_spread: nats, deviation of its logarithm: a factor of 4 either way at one sigma, from a payload that
            nobody touches (0.06 µT between trials of one unit of BROAD) to one that is taken apart.
        jump_share: of the pairs of neighbouring logs between which the hard iron jumped.
        jump: µT, deviation of a jump's size on each axis; magnets of BROAD's trials 32 to 35 moved it by 5 to 67.
        wrong_share: of the logs that a disturbed field or a wrong unit spoils though their calibration converged.
        wrong_hard_iron: µT, deviation of the hard iron of such a log.
        wrong_shape: deviation of its soft iron, relative; translation trials of BROAD were off by 3 to 10 %.
        scatter: relative; by which soft irons of one instrument differ from log to log beyond their stated sigmas, in
            the comparison of instruments (trials 1, 4 and 6 of BROAD: 0.4 %).
        scattered: prior share of the instruments whose logs scatter beyond their sigmas at all.
        before: relative and µT, deviations of soft and hard iron before the first log; phones have 400 µT.
        bias_scatter: mrad/s; the same of the gyroscope's bias (trials 1, 4 and 6: 1.3).
        hard_iron_scatter: µT; the same of the hard iron where it did not jump (0.06 to 0.3).
        raw, calibrated: relative, µT: how much soft and hard iron differ between instruments as they are built, and
            between those that left a factory calibrated, whose being alike says nothing (BROAD: 0.8 % and 0.6 µT).
        skew: mrad; how much the axes of magnetometer and gyroscope differ in instruments (boards: 0.7 to 1.3°).
        skew_scatter: mrad; by which it differs from log to log of one beyond its sigma (BROAD: 0.2°).
        bias: mrad/s; how much the gyroscope's bias differs between instruments.
        same: nats; prior logarithmic odds that two logs given together are of one instrument.
    """

    walk: float = 0.3
    walk_spread: float = float(np.log(4.0))
    jump_share: float = 0.02
    jump: float = 20.0
    wrong_share: float = 0.02
    wrong_hard_iron: float = 30.0
    wrong_shape: float = 0.05
    scatter: float = 0.005
    scattered: float = 0.1
    before: tuple[float, float] = (0.2, 1000.0)
    bias_scatter: float = 1.3
    hard_iron_scatter: float = 0.3
    raw: tuple[float, float] = (0.05, 30.0)
    calibrated: tuple[float, float] = (0.01, 0.5)
    skew: float = 17.0
    skew_scatter: float = 3.5
    bias: float = 10.0
    same: float = 2.0


DAY = 86400.0  # s
