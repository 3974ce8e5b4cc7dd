"""Plan of the motion and duration for a required heading accuracy, with and without prior knowledge.

Each motion is simulated with the sensors' noise, and the information of its field chain is taken at the minimum after
several durations. Prior knowledge is added to it. A plan thus costs one fit per motion and duration, and gives the
Cramér–Rao bound with an unknown misalignment of typical boards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.estimators.gauge import fix_scale
from magyc_gtsam.estimators.smoother.dip import known_dip
from magyc_gtsam.estimators.smoother.fit import Fit, inverse_information
from magyc_gtsam.estimators.smoother.known import known_of, typical_matrix
from magyc_gtsam.estimators.smoother.options import FIELD_SIGMA, SmootherOptions
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.estimators.smoother.skew import skew_prior_fact, widened
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC
from magyc_gtsam.factors.chain.chain_values import SKEW
from magyc_gtsam.factors.chain.facts import Fact, StrengthFact, field_strength, quadratic
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.level_turn import MisalignmentError
from magyc_gtsam.observability import assess
from magyc_gtsam.recording import Recording
from magyc_gtsam.simulation import simulate

MOTIONS: Mapping[str, str] = {
    "wide": "all headings, pitch 45°, roll 5°",
    "low": "a quarter of the headings, pitch 45°, roll 5°",
    "moderate": "all headings, pitch 5°, roll 5°",
    "tiny": "a quarter of the headings, pitch 5°, roll 5°",
    "level": "all headings, pitch 1°, roll 1°",
    "ship": "all headings at 2°/s, pitch 1°, roll 2°",
}
DURATIONS = (30.0, 60.0, 120.0, 300.0, 600.0, 1200.0)  # s
WAYS = ("nothing", "the place", "an earlier calibration", "both")
_BOARD = np.radians(0.5)  # rad, deviation of each angle between two chips; boards have 0.4 to 0.75° per angle


@dataclass(frozen=True)
class Planned:
    """The expected accuracy of a motion of some duration with prior knowledge `known` (of `WAYS`).

    Attributes:
        heading: largest standard deviation of the heading over a level turn, deg.
        hard_iron: standard deviation of the hard iron's weakest direction, T.
        enough: whether the result would be trusted.
    """

    motion: str
    known: str
    duration: float
    heading: float
    hard_iron: float
    enough: bool


def plan(
    noise: tuple[float, float] = (1e-6, 5e-3),
    options: SmootherOptions | None = None,
    *,
    rate: float = 10.0,
    motions: Sequence[str] = tuple(MOTIONS),
    durations: Sequence[float] = DURATIONS,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Planned]:
    """Return the plan for all motions, durations and kinds of prior knowledge.

    Args:
        noise: standard deviation per sample of magnetometer, T, and gyroscope, rad/s.
        options: options with the earlier calibration, its possible change since, and the prior of a misalignment.
            Without an earlier calibration the matrix counts as known to 0.2 % per element and the hard iron as unknown.
        rate: rate of both sensors, Hz.
        motions, durations: names, and s.
        progress: called with the share done.

    Raises:
        MagycError: a motion is unknown or a noise is not positive.
    """
    unknown = sorted(set(motions) - MOTIONS.keys())
    if unknown or not min(noise) > 0:
        raise MagycError(
            f"plan: motion {unknown[0]!r} is not one of {', '.join(MOTIONS)}"
            if unknown
            else f"plan: noise must be above 0, got {noise[0]:g} T and {noise[1]:g} rad/s"
        )
    options = SmootherOptions() if options is None else options
    result: list[Planned] = []
    for index, motion in enumerate(motions):
        whole = simulate(
            motion, max(durations), rate, seed=1, magnetometer_noise=noise[0], gyroscope_noise=noise[1]
        )
        for duration in sorted(durations):
            recording = replace(whole.recording.between(0, duration), attitude=None)
            result += _of_recording(motion, duration, recording, noise, options)
        progress((index + 1) / len(motions))
    return result


def shortest(planned: Sequence[Planned], motion: str, known: str, heading: float) -> Planned | None:
    """Return the shortest duration of a motion that is enough for a heading accuracy, deg; None if none is."""
    return next(
        (p for p in planned if (p.motion, p.known) == (motion, known) and p.enough and p.heading <= heading), None
    )


def _of_recording(
    motion: str, duration: float, recording: Recording, noise: tuple[float, float], options: SmootherOptions
) -> list[Planned]:
    fit = fit_field_chain(recording, noise=noise, delay=0.0, robust=False)
    parameters = fit.state.parameters
    strength, _ = field_strength(parameters[:6])
    place: tuple[Fact, ...] = (StrengthFact(strength, FIELD_SIGMA), *known_dip(recording, fit))
    matrix: tuple[Fact, ...] = (typical_matrix(parameters),)
    if options.prior is not None:
        known = known_of(options)
        matrix = known.facts if known.skew is None else (*known.facts, known.skew)
    facts = ((), place, matrix, (*place, *matrix))
    return [
        _planned(motion, way, duration, recording, fit, given, options)
        for way, given in zip(WAYS, facts, strict=True)
    ]


def _planned(
    motion: str,
    way: str,
    duration: float,
    recording: Recording,
    fit: Fit,
    facts: Sequence[Fact],
    options: SmootherOptions,
) -> Planned:
    wide = widened(fit, AUTOMATIC)
    parameters = wide.state.parameters
    information = wide.reduced.information - quadratic(wide.chain.facts, parameters)[2]
    deviation = _BOARD if options.misalignment == "auto" else float(options.misalignment)
    free = wide.free.copy()
    free[SKEW] = deviation > 0
    if deviation > 0:
        facts = (*facts, skew_prior_fact(deviation))
    covariance = inverse_information(information + quadratic(facts, parameters)[2], free)
    soft = unvech(parameters[:6])
    soft_iron, unit, reported = fix_scale(soft, covariance[:12, :12])
    cross = covariance[:9, SKEW].copy()
    cross[:6] /= unit
    found = assess(
        reported,
        soft_iron,
        unit,
        recording,
        parameters[6:9],
        MisalignmentError(covariance[SKEW, SKEW], cross, np.zeros((12, 12))),
    )
    worst = float(np.sqrt(_largest(reported[6:9, 6:9])))
    assert found.heading_sigma is not None
    return Planned(motion, way, duration, found.heading_sigma, worst, found.observable)


def _largest(covariance: Array) -> float:
    return max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0)
