"""How far each effect stands out of the noise at its published strength, whoever looks for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from magyc_gtsam.blindtest.scenarios import MOTIONS
from magyc_gtsam.estimators.chain_search import fit_field_chain
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.simulation import MILLIGAUSS, simulate
from magyc_gtsam.simulation.effects import EFFECTS

_NOISE = (10 * MILLIGAUSS, 5e-3)
_QUIET = {"magnetometer_noise": 1e-3 * _NOISE[0], "gyroscope_noise": 1e-3 * _NOISE[1]}


def visibility(name: str, motion: str, seed: int = 0) -> float:
    """Root of the misfit that the twelve parameters leave, in sigmas; NaN where the axes do not agree at all.

    All noise-free, judged at 10 mG and 5 mrad/s over 600 s at 10 Hz; what varies from sample to sample (tone,
    spikes) is worth more than this says, since windows average it.
    """
    recording = simulate(motion, 600, seed=seed, effects=(name,), **_QUIET).recording  # type: ignore[arg-type]
    try:
        fit, _ = fit_field_chain(recording, noise=_NOISE, robust=False, delay=0.0, window=0.5)
    except MagycError:
        return float("nan")
    return float(np.sqrt(max(2 * fit.reduced.cost, 0.0)))


def table(
    seeds: int = 4, motions: Sequence[str] = MOTIONS, progress: Callable[[float], None] = lambda _: None
) -> dict[str, dict[str, float]]:
    """{effect: {motion: median visibility over seeds}}."""
    result: dict[str, dict[str, float]] = {}
    for done, name in enumerate(EFFECTS):
        result[name] = {m: float(np.median([visibility(name, m, s) for s in range(seeds)])) for m in motions}
        progress((done + 1) / len(EFFECTS))
    return result
