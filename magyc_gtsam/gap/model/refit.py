"""Joint refit of the twelve parameters, the delay and the terms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.noise_levels import adapt
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.field_chain import DELAY
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.problem import Active, Model, Problem
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_ROUNDS = 3  # of noise levels
_STEPS = 8
_SHORTER = (1.0, 0.5, 0.2, 0.05)
_ROUNDING = 0.5  # of a cost, to second order of the rotations
_GRID = 81
_FOLLOWING = 3  # steps of the iron behind those of what bends the reading
_ASTRAY = 100.0  # times the cost allowed, from which it is not followed
_SETTLED = 1e-3  # squared length of a step, in sigmas


@dataclass(frozen=True, eq=False)
class Refit:
    """A model at its minimum: its twin there, and the covariance of free parameters and terms, in their order."""

    twin: Twin
    covariance: Array
    converged: bool

    @property
    def model(self) -> Model:
        """The model."""
        return self.twin.model

    def weight_of(self, index: int) -> float:
        """Squared length of the value of the model's term `index`, in its sigmas."""
        value, covariance = self.value_of(index)
        return float(value @ np.linalg.pinv(covariance) @ value)

    def value_of(self, index: int) -> tuple[Array, Array]:
        """Value (k,) and covariance (k, k) of the model's term `index`."""
        model = self.model
        term = model.terms[index]
        if term.name == "timing":
            place = int(np.flatnonzero(np.flatnonzero(model.free) == DELAY)[0])
            return model.parameters[[DELAY]], self.covariance[place : place + 1, place : place + 1]
        first = int(model.free.sum()) + sum(len(t.value) for t in model.terms[:index] if t.name != "timing")
        rows = slice(first, first + len(term.value))
        return term.value, self.covariance[rows, rows]


def determined(result: Refit, index: int) -> bool:
    """Whether the data, not the prior, hold every direction of the values of the model's term `index`."""
    _, covariance = _standardised(result, index)
    largest = float(np.linalg.eigvalsh(covariance)[-1])
    return largest < (RULES.determined_by_data * TERMS[result.model.terms[index].name].prior) ** 2


def possible(result: Refit, index: int) -> bool:
    """Whether the value of the model's term `index` is any that its effect can have."""
    value, _ = result.value_of(index)
    term = result.model.terms[index]
    return TERMS[term.name].possible(result.twin, value, term.setting)


def small(result: Refit, index: int) -> bool:
    """Whether the model's term `index` is so small that it needs more than significance to be given a name."""
    value, _ = _standardised(result, index)
    return float(np.linalg.norm(value)) < TERMS[result.model.terms[index].name].least


def widened(result: Refit) -> Refit:
    """With the covariance that the windows deserve where their misfit hangs together, as `smoother` has it."""
    twin = result.twin
    fit = Fit(twin.chain, twin.state, twin.chain.unweighted(), twin.reduced, twin.model.free)
    return replace(result, covariance=fit.colour * result.covariance)


def _standardised(result: Refit, index: int) -> tuple[Array, Array]:
    """`Refit.value_of` for a change of the channels by their deviations."""
    value, covariance = result.value_of(index)
    term = result.model.terms[index]
    deviations = TERMS[term.name].deviations(result.twin, term.setting)
    return value * deviations, covariance * np.outer(deviations, deviations)


def refit(problem: Problem, model: Model, short_term: SensorNoise | None, known: Twin | None = None) -> Refit:
    """Everything jointly, re-linearised at each step; noise levels in between (None keeps them).

    `known` is a twin of the same problem, perhaps of the same model without terms that are new.

    Raises:
        MagycError: a term whose effect on the readings is beyond all bounds.
    """
    converged = False
    twin = (known and known.beside(model)) or Twin.of(problem, model)
    covariance = np.zeros((0, 0))
    for _ in range(_ROUNDS if short_term is not None else 1):
        for _ in range(_STEPS):
            base = twin.base_columns
            precision, value = prior_of(twin)
            gradient = base @ twin.residual().ravel() - twin.base_pull + precision * value
            information = base @ base.T + np.diag(precision)
            if not np.isfinite(information).all():
                raise MagycError(f"the model with {', '.join(t.name for t in model.terms)} has no finite fit")
            covariance = _inverse(information)
            step = -covariance @ gradient
            length = float(step @ information @ step)
            converged = length < _SETTLED
            if converged:
                break
            ahead = _advance(problem, twin, step, twin.base_pull)
            if ahead is None:
                return Refit(twin, covariance, False)
            twin = ahead
            model = twin.model
        if short_term is None:
            break
        fixed = np.zeros_like(model.free)
        fit = adapt(Fit(twin.chain, twin.state, twin.chain.unweighted(), twin.reduced, fixed), False, short_term)
        before, after = np.array(model.noise), np.array(fit.chain.noise)
        model = replace(model, noise=fit.chain.noise)
        twin = Twin.of(problem, model)
        if np.abs(np.log(after / before)).max() < 3e-3:
            break
    return Refit(twin, covariance, converged)


