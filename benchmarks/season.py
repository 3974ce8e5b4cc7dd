"""Simulation of a season of dives of one instrument, to test histories.

Each dive is a compressed factor. Its covariance is that of a calibrated simulation of its motion, and its mean is the
truth with noise of that covariance, which matches `calibrate` by the efficiency study. A hundred seasons thus take
seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.estimators import calibrate
from magyc_gtsam.history.log_factor import HARD_IRON, MICROTESLA, MILLIRADIAN, SIZE, LogFactor, compress
from magyc_gtsam.history.model import DAY
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation import simulate

_START = 1.7e9  # s since 1970


@dataclass(frozen=True)
class SeasonPlan:
    """The events of a season.

    Attributes:
        dives: number of dives.
        walk: random walk of the hard iron, µT per √day.
        jumps: number of jumps of the hard iron, at least three dives apart.
        jump: length of each jump, µT.
        refit: relative deviation by which the soft iron changes for good at each jump.
        wrecks: number of dives near a wreck, with a soft iron off by some 3 % and a hard iron by some 5 µT per axis.
        wrong_units: number of dives that were refused for their unit.
        bias_scatter: scatter of the gyroscope bias from dive to dive, mrad/s.
        model_error: deviations, relative and µT, of an error of soft and hard iron beside that of the dives.
        shared: share of its variance that is the same error in all dives.
    """

    dives: int = 60
    walk: float = 0.3
    jumps: int = 2
    jump: float = 4.0
    refit: float = 0.0
    wrecks: int = 1
    wrong_units: int = 1
    bias_scatter: float = 1.0
    model_error: tuple[float, float] = (0.0, 0.0)
    shared: float = 0.0


@dataclass(frozen=True, eq=False)
class Season:
    """The dives and the truth: shape (5,) after the last dive, hard iron (k, 3) T and of the next dive, mean bias (3,)
    rad/s, and the dives of each event.
    """

    factors: tuple[LogFactor, ...]
    shape: Array
    hard_iron: Array
    next_hard_iron: Array
    bias: Array
    jumps: tuple[int, ...]
    wrecks: tuple[int, ...]
    wrong_units: tuple[int, ...]


def dive_factors(motions: Sequence[str], duration: float = 600.0, rate: float = 10.0) -> tuple[LogFactor, ...]:
    """Return the factor of one calibrated simulation per motion."""
    recordings = [simulate(motion, duration, rate, seed=1).recording for motion in motions]
    return tuple(compress(calibrate(r), motion, None) for r, motion in zip(recordings, motions, strict=True))


def draw_season(seed: int, dives: Sequence[LogFactor], plan: SeasonPlan | None = None) -> Season:
    """Draw a season; each dive is one of `dives` at random."""
    plan = plan or SeasonPlan()
    rng = np.random.default_rng(seed)
    day = np.cumsum(rng.uniform(0.5, 3.0, plan.dives))
    events = rng.permutation(np.arange(2, plan.dives - 2, 3))  # at least three dives apart
    jumps = tuple(sorted(events[: plan.jumps].tolist()))
    wrecks = tuple(sorted(events[plan.jumps :][: plan.wrecks].tolist()))
    wrong_units = tuple(sorted(events[plan.jumps + plan.wrecks :][: plan.wrong_units].tolist()))
    shape, bias, hard_iron = rng.normal(0, 0.05, 5), rng.normal(0, 10.0, 3), rng.normal(0, 20.0, 3)
    truth, factors = np.zeros((plan.dives, 3)), []
    deviation = np.r_[np.repeat(plan.model_error, (5, 3)), np.zeros(3)]
    turn = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))[0]
    root = deviation[:, None] * turn * rng.uniform(0.2, 1.5, SIZE)  # of the covariance of the model error
    common, apart = np.sqrt(plan.shared) * rng.normal(size=SIZE), np.sqrt(1 - plan.shared)
    for k in range(plan.dives):
        if k:
            hard_iron = hard_iron + rng.normal(0, plan.walk * np.sqrt(day[k] - day[k - 1]), 3)
        if k in jumps:
            direction = rng.normal(size=3)
            hard_iron = hard_iron + plan.jump * direction / np.linalg.norm(direction)
            if plan.refit:
                shape = shape + rng.normal(0, plan.refit, 5)
        truth[k] = hard_iron
        kind = dives[int(rng.integers(len(dives)))]
        assert kind.covariance is not None
        mean = np.concatenate([shape, hard_iron, bias + rng.normal(0, plan.bias_scatter, 3)])
        mean += np.linalg.cholesky(kind.covariance + 1e-15 * np.eye(SIZE)) @ rng.normal(size=SIZE)
        mean += root @ (common + apart * rng.normal(size=SIZE))
        kind = replace(kind, covariance=kind.covariance + root @ root.T)
        if k in wrecks:
            mean[:5] += rng.normal(0, 0.03, 5)
            mean[HARD_IRON] += rng.normal(0, 5.0, 3)
        factor = replace(kind, name=f"dive {k + 1}", time=_START + float(day[k]) * DAY, mean=mean)
        if k in wrong_units:
            factor = replace(factor, mean=None, covariance=None, problem="likely the unit is another")
        factors.append(factor)
    ahead = hard_iron + rng.normal(0, plan.walk * np.sqrt(np.median(np.diff(day))), 3)
    return Season(
        tuple(factors),
        shape,
        truth * MICROTESLA,
        ahead * MICROTESLA,
        bias * MILLIRADIAN,
        jumps,
        wrecks,
        wrong_units,
    )
