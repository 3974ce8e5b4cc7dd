"""Table 2 and Figs 2 to 5 of the review (Papafotis, Nikitas and Sotiriadis, Sensors 2021, 21, 5288).

The cost J (74) is computed with squared norms, without which no method can reach the printed accuracies (1/ρ of
about 365 at best); "bound" is the reciprocal of the mean of J at the Cramér–Rao bound, 2.42e5. δ of (76) is not
printed; robustness is given for δ = 1, "better than no calibration", and for a strict one.

The methods of this package are at the bound, except for the filter (2.51e5 to 2.54e5 over 250 runs, whose mean varies
by 3 %; 2.46e5 over 1500). The printed 2.26e5 to 2.32e5 are also consistent with it, two such deviations below. Where
the printed figures are lower still, the following was measured over the same 250 runs:

- twostep, 35.3 and 91.6 %: for fields of equal strength the centred estimate (8) is c = 0, E = −I for any
  data, and (10a) then divides rounding errors by rounding errors. One iteration from there gives 1/ρ = 43, three
  give 2.5e5. (14b) is the bias of another model than (2), which leaves 2.2e4; taking (13) for a singular value
  decomposition, which drops the signs of S, leaves 1.4e3 to 1.6e3, in 40 % of the runs where V is replaced by U. The
  printed pair of figures is not among these.
- crassidis, 3.31e3: depends on the filter's start and noise, which are not printed. With σ = 0.005 as simulated
  1/ρ is 6.9e4 in 77 % of the runs, and (22) for h, as (14b), gives 2.0e4.
- wu-shi, 87.2 %: starting at T = chol(A), as (57) prints it, instead of chol(A)⁻¹ succeeds in 85.2 %.
- vasconcelos, 99.6 %: (40) to (44) as printed do not give the ellipsoid's matrix and centre.
- ali-pso, 98.8 %: the swarm of w = 1, c1 = c2 = 2 diverges, and (45) is zero for an infinite ellipsoid.

The figures vary one of γ, β, K and σ from this baseline. `calibrate` centres the samples first, so that γ has no
effect; "as drawn" fits the samples about their own origin, as the review appears to do.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate
from magyc_gtsam.estimators.ellipsoid.ali_pso import ali_pso
from magyc_gtsam.estimators.ellipsoid.crassidis import CrassidisFilter
from magyc_gtsam.estimators.ellipsoid.dorveaux import dorveaux
from magyc_gtsam.estimators.ellipsoid.magical import magical
from magyc_gtsam.estimators.ellipsoid.twostep import twostep
from magyc_gtsam.estimators.ellipsoid.vasconcelos import vasconcelos
from magyc_gtsam.estimators.ellipsoid.wu_shi import wu_shi
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.metrics import RunScores, model, model_cost, scores
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.study.drawing import Panel, draw_panels

# Accuracy 1/ρ, robustness in %, executions per second, as printed.
PUBLISHED = {
    "twostep": (35.3, 91.6, 455.0),
    "crassidis": (3.31e3, 100.0, 47.6),
    "dorveaux": (2.26e5, 100.0, 12.8),
    "vasconcelos": (2.28e5, 99.6, 0.089),
    "ali-pso": (2.27e5, 98.8, 0.10),
    "wu-shi": (2.32e5, 87.2, 0.24),
    "magical": (2.28e5, 100.0, 29.4),
}
FITS = {
    "twostep": twostep,
    "dorveaux": dorveaux,
    "vasconcelos": vasconcelos,
    "ali-pso": ali_pso,
    "wu-shi": wu_shi,
    "magical": magical,
}
STRICT = 0.01  # δ: a tenth of the error without calibration, since the cost is squared
STRENGTH = 50e-6  # T per unit of the review's field
RATE = 10.0  # Hz; the methods do not use the time


class Condition(NamedTuple):
    """Parameters of Algorithm 8; the defaults are the baseline (80)."""

    gamma: float = 0.05
    beta: float = 0.05
    samples: int = 300
    noise: float = 0.005


BASELINE = Condition()
FIGURES: dict[str, tuple[Condition, ...]] = {
    "gamma": tuple(BASELINE._replace(gamma=g) for g in (0.05, 0.15, 0.25, 0.5, 0.75, 1.0)),
    "beta": tuple(BASELINE._replace(beta=b) for b in (0.05, 0.15, 0.25, 0.5, 0.75, 1.0)),
    "samples": tuple(BASELINE._replace(samples=k) for k in (50, 150, 300)),
    "noise": tuple(BASELINE._replace(noise=s) for s in (0.0005, 0.005, 0.05)),
}
"""The parameter varied in Figs 2, 3, 4 and 5."""
SYMBOLS = {"gamma": "γ", "beta": "β", "samples": "K", "noise": "σ"}
SAID = {
    "gamma": "magical and ali-pso almost always; twostep and wu-shi a little less; dorveaux and crassidis to a "
    "moderate γ; all precise but twostep and crassidis",
    "beta": "magical and dorveaux most robust; vasconcelos, ali-pso and crassidis to a moderate β; wu-shi most "
    "accurate, rarely; the rest fail often",
    "samples": "no matter for robustness; high accuracy even at K = 50; time linear in K",
    "noise": "all immune in robustness; accuracy falls by an order with each order of the variance",
}
"""The review's statements about its figures, whose numbers it does not print."""


