"""The visibility of each effect at its published strength above the noise."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.preparation import magnetometer_noise
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation import MILLIGAUSS, inject, simulate
from magyc_gtsam.simulation.environment import CHANNELS

_NOISE = (10 * MILLIGAUSS, 5e-3)
_SAMPLES = 6000  # samples of a simulated recording
_QUIET = {"magnetometer_noise": 1e-3 * _NOISE[0], "gyroscope_noise": 1e-3 * _NOISE[1]}
# Effects on single samples, which stand out of the noise of single samples.
OF_SAMPLES = ("coloured-noise", "spikes", "tone", "quantisation")
_ROUNDS = 6  # largest number of factors that are tried
_NEAR = 1.1  # ratio to the required visibility that is near enough
_LARGEST = 8.0  # largest factor


def visibility(name: str, motion: str, seed: int = 0) -> float:
    """Return the root of the misfit of the twelve parameters, in sigmas; NaN if the axes do not agree.

    The recording is free of noise and judged at 10 mG and 5 mrad/s over 600 s at 10 Hz. Effects that vary from sample
    to sample (tone, spikes) stand out more than this, since windows average them.
    """
    recording = simulate(motion, 600, seed=seed, effects=(name,), **_QUIET).recording  # type: ignore[arg-type]
    return misfit(recording, _NOISE)


def misfit(recording: Recording, noise: tuple[float, float]) -> float:
    """Return the root of the misfit of the twelve parameters, in sigmas; NaN if nothing fits.

    Args:
        recording: a recording with effects but without noise.
        noise: noise at which it is judged, T and rad/s per sample.
    """
    try:
        fit = fit_field_chain(recording, noise=noise, robust=False, delay=0.0, window=0.5)
    except MagycError:
        return float("nan")
    return float(np.sqrt(max(2 * fit.reduced.cost, 0.0)))


@lru_cache
def median_visibility(name: str, motion: str, seeds: int) -> float:
    """Return the median visibility over seeds 0 to `seeds` − 1."""
    return float(np.median([visibility(name, motion, seed) for seed in range(seeds)]))


def factor_in(recording: Recording, calibration: Calibration, name: str, seed: int) -> float:
    """Return the factor at which an effect stands out of a real recording as far as of a simulated one.

    The noise of the real recording is its misfit to the twelve parameters and the delay, including its colour; the
    simulated recording is of the wide motion. The factor is at most `_LARGEST` and the nearest of those tried, since
    some recordings cannot show an effect, and a fully clipped axis shows less than a slightly clipped one.

    Args:
        recording, calibration: as in `inject`.
        name: name of the effect.
        seed: seed of the random numbers.
    """
    level = magnetometer_noise(recording) / _NOISE[0]
    if name == "tone":
        return float(level * np.sqrt(_SAMPLES / recording.magnetic_field_fresh.sum()))
    if name in OF_SAMPLES:
        return float(level)
    if name == "axis-order":
        return 1.0
    base = fit_field_chain(recording, robust=False, delay=calibration.delay)

    def stands_out(factor: float) -> float:
        changed, _ = inject(recording, calibration, [(name, factor)], seed, CHANNELS)
        try:
            fit = fit_field_chain(changed, noise=base.chain.noise, robust=False, delay=calibration.delay)
        except MagycError:
            return np.inf  # the effect is so large that nothing fits
        return float(np.sqrt(max(2 * (fit.reduced.cost - base.reduced.cost) / base.colour, 0.0)))

    factor, wanted = 1.0, median_visibility(name, "wide", 4)
    tried: dict[float, float] = {}  # {factor: logarithmic distance from the required visibility}
    while factor not in tried and len(tried) < _ROUNDS:
        share = wanted / max(stands_out(factor), 0.2 * wanted)
        tried[factor] = abs(np.log(max(share, 1e-9)))
        if 1 / _NEAR < share < _NEAR:
            break
        factor = float(np.clip(factor * max(share, 0.2), 0.0, _LARGEST))
    return min(tried, key=lambda one: tried[one])
