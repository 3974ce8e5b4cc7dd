"""The twin: a model as a state space, whose innovations are white if the model is right.

The state is the direction of the field in the integrated world frame. It is constant except for the gyroscope's noise,
and the magnetometer measures it linearly. One banded factorisation of the field chain contains the forward filter: with
L its Cholesky factor, the prediction for window n has the information Π = s² I − L_{n,n−1} L_{n,n−1}ᵀ and the
information vector afterᵀ e − L_{n,n−1} z_{n−1}, z = L⁻¹ c. Residuals and any number of regressors are filtered
together, without a loop over windows; their sum of squares is the cost of the field chain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.estimators.smoother.columns import EstimatedTerms
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.factors.chain.banded import inverse_blocks
from magyc_gtsam.factors.chain.chain_values import PARAMETERS, ChainState, Reduced
from magyc_gtsam.factors.chain.field_chain import FieldChain
from magyc_gtsam.factors.chain.forward_filter import ForwardFilter
from magyc_gtsam.factors.chain.rate_columns import turned_by
from magyc_gtsam.factors.chain.rotations import Array, cross, skew
from magyc_gtsam.factors.chain.vech import SYMMETRIC_UNITS, unvech
from magyc_gtsam.factors.effects.changes import Setting
from magyc_gtsam.factors.effects.forms import FORMS
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.gap.model.columns import Columns
from magyc_gtsam.gap.model.model_chain import build, to_sensor_of, window_signals
from magyc_gtsam.gap.model.problem import Integrated, Model, Problem, added_by

_DIFFERENCE = 1e-3  # rad/s
_BIAS_STEP, _NEARBY = 1e-6, 1e-6  # steps of numerical derivatives: rad/s of the bias, relative of the soft iron


@dataclass(frozen=True, eq=False)
class Twin:
    """A model linearised on a recording.

    Attributes:
        problem, model: the data and the model.
        chain, state, reduced: the field chain with optimised directions, and its linearisation.
        windows, gyroscope: signals of the windows and of the gyroscope's samples.
    """

    problem: Problem
    model: Model
    chain: FieldChain
    state: ChainState
    reduced: Reduced
    windows: Signals
    gyroscope: Signals
    _integrated: Integrated

    @classmethod
    def of(cls, problem: Problem, model: Model, near: Twin | None = None) -> Twin:
        """Linearise a model on the data, starting from the directions of a twin near it if there is one."""
        chain, state, reduced, integrated = build(
            problem, model, None if near is None else (near.state, near._integrated)
        )
        gyroscope = Signals(
            problem.gyroscope.time,
            rate=integrated.rate,
            acceleration=problem.gyroscope.acceleration,
            channels=problem.gyroscope.channels,
        )
        return cls(
            problem,
            model,
            chain,
            state,
            reduced,
            window_signals(problem, integrated, state),
            gyroscope,
            integrated,
        )

    def fit(self, free: np.ndarray | None = None, terms: EstimatedTerms | None = None) -> Fit:
        """Return the twin as a fit of the field chain, unweighted, with the model's free parameters by default."""
        free = self.model.free if free is None else free
        return Fit(self.chain, self.state, self.chain.unweighted(), self.reduced, free, terms=terms)

    @property
    def n(self) -> int:
        """Return the number of windows."""
        return len(self.chain.windows)

    @property
    def time(self) -> Array:
        """Return the times (n,) of the windows, s."""
        return self.chain.windows.time

    @property
    def duration(self) -> float:
        """Return the time from the first to the last window, s."""
        return float(self.time[-1] - self.time[0])

    def beside(self, model: Model) -> Twin | None:
        """Return the twin of this model with further terms at 0, without a new linearisation; None for other models."""
        own, count = self.model, len(self.model.terms)
        same = model.noise == own.noise and np.array_equal(model.parameters, own.parameters)
        more = model.terms[count:]
        if not same or model.terms[:count] != own.terms or any(term.value.any() for term in more):
            return None
        result = replace(self, model=model)
        result.__dict__["_filter"] = self._filter
        if np.array_equal(model.free, own.free):
            added = [self.columns(t.name, t.setting) for t in more if t.name != "timing"]
            result.__dict__["_of_terms"] = [*self._of_terms, *added]
            result.__dict__["base_columns"] = np.concatenate([self.base_columns, *map(self.whiten, added)])
        return result

    def residual(self) -> Array:
        """Return the whitened innovations (3, n) of the data."""
        return self._without_colour(self.innovations())

    def innovations(self) -> Array:
        """Return the innovations (3, n) of the data in units of the sensors' noise, with their colour."""
        residuals = self.chain.residuals(self.state)
        window = residuals.window[None] * self.chain.window_scale
        link = residuals.link[None] * self.chain.link_scale
        return self._filter(window, link)[0]

    @property
    def along_field(self) -> Array:
        """Return the unit vectors (3, n) along which an innovation is of the field's strength and of no direction."""
        soft = self.windows.need("soft_iron")
        normal = np.linalg.solve(soft @ soft, self.windows.need("field"))
        result: Array = normal / np.linalg.norm(normal, axis=0)
        return result

    def whiten(self, columns: Columns) -> Array:
        """Return the innovations (p, 3n) of regressors."""
        count = len(columns.window)
        return self._without_colour(self._filter_of_units(columns.window, columns.link)).reshape(count, -1)

    def _without_colour(self, rows: Array) -> Array:
        """Return rows (…, 3, n) of innovations, whitened for the colour of their noise."""
        colour = self.problem.colour
        return rows if colour is None else colour.whiten(rows)

    @property
    def cost(self) -> float:
        """Half the sum of squares of the residual."""
        if self.problem.colour is None or not np.isfinite(self.reduced.cost):
            return float(self.reduced.cost)
        return 0.5 * float((self.residual() ** 2).sum())

    @cached_property
    def _filter(self) -> ForwardFilter:
        return ForwardFilter.of(self.chain, self.reduced)

    @cached_property
    def _filter_of_units(self) -> ForwardFilter:
        return self._filter.of_units(self.chain.window_scale, self.chain.link_scale)

    @cached_property
    def base_columns(self) -> Array:
        """Return the whitened regressors (q, 3n) of the free parameters, then of the model's terms."""
        return np.concatenate([self.parameter_columns, *(self.whiten(own) for own in self._of_terms)])

    @cached_property
    def _of_terms(self) -> list[Columns]:
        return [self.columns(t.name, t.setting, t.value) for t in self.model.estimated]

    @cached_property
    def parameter_columns(self) -> Array:
        """Return the whitened regressors (q, 3n) of the free parameters."""
        free = np.flatnonzero(self.model.free)
        window = self.reduced.on_parameters / self.chain.window_scale
        link = np.zeros((PARAMETERS, 3, self.n - 1))
        link[9:12] = -cross(self.state.direction[:, None, :-1], self.chain.windows.lever).swapaxes(0, 1)
        window += self._of_world
        return self.whiten(Columns(window[free], link[free]))

    @cached_property
    def _of_world(self) -> Array | float:
        """The derivative (13, 3, n) of the terms that are fixed in the world with respect to the parameters.

        Their fields pass through the soft iron. The gyroscope's bias turns the integrated world about the field; how it
        is tilted against the world, the field shows.
        """
        fixed = [t for t in self.model.on("magnetometer") if "to_sensor" in FORMS[t.name].needs]
        if not fixed:
            return 0.0
        result = np.zeros((PARAMETERS, 3, self.n))
        before, unit = added_by(fixed, self.windows), self.windows.need("soft_iron")
        for index, step in enumerate(_NEARBY * np.linalg.norm(unit) * SYMMETRIC_UNITS):
            result[index] = added_by(fixed, replace(self.windows, soft_iron=unit + step)) - before
        result[:6] /= _NEARBY * np.linalg.norm(unit)
        for index in range(9, 12):
            parameters = self.state.parameters.copy()
            parameters[index] += _BIAS_STEP
            turned = to_sensor_of(self._integrated, self.state._replace(parameters=parameters))
            result[index] = (added_by(fixed, replace(self.windows, to_sensor=turned)) - before) / _BIAS_STEP
        return result

    @cached_property
    def base_score_bias(self) -> Array:
        """Return the score bias (q,) of `base_columns`."""
        return np.concatenate([np.zeros(int(self.model.free.sum())), *(own.bias for own in self._of_terms)])

    def columns(self, name: str, setting: Setting, value: Array | None = None) -> Columns:
        """Return the regressors of a form, per unit of value; of one that is not linear, at a value (None: at 0)."""
        form = FORMS[name]
        if form.side == "magnetometer":
            here = self.windows
            own = form.columns(here, setting) if value is None else form.derivatives(here, value, setting)
            return Columns(own, None)
        if "rate" in form.needs:  # the regressors contain the gyroscope's noise, so that their score has a bias
            return self.of_profile(lambda signals: form.columns(signals, setting))
        return self.on_gyroscope(form.columns(self.gyroscope, setting))

    def of_profile(self, profile: Callable[[Signals], Array]) -> Columns:
        """Return the regressors of rate errors, a function (p, 3, ·) rad/s of the gyroscope's signals."""
        return self.on_gyroscope(profile(self.gyroscope))._replace(score_bias=self.rate_score_bias(profile))

    def of_slow_profile(self, profile: Callable[[Signals], Array], reads_rate: bool = True) -> Columns:
        """Return the same from the mean signals of the windows, to second order in the rotation within a window.

        Args:
            profile: as for `of_profile`.
            reads_rate: False for a profile without the rate, which contains no gyroscope noise and has no score bias.
        """
        at = self.windows
        turned = turned_by(np.swapaxes(self.chain.windows.rotation, 0, 1), profile(at))
        angle = -0.5 * (turned[..., 1:] + turned[..., :-1]) * np.diff(self.time)
        link = -cross(self.state.direction[:, None, :-1], angle.swapaxes(0, 1)).swapaxes(0, 1)
        return Columns(np.zeros_like(turned), link, self.rate_score_bias(profile) if reads_rate else None)

    def on_gyroscope(self, rate: Array) -> Columns:
        """Return the regressors of rate errors (p, 3, G) rad/s."""
        soft = unvech(self.state.parameters[:6])
        at = self._integrated.errors
        return Columns(*at.columns(self.chain.windows, soft, self.state.direction, rate))

    def rate_score_bias(self, profile: Callable[[Signals], Array]) -> Array:
        """Return the score bias (p,) of regressors `profile` (p, 3, ·) that contain the measured rate.

        The gyroscope's noise η is in the regressor and in the link's residual. With J = ∂profile/∂ω, the link's
        residual −[g]× R η and its share 1 − h that the smoother leaves, the expected score without any effect is
        −Σ tr((1 − h) [g]× R Jᵀ Rᵀ [g]×ᵀ): a scale below one would reduce the noise and so seem to fit better. Only the
        gyroscope's own noise causes this, not the other errors in the model's noise level.
        """
        at = self.windows
        score_bias = np.zeros(len(profile(at)))
        to_world = np.swapaxes(self.chain.windows.rotation, 0, 1)
        rate = at.need("rate")
        across = np.einsum("ijn,jkn->ikn", skew(self.state.direction.T).transpose(1, 2, 0), to_world)[..., :-1]
        weight = np.einsum("ian,ijn,jbn->abn", across, self._link_redundancy, across)
        for axis in range(3):
            step = np.zeros((3, 1))
            step[axis] = _DIFFERENCE
            slope = profile(replace(at, rate=rate + step)) - profile(replace(at, rate=rate - step))
            middle = 0.5 * (slope[..., 1:] + slope[..., :-1]) / (2 * _DIFFERENCE)
            score_bias -= np.einsum("bn,pbn->p", weight[:, axis], middle)
        own = min(1.0, self.problem.rate_noise / self.model.noise.gyroscope)
        colour = self.problem.colour
        return own**2 * score_bias * (1.0 if colour is None else colour.gain)

    @cached_property
    def _link_redundancy(self) -> Array:
        """Return the share (3, 3, n − 1) of each link's noise that remains in its residual; 0 across a gap."""
        filter_ = self._filter
        s00, s01, s11 = inverse_blocks(self.reduced.band, self.reduced.factor)
        covariance = np.array([[s00, s01], [s01, s11]])
        own = np.zeros((2, 2, self.n))
        own[0, 0], own[1, 0], own[1, 1] = filter_.factor[0, ::2], filter_.factor[1, ::2], filter_.factor[0, 1::2]
        # Neighbours: Cov_{n,n+1} = −(L_nn L_nnᵀ)⁻¹ H_{n,n+1} Cov_{n+1} and H_{n+1,n} = L_{n+1,n} L_nnᵀ.
        gain = np.linalg.solve(own[..., :-1].transpose(2, 1, 0), filter_.below.transpose(2, 1, 0))
        neighbour = -np.einsum("nab,bcn->acn", gain, covariance[..., 1:])
        before, after = filter_.before, filter_.after
        hat = np.einsum("ian,abn,jbn->ijn", before, covariance[..., :-1], before)
        hat += np.einsum("ian,abn,jbn->ijn", after, covariance[..., 1:], after)
        mixed = np.einsum("ian,abn,jbn->ijn", before, neighbour, after)
        hat += mixed + np.swapaxes(mixed, 0, 1)
        linked = (self.chain.link_scale > 0).astype(float)
        return (np.eye(3)[:, :, None] - hat) * linked

    def predictions(self) -> tuple[Array, Array]:
        """Return the direction (3, n) filtered up to each window, and its covariance (3, 3, n) in rad²."""
        residuals = self.chain.residuals(self.state)
        tangent, covariance = self._filter.filtered(
            residuals.window * self.chain.window_scale, residuals.link * self.chain.link_scale
        )
        basis = self.reduced.basis
        g = self.state.direction + np.einsum("ian,an->in", basis, tangent)
        return g, np.einsum("ian,abn,jbn->ijn", basis, covariance, basis)

    def log_determinant(self) -> Array:
        """Return the log determinant (n,) of the innovations' covariance before whitening, in window sigmas."""
        return np.log(np.linalg.det(np.moveaxis(self._filter.scatter, 2, 0)))
