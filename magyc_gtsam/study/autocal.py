"""The simulations of the Autocal paper (section III-B): Figs 5 and 6, and one-sided data.

One unit of the paper's sensor is a microtesla here. `synthetic` draws (35) to (38) as printed. One-sided data, to which
the paper attributes the failures on real tracks (section III-C3), are of two kinds: directions on one half of the
sphere, and a vehicle that never turns over, with rates for the methods that use a gyroscope.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.engine import Row
from magyc_gtsam.estimators import calibrate, methods
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.metrics import model, normalised_model_error
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation import disturb, simulate
from magyc_gtsam.study.drawing import Panel, draw_panels

UNIT = 1e-6  # T
SCALE, OFFSET, OUTLIER = 100.0, 20.0, 100.0  # σ_K, σ_b and ζ of (35), (36) and below (38)
NOISES = (0.5, 1.0, 1.5, 2.0)  # σ of Fig. 5
OUTLIERS = (0.0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)  # η of Fig. 6
SHARES = (0.0, 0.01, 0.03, 0.1, 0.3)  # η of the one-sided data
FAILED = 0.1  # model error above which a method has failed

Rows = Mapping[str, tuple[str, Mapping[str, Any]]]

VARIANTS: Rows = {
    **{
        name: (name, {})
        for name in ("ellipsoid", "dorveaux", "vasconcelos", "kok-schon", "magical", "l1-ellipsoid")
    },
    **{f"autocal, {k}": ("autocal", {"kernel": k}) for k in ("l1", "huber", "cauchy", "geman-mcclure")},
    "autocal, cauchy, τ = √3 units": ("autocal", {"width": float(np.sqrt(3)) * UNIT}),
}
"""Row of the tables → method and its options; only registered methods are run."""


SAID = {
    "Fig. 5": "without outliers all alike, autocal a little worse above σ = 1.2; from 1 % of outliers on autocal is "
    "best and magical the best of the others; geman-mcclure falls behind as σ grows",
    "Fig. 6": "cauchy and geman-mcclure alike, huber behind as η grows; the l1 start worse than autocal",
}
"""The paper's statements about its figures, whose numbers it does not print."""


class AutocalCase(NamedTuple):
    """One recording: part of the study, value of its condition, and seed."""

    part: str
    value: float
    seed: int


@dataclass(frozen=True)
class ModelErrors:
    """Model errors (39) of one method under one condition.

    Attributes:
        median, mean: over all runs; a run without a calibration counts as infinite.
        failed: share of the runs without a calibration or with an error above FAILED.
    """

    median: float
    mean: float
    failed: float


