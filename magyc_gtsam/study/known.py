"""Study of the gain from prior knowledge: misalignment, an earlier calibration, and the place.

Skews: chips that are misaligned by 0 to 1.5° in a random direction, with the misalignment estimated if the data show
one, always, and never. Boards: the same with misalignments drawn from the prior of `calibrate`; averaged over this
prior, but not at each size, the NEES of a consistent covariance equals its number of degrees of freedom. Facts:
vehicles that hardly tilt, with the operator's knowledge added step by step, batch and online. Matrices: an earlier
calibration whose matrix is wrong by some percent, and whether that is noticed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from magyc_gtsam.study.known_facts import FACTS, fact_row, matrix_row
from magyc_gtsam.study.rows import HERE, Running, study_rows

SKEWS = (0.0, 0.2, 0.7, 1.5)  # deg
MOTIONS = ("wide", "moderate", "low", "tiny", "level")
WAYS: Mapping[str, float | str] = {"asked": "auto", "never": 0, "always": np.radians(10.0)}
LIMITED = (("tiny", 60.0), ("level", 600.0), ("ship", 600.0))
PERCENTS = (0.2, 0.5, 1.0)


@dataclass(frozen=True)
class SkewCell:
    """Results over the runs of one motion, misalignment and way.

    Attributes:
        heading: root-mean-square heading error over a level turn, deg.
        hard_iron: root-mean-square hard iron error per axis, T.
        nees, of_sensors: mean NEES of `FREEDOMS` degrees of freedom, by the stated covariance, and by that without the
            model error, which the simulated instruments do not have.
        decided, refused: shares of runs in which a misalignment was corrected, and of runs whose result was not
            trusted.
    """

    heading: float
    hard_iron: float
    nees: float
    of_sensors: float
    decided: float
    refused: float


@dataclass(frozen=True)
class FactCell:
    """Results over the runs of one motion and prior knowledge.

    Attributes:
        error, stated: root mean squares of hard iron error and stated sigma per axis, T.
        bound: root mean square of the Cramér–Rao bound per axis with that knowledge, as if it were right, T.
        ratio, of_sensors: squared error relative to the stated covariance, and to that without the model error, per
            degree of freedom.
        refused: share of the runs that are not trusted.
    """

    error: float
    bound: float
    stated: float
    ratio: float
    of_sensors: float
    refused: float


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


def known_rows(chosen: Sequence[KnownCase], running: Running = HERE) -> list[Row]:
    """Return one row per unit."""
    return study_rows("known", worked, chosen, running)


def worked(unit: KnownCase) -> Row:
    """Return one row with a column "<way> <number>" for all ways and numbers of the unit's kind."""
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


def skew_cells(motion: str, degrees: float | None, rows: Sequence[Row]) -> dict[str, SkewCell]:
    """Return {way of `WAYS`: result} of one misalignment, or with None of boards drawn from the prior."""
    mean = _means(rows, "board", motion, 0.0) if degrees is None else _means(rows, "skew", motion, degrees)
    return {
        way: SkewCell(
            mean(f"{way} heading") ** 0.5,
            mean(f"{way} hard_iron") ** 0.5,
            mean(f"{way} nees"),
            mean(f"{way} of_sensors"),
            mean(f"{way} decided"),
            mean(f"{way} refused"),
        )
        for way in WAYS
    }


def fact_cells(motion: str, duration: float, rows: Sequence[Row]) -> dict[str, FactCell]:
    """Return {prior knowledge of `FACTS`: result}, with aligned chips."""
    mean = _means(rows, "fact", motion, duration)
    return {way: _fact_cell(way, mean) for way in FACTS}


def matrix_cell(motion: str, percent: float, rows: Sequence[Row]) -> FactCell:
    """Return the result with a wrong earlier matrix."""
    return _fact_cell("wrong", _means(rows, "matrix", motion, percent))


def _fact_cell(way: str, mean: Callable[[str], float]) -> FactCell:
    error, bound, stated = (mean(f"{way} {name}") ** 0.5 for name in ("error", "bound", "stated"))
    ratio, of_sensors, refused = (mean(f"{way} {name}") for name in ("ratio", "of_sensors", "refused"))
    return FactCell(error, bound, stated, ratio, of_sensors, refused)


def _means(rows: Sequence[Row], kind: str, motion: str, size: float) -> Callable[[str], float]:
    chosen = [row for row in rows if (row["kind"], row["motion"], row["size"]) == (kind, motion, size)]
    return lambda name: float(np.mean([row[name] for row in chosen]))


def band(runs: int, freedoms: int = FREEDOMS) -> tuple[float, float]:
    """Return the 95 % band of the mean of `runs` χ² variables of `freedoms` degrees of freedom."""
    half = 1.96 * float(np.sqrt(2 * freedoms / runs))
    return freedoms - half, freedoms + half