def tempered(problem: Problem, result: Refit, short_term: SensorNoise) -> Refit:
    """With every effect of many values held by a deviation of its own values, refitted (empirical Bayes).

    A weak effect of many values is mostly noise in those that the motion hardly determines; to apply it would do more
    harm than good. The deviation is the one under which the data are most likely.
    """
    terms = list(result.model.terms)
    for index, term in enumerate(terms):
        if len(term.value) > RULES.one_vector:
            value, covariance = _standardised(result, index)
            terms[index] = replace(term, prior=spread(value, covariance, TERMS[term.name].prior))
    if terms == list(result.model.terms):
        return result
    return refit(problem, replace(result.model, terms=tuple(terms)), short_term)


def spread(value: Array, covariance: Array, prior: float) -> float:
    """The most likely deviation of values that are estimated with this covariance, of which `prior` is a part."""
    precision = np.linalg.pinv(covariance, hermitian=True)
    known, direction = np.linalg.eigh(precision - np.eye(len(value)) / prior**2)
    known = np.maximum(known, 0.0)
    pull = direction.T @ (precision @ value)
    deviation = prior * np.logspace(-4, 0, _GRID)[:, None]
    widened = 1 + deviation**2 * known
    likelihood = 0.5 * (deviation**2 * pull**2 / widened - np.log(widened)).sum(axis=1)
    return float(deviation[np.argmax(likelihood), 0])


def _advance(problem: Problem, twin: Twin, step: Array, pull: Array) -> Twin | None:
    """The twin after a step, shortened until the cost does not rise; None where no step helps."""
    for share in _SHORTER:
        try:
            ahead = Twin.of(problem, _stepped(twin.model, share * step))
        except MagycError:
            continue  # a step too far for the chain to be factorised
        # The gyroscope's scale is not fitted by cost alone (`Twin.rate_pull`).
        allowed = _cost(twin) + share * abs(float(pull @ step)) + _ROUNDING
        for _ in range(_FOLLOWING if twin.model.bends else 0):
            if not allowed < _cost(ahead) < _ASTRAY * allowed:
                break
            ahead = _followed(problem, ahead) or ahead
        if np.isfinite(ahead.reduced.cost) and _cost(ahead) <= allowed:
            return ahead
    return None


def _followed(problem: Problem, ahead: Twin) -> Twin | None:
    """With the twelve parameters a step further, the terms held.

    What a bend adds the iron takes away, nearly all of it: on the straight line between two such pairs the cost is
    higher than at both its ends.
    """
    count = int(ahead.model.free.sum())
    base = ahead.base_columns[:count]
    step = np.zeros(len(ahead.base_columns))
    step[:count] = -_inverse(base @ base.T) @ (base @ ahead.residual().ravel())
    try:
        return Twin.of(problem, _stepped(ahead.model, step))
    except MagycError:
        return None


def _inverse(information: Array) -> Array:
    """The covariance, of parameters in whatever units; wide where the data determine nothing."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    weight, vector = np.linalg.eigh(information * scale * scale[:, None])
    result: Array = (vector / np.maximum(weight, 1e-13)) @ vector.T * scale * scale[:, None]
    return result


def prior_of(twin: Twin) -> tuple[Array, Array]:
    """(q,) precision of the free parameters and the terms before anything was measured, and the values it holds to 0.

    What a motion does not determine of a term stays where the data sheet has it.
    """
    base = np.zeros(int(twin.model.free.sum()))
    precision, values = [base], [base]
    for term in twin.model.estimated:
        own = TERMS[term.name]
        held = own.deviations(twin, term.setting) / (term.prior or own.prior)
        precision.append(np.broadcast_to(held**2, term.value.shape))
        values.append(term.value)
    return np.concatenate(precision), np.concatenate(values)


def _cost(twin: Twin) -> float:
    precision, value = prior_of(twin)
    return float(twin.reduced.cost + 0.5 * precision @ value**2)


def _stepped(model: Model, step: Array) -> Model:
    parameters = model.parameters.copy()
    count = int(model.free.sum())
    parameters[model.free] += step[:count]
    terms = []
    for term in model.terms:
        if term.name == "timing":
            terms.append(replace(term, value=parameters[[DELAY]]))
        else:
            k = len(term.value)
            terms.append(replace(term, value=term.value + step[count : count + k]))
            count += k
    return replace(model, parameters=parameters, terms=tuple(terms))


def with_term(model: Model, term: Active) -> Model:
    """A model with one more term; a timing frees the delay."""
    free = model.free.copy()
    free[DELAY] |= term.name == "timing"
    return replace(model, free=free, terms=(*model.terms, term))


def without_term(model: Model, index: int) -> Model:
    """A model with one term less; without a timing the delay is fixed at 0."""
    terms = tuple(t for i, t in enumerate(model.terms) if i != index)
    if model.terms[index].name != "timing":
        return replace(model, terms=terms)
    free, parameters = model.free.copy(), model.parameters.copy()
    free[DELAY], parameters[DELAY] = False, 0.0
    return replace(model, free=free, parameters=parameters, terms=terms)