def synthetic(
    seed: int,
    *,
    samples: int = 1000,
    noise: float = 1.0,
    outliers: float = 0.0,
    one_sided: bool = False,
    length: float = SCALE,
) -> tuple[Recording, Calibration]:
    """Return a recording and its truth by (35) to (38).

    Args:
        seed: seed of all random numbers.
        samples: number of samples N.
        noise, outliers: σ in units, and share of outliers η.
        one_sided: whether all directions are on one half of the sphere.
        length: σ_K in units.
    """
    random = np.random.default_rng(seed)
    k, b = random.standard_normal(6), random.standard_normal(3)
    matrix = np.eye(3)
    matrix[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]] += 0.1 * k
    matrix *= length  # (35)
    offset = OFFSET * (1 + b)  # (36)
    direction = random.standard_normal((samples, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    if one_sided:
        direction[:, 2] = np.abs(direction[:, 2])
    field = direction @ matrix.T + offset + noise * random.standard_normal((samples, 3))  # (37)
    outlier = random.permutation(samples)[: round(outliers * samples)]
    field[outlier] += random.uniform(-OUTLIER, OUTLIER, (len(outlier), 3))  # (38)
    left, stretch, _ = np.linalg.svd(matrix)
    root = (left * stretch) @ left.T * UNIT
    strength = float(np.cbrt(np.linalg.det(root)))
    truth = Calibration(root / strength, offset * UNIT, field_strength=strength, method="truth")
    return Recording(np.arange(samples) / 100, field * UNIT, name=f"synthetic-{seed}"), truth


def triangular(calibration: Calibration) -> Array:
    """Return K (3, 3) T, upper triangular with a positive diagonal, of a calibration with field strength."""
    matrix, _ = model(calibration)
    scale = float(np.trace(matrix))
    triangle = np.linalg.cholesky((matrix @ matrix.T)[::-1, ::-1] / scale**2)[::-1, ::-1] * scale
    return np.asarray(triangle, dtype=np.float64)


def model_error(estimate: Calibration, truth: Calibration) -> float:
    """Return the model error (39), with triangular matrices as in the paper."""
    return normalised_model_error(triangular(estimate), estimate.hard_iron, triangular(truth), truth.hard_iron)


def variants(names: Iterable[str] | None = None) -> Rows:
    """Return the rows of VARIANTS that can be run, or the named ones of them."""
    wanted = VARIANTS if names is None else {name: VARIANTS[name] for name in names}
    return {name: row for name, row in wanted.items() if row[0] in methods()}


@dataclass(frozen=True)
class StudyPart:
    """One figure, or one kind of one-sided data.

    Attributes:
        title: title of its table.
        symbol: symbol of the condition.
        values: values of the condition.
        draw: (value, seed) → recording and truth.
        error: (estimate, truth) → error.
        smoother: whether to run `smoother` in addition to VARIANTS.
    """

    title: str
    symbol: str
    values: tuple[float, ...]
    draw: Callable[[float, int], tuple[Recording, Calibration]]
    error: Callable[[Calibration, Calibration], float] = model_error
    smoother: bool = False


def _noisy(value: float, seed: int, *, outliers: float) -> tuple[Recording, Calibration]:
    return synthetic(seed, noise=value, outliers=outliers)


def _spoilt(value: float, seed: int, *, one_sided: bool = False) -> tuple[Recording, Calibration]:
    return synthetic(seed, outliers=value, one_sided=one_sided)


def _vehicle(value: float, seed: int) -> tuple[Recording, Calibration]:
    """Return a simulation with gyroscope, and up to 50 µT added in a share of its seconds."""
    simulation = simulate("wide", seed=seed)
    return disturb(simulation.recording, value, seed=seed), simulation.truth


def hard_iron_error(estimate: Calibration, truth: Calibration) -> float:
    """Return the hard iron error over the field strength, since the scale is not observable on a vehicle."""
    return float(np.linalg.norm(estimate.hard_iron - truth.hard_iron) / (truth.field_strength or np.nan))


PARTS: dict[str, StudyPart] = {
    "noise": StudyPart("Fig. 5 without outliers", "σ", NOISES, partial(_noisy, outliers=0.0)),
    "noise-1": StudyPart("Fig. 5 with 1 % of outliers", "σ", NOISES, partial(_noisy, outliers=0.01)),
    "noise-10": StudyPart("Fig. 5 with 10 % of outliers", "σ", NOISES, partial(_noisy, outliers=0.1)),
    "outliers": StudyPart("Fig. 6", "η", OUTLIERS, _spoilt),
    "one-sided": StudyPart("Directions on one side", "η", SHARES, partial(_spoilt, one_sided=True)),
    "vehicle": StudyPart(
        "Vehicle that never turns over, hard iron",
        "share disturbed",
        SHARES,
        _vehicle,
        hard_iron_error,
        smoother=True,
    ),
}


def units(
    runs: int, parts: Iterable[str] | None = None, values: Sequence[float] | None = None
) -> list[AutocalCase]:
    """Return `runs` recordings per condition (25 in the paper), for the given parts and values or all of them."""
    return [
        AutocalCase(part, value, seed)
        for part in (PARTS if parts is None else parts)
        for value in (PARTS[part].values if values is None else values)
        for seed in range(runs)
    ]


def worked(unit: AutocalCase, names: Sequence[str] | None = None) -> Row:
    """Run all methods of VARIANTS, or those named; the error is infinite for a method without a calibration."""
    part = PARTS[unit.part]
    recording, truth = part.draw(unit.value, unit.seed)
    rows = dict(variants(names)) | ({"smoother": ("smoother", {})} if part.smoother else {})
    errors = []
    for method, options in rows.values():
        try:
            errors.append(part.error(calibrate(recording, method, **options), truth))
        except MagycError:  # a failure counts as an infinite error
            errors.append(np.inf)
    return {"method": list(rows), "model_error": errors}


def method_scores(rows: Sequence[Row], part: str) -> dict[float, dict[str, ModelErrors]]:
    """Return {value: {method: score}} of a part."""
    errors: dict[float, dict[str, list[float]]] = {}
    for row in rows:
        if row["part"] == part:
            errors.setdefault(row["value"], {}).setdefault(row["method"], []).append(row["model_error"])
    return {value: {name: _score(np.array(each)) for name, each in own.items()} for value, own in errors.items()}


def _score(values: Array) -> ModelErrors:
    return ModelErrors(float(np.median(values)), float(np.mean(values)), float((values > FAILED).mean()))


def draw(target: Path, rows: Sequence[Row]) -> None:
    """Draw the mean error over the condition, as in the paper, one panel per part."""
    panels = []
    for name, part in PARTS.items():
        table = method_scores(rows, name)
        if table:
            x = sorted(table)
            lines = {method: [table[value][method].mean for value in x] for method in table[x[0]]}
            panels.append(Panel(part.title, part.symbol, "mean error", x, lines))
    draw_panels(target, panels)
