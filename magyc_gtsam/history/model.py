"""The assumptions of a history about an instrument between its logs, each with its unit and origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class HistoryModel:
    """Priors on the hard iron's random walk and jumps, and on the differences of instruments and logs.

    Attributes:
        walk: µT per √day (per √log without dates), prior median of the walk's deviation.
        walk_spread: nats, deviation of its logarithm: a factor of 4 either way at one sigma, from a payload that
            nobody touches (0.06 µT between trials of one unit of BROAD) to one that is taken apart.
        jump_share: share of the pairs of neighbouring logs between which the hard iron jumped.
        jump: µT, deviation of a jump on each axis; magnets in BROAD's trials 32 to 35 moved it by 5 to 67.
        refit_share: share of the pairs of neighbouring logs between which the soft iron changed for good as well, as
            where a payload or the unit was replaced.
        refit_shape: relative, deviation of that change; as large as that of a wrong log, so that a single log is rather
            wrong, and two that agree are not.
        wrong_share: share of the logs with a disturbed field or a wrong unit whose calibration converged.
        wrong_hard_iron: µT, deviation of the hard iron of such a log.
        wrong_shape: relative, deviation of its soft iron; translation trials of BROAD were off by 3 to 10 %.
        scatter: relative, scatter of one instrument's soft irons between logs beyond their stated sigmas, for the
            comparison of instruments (trials 1, 4 and 6 of BROAD: 0.4 %).
        scattered: prior share of the instruments whose logs scatter beyond their sigmas at all.
        shared_error: prior probability that the logs share all of their model error, as they do where it is the
            instrument's (a gyroscope's scale, a mount, non-linearity); that they share half or none is equally likely.
        before: relative and µT, deviations of soft and hard iron before the first log; phones have 400 µT.
        bias_scatter: mrad/s, prior median of the scatter of the gyroscope bias from log to log (trials 1, 4 and
            6: 1.3).
        bias_scatter_spread: nats, deviation of its logarithm: a factor of 3, as 10 °C change a MEMS gyroscope by 3 to
            10 mrad/s (0.02 to 0.05 °/s per °C).
        hard_iron_scatter: µT, scatter of the hard iron where it did not jump (0.06 to 0.3).
        raw, calibrated: (relative, µT), deviations of soft and hard iron between instruments as built, and between
            factory-calibrated ones, which are similar but not identical (BROAD: 0.8 % and 0.6 µT).
        skew: mrad, deviation of the misalignment of magnetometer and gyroscope (boards: 0.7 to 1.3°).
        skew_scatter: mrad, its scatter between logs of one instrument beyond its sigma (BROAD: 0.2°).
        bias: mrad/s, deviation of the gyroscope bias between instruments.
        gyroscope_scale: ‰, deviation of the scale of each of the gyroscope's axes between instruments.
        gyroscope_scale_scatter: ‰, its scatter between logs of one instrument beyond its sigma (trials 1, 4
            and 6 of BROAD: 1).
        same: nats, prior log odds that two logs given together are of one instrument.
    """

    walk: float = 0.3
    walk_spread: float = float(np.log(4.0))
    jump_share: float = 0.02
    jump: float = 20.0
    refit_share: float = 0.002
    refit_shape: float = 0.05
    wrong_share: float = 0.02
    wrong_hard_iron: float = 30.0
    wrong_shape: float = 0.05
    scatter: float = 0.005
    scattered: float = 0.1
    shared_error: float = 0.5
    before: tuple[float, float] = (0.2, 1000.0)
    bias_scatter: float = 1.3
    bias_scatter_spread: float = float(np.log(3.0))
    hard_iron_scatter: float = 0.3
    raw: tuple[float, float] = (0.05, 30.0)
    calibrated: tuple[float, float] = (0.01, 0.5)
    skew: float = 17.0
    skew_scatter: float = 3.5
    bias: float = 10.0
    gyroscope_scale: float = 10.0
    gyroscope_scale_scatter: float = 1.0
    same: float = 2.0


DAY = 86400.0  # s
