"""The simulations of the Autocal paper (section III-B) and two of its claims: Fig. 5 and 6, and one-sided data.

One unit of the paper's sensor is a microtesla here. `synthetic` draws (35) to (38) as printed. One-sided data,
which the paper blames for the failures on real tracks (section III-C3), come in two kinds: directions on one
half of the sphere, and a vehicle that never turns over, with rates for the methods that use a gyroscope.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators import calibrate, methods
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.metrics import model, normalised_model_error
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.simulation import disturb, simulate

UNIT = 1e-6  # T
SCALE, OFFSET, OUTLIER = 100.0, 20.0, 100.0  # σ_K, σ_b and ζ of (35), (36) and below (38)
NOISES = (0.5, 1.0, 1.5, 2.0)  # σ of Fig. 5
OUTLIERS = (0.0, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)  # η of Fig. 6
SHARES = (0.0, 0.01, 0.03, 0.1, 0.3)  # η of the one-sided data
FAILED = 0.1  # model error from which a method has failed

Progress = Callable[[float], None]
Rows = Mapping[str, tuple[str, Mapping[str, Any]]]

VARIANTS: Rows = {
    **{
        name: (name, {})
        for name in ("ellipsoid", "dorveaux", "vasconcelos", "kok-schon", "magical", "l1-ellipsoid")
    },
    **{f"autocal, {k}": ("autocal", {"kernel": k}) for k in ("l1", "huber", "cauchy", "geman-mcclure")},
    "autocal, cauchy, τ = √3 units": ("autocal", {"width": float(np.sqrt(3)) * UNIT}),
}
"""Row of the tables → method and its options; those of the registry only are run."""


@dataclass(frozen=True)
class Score:
    """Model errors (39) of one method under one condition.

    Attributes:
        median, mean: of all runs; infinite where one gave no calibration.
        failed: share of the runs that gave none, or one that is off by more than FAILED.
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
    """A recording and its truth by (35) to (38).

    Args:
        seed: of everything.
        samples: N.
        noise, outliers: σ in units, η.
        one_sided: all directions on one half of the sphere.
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
    hit = random.permutation(samples)[: round(outliers * samples)]
    field[hit] += random.uniform(-OUTLIER, OUTLIER, (len(hit), 3))  # (38)
    left, stretch, _ = np.linalg.svd(matrix)
    root = (left * stretch) @ left.T * UNIT
    strength = float(np.cbrt(np.linalg.det(root)))
    truth = Calibration(root / strength, offset * UNIT, field_strength=strength, method="truth")
    return Recording(np.arange(samples) / 100, field * UNIT, name=f"synthetic-{seed}"), truth


def triangular(calibration: Calibration) -> Array:
    """(3, 3) K in T, upper triangular with a positive diagonal, of a calibration with field strength."""
    matrix, _ = model(calibration)
    scale = float(np.trace(matrix))
    triangle = np.linalg.cholesky((matrix @ matrix.T)[::-1, ::-1] / scale**2)[::-1, ::-1] * scale
    return np.asarray(triangle, dtype=np.float64)


def model_error(estimate: Calibration, truth: Calibration) -> float:
    """(39), with triangular matrices as in the paper."""
    return normalised_model_error(triangular(estimate), estimate.hard_iron, triangular(truth), truth.hard_iron)


def variants(names: Iterable[str] | None = None) -> Rows:
    """The rows of VARIANTS that can be run, or those of them that are named."""
    wanted = VARIANTS if names is None else {name: VARIANTS[name] for name in names}
    return {name: row for name, row in wanted.items() if row[0] in methods()}


def condition(
    recordings: Iterable[tuple[Recording, Calibration]],
    rows: Rows,
    error: Callable[[Calibration, Calibration], float] = model_error,
) -> dict[str, Score]:
    """Run all methods on the same recordings (recording, truth) and score them by `error`."""
    errors: dict[str, list[float]] = {name: [] for name in rows}
    for recording, truth in recordings:
        for name, (method, options) in rows.items():
            try:
                errors[name].append(error(calibrate(recording, method, **options), truth))
            except MagycError:
                errors[name].append(np.inf)
    return {name: _score(np.array(values)) for name, values in errors.items()}


def _score(values: Array) -> Score:
    return Score(float(np.median(values)), float(np.mean(values)), float((values > FAILED).mean()))


def noise_study(
    runs: int,
    progress: Progress | None = None,
    *,
    outliers: float,
    names: Iterable[str] | None = None,
    noises: Sequence[float] = NOISES,
) -> dict[float, dict[str, Score]]:
    """Fig. 5: {σ: scores} at a share of outliers."""

    def recordings(noise: float) -> Iterable[tuple[Recording, Calibration]]:
        return (synthetic(seed, noise=noise, outliers=outliers) for seed in range(runs))

    return _table(noises, recordings, variants(names), model_error, progress)


def outlier_study(
    runs: int,
    progress: Progress | None = None,
    *,
    one_sided: bool = False,
    names: Iterable[str] | None = None,
    shares: Sequence[float] | None = None,
) -> dict[float, dict[str, Score]]:
    """Fig. 6, or the same with all directions on one side: {η: scores} at σ = 1."""

    def recordings(share: float) -> Iterable[tuple[Recording, Calibration]]:
        return (synthetic(seed, outliers=share, one_sided=one_sided) for seed in range(runs))

    wanted = (SHARES if one_sided else OUTLIERS) if shares is None else shares
    return _table(wanted, recordings, variants(names), model_error, progress)


def vehicle_study(
    runs: int,
    progress: Progress | None = None,
    *,
    motion: str = "wide",
    names: Iterable[str] | None = None,
    shares: Sequence[float] = SHARES,
) -> dict[float, dict[str, Score]]:
    """A vehicle with gyroscope that never turns over: {share of seconds with up to 50 µT added: scores}.

    `smoother` is among the methods. Scored by the hard iron's error over the field strength, because the field
    of a magnetometer with gyroscope has no known scale.
    """

    def recordings(share: float) -> Iterable[tuple[Recording, Calibration]]:
        for seed in range(runs):
            simulation = simulate(motion, seed=seed)
            yield disturb(simulation.recording, share, seed=seed), simulation.truth

    rows = {**variants(names), "smoother": ("smoother", {})}
    return _table(shares, recordings, rows, hard_iron_error, progress)


def hard_iron_error(estimate: Calibration, truth: Calibration) -> float:
    """Length of the hard iron's error over the field strength."""
    return float(np.linalg.norm(estimate.hard_iron - truth.hard_iron) / (truth.field_strength or np.nan))


def _table(
    conditions: Sequence[float],
    recordings: Callable[[float], Iterable[tuple[Recording, Calibration]]],
    rows: Rows,
    error: Callable[[Calibration, Calibration], float],
    progress: Progress | None,
) -> dict[float, dict[str, Score]]:
    table = {}
    for index, value in enumerate(conditions):
        table[value] = condition(recordings(value), rows, error)
        if progress:
            progress((index + 1) / len(conditions))
    return table


STUDIES: Mapping[str, Callable[[int, Progress | None], dict[float, dict[str, Score]]]] = {
    "Fig. 5 without outliers, by σ": partial(noise_study, outliers=0.0),
    "Fig. 5 with 1 % of outliers, by σ": partial(noise_study, outliers=0.01),
    "Fig. 5 with 10 % of outliers, by σ": partial(noise_study, outliers=0.1),
    "Fig. 6, by the share of outliers": outlier_study,
    "Directions on one side, by the share of outliers": partial(outlier_study, one_sided=True),
    "Vehicle that never turns over, by the share of disturbed seconds; error of the hard iron": vehicle_study,
}
"""What `magyc-gtsam study autocal` prints: title → function of (runs, progress)."""