class ReviewCase(NamedTuple):
    """One data set."""

    gamma: float
    beta: float
    samples: int
    noise: float
    seed: int


@dataclass(frozen=True)
class MethodScore:
    """One method over all runs of a condition.

    scores: at δ = 1; strict: at δ = STRICT; refused: runs that failed or whose result the method did not trust; bound:
    1/ρ at the Cramér–Rao bound.
    """

    method: str
    scores: RunScores
    strict: RunScores
    refused: int
    bound: float


@dataclass(frozen=True, eq=False)
class Sample:
    """One draw of (66) to (68): y = matrix · field + offset + noise, all without units."""

    y: Array
    field: Array
    matrix: Array
    offset: Array
    noise: float


def fibonacci_sphere(count: int) -> Array:
    """Return unit vectors (count, 3) spread evenly over the sphere, by step 3 of Algorithm 8."""
    k = np.arange(1, count + 1)
    theta = 2 * np.pi * k / ((1 + np.sqrt(5)) / 2)
    phi = np.arccos(1 - 2 * (k - 0.5) / count)
    return np.stack([np.cos(theta) * np.sin(phi), np.sin(theta) * np.sin(phi), np.cos(phi)], axis=1)


def draw(
    seed: int, *, samples: int = 300, beta: float = 0.05, gamma: float = 0.05, noise: float = 0.005
) -> Sample:
    """Draw a data set by Algorithm 8 with (68); the defaults are the baseline (80).

    Args:
        seed: seed of the random numbers.
        samples: number of samples.
        beta, gamma: half widths of the distributions of the matrix's and the offset's elements.
        noise: standard deviation of a sample.
    """
    random = np.random.default_rng(seed)
    field = fibonacci_sphere(samples)
    matrix = random.uniform(0.8, 1.2) * np.eye(3) + random.uniform(-beta, beta, (3, 3))  # (66a), (68a), (68b)
    offset = random.uniform(-gamma, gamma, 3)  # (66b), (68c)
    y = field @ matrix.T + offset + noise * random.standard_normal((samples, 3))  # (67)
    return Sample(y, field, matrix, offset, noise)


def bound(sample: Sample) -> float:
    """Return the smallest mean of J² (74) of an unbiased method, the trace of the Cramér–Rao bound.

    Three of T's nine elements are the free rotation, which the pseudo-inverse leaves out, as (72) does.
    """
    across = sample.field @ np.linalg.inv(sample.matrix)  # gradient of ‖m‖ by y
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    jacobian = np.hstack([np.einsum("ni,nj->nij", across, sample.field).reshape(-1, 9), across])
    return float(np.trace(np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-9, hermitian=True)) * sample.noise**2)


def units(runs: int, conditions: Sequence[Condition]) -> list[ReviewCase]:
    """Return `runs` data sets of each condition, seeds 0 to runs − 1; the review has 250."""
    return [ReviewCase(*condition, seed) for condition in dict.fromkeys(conditions) for seed in range(runs)]


