"""Study of the gain from prior knowledge: misalignment, an earlier calibration, and the place.

Skews: chips that are misaligned by 0 to 1.5° in a random direction, with the misalignment estimated if the data show
one, always, and never. Boards: the same with misalignments drawn from the prior of `calibrate`; averaged over this
prior, but not at each size, the NEES of a consistent covariance equals its number of degrees of freedom. Facts:
vehicles that hardly tilt, with the operator's knowledge added step by step, batch and online. Matrices: an earlier
calibration whose matrix is wrong by some percent, and whether that is noticed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC
from magyc_gtsam.factors.chain.rotations import exponential_matrices
from magyc_gtsam.heading_uncertainty import turn_of
from magyc_gtsam.level_turn import calibrated
from magyc_gtsam.recording import Array
from magyc_gtsam.simulation import Simulation, simulate
from magyc_gtsam.simulation.sensor import SOFT_IRON
from magyc_gtsam.study.efficiency import FREEDOMS, error, nees
from magyc_gtsam.study.known_facts import fact_row, matrix_row

SKEWS = (0.0, 0.2, 0.7, 1.5)  # deg
MOTIONS = ("wide", "moderate", "low", "tiny", "level")
WAYS: Mapping[str, float | str] = {"asked": "auto", "never": 0, "always": np.radians(10.0)}
LIMITED = (("tiny", 60.0), ("level", 600.0), ("ship", 600.0))
PERCENTS = (0.2, 0.5, 1.0)


class KnownCase(NamedTuple):
    """One recording of the study.

    `kind` is "skew" (size in degrees), "board" (no size), "fact" (duration in s) or "matrix" (percent).
    """

    kind: str
    motion: str
    size: float
    seed: int


def skewed(motion: str, degrees: float, seed: int) -> Simulation:
    """Return a simulation of chips misaligned in a random direction; the truth has the symmetric soft iron."""
    simulation = simulate(motion, seed=seed, soft_iron=SOFT_IRON @ _turn(degrees, seed))
    symmetric = SOFT_IRON / np.cbrt(np.linalg.det(SOFT_IRON))
    return replace(simulation, truth=replace(simulation.truth, soft_iron=symmetric))


def _turn(degrees: float, seed: int) -> Array:
    axis = np.random.default_rng(seed).normal(size=3)
    return exponential_matrices((np.radians(degrees) * axis / np.linalg.norm(axis))[:, None])[:, :, 0]


def believed(seed: int) -> float:
    """Return the misalignment, deg, of a board drawn from the prior of `calibrate`, up to the largest admitted."""
    random = np.random.default_rng([seed, 29])
    while True:
        deviation = random.choice(AUTOMATIC.deviations, p=AUTOMATIC.weights)
        size = float(np.linalg.norm(deviation * random.normal(size=3)))
        if size <= AUTOMATIC.most:
            return float(np.degrees(size))


def heading_error(simulation: Simulation, degrees: float, seed: int, calibration: Calibration) -> float:
    """Return the root-mean-square heading error over a level turn, deg, with the field in the gyroscope's axes."""
    truth = simulation.truth
    turn = turn_of(simulation.recording, truth)
    raw = turn.field @ (truth.soft_iron @ _turn(degrees, seed)).T + truth.hard_iron
    back = np.eye(3)
    for term in calibration.terms:
        back = exponential_matrices(term.value[:, None])[:, :, 0]
    off = turn.error(calibrated(raw, calibration.soft_iron, calibration.hard_iron) @ back.T)
    return float(np.sqrt(np.mean(off**2)))


def units(seeds: Iterable[int], kinds: Iterable[str] = ("skew", "board", "fact", "matrix")) -> list[KnownCase]:
    """Return the units of the whole study."""
    cells = {
        "skew": [(motion, size) for motion in MOTIONS for size in SKEWS],
        "board": [(motion, 0.0) for motion in MOTIONS],
        "fact": list(LIMITED),
        "matrix": [(motion, size) for motion in ("wide", "tiny", "level") for size in PERCENTS],
    }
    return [KnownCase(kind, *cell, seed) for seed in seeds for kind in kinds for cell in cells[kind]]


def worked(unit: KnownCase) -> Row:
    """Return one row with a column "<way> <number>" for all ways and numbers of the unit's kind.

    Of skews and boards the numbers are the squares of the heading error over a level turn, deg, and of the hard iron
    error per axis, T; the NEES of `FREEDOMS` degrees of freedom by the stated covariance, and "of_sensors" by that
    without the model error, which the simulated instruments do not have; whether a misalignment was corrected
    ("decided"), and whether the result was not trusted ("refused"). Those of facts and matrices are of
    `known_facts.fact_row`.
    """
    if unit.kind in ("skew", "board"):
        found = _skew_row(unit)
    else:
        row = {"fact": fact_row, "matrix": matrix_row}[unit.kind]
        found = row(unit.motion, unit.size, unit.seed)
    return {f"{way} {name}": [value] for way, numbers in found.items() for name, value in numbers.items()}


def _skew_row(unit: KnownCase) -> dict[str, Row]:
    degrees = believed(unit.seed) if unit.kind == "board" else unit.size
    simulation = skewed(unit.motion, degrees, unit.seed)
    rows = {}
    for way, misalignment in WAYS.items():
        calibration = calibrate(simulation.recording, misalignment=misalignment)
        away = error(calibration, simulation.truth)
        assert calibration.covariance is not None
        assert calibration.noise_covariance is not None
        rows[way] = {
            "heading": heading_error(simulation, degrees, unit.seed, calibration) ** 2,
            "hard_iron": float(np.mean(away[6:9] ** 2)),
            "nees": nees(away, calibration.covariance),
            "of_sensors": nees(away, calibration.noise_covariance),
            "decided": float(bool(calibration.terms)),
            "refused": float(not calibration.trusted),
        }
    return rows


def band(runs: int, freedoms: int = FREEDOMS) -> tuple[float, float]:
    """Return the 95 % band of the mean of `runs` χ² variables of `freedoms` degrees of freedom."""
    half = 1.96 * float(np.sqrt(2 * freedoms / runs))
    return freedoms - half, freedoms + half
