"""Facts that need the vertical: its estimation in the integrated world, and how such a fact enters a fit.

Vertical and field directions are compared in the integrated world, in which both are constant, so that accelerations of
the vehicle average out. A fact is one scalar y(θ) for the whole log, because its error is constant. The directions are
eliminated in the chain, so y is linearised at their optimum for θ, dg/dθ = −T H⁻¹ C (tangent bases T, the directions'
matrix H and its border C with θ), and relinearised at every minimum until it converges.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.estimators.smoother.skew_prior import AUTOMATIC
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, SKEW, WITH_SKEW, ChainState
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.level_turn import vertical
from magyc_gtsam.recording import Recording

_GRAVITY = 9.80665  # m/s²

SomeFact = TypeVar("SomeFact", bound="UprightFact")


@dataclass(frozen=True)
class UprightModel:
    """The error model and thresholds of the vertical.

    Attributes:
        average: s, over which the specific force is averaged in the world; a change of speed by 2 m/s leaves 0.2°.
        accelerated: m/s², largest difference of the specific force from gravity for a window to count.
        offset: m/s² per axis, sigma of an accelerometer's offset (10 mg; MEMS with factory calibration have 5 to 20).
        attitude: rad, sigma of the vertical of an attitude.
        contradicts: sigmas from which the measurement contradicts the known value.
        settled: whitened change of y below which its linearisation has converged.
        outlier: robust deviations from the median beyond which a window does not count.
        least: number of windows below which there is no fact.
    """

    average: float = 60.0
    accelerated: float = 1.0
    offset: float = 0.1
    attitude: float = np.radians(0.2)
    contradicts: float = 4.0
    settled: float = 0.02
    outlier: float = 3.5
    least: int = 8


MODEL = UprightModel()


@dataclass(frozen=True, eq=False)
class Vertical:
    """The source of the vertical.

    Attributes:
        time: (k,) s.
        force: (k, 3) m/s², specific force, or gravity along the vertical of an attitude, in sensor axes.
        by_attitude: whether `force` is by an attitude.
        signed: whether up and down are distinguished.
    """

    time: Array
    force: Array
    by_attitude: bool
    signed: bool


class Upright(NamedTuple):
    """The vertical at the n windows of a fit.

    Attributes:
        up: (3, n) unit vectors in the integrated world.
        counts: (n,) bool, windows that count.
        turn: (3, 3, n) s²/m, derivative of `up` by an offset of the specific force in sensor axes.
    """

    up: Array
    counts: np.ndarray
    turn: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class UprightFact(ABC):
    """The fact y(θ) ~ N(known, σ²), linearised; a `factors.chain.facts.Fact` on θ of 13 or 16 entries.

    Attributes:
        vertical: source of the vertical.
        value: whitened residual at `at`.
        slope: (16,) derivative of the residual; 0 before the linearisation.
        at: (16,) θ of the linearisation.
        measured, sigma: rad, y at `at`, and σ.
        contradiction: sigmas by which the data alone contradict the fact, which is then not used; otherwise 0.
    """

    vertical: Vertical
    value: float = 0.0
    slope: Array = field(default_factory=lambda: np.zeros(WITH_SKEW))
    at: Array = field(default_factory=lambda: np.zeros(WITH_SKEW))
    measured: float = np.nan
    sigma: float = np.nan
    contradiction: float = 0.0

    @abstractmethod
    def linearised(self: SomeFact, fit: Fit) -> SomeFact:
        """Return the fact linearised at a minimum; unchanged if too few windows count."""

    @property
    @abstractmethod
    def sentence(self) -> str:
        """The contradiction by the data in words."""

    @property
    @abstractmethod
    def name(self) -> str:
        """The key in the diagnostics."""

    @property
    def used(self) -> bool:
        """Whether it informs the fit."""
        return bool(self.slope.any())

    def residual(self, parameters: Array) -> tuple[Array, Array]:
        """Return residual and Jacobian; see `Fact`."""
        away = with_angles(parameters) - self.at
        return np.array([self.value + self.slope @ away]), self.slope[None, : len(parameters)]

    @property
    def diagnostics(self) -> dict[str, dict[str, float | bool]]:
        """The measured value in degrees and whether it was used; empty if nothing was measured."""
        if not np.isfinite(self.sigma):
            return {}
        measured, sigma = np.degrees([self.measured, self.sigma]).tolist()
        return {self.name: {"measured_deg": measured, "sigma_deg": sigma, "used": self.used}}

    def at_minimum(
        self: SomeFact, fit: Fit, slopes: Array, measured: float, known: float, sigma: float
    ) -> SomeFact:
        """Return the fact linearised at a fit, where y is `measured`, given its derivative by the directions (3, n)."""
        at = with_angles(fit.state.parameters)
        wide = fit.chain.eliminate(ChainState(at, fit.state.direction), fit.weights)
        total = np.einsum("in,pin->p", slopes, wide.direction_slopes)
        value = (measured - known) / sigma
        return replace(self, value=value, slope=total / sigma, at=at, measured=measured, sigma=sigma)


def vertical_of(recording: Recording) -> Vertical | None:
    """Return the source of the vertical in a recording, an attitude or else an accelerometer; None if there is none."""
    by_attitude = recording.attitude is not None and bool(np.isfinite(recording.attitude).any())
    force = recording.acceleration
    if by_attitude:
        up = vertical(recording.attitude, recording.acceleration)
        force = None if up is None else up * _GRAVITY
    if force is None:
        return None
    known = np.isfinite(force).all(axis=1)
    if not known.any():
        return None
    return Vertical(recording.time[known], force[known], by_attitude, recording.acceleration is not None)


def upright_facts(fit: Fit) -> list[UprightFact]:
    """Return the upright facts of a fit."""
    return [fact for fact in fit.chain.facts if isinstance(fact, UprightFact)]


def relinearised(fit: Fit) -> tuple[Fit, bool]:
    """Return a fit with its upright facts linearised at its minimum, and whether their linearisation had converged."""
    facts, settled = [], True
    for fact in fit.chain.facts:
        if isinstance(fact, UprightFact) and not fact.contradiction:
            now = fact.linearised(fit)
            if not fact.used and now.used:
                now = _tested(now, fit)
            expected = fact.residual(fit.state.parameters)[0][0]
            settled &= not now.used or (fact.used and abs(now.value - expected) < MODEL.settled)
            fact = now
        facts.append(fact)
    if all(one is other for one, other in zip(facts, fit.chain.facts, strict=True)):
        return fit, settled
    chain = replace(fit.chain, facts=tuple(facts))
    return replace(fit, chain=chain, reduced=chain.eliminate(fit.state, fit.weights)), settled


def _tested(fact: UprightFact, fit: Fit) -> UprightFact:
    """Return the fact, marked as contradicted and unused if a fit without it differs by too many sigmas.

    A misalignment that is not fitted has the typical prior variance of boards.
    """
    size = len(fit.state.parameters)
    spread = float(fact.slope[:size] @ fit.covariance @ fact.slope[:size]) * fit.colour * fit.widening
    if size == PARAMETERS:
        spread += AUTOMATIC.typical**2 * float(fact.slope[SKEW] @ fact.slope[SKEW])
    away = abs(fact.value) / np.sqrt(1 + spread)
    if away < MODEL.contradicts:
        return fact
    return replace(fact, value=0.0, slope=np.zeros(WITH_SKEW), contradiction=float(away))


def upright(vertical: Vertical, fit: Fit) -> Upright | None:
    """Return the vertical at the windows of a fit; None if too few of them count."""
    windows = fit.chain.windows
    force, counts = _of_windows(vertical, windows)
    counts &= np.abs(np.sqrt(np.einsum("in,in->n", force, force)) - _GRAVITY) < MODEL.accelerated
    counts &= fit.weights.window > 0
    if counts.sum() < MODEL.least:
        return None
    # The vertical in the integrated world, and its derivative by an offset of the accelerometer.
    share = counts.astype(float)
    to_world = windows.rotation.swapaxes(0, 1) * share
    up = _averaged(np.einsum("ijn,jn->in", to_world, force), windows.time)
    turn = _averaged(to_world, windows.time)
    length = np.sqrt(np.einsum("in,in->n", up, up))
    counts &= length > 0.5 * _GRAVITY * np.maximum(_averaged(share, windows.time), 1e-12)
    if counts.sum() < MODEL.least:
        return None
    length = np.maximum(length, 1e-12)
    return Upright(up / length, counts, turn / length)


def vertical_sigma(vertical: Vertical, lever: Array) -> float:
    """Return the sigma of y, in rad, by the error of the vertical.

    `lever` (3,) rad s²/m is the derivative of y by an offset of the specific force.
    """
    return MODEL.attitude if vertical.by_attitude else MODEL.offset * float(np.linalg.norm(lever))


def independent(windows: FieldWindows) -> float:
    """Return the number of independent averages of the vertical."""
    return max(float(np.ptp(windows.time)) / MODEL.average, 1.0)


def near(angle: Array, counts: np.ndarray) -> np.ndarray:
    """Return which angles are within `outlier` robust deviations (by the median absolute deviation) of the median.

    The weights are 0 or 1, so that the derivative of the mean is the mean of the derivatives.
    """
    away = np.abs(angle - np.median(angle[counts]))
    result: np.ndarray = away <= MODEL.outlier * 1.4826 * float(np.median(away[counts])) + 1e-12
    return result


def _of_windows(vertical: Vertical, windows: FieldWindows) -> tuple[Array, np.ndarray]:
    """Return the mean force (3, n) of each window, and which windows (n,) have samples."""
    time = windows.time
    middle = 0.5 * (time[1:] + time[:-1])
    edges = np.concatenate([[1.5 * time[0] - 0.5 * time[1]], middle, [1.5 * time[-1] - 0.5 * time[-2]]])
    rows = np.searchsorted(vertical.time, edges)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(vertical.force, axis=0)])
    count = np.diff(rows)
    mean = (total[rows[1:]] - total[rows[:-1]]) / np.maximum(count, 1)[:, None]
    return mean.T, count > 0


def _averaged(values: Array, time: Array) -> Array:
    """Return, for each window, the sums of (..., n) over the windows within half of `average` of it."""
    first = np.searchsorted(time, time - 0.5 * MODEL.average)
    last = np.searchsorted(time, time + 0.5 * MODEL.average, side="right")
    total = np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)], axis=-1)
    result: Array = total[..., last] - total[..., first]
    return result
