"""What is gained by what is known: skews that the data decide, an earlier calibration, the strength of the field.

Skews: chips that are 0 to 1.5° askew in a random direction, calibrated with the skew asked of the data, always, and
never. Facts: vehicles that hardly tilt, with what the operator knows added step by step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.estimators.smoother.options import DIP_SIGMA, FIELD_SIGMA
from magyc_gtsam.factors.chain.rotations import exponential_matrices
from magyc_gtsam.level_turn import turn_of
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation import Simulation, simulate
from magyc_gtsam.simulation.sensor import SOFT_IRON
from magyc_gtsam.study.efficiency import FREEDOMS, error, nees

SKEWS = (0.0, 0.2, 0.7, 1.5)  # deg
MOTIONS = ("wide", "moderate", "low", "tiny", "level")
WAYS: Mapping[str, float | str] = {"asked": "auto", "never": 0, "always": np.radians(10.0)}
LIMITED = (("tiny", 60.0), ("level", 600.0), ("ship", 600.0))
_EARLIER = 990_001  # seed of the earlier calibration
_OFFSET, _ROUGH = 0.1, 0.3  # m/s², of an accelerometer's axis all the time, and from sample to sample
_MOVED = 100e-6  # T, by which its hard iron may have changed


@dataclass(frozen=True)
class SkewCell:
    """Means over the runs of one motion, skew and way: root-mean-square heading error over a level turn (deg) and hard
    iron error of an axis (T); NEES of `FREEDOMS`; shares of runs in which a skew was taken out, and not trusted."""

    heading: float
    hard_iron: float
    nees: float
    decided: float
    refused: float


@dataclass(frozen=True)
class FactCell:
    """Of one motion and what was known: hard iron error and stated sigma of an axis (T, root mean square), the squared
    error in the stated covariance per freedom, share not trusted."""

    error: float
    stated: float
    ratio: float
    refused: float


def skewed(motion: str, degrees: float, seed: int) -> Simulation:
    """A simulation of chips that are askew in a random direction; the truth has the symmetric soft iron."""
    axis = np.random.default_rng(seed).normal(size=3)
    turn = exponential_matrices((np.radians(degrees) * axis / np.linalg.norm(axis))[:, None])[:, :, 0]
    simulation = simulate(motion, seed=seed, soft_iron=SOFT_IRON @ turn)
    symmetric = SOFT_IRON / np.cbrt(np.linalg.det(SOFT_IRON))
    return replace(simulation, truth=replace(simulation.truth, soft_iron=symmetric))


class Placed(NamedTuple):
    """A simulation with what its operator knows of the place: recording (its accelerometer off by `_OFFSET` an axis),
    truth, the true dip rad, and `field` as `calibrate` takes it, off by the sigmas of the world's model."""

    recording: Recording
    truth: Calibration
    dip: float
    field: tuple[float, float]


def placed(motion: str, duration: float, seed: int) -> Placed:
    """Errors drawn by the seed."""
    simulation = simulate(motion, duration, seed=seed)
    random = np.random.default_rng([seed, 17])
    north, east, down = simulation.field
    dip = float(np.arctan2(down, np.hypot(north, east)))
    force = simulation.recording.acceleration
    assert force is not None
    force = force + _OFFSET * random.normal(size=3) + _ROUGH * random.normal(size=force.shape)
    strength = simulation.truth.field_strength
    assert strength is not None
    field = strength + FIELD_SIGMA * random.normal(), dip + DIP_SIGMA * random.normal()
    return Placed(replace(simulation.recording, acceleration=force), simulation.truth, dip, field)


def heading_error(simulation: Simulation, degrees: float, seed: int, calibration: Calibration) -> float:
    """deg, root mean square over a level turn, with the field brought to the gyroscope's axes."""
    axis = np.random.default_rng(seed).normal(size=3)
    skew = exponential_matrices((np.radians(degrees) * axis / np.linalg.norm(axis))[:, None])[:, :, 0]
    truth = simulation.truth
    turn = turn_of(simulation.recording, truth)
    raw = turn.field @ (truth.soft_iron @ skew).T + truth.hard_iron
    back = np.eye(3)
    for term in calibration.terms:
        back = exponential_matrices(term.value[:, None])[:, :, 0]
    field = (raw - calibration.hard_iron) @ np.linalg.inv(calibration.soft_iron).T @ back.T
    angle = np.arctan2(field @ turn.left, field @ turn.ahead) - np.arctan2(
        turn.field @ turn.left, turn.field @ turn.ahead
    )
    return float(np.degrees(np.sqrt(np.mean(np.angle(np.exp(1j * angle)) ** 2))))


def skew_cells(
    motion: str, degrees: float, runs: int, progress: Callable[[float], None] = lambda _: None
) -> dict[str, SkewCell]:
    """{way of `WAYS`: what came out}."""
    found: dict[str, list[tuple[float, ...]]] = {way: [] for way in WAYS}
    for seed in range(runs):
        simulation = skewed(motion, degrees, seed)
        for way, misalignment in WAYS.items():
            calibration = calibrate(simulation.recording, misalignment=misalignment)
            away = error(calibration, simulation.truth)
            assert calibration.covariance is not None
            found[way].append(
                (
                    heading_error(simulation, degrees, seed, calibration) ** 2,
                    float(np.mean(away[6:9] ** 2)),
                    nees(away, calibration.covariance),
                    float(bool(calibration.terms)),
                    float(not calibration.trusted),
                )
            )
        progress((seed + 1) / runs)
    return {way: _skew_cell(np.mean(rows, axis=0)) for way, rows in found.items()}


def _skew_cell(mean: Array) -> SkewCell:
    heading, hard_iron, score, decided, refused = map(float, mean)
    return SkewCell(heading**0.5, hard_iron**0.5, score, decided, refused)


def band(runs: int) -> tuple[float, float]:
    """The 95 % band of the mean NEES."""
    half = 1.96 * float(np.sqrt(2 * FREEDOMS / runs))
    return FREEDOMS - half, FREEDOMS + half


def fact_cells(
    motion: str, duration: float, runs: int, progress: Callable[[float], None] = lambda _: None
) -> dict[str, FactCell]:
    """{what was known: what came out}; the chips are known to be aligned."""
    earlier = calibrate(simulate("wide", seed=_EARLIER).recording, misalignment=0)
    matrix = {"prior": earlier, "hard_iron_walk": _MOVED}
    found: dict[str, list[tuple[float, ...]]] = {}
    for seed in range(runs):
        run = placed(motion, duration, seed)
        recording = replace(run.recording, attitude=None)
        ways: Mapping[str, Mapping[str, Any]] = {
            "alone": {},
            "+ matrix": matrix,
            "+ strength": matrix | {"field": (run.field[0], None)},
            "+ dip": matrix | {"field": run.field},
        }
        for way, options in ways.items():
            calibration = calibrate(recording, misalignment=0, **options)
            away = error(calibration, run.truth)[6:9]
            assert calibration.covariance is not None
            block = calibration.covariance[6:9, 6:9]
            ratio = float(away @ np.linalg.solve(block, away)) / 3
            found.setdefault(way, []).append(
                (float(np.mean(away**2)), float(np.trace(block)) / 3, ratio, float(not calibration.trusted))
            )
        progress((seed + 1) / runs)
    return {way: _fact_cell(rows) for way, rows in found.items()}


def _fact_cell(rows: Sequence[tuple[float, ...]]) -> FactCell:
    square, stated, ratio, refused = map(float, np.mean(rows, axis=0))
    return FactCell(square**0.5, stated**0.5, ratio, refused)
