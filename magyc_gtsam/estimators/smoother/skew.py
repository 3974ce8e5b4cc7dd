"""The misalignment (skew) between the chips: its posterior, and its share of the calibration's covariance.

With a gyroscope the full matrix B = S Exp(ε) is observable. The three angles ε have the prior N(0, s²), whose standard
deviation s is itself unknown (`SkewPrior`, from 0 to 2°). The evidence of each s follows in closed form from one
linearisation at the minimum (Laplace approximation, with the Occam factor). With θ split into ε and the rest a, and
the data's information matrix Λ divided by the residual's autocorrelation time (`Fit.colour`),

    S = Λ_εε − Λ_εa Λ_aa⁻¹ Λ_aε,   b = S ε₀ − (g_ε − Λ_εa Λ_aa⁻¹ g_a),   Q = S + 1/s²,
    ln p(data | s) / p(data | 0) = ½ bᵀ Q⁻¹ b − ½ ln |I + s² S|,   ε | s ~ N(Q⁻¹ b, Q⁻¹).

If a misalignment is probable enough, its posterior mean over all s is corrected, in the directions that the motion
resolves. That decision gives aligned chips a larger prior probability than the covariance does (`SkewPrior.aligned`).
Otherwise the twelve parameters are reported for ε = 0. In both cases the second moment of ε about the corrected value,
over all s, is propagated to their covariance by da/dε = −Λ_aa⁻¹ Λ_aε, so that the stated sigmas hold.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.columns import UnmodelledColumns
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.skew_prior import Skew, SkewPrior
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, SKEW, WITH_SKEW, ChainState, Weights, iron_matrix
from magyc_gtsam.factors.chain.facts import Fact, LinearFact, quadratic
from magyc_gtsam.factors.chain.rotations import Array, by_axes
from magyc_gtsam.factors.chain.small import eigenvectors

_LEAST_SPLIT = 40  # windows of a recording from which its halves are compared


class Profile(NamedTuple):
    """The likelihood of ε with all other parameters profiled out.

    Attributes:
        information: (3, 3) S of the module's docstring.
        pull: (3,) b of the module's docstring.
        gain: (13, 3) as in `Skew`.
        shift: (13,) as in `Skew`, for ε = 0.
    """

    information: Array
    pull: Array
    gain: Array
    shift: Array


def widened(fit: Fit, prior: SkewPrior, known: LinearFact | None = None) -> Fit:
    """Return the fit linearised with a free misalignment, which is 0 if the fit has thirteen parameters.

    Args:
        fit: at its minimum.
        prior: of the misalignment; its widest deviation becomes the last fact of the chain.
        known: an earlier calibration's constraint on it.
    """
    facts = fit.chain.facts if known is None else (*fit.chain.facts, known)
    chain = replace(fit.chain, facts=(*facts, skew_prior_fact(prior.widest)))
    state = ChainState(with_angles(fit.state.parameters), fit.state.direction)
    free = np.append(fit.free[:PARAMETERS], np.ones(3, dtype=bool))
    return replace(fit, chain=chain, state=state, free=free, reduced=chain.eliminate(state, fit.weights))


def with_angles(parameters: Array) -> Array:
    """Return θ (16,), with zero misalignment if `parameters` have none."""
    return np.append(parameters, np.zeros(WITH_SKEW - len(parameters)))


class SkewPriorFact(LinearFact):
    """The prior of the misalignment, to be told from facts about the instrument."""


def skew_prior_fact(deviation: float) -> SkewPriorFact:
    """Return the fact ε ~ N(0, deviation²)."""
    return SkewPriorFact(np.arange(SKEW.start, SKEW.stop), np.zeros(3), np.eye(3) / deviation)


def on_skew(fact: Fact) -> bool:
    """Return whether a fact concerns the misalignment."""
    return isinstance(fact, LinearFact) and int(fact.rows[0]) == SKEW.start


def skew_of(fit: Fit, prior: SkewPrior, factor: float, *, decide: bool = True) -> Skew:
    """Return the misalignment estimate of a fit of sixteen parameters, at or near its minimum.

    Args:
        fit: with `skew_prior_fact(prior.widest)` as the last fact of its chain.
        prior: of the misalignment.
        factor: divides the data's information: the residual's colour, which an unmodelled misalignment raises, times
            its widening.
        decide: whether it may be corrected; if False it is left undecided, however probable.
    """
    profile = profile_of(fit, factor)
    believed = SkewPosterior.of(profile, prior)
    if not decide or believed.probability <= prior.probable:
        return believed.around(np.zeros(3), profile)
    doubt = _doubt(fit, believed.mean, prior, factor)
    return believed.around(np.zeros(3) if doubt else believed.resolved, profile, doubt)


def skew_from_score(fit: Fit, prior: SkewPrior) -> Skew:
    """Return the undecided misalignment estimate of a fit of thirteen parameters, from one group of columns."""
    chain, parameters = fit.chain, fit.state.parameters
    body = np.einsum("ijn,jn->in", chain.rotation(parameters), fit.state.direction)
    columns = iron_matrix(parameters) @ by_axes(body)
    beside = fit.beside
    new = beside.of(UnmodelledColumns(columns, None))
    profile = Profile(new.normal, new.score, -beside.move(new), np.zeros(PARAMETERS))
    return SkewPosterior.of(profile, prior).around(np.zeros(3), profile)


class SkewPosterior(NamedTuple):
    """The posterior of ε under each of the k deviations of a prior.

    Attributes:
        share: (k,) posterior weights of the deviations.
        decisive: (k,) the same with the weights of a decision, in the resolved directions.
        angle: (k, 3) posterior means along the principal axes.
        variance: (k, 3) posterior variances along them.
        axes: (3, 3) principal axes of the data's information, in columns.
        kept: (3,) bool, axes that are resolved.
        best: nats of the likeliest deviation against none, in the resolved directions.
        probability: that there is a misalignment, in the resolved directions, with the weights of a decision.
    """

    share: Array
    decisive: Array
    angle: Array
    variance: Array
    axes: Array
    kept: np.ndarray
    best: float
    probability: float

    @classmethod
    def of(cls, profile: Profile, prior: SkewPrior) -> SkewPosterior:
        """Compute the posterior; the prior is isotropic, so the likelihood factorises over the principal axes."""
        known, axes = eigenvectors(profile.information)
        known, pull = np.maximum(known, 0.0), profile.pull @ axes
        before = np.square(prior.deviations)[:, None]
        told = before * known
        variance = before / (1 + told)
        angle = variance * pull
        nats, kept = 0.5 * (pull * angle - np.log1p(told)), known > prior.resolved**-2
        seen = nats @ kept
        decisive = _normalised(prior.cautious, seen)
        probability = float(decisive[before[:, 0] > 0].sum())
        share = _normalised(np.array(prior.weights), nats.sum(axis=1))
        return cls(share, decisive, angle, variance, axes, kept, float(seen.max()), probability)

    @property
    def mean(self) -> Array:
        """(3,) posterior mean of ε over all deviations."""
        result: Array = self.axes @ (self.share @ self.angle)
        return result

    @property
    def resolved(self) -> Array:
        """(3,) ε that a decision corrects: the posterior mean along the resolved axes."""
        result: Array = self.axes @ np.where(self.kept, self.decisive @ self.angle, 0.0)
        return result

    def around(self, value: Array, profile: Profile, doubt: str = "") -> Skew:
        """Return the estimate with value `value` and the second moment of ε about it."""
        away = self.angle @ self.axes.T - value
        second = (self.axes * (self.share @ self.variance)) @ self.axes.T + (self.share * away.T) @ away
        shift = profile.shift + profile.gain @ value
        return Skew(value, second, self.best, self.probability, profile.gain, shift, doubt)


def _normalised(weights: Array, nats: Array) -> Array:
    share = weights * np.exp(nats - nats.max())
    result: Array = share / share.sum()
    return result


def profile_of(fit: Fit, factor: float) -> Profile:
    """Return the profile likelihood of ε, maximised over all other parameters; `factor` divides the information."""
    parameters, facts = fit.state.parameters, fit.chain.facts
    _, slope, believed = quadratic(facts, parameters)
    _, other_slope, other = quadratic(facts[:-1], parameters)
    information = (fit.reduced.information - believed) / factor + other
    gradient = (fit.reduced.gradient - slope) / factor + other_slope
    rest = np.flatnonzero(fit.free[:PARAMETERS])
    scale = 1 / np.sqrt(np.maximum(np.diag(information)[rest], 1e-300))
    inner = information[np.ix_(rest, rest)] * scale * scale[:, None] + 1e-13 * np.eye(len(rest))
    border = np.column_stack([information[rest, SKEW], gradient[rest]]) * scale[:, None]
    solved = scale[:, None] * np.linalg.solve(inner, border)
    curvature = information[SKEW, SKEW] - information[SKEW, rest] @ solved[:, :3]
    curvature = 0.5 * (curvature + curvature.T)
    skewed = parameters[SKEW]
    pull = curvature @ skewed - (gradient[SKEW] - information[SKEW, rest] @ solved[:, 3])
    gain, shift = np.zeros((PARAMETERS, 3)), np.zeros(PARAMETERS)
    gain[rest] = -solved[:, :3]
    shift[rest] = -solved[:, 3] + solved[:, :3] @ skewed
    return Profile(curvature, pull, gain, shift)


def _doubt(fit: Fit, angle: Array, prior: SkewPrior, factor: float) -> str:
    """Return why a probable misalignment cannot be that of the chips: too large, or not constant; "" if it can."""
    size = float(np.degrees(np.linalg.norm(angle)))
    most = float(np.degrees(prior.most))
    remedy = "calibrate where the field is uniform, away from steel and in one place"
    if np.linalg.norm(angle) > prior.most:
        return (
            f"the field varies along the way: it would take chips that are {size:.1f}° misaligned, and boards are "
            f"within {most:.0f}°; {remedy}, or say that they are (misalignment=np.radians({np.ceil(size):.0f}))"
        )
    count = len(fit.chain.windows)
    if count < _LEAST_SPLIT:
        return ""
    first, second = (_of_part(fit, rows, factor) for rows in (slice(0, count // 2), slice(count // 2, count)))
    apart = first.value - second.value
    if float(apart @ np.linalg.solve(first.covariance + second.covariance, apart)) < prior.apart:
        return ""
    one, two = (np.degrees(part.value).round(1).tolist() for part in (first, second))
    return (
        f"the field varies along the way: the first half of the recording shows chips that are misaligned by {one}° "
        f"about x, y, z, the second half by {two}°; {remedy}"
    )


class _Angle(NamedTuple):
    """An estimate of ε (3,) and its covariance (3, 3)."""

    value: Array
    covariance: Array


def _of_part(fit: Fit, rows: slice, factor: float) -> _Angle:
    """Return ε estimated from some of the windows alone, with the widest prior."""
    links = slice(rows.start, rows.stop - 1)
    chain = fit.chain.part(rows.start, rows.stop)
    state = ChainState(fit.state.parameters, fit.state.direction[:, rows])
    weights = Weights(fit.weights.window[rows], fit.weights.link[links])
    # The directions are those of the whole: at the same θ they differ at the cut only.
    part = replace(fit, chain=chain, state=state, weights=weights, reduced=chain.eliminate(state, weights))
    profile = profile_of(part, factor)
    held_by = quadratic(chain.facts[-1:], state.parameters)[2][SKEW, SKEW]
    covariance = np.linalg.inv(profile.information + held_by).astype(np.float64)
    return _Angle(covariance @ profile.pull, covariance)
