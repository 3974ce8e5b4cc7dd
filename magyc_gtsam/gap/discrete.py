"""What is checked before anything is estimated: the order and signs of the axes, and which rows are samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.estimators.smoother.axes import arrangements, check
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.gyroscope_track import summed_rate
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.held_clock import on_own_clock
from magyc_gtsam.gap.noise_effects import NoiseScore, quantisation, sample_hold
from magyc_gtsam.recording import Recording

_COARSE = 0.2  # step in sigmas from which values repeat by chance
_SECOND = 1.0  # s over which readings are averaged to see whether they move
_REST = 10  # such means that hardly differ are a rest
_SAME = 0.03  # of the field's spread over the recording: less is no move
_NEAR = 3  # means beside a rest in which a jump belongs to it
_JUMP = 0.1  # of the field's spread
_SPARED = 5.0  # s between the samples of a rest that count


def settled(recording: Recording, names: Sequence[str]) -> tuple[Recording, tuple[NoiseScore, ...]]:
    """The recording as its samples should be read, and the tests that say how.

    Raises:
        MagycError: the unit of the gyroscope is wrong.
    """
    scores: list[NoiseScore] = []
    if "axis-order" in names:
        recording, scores = _rearranged(recording)
    held = sample_hold(recording)
    if "sample-hold" in names:
        scores.append(held)
    if held.significant:
        recording = on_own_clock(recording)
    else:
        recording = _unheld(recording, short_term_noise(recording).magnetometer)
    return recording, tuple(scores)


def _rearranged(recording: Recording) -> tuple[Recording, list[NoiseScore]]:
    """With the gyroscope in the magnetometer's axes, where they differed."""
    try:
        check(recording)
    except MagycError:
        best = arrangements(recording)[0]
        if best.unit:
            raise
        assert recording.angular_rate is not None
        turned = replace(recording, angular_rate=recording.angular_rate @ best.matrix.T)
        explained = 1 - best.unexplained
        score = NoiseScore(
            "axis-order",
            explained,
            0.5,
            1e6,
            True,
            best.matrix.ravel(),
            np.zeros(9),
            {"explained": explained},
        )
        return turned, [score]
    return recording, []


def _unheld(recording: Recording, noise: float) -> Recording:
    """With all entries as samples, where the magnetometer's repeat because its steps are coarse (noise T per sample).

    To leave such repeats out would keep the first of each, and so make the magnetometer seem early.
    """
    if quantisation(recording, noise).statistic < _COARSE:
        return recording
    return replace(recording, magnetic_field_fresh=recording.magnetic_field_stamped)


def moving(recording: Recording) -> Recording:
    """With one sample in `_SPARED` s where the reading stands still for `_REST` s or more.

    A field that differs from place to place, by a microtesla or two in any room, differs by one number where the
    sensor rests, however long it rests there; told a hundred times it would pass for iron that came and went. A rest
    that begins or ends with a jump which no turn explains is kept: iron did come or go there.
    """
    time, field = recording.magnetometer
    second = np.floor((time - time[0]) / _SECOND).astype(int)
    number, starts, count = np.unique(second, return_index=True, return_counts=True)
    if len(number) < 2 * _REST:
        return recording
    mean = np.add.reduceat(field, starts, axis=0) / count[:, None]
    spread = float(np.sqrt(mean.var(axis=0).sum()))
    stretches = np.lib.stride_tricks.sliding_window_view(mean, _REST, axis=0)
    calm = np.flatnonzero(np.ptp(stretches, axis=2).max(axis=1) < _SAME * spread)
    still = np.zeros(len(mean), dtype=bool)
    still[np.unique(calm[:, None] + np.arange(_REST))] = True
    edges = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0)).reshape(-1, 2)
    jumps = _jumps(recording, time[starts], mean, spread)
    for first, end in edges:
        if jumps[max(first - _NEAR, 0) : first].any() or jumps[end - 1 : end + _NEAR].any():
            still[first:end] = False
    if not still.any() or still.all():
        return recording
    spared = np.diff(np.floor((time - time[0]) / _SPARED), prepend=-1.0) > 0
    fresh = recording.magnetic_field_fresh.copy()
    fresh[fresh] = ~still[np.searchsorted(number, second)] | spared
    return replace(recording, magnetic_field_fresh=fresh)


def _jumps(recording: Recording, time: Array, mean: Array, spread: float) -> np.ndarray:
    """(n − 1,) whether the field changes more from one mean (n, 3) to the next than the gyroscope turned it."""
    when, rate = recording.gyroscope
    turned = summed_rate(when, np.linalg.norm(rate, axis=1))
    # A mean reaches a second ahead of its first sample.
    turn = np.interp(time[1:] + _SECOND, when, turned) - np.interp(time[:-1], when, turned)
    change = np.linalg.norm(np.diff(mean, axis=0), axis=1)
    result: np.ndarray = change > _JUMP * spread + 2 * spread * turn
    return result
