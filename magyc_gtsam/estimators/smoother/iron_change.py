"""Detection of stretches of a recording with another hard iron, or with another instrument.

The robust fit rejects such stretches as disturbed, without a message if they are the smaller part. It does the same
with disturbances by the surroundings, which can be told apart. After a change of the hard iron, the stretches fit with
the same soft iron and field strength and another hard iron, which the rotation within them determines. Only hard iron,
gyroscope bias and field strength are fitted there, so that the question costs little where the answer is no. If a
sensor was remounted, or part of the log is another instrument's, the stretches can be calibrated by themselves, and
give another soft iron, hard iron or misalignment with certainty; no disturbance by the surroundings does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import BRIEF, Fit, begin, inverse_information
from magyc_gtsam.estimators.smoother.options import SmootherOptions
from magyc_gtsam.estimators.smoother.preparation import preintegrate, short_term_noise
from magyc_gtsam.estimators.smoother.search import refit_field_chain, shortened
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.factors.chain.facts import field_strength
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.median import median
from magyc_gtsam.factors.chain.vech import vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.sensor_faults.cut_off import inside


@dataclass(frozen=True)
class _Limits:
    """Thresholds, set on vehicles of five kinds with a jump of 3 µT per axis, and on real logs without a jump."""

    # s measured in all stretches together, and of a break between two; less seldom turns enough
    shortest: float = 15.0
    disturbed: float = 0.5  # weight of a window below which it counts as disturbed
    smoothed: float = 5.0  # s, length of the median filter of the weights, and of a stretch
    bridged: float = 0.5  # share of the longer stretch beside a break up to which the break is not one
    explained: float = 0.8  # least mean weight of the windows of a stretch that another hard iron explains
    strength: float = 0.02  # largest relative difference of the field strength
    settled: float = 1e-3  # relative step of the field strength below which it has converged
    rounds: int = 10  # most such steps; one to three were observed
    noise: float = 1.5  # largest noise in the stretch, as a multiple of that in the rest
    sigmas: float = 6.0  # least Mahalanobis distance of the change
    # Least change: of the hard iron over the field strength (a degree of heading), of a soft iron's element, in rad
    smallest: float = 0.02
    misaligned: float = float(np.radians(20.0))  # prior standard deviation of the misalignment after a remounting
    # least squared Mahalanobis distance of two instruments, 12 degrees of freedom: as 36 of 3
    distance: float = 60.0


_LIMITS = _Limits()


class IronChange(NamedTuple):
    """The change (3,) T of the hard iron in `stretches` (k, 2), from and to in s since the first row."""

    stretches: Array
    change: Array

    def sentence(self, recording: Recording) -> str:
        """Return the times and the size of the change in words, with the remedy."""
        duration = recording.time[-1] - recording.time[0]
        times = [t for t in self.stretches.ravel() if _LIMITS.smoothed < t < duration - _LIMITS.smoothed]
        listed = " and ".join(f"{t:.0f} s" for t in times[:2]) or f"{self.stretches[0, 0]:.0f} s"
        if len(times) > 2:
            listed += f" and {len(times) - 2} more times"
        shown, unit = recording.field_shown
        return (
            f"the hard iron changed at {listed} by {np.linalg.norm(self.change) * shown:.2g} {unit}: choose an "
            "interval without the change (start=, end=), or run `mg.find_gap`"
        )


def hard_iron_change(
    recording: Recording, stretches: Array, fit: Fit, calibration: Calibration, options: SmootherOptions
) -> IronChange | None:
    """Return the stretches that another hard iron explains; None if there are none.

    Args:
        recording: the data.
        stretches: (k, 2) s since the first row, those that the fit rejects.
        fit, calibration: of the whole recording.
        options: of that fit.
    """
    if not len(stretches) or not fit.converged or calibration.covariance is None:
        return None
    try:
        found = _refit(recording.rows(inside(stretches, recording.time - recording.time[0])), fit, options)
    except MagycError:  # too short, or a direction without curvature
        return None
    if found is None:
        return None
    other, covariance = found
    change = other.state.parameters[6:9] - fit.state.parameters[6:9]
    explained = (
        other.trusted_share >= _LIMITS.explained
        and other.chain.noise.magnetometer <= _LIMITS.noise * fit.chain.noise.magnetometer
    )
    apart = change @ np.linalg.solve(covariance + fit.covariance[6:9, 6:9], change) > _LIMITS.sigmas**2
    strength, _ = field_strength(fit.state.parameters[:6])
    if explained and apart and np.linalg.norm(change) > _LIMITS.smallest * strength:
        return IronChange(stretches, change)
    return None


def disturbed_stretches(recording: Recording, fit: Fit, options: SmootherOptions) -> Array:
    """Return the stretches (k, 2), from and to in s since the first row, that a fit rejects."""
    return _disturbed(fit.chain.windows.time - recording.time[0], fit.weights.window, options.window)


def _refit(recording: Recording, fit: Fit, options: SmootherOptions) -> tuple[Fit, Array] | None:
    """Fit hard iron, gyroscope bias and field strength to a part of the recording, with all else as in `fit`.

    Returns:
        The fit, and the covariance (3, 3) of its hard iron; None if the field has another strength there, which an
        instrument at rest cannot tell from another hard iron, or if there is no minimum.
    """
    samples = preintegrate(recording, shortened(options.window), options.turn)
    short_term = short_term_noise(recording) if options.noise is None else None
    parameters, noise = fit.state.parameters.copy(), fit.chain.noise
    free = np.zeros(len(parameters), dtype=bool)
    free[6:12] = True
    with_strength, stronger = np.zeros((len(free), 7)), 1.0
    with_strength[6:12, 1:] = np.eye(6)
    for _ in range(_LIMITS.rounds):
        windows = samples.integrate(parameters[9:12], float(parameters[DELAY]))
        begun = begin(FieldChain(windows, noise), parameters, free, BRIEF)
        other = refit_field_chain(samples, begun, options.reject, short_term)
        if not other.converged:
            return None
        parameters, noise = other.state.parameters.copy(), other.chain.noise
        with_strength[:6, 0] = parameters[:6]
        information = with_strength.T @ other.reduced.information @ with_strength
        covariance = inverse_information(information, np.ones(7, dtype=bool))
        share = -float(covariance[0] @ (with_strength.T @ other.reduced.gradient))
        if abs(stronger * (1 + share) - 1) > _LIMITS.strength:
            return None
        if abs(share) < _LIMITS.settled:
            return other, covariance[1:4, 1:4]
        stronger *= 1 + share
        parameters[:6] *= 1 + share
    return None


def _disturbed(time: Array, weight: Array, window: float) -> Array:
    """Return the stretches (k, 2) s with a low running median of the weights, merged across short breaks; `window`, in
    s, is the length of the longest window.
    """
    low = np.flatnonzero(weight < _LIMITS.disturbed)
    if len(low):
        size = round(_LIMITS.smoothed / max(median(np.diff(time)), 1e-9)) | 1
        low = np.flatnonzero(median_filter(weight, size, mode="nearest") < _LIMITS.disturbed)
    if not len(low):
        return np.empty((0, 2))
    breaks = np.flatnonzero(np.diff(low) > 1)
    first, last = low[np.append(0, breaks + 1)], low[np.append(breaks, len(low) - 1)]
    longer = np.maximum(*((time[last] - time[first])[side] for side in (slice(1, None), slice(None, -1))))
    apart = time[first[1:]] - time[last[:-1]] >= np.minimum(_LIMITS.shortest, _LIMITS.bridged * longer)
    first, last = first[np.append(True, apart)], last[np.append(apart, True)]
    measured = np.cumsum(np.minimum(np.diff(time, prepend=time[0]), window))  # without gaps of the log
    length = measured[last] - measured[first]
    kept = length >= _LIMITS.smoothed
    if length[kept].sum() < _LIMITS.shortest:
        return np.empty((0, 2))
    return np.column_stack([time[first], time[last]])[kept]


def instrument_change(
    recording: Recording,
    stretches: Array,
    whole: Calibration,
    options: SmootherOptions,
    calibrate: Callable[[Recording, SmootherOptions], Calibration],
) -> str:
    """Return that the disturbed stretches are of another instrument, in words; "" if they are not.

    Args:
        recording: the data.
        stretches: (k, 2) s since the first row, those that the calibration rejects.
        whole: the calibration, which is trusted.
        options: of that calibration.
        calibrate: calibrates a recording without this question.
    """
    rows = inside(stretches, recording.time - recording.time[0])
    try:
        part = calibrate(recording.rows(rows), replace(options, misalignment=_LIMITS.misaligned))
    except MagycError:  # too short, or too little motion
        return ""
    if not part.trusted:
        return ""
    assert whole.field_strength is not None
    (here, known_here), (there, known_there) = (_instrument(each, whole.field_strength) for each in (whole, part))
    away, known = there - here, known_here + known_there
    if away @ np.linalg.solve(known, away) < _LIMITS.distance or np.abs(away).max() < _LIMITS.smallest:
        return ""
    first, last = stretches[0, 0], stretches[-1, 1]
    shown, unit = recording.field_shown
    moved = np.linalg.norm(part.hard_iron - whole.hard_iron) * shown
    return (
        f"the instrument is another one between {first:.0f} and {last:.0f} s (its hard iron by {moved:.2g} {unit}): a "
        "sensor that was remounted, or a log of another one? Choose an interval (start=, end=)"
    )


def _instrument(calibration: Calibration, strength: float) -> tuple[Array, Array]:
    """Return soft iron, hard iron over a `strength` T and misalignment (12,), and their covariance (12, 12).

    The strength is one for both instruments: the place may change it, but the hard iron only if the scale changed.
    """
    covariance = calibration.covariance
    assert covariance is not None
    unit = np.r_[np.ones(6), np.full(3, 1 / strength)]
    skew = calibration.diagnostics.get("skew")
    known = np.zeros((12, 12))
    known[:9, :9] = covariance[:9, :9] * unit * unit[:, None]
    known[9:, 9:] = np.eye(3) if skew is None else skew["covariance"]
    turn = next((term.value for term in calibration.terms if term.name == "misalignment"), np.zeros(3))
    value = np.concatenate([vech(calibration.soft_iron), calibration.hard_iron * unit[6:], turn])
    return value, known + 1e-12 * np.eye(12)