def worked(unit: ReviewCase) -> Row:
    """Run all methods on one data set, by `calibrate` (centred) and on the samples as drawn."""
    gamma, beta, samples, noise, seed = unit
    data = draw(seed, samples=samples, beta=beta, gamma=gamma, noise=noise)
    recording = Recording(np.arange(samples) / RATE, data.y * STRENGTH)
    trivial = model_cost(np.eye(3), np.zeros(3), data.matrix, data.offset)  # (75)
    columns: dict[str, list[object]] = {
        name: [] for name in ("method", "centred", "cost", "trivial", "seconds", "trusted", "bound")
    }
    for name in PUBLISHED:
        for centred in (True, False):
            found = _calibrated(recording, name, data) if centred else _as_drawn(name, data)
            for column, value in zip(
                columns, (name, centred, found[0], trivial, *found[1:], bound(data)), strict=True
            ):
                columns[column].append(value)
    return columns


def method_scores(
    rows: Sequence[Row], condition: Condition = BASELINE, *, centred: bool = True
) -> list[MethodScore]:
    """Return one score per method."""
    result = []
    for name in PUBLISHED:
        own = [
            row
            for row in rows
            if row["method"] == name and row["centred"] == centred and _condition(row) == condition
        ]
        cost, trivial, took = ([row[column] for row in own] for column in ("cost", "trivial", "seconds"))
        loose, strict = (scores(cost, trivial, took, delta=delta) for delta in (1.0, STRICT))
        least = float(1 / np.mean([row["bound"] for row in own]))
        result.append(MethodScore(name, loose, strict, sum(not row["trusted"] for row in own), least))
    return result


def draw_figures(target: Path, rows: Sequence[Row]) -> None:
    """Draw Figs 2 to 5: accuracy and robustness over the varied parameter, by `calibrate` and as drawn."""
    panels = []
    for parameter, conditions in FIGURES.items():
        x = [getattr(condition, parameter) for condition in conditions]
        for centred in (True, False):
            each = [method_scores(rows, condition, centred=centred) for condition in conditions]
            how = "" if centred else ", as drawn"
            accuracy = {name: [cell[i].scores.accuracy for cell in each] for i, name in enumerate(PUBLISHED)}
            accuracy["bound"] = [cell[0].bound for cell in each]
            robust = {name: [100 * cell[i].scores.robustness for cell in each] for i, name in enumerate(PUBLISHED)}
            panels.append(Panel(f"accuracy{how}", SYMBOLS[parameter], "1/ρ", x, accuracy))
            panels.append(Panel(f"robustness{how}", SYMBOLS[parameter], "%", x, robust, logarithmic=False))
    draw_panels(target, panels, columns=4)


def _condition(row: Row) -> Condition:
    return Condition(row["gamma"], row["beta"], row["samples"], row["noise"])


def _calibrated(recording: Recording, method: str, data: Sample) -> tuple[float, float, bool]:
    """Return J (74), the run time, s, and whether the method trusts its result."""
    start = time.process_time()
    try:
        calibration = calibrate(recording, method, field_strength=STRENGTH)
    except MagycError:
        return np.inf, time.process_time() - start, False
    seconds = time.process_time() - start
    matrix, offset = model(calibration)
    cost = model_cost(matrix / STRENGTH, offset / STRENGTH, data.matrix, data.offset)
    return cost, seconds, calibration.converged


def _as_drawn(method: str, data: Sample) -> tuple[float, float, bool]:
    """Return the results of `_calibrated` for the method alone, on samples that are not centred."""
    start = time.process_time()
    try:
        if method == "crassidis":
            fitted: Any = CrassidisFilter()
            for sample in data.y:
                fitted.update(sample)
        else:
            fitted = FITS[method](data.y)
    except (MagycError, np.linalg.LinAlgError):  # a failure counts as an infinite cost
        return np.inf, time.process_time() - start, False
    seconds = time.process_time() - start
    cost = model_cost(fitted.matrix, fitted.offset, data.matrix, data.offset)
    return cost, seconds, bool(getattr(fitted, "converged", True))
