"""The field chain: the field direction of every window is eliminated, which leaves a cost on (S, h, b, τ, ε) alone.

See docs/field_chain.md. Directions are in the integrated world frame of `preintegration`. Parameters θ (13 or 16):

    vech(S) 6 T (soft iron times field strength), h 3 T, b 3 rad/s, τ 1 s (delay), ε 3 rad (skew, where it is a
    parameter),

states g_n ∈ S² (the field direction of window n), residuals

    r_n = B M_n(τ) g_n + h − mean(m)_n,  B = S Exp(ε),      covariance σ_m²/W_n I,
    e_n = g_{n+1} − Exp(−ΔK_n (b − b₀)) g_n  (chordal),     variance σ_g² Σdt² in the tangent plane,

and the priors on θ (`facts`). ε turns the gyroscope's axes into the magnetometer's. With twelve parameters and a delay
θ has 13 entries, so that a skew held at 0 costs nothing.

One Gauss–Newton step eliminates the directions by a banded Cholesky factorisation (2×2 blocks, three sub-diagonals) and
is linear in the number of windows. All arrays keep the windows along their last, contiguous axis.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg.lapack import dtbtrs

from magyc_gtsam.factors.chain import compiled
from magyc_gtsam.factors.chain.chain_values import (
    DELAY,
    ChainState,
    Reduced,
    Residuals,
    SensorNoise,
    Weights,
    iron_matrix,
)
from magyc_gtsam.factors.chain.directions import DirectionModel, LinearisedSensor, QuadraticPrior, stepped
from magyc_gtsam.factors.chain.facts import Fact, quadratic
from magyc_gtsam.factors.chain.field_windows import FieldWindows
from magyc_gtsam.factors.chain.linearisation import Linearised
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.small import inverse
from magyc_gtsam.factors.errors import MagycError

_SETTLING = 20  # largest number of Gauss–Newton steps of the directions alone
_SETTLED = 1e-12  # rad², squared step of a direction; a last one leaves 2e-10 rad, since each squares them


@dataclass(frozen=True, eq=False)
class FieldChain:
    """Cost, elimination and diagnostics of one chain of windows.

    Args:
        windows: integrated windows; `windows.bias` and `.delay` are the linearisation points.
        noise: standard deviations per sample.
        bend: linearisation of the sensor, where it clips or is non-linear.
        facts: priors on θ.

    Attributes:
        window_scale: (n,) 1/T, reciprocal standard deviation of a window's mean.
        link_scale: (n − 1,) 1/rad, reciprocal standard deviation of a link; 0 across a hole.

    Raises:
        MagycError: fewer than 3 windows.
    """

    windows: FieldWindows
    noise: SensorNoise
    bend: LinearisedSensor | None = field(default=None, kw_only=True)
    facts: tuple[Fact, ...] = field(default=(), kw_only=True)
    window_scale: Array = field(init=False)
    link_scale: Array = field(init=False)

    def __post_init__(self) -> None:
        if len(self.windows) < 3:
            raise MagycError(
                f"{len(self.windows)} windows, at least 3 are needed: the recording is too short or hardly moves"
            )
        w = self.windows
        object.__setattr__(self, "window_scale", np.sqrt(w.count) / self.noise.magnetometer)
        # A floor of a thousandth of the magnetometer's own angular noise keeps a noise-free gyroscope solvable.
        floor = (0.001 * self.noise.magnetometer / (w.spread + 1e-9)) ** 2 / w.count.mean()
        variance = self.noise.gyroscope**2 * w.link_time + floor
        object.__setattr__(self, "link_scale", w.linked / np.sqrt(variance))

    @property
    def window_sigma(self) -> Array:
        """Standard deviation of each window's mean (n,) in T."""
        return 1 / self.window_scale

    @property
    def link_sigma(self) -> Array:
        """Standard deviation of each link (n − 1,) in rad; infinite across a hole."""
        with np.errstate(divide="ignore"):
            return 1 / self.link_scale

    def part(self, first: int, stop: int) -> FieldChain:
        """Return the chain of the windows `first` ≤ n < `stop`, with the same facts."""
        bend = None if self.bend is None else LinearisedSensor(*(each[:, first:stop] for each in self.bend))
        return replace(self, windows=self.windows.part(first, stop), bend=bend)

    def unweighted(self) -> Weights:
        """Return weights that are all one."""
        return Weights(np.ones(len(self.windows)), np.ones(len(self.windows) - 1))

    def start(self, parameters: Array) -> ChainState:
        """Return a state at θ whose directions are computed from each window's own field.

        A window whose field equals the hard iron has no direction of its own and starts along x.
        """
        body = inverse(iron_matrix(parameters)) @ (self.windows.field - parameters[6:9, None])
        body[0] += ~body.any(axis=0)
        g = np.einsum("ijn,in->jn", self.rotation(parameters), body)
        return ChainState(parameters, g / np.sqrt(np.einsum("in,in->n", g, g)))

    def residuals(self, state: ChainState) -> Residuals:
        """Return the unwhitened residuals of windows and links."""
        parameters, g = state
        if compiled.loops and self.bend is None:
            n = g.shape[1]
            result = Residuals(np.empty((3, n)), np.empty((3, n - 1)))
            model = iron_matrix(parameters), self.rotation(parameters), self.turn(parameters)
            target = self.windows.field, parameters[6:9]
            compiled.loops.residuals(n, *map(compiled.given, (*model, *target, g)), *result)
            return result
        body = np.einsum("ijn,jn->in", self.rotation(parameters), g)
        window = iron_matrix(parameters) @ body
        if self.bend is not None:
            window *= self.bend.answer
        window -= self._target(parameters[6:9, None])
        turn = self.turn(parameters)
        return Residuals(window, g[:, 1:] - np.einsum("ijn,jn->in", turn, g[:, :-1]))

    def squares(self, residuals: Residuals) -> tuple[Array, Array]:
        """Return the squared whitened residuals of windows (n,) and links (n − 1,)."""
        return (
            np.einsum("in,in->n", residuals.window, residuals.window) * self.window_scale**2,
            np.einsum("in,in->n", residuals.link, residuals.link) * self.link_scale**2,
        )

    def eliminate(self, state: ChainState, weights: Weights) -> Reduced:
        """Linearise at `state` and eliminate the directions.

        Raises:
            MagycError: a window's direction has no finite curvature.
        """
        parameters, size = state.parameters, len(state.parameters)
        linear = Linearised.of(self.windows, state, self._sight(state, weights))
        known = self.known(state, linear.basis)
        if known is not None:
            known.onto_first(linear.band, linear.border[size])
            linear.border[:size, :, 0] += known.information[:size, size:]
        products, cost, factor, absorbed, failed = linear.eliminated()
        self._check(failed)
        information, gradient = products[:size, :size], products[:size, size]
        if known is not None:
            information += known.information[:size, :size]
            gradient += known.gradient[:size]
            cost += known.cost
        if self.facts:
            believed = quadratic(self.facts, parameters)
            cost += believed[0]
            gradient += believed[1]
            information += believed[2]
        return Reduced(
            cost,
            information,
            gradient,
            linear.basis,
            linear.on_direction,
            linear.before,
            linear.after,
            linear.columns[:size],
            linear.links[:3].swapaxes(0, 1),
            linear.band.T,
            factor,
            absorbed.T,
        )

    def _target(self, hard_iron: Array) -> Array:
        """Return what B M g (3, n) T should be, times the answer of the sensor where it bends."""
        if self.bend is None:
            return self.windows.field - hard_iron
        answer, at = self.bend
        return self.windows.field + (answer - 1) * at - answer * hard_iron

    def move(self, state: ChainState, reduced: Reduced, step: Array) -> ChainState:
        """Return the state after a step on θ; the directions follow by back-substitution."""
        if compiled.loops:
            factor, n = reduced.band_factor, state.direction.shape[1]
            room, moved = np.empty(2 * n), np.empty((3, n))
            inputs = map(compiled.given, (reduced.half.T, step, reduced.basis, state.direction))
            compiled.loops.move(n, factor.columns, factor.inverse, *inputs, room, moved)
            return ChainState(state.parameters + step, moved)
        pull = reduced.half[:, -1] + reduced.half[:, :-1] @ step
        tangent, _ = dtbtrs(reduced.factor, pull, uplo="L", trans="T")
        return ChainState(state.parameters + step, stepped(state.direction, reduced.basis, tangent))

    def settle(self, state: ChainState, weights: Weights) -> tuple[ChainState, Reduced]:
        """Optimise the directions for the state's θ; return the state and the linearisation there."""
        state = self.settled(state, weights)
        return state, self.eliminate(state, weights)

    def settled(self, state: ChainState, weights: Weights) -> ChainState:
        """Return the state with the directions optimised for its θ, which is unchanged."""
        sight = self._sight(state, weights)
        for _ in range(_SETTLING):
            equations = sight.equations(state.direction)
            known = self.known(state, equations.basis)
            if known is not None:
                known.onto_first(equations.band, equations.gradient)
            direction, moved, failed = equations.stepped(state.direction)
            self._check(failed)
            state = ChainState(state.parameters, direction)
            if moved < _SETTLED:
                break
        return state

    def known(self, state: ChainState, basis: Array) -> QuadraticPrior | None:
        """Return the prior on θ and the first direction besides the facts; the base class has none."""
        return None

    def _sight(self, state: ChainState, weights: Weights) -> DirectionModel:
        parameters = state.parameters
        scale = self.window_scale * np.sqrt(weights.window)
        field = self._target(parameters[6:9, None]) * scale
        return DirectionModel(
            iron_matrix(parameters),
            self.rotation(parameters),
            scale,
            field,
            self.turn(parameters),
            self.link_scale * np.sqrt(weights.link),
            None if self.bend is None else self.bend.answer,
        )

    def _check(self, failed: int) -> None:
        """Raise an error if the matrix of the directions has no factor, from a row on."""
        if failed:
            window = (failed - 1) // 2
            raise MagycError(
                f"window {window} at {self.windows.time[window]:.1f} s has no finite direction: "
                "its weight or its noise is out of range"
            )

    def rotation(self, parameters: Array) -> Array:
        """Return M (3, 3, n) at θ: the rotation from the integrated world to the sensor, averaged over each window."""
        return self.windows.rotation_at(parameters[9:12], float(parameters[DELAY]))

    def turn(self, parameters: Array) -> Array:
        """Return E = Exp(−ΔK (b − b₀)), (3, 3, n − 1)."""
        return self.windows.turn_at(parameters[9:12])
