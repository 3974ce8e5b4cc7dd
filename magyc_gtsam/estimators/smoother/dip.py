"""The dip of the field at the place, as a fact: the angle of the chain's directions below the horizontal.

Vertical and directions meet in the integrated world, in which both stand still, so that what a vehicle accelerates
averages out. Over the windows n, with g_n the field's direction and p_n the vertical there,

    y(θ) = mean_n arcsin(−g_n(θ) · p_n) ~ N(dip, σ²),   σ² = σ_place² + σ_scatter² + σ_vertical²,

one number for the whole log: what the place, the accelerometer's offset or the attitude are off by is the same all
the time. The directions are eliminated in the chain, so y is linearised at their best for θ, dg/dθ = −T H⁻¹ C (tangent
bases T, the directions' matrix H and its border C with θ), again at every minimum until it stands still.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.options import DIP_SIGMA, FIELD_SIGMA, PlaceField
from magyc_gtsam.estimators.smoother.skew import with_angles
from magyc_gtsam.factors.chain.chain_values import ChainState
from magyc_gtsam.factors.chain.field_chain import WITH_SKEW, direction_slopes
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.level_turn import vertical
from magyc_gtsam.recording import Recording

_GRAVITY = 9.80665  # m/s²


@dataclass(frozen=True)
class DipModel:
    """What is believed of a vertical.

    Attributes:
        average: s, over which the specific force is averaged in the world; a change of speed by 2 m/s leaves 0.2°.
        accelerated: m/s² by which the specific force may differ from gravity for a window to count.
        offset: m/s² an axis, of an accelerometer (10 mg: MEMS after the factory's calibration are off by 5 to 20).
        attitude: rad, by which the vertical of an attitude is off.
        contradicts: sigmas from which the field here is not that of the place.
        settled: whitened change of y at which its linearisation stands still.
        outlier: robust deviations from the median beyond which a window does not count.
        least: windows that count, below which there is no dip.
    """

    average: float = 60.0
    accelerated: float = 1.0
    offset: float = 0.1
    attitude: float = np.radians(0.2)
    contradicts: float = 4.0
    settled: float = 0.02
    outlier: float = 3.5
    least: int = 8


MODEL = DipModel()


@dataclass(frozen=True, eq=False)
class DipFact:
    """y(θ) ~ N(dip, σ²), linearised; a `factors.chain.facts.Fact` on θ of 13 or 16 entries.

    Args:
        place: with a dip.
        time: (k,) s.
        force: (k, 3) m/s², specific force, or gravity along the vertical of an attitude, in sensor axes.
        by_attitude: which of the two.
        signed: whether up and down are told apart.

    Attributes:
        value: whitened residual at `at`; slope (16,): its derivative; 0 before it was linearised.
        measured, sigma: rad, y there and σ.
        contradiction: sigmas by which the data alone contradict it; it is not used then.
    """

    place: PlaceField
    time: Array
    force: Array
    by_attitude: bool
    signed: bool
    value: float = 0.0
    slope: Array = field(default_factory=lambda: np.zeros(WITH_SKEW))
    at: Array = field(default_factory=lambda: np.zeros(WITH_SKEW))
    measured: float = np.nan
    sigma: float = np.nan
    contradiction: float = 0.0

    @property
    def used(self) -> bool:
        """Whether it informs the fit."""
        return bool(self.slope.any())

    def residual(self, parameters: Array) -> tuple[Array, Array]:
        """See `Fact`."""
        away = with_angles(parameters) - self.at
        return np.array([self.value + self.slope @ away]), self.slope[None, : len(parameters)]

    @property
    def diagnostics(self) -> dict[str, dict[str, float | bool]]:
        """What was measured, in degrees, and whether it was used; empty where nothing was."""
        if not np.isfinite(self.sigma):
            return {}
        measured, sigma = np.degrees([self.measured, self.sigma]).tolist()
        return {"dip": {"measured_deg": measured, "sigma_deg": sigma, "used": self.used}}

    @property
    def sentence(self) -> str:
        """What the data alone say against it; "" where they do not."""
        if not self.contradiction:
            return ""
        assert self.place.dip is not None
        here, there = np.degrees([self.measured, self.place.dip])
        return (
            f"the field dips by {here:.1f}° here and by {there:.1f}° at the place ({self.contradiction:.1f} sigmas), "
            "which is not used: indoors and beside iron the field is not the world's; calibrate in the open, or leave "
            "the dip away"
        )


def dip_fact(recording: Recording, place: PlaceField | None) -> tuple[DipFact, ...]:
    """The fact, not linearised yet; none where no dip is known, or nothing says which way is up."""
    if place is None or place.dip is None:
        return ()
    by_attitude = recording.attitude is not None and bool(np.isfinite(recording.attitude).any())
    force = recording.acceleration
    if by_attitude:
        up = vertical(recording.attitude, recording.acceleration)
        force = None if up is None else up * _GRAVITY
    if force is None:
        return ()
    known = np.isfinite(force).all(axis=1)
    signed = recording.acceleration is not None
    return (DipFact(place, recording.time[known], force[known], by_attitude, signed),) if known.any() else ()


def dip_of(fit: Fit) -> DipFact | None:
    """The dip among a fit's facts."""
    return next((fact for fact in fit.chain.facts if isinstance(fact, DipFact)), None)


def known_dip(recording: Recording, fit: Fit) -> tuple[DipFact, ...]:
    """As if the dip that a fit has were known, with the sigma of a place; none where nothing says which way is up."""
    place = PlaceField(1.0, FIELD_SIGMA, 0.0, DIP_SIGMA)
    linear = (_linearised(fact, fit) for fact in dip_fact(recording, place))
    parameters = with_angles(fit.state.parameters)
    return tuple(replace(fact, value=0.0, at=parameters) for fact in linear if fact.used)


def relinearised(fit: Fit) -> tuple[Fit, bool]:
    """A fit with its dip linearised at its minimum, and whether it was so before."""
    index = next((k for k, fact in enumerate(fit.chain.facts) if isinstance(fact, DipFact)), None)
    if index is None:
        return fit, True
    before = fit.chain.facts[index]
    assert isinstance(before, DipFact)
    if before.contradiction:
        return fit, True
    now = _linearised(before, fit)
    if not before.used and now.used:
        now = _questioned(now, fit)
    expected = before.residual(fit.state.parameters)[0][0]
    settled = not now.used or (before.used and abs(now.value - expected) < MODEL.settled)
    chain = replace(fit.chain, facts=(*fit.chain.facts[:index], now, *fit.chain.facts[index + 1 :]))
    return replace(fit, chain=chain, reduced=chain.eliminate(fit.state, fit.weights)), settled


def _questioned(fact: DipFact, fit: Fit) -> DipFact:
    """The fact, or that the data contradict it, by a fit without it."""
    slope = fact.slope[: len(fit.state.parameters)]
    spread = float(slope @ fit.covariance @ slope) * fit.colour * fit.widening
    away = abs(fact.value) / np.sqrt(1 + spread)
    if away < MODEL.contradicts:
        return fact
    return replace(fact, value=0.0, slope=np.zeros(WITH_SKEW), contradiction=float(away))


def _linearised(fact: DipFact, fit: Fit) -> DipFact:
    """At a minimum; unchanged where too few windows count."""
    windows, g = fit.chain.windows, fit.state.direction
    force, counts = _of_windows(fact, windows)
    counts &= np.abs(np.sqrt(np.einsum("in,in->n", force, force)) - _GRAVITY) < MODEL.accelerated
    counts &= fit.weights.window > 0
    if counts.sum() < MODEL.least:
        return fact
    # The vertical in the integrated world, and by how much an offset of the accelerometer turns it.
    share = counts.astype(float)
    to_world = windows.rotation.swapaxes(0, 1) * share
    up = _averaged(np.einsum("ijn,jn->in", to_world, force), windows.time)
    turn = _averaged(to_world, windows.time)
    length = np.sqrt(np.einsum("in,in->n", up, up))
    counts &= length > 0.5 * _GRAVITY * np.maximum(_averaged(share, windows.time), 1e-12)
    if counts.sum() < MODEL.least:
        return fact
    length = np.maximum(length, 1e-12)
    up = up / length
    sine = -np.einsum("in,in->n", g, up)
    assert fact.place.dip is not None
    if not fact.signed and np.median(sine[counts]) * fact.place.dip < 0:
        up, sine = -up, -sine
    angle = np.arcsin(np.clip(sine, -1.0, 1.0))
    slope = -1 / np.sqrt(np.maximum(1 - sine**2, 1e-4))  # dy/d(g · p)
    weight = counts * _near(angle, counts) * fit.weights.window
    weight = weight / weight.sum()
    measured = float(weight @ angle)
    scatter = float(weight @ (angle - measured) ** 2)
    independent = max(float(np.ptp(windows.time)) / MODEL.average, 1.0)
    across = g - np.einsum("in,in->n", g, up) * up
    lever = np.einsum("n,in,ijn->j", weight * slope / length, across, turn)
    vertical_sigma = MODEL.attitude if fact.by_attitude else MODEL.offset * float(np.linalg.norm(lever))
    sigma = float(np.sqrt(fact.place.dip_sigma**2 + scatter / independent + vertical_sigma**2))
    at = with_angles(fit.state.parameters)
    wide = fit.chain.eliminate(ChainState(at, g), fit.weights)
    total = np.einsum("n,in,pin->p", weight * slope, up, direction_slopes(wide))
    return replace(
        fact,
        value=(measured - fact.place.dip) / sigma,
        slope=total / sigma,
        at=at,
        measured=measured,
        sigma=sigma,
    )


def _of_windows(fact: DipFact, windows: FieldWindows) -> tuple[Array, np.ndarray]:
    """(3, n) mean force within each window, and which have one."""
    time = windows.time
    middle = 0.5 * (time[1:] + time[:-1])
    edges = np.concatenate([[1.5 * time[0] - 0.5 * time[1]], middle, [1.5 * time[-1] - 0.5 * time[-2]]])
    rows = np.searchsorted(fact.time, edges)
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(fact.force, axis=0)])
    count = np.diff(rows)
    mean = (total[rows[1:]] - total[rows[:-1]]) / np.maximum(count, 1)[:, None]
    return mean.T, count > 0


def _averaged(values: Array, time: Array) -> Array:
    """Sums of (..., n) over the windows within half of `average` of each."""
    first = np.searchsorted(time, time - 0.5 * MODEL.average)
    last = np.searchsorted(time, time + 0.5 * MODEL.average, side="right")
    total = np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(values, axis=-1)], axis=-1)
    result: Array = total[..., last] - total[..., first]
    return result


def _near(angle: Array, counts: np.ndarray) -> np.ndarray:
    """Within `outlier` deviations of the median, by the median absolute deviation; all or nothing, so that the mean's
    derivative is the mean of the derivatives."""
    away = np.abs(angle - np.median(angle[counts]))
    near: np.ndarray = away <= MODEL.outlier * 1.4826 * float(np.median(away[counts])) + 1e-12
    return near
