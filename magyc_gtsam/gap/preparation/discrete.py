"""Checks before the estimation: order and signs of the axes, which rows are samples, and whether there is noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import comb

import numpy as np

from magyc_gtsam.estimators.smoother.axes import arrangements, check
from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.model.rests import by_second, spread
from magyc_gtsam.gap.preparation.held_clock import on_own_clock
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.noise_effects import NoiseScore, lattice, sample_hold
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.held import with_chance_repeats
from magyc_gtsam.recording.turned import with_turned_gyroscope

_ORDER = 12  # of the differences, which suppress a motion with eight or more samples in its shortest period


def settled(recording: Recording, names: Sequence[str]) -> tuple[Recording, tuple[NoiseScore, ...]]:
    """Return the recording with axes, samples and times corrected, and the tests that led to the corrections.

    Raises:
        MagycError: the unit of the gyroscope is wrong.
    """
    scores: list[NoiseScore] = []
    if "axis-order" in names:
        recording, scores = _rearranged(recording)
    held = sample_hold(recording)
    if "sample-hold" in names:
        scores.append(held)
    recording = with_chance_repeats(recording)
    return on_own_clock(recording) if held.significant else recording, tuple(scores)


def _rearranged(recording: Recording) -> tuple[Recording, list[NoiseScore]]:
    """Return the recording with the gyroscope in the magnetometer's axes, and a score if they differed."""
    try:
        check(recording)
    except MagycError:
        best = arrangements(recording)[0]
        if best.unit:
            raise
        turned = with_turned_gyroscope(recording, best.matrix)
        explained = 1 - best.unexplained
        setting = {"explained": explained}
        return turned, [NoiseScore.counted("axis-order", explained, True, True, best.matrix.ravel(), setting)]
    return recording, []


def moving(recording: Recording) -> Recording:
    """Return the recording with one sample per `RULES.rest_spared` s in rests of `RULES.rest_means` s or more.

    The field varies from place to place, by a microtesla or two in any room. At a rest it has one value, however long
    the rest lasts; counted a hundred times, this would be taken for iron that came and went. A rest that begins or
    ends with a jump that no rotation explains is kept, because there iron did come or go.
    """
    time, field = recording.magnetometer
    number, starts, mean = by_second(time, field, time[0])
    if len(number) < 2 * RULES.rest_means:
        return recording
    size = spread(mean)
    stretches = np.lib.stride_tricks.sliding_window_view(mean, RULES.rest_means, axis=0)
    calm = np.flatnonzero(np.ptp(stretches, axis=2).max(axis=1) < RULES.rest_same * size)
    still = np.zeros(len(mean), dtype=bool)
    still[np.unique(calm[:, None] + np.arange(RULES.rest_means))] = True
    edges = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0)).reshape(-1, 2)
    jumps = _jumps(recording, time[starts], mean, size)
    for first, end in edges:
        if jumps[max(first - RULES.rest_near, 0) : first].any() or jumps[end - 1 : end + RULES.rest_near].any():
            still[first:end] = False
    if not still.any() or still.all():
        return recording
    spared = np.diff(np.floor((time - time[0]) / RULES.rest_spared), prepend=-1.0) > 0
    fresh = recording.magnetic_field_fresh.copy()
    fresh[fresh] = ~np.repeat(still, np.diff(np.append(starts, len(time)))) | spared
    return replace(recording, magnetic_field_fresh=fresh)


def _jumps(recording: Recording, time: Array, mean: Array, size: float) -> np.ndarray:
    """Return (n − 1,) whether the field changes more between successive means (n, 3) than the rotation explains."""
    when, rate = recording.gyroscope
    turned = summed_rate(when, np.linalg.norm(rate, axis=1))
    # A mean covers `window` s from its first sample on.
    turn = np.interp(time[1:] + RULES.window, when, turned) - np.interp(time[:-1], when, turned)
    change = np.linalg.norm(np.diff(mean, axis=0), axis=1)
    result: np.ndarray = change > RULES.rest_jump * size + 2 * size * turn
    return result


def noiseless(recording: Recording) -> bool:
    """Return whether the magnetometer has no measurable noise, as exact output of a simulator.

    Every test of the workflow measures a misfit relative to the noise.
    Coarse readings that seldom change are not noise-free: their steps are an effect that can be named.
    """
    value = recording.magnetometer.value
    if len(value) <= _ORDER or max(lattice(axis) for axis in value.T) > RULES.noiseless:
        return False
    differences = np.diff(value, n=_ORDER, axis=0)
    level = np.sqrt((differences**2).mean(axis=1) / comb(2 * _ORDER, _ORDER))
    return bool(np.percentile(level, RULES.noiseless_share) < RULES.noiseless)
