"""The joint refit of the twelve parameters, the delay and the terms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

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
_REMEMBERED = 3  # earlier points of the acceleration
_STEPS = 8  # Gauss–Newton steps in a round
_DAMPED = (1e-2, 1e-1, 1.0, 10.0)  # Levenberg–Marquardt damping that is tried where a step fails
_ROUNDING = 0.5  # error of a cost, from second-order terms of the rotations
_GRID = 81  # deviations that are tried
_FOLLOWING = 3  # steps of the twelve parameters after a step of a non-linear term
_ASTRAY = 100.0  # times the allowed cost, from which these steps are not made
_SETTLED = 1e-2  # squared length of a step, in sigmas


@dataclass(frozen=True, eq=False)
class Refit:
    """A model at its minimum.

    Attributes:
        twin: the model, linearised at the minimum.
        covariance: (q, q) of the free parameters, then of the terms.
        converged: whether the last step was small.
    """

    twin: Twin
    covariance: Array
    converged: bool

    @property
    def model(self) -> Model:
        """The model."""
        return self.twin.model

    def weight_of(self, index: int) -> float:
        """Return the Wald statistic of the model's term `index`."""
        value, covariance = self.value_of(index)
        return float(value @ np.linalg.pinv(covariance) @ value)

    def value_of(self, index: int) -> tuple[Array, Array]:
        """Return value (k,) and covariance (k, k) of the model's term `index`."""
        term, rows = self.model.terms[index], self.rows_of(index)
        value = self.model.parameters[[DELAY]] if term.name == "timing" else term.value
        return value, self.covariance[np.ix_(rows, rows)]

    def rows_of(self, index: int) -> np.ndarray:
        """Return the places (k,) of the model's term `index` among its free parameters and terms."""
        model = self.model
        term = model.terms[index]
        if term.name == "timing":
            return np.flatnonzero(np.flatnonzero(model.free) == DELAY)
        first = int(model.free.sum()) + sum(len(t.value) for t in model.terms[:index] if t.name != "timing")
        return np.arange(first, first + len(term.value))


def determined(result: Refit, index: int) -> bool:
    """Return whether the data, not the prior, determine all values of the model's term `index`."""
    _, covariance = _standardised(result, index)
    largest = float(np.linalg.eigvalsh(covariance)[-1])
    return largest < (RULES.determined_by_data * TERMS[result.model.terms[index].name].prior) ** 2


def possible(result: Refit, index: int) -> bool:
    """Return whether the value of the model's term `index` is physically possible for its effect."""
    value, _ = result.value_of(index)
    term = result.model.terms[index]
    effect = TERMS[term.name]
    size = float(np.abs(_standardised(result, index)[0]).max())
    return size < RULES.farthest * effect.prior and effect.possible(result.twin, value, term.setting)


def widened(result: Refit) -> Refit:
    """Return the refit with its covariance widened for the autocorrelation of the residuals, as in `smoother`."""
    twin = result.twin
    fit = Fit(twin.chain, twin.state, twin.chain.unweighted(), twin.reduced, twin.model.free)
    return replace(result, covariance=fit.colour * result.covariance)


def _standardised(result: Refit, index: int) -> tuple[Array, Array]:
    """Return `Refit.value_of` per standard deviation of the channels."""
    value, covariance = result.value_of(index)
    term = result.model.terms[index]
    deviations = TERMS[term.name].deviations(result.twin, term.setting)
    return value * deviations, covariance * np.outer(deviations, deviations)


def refit(
    problem: Problem,
    model: Model,
    short_term: SensorNoise | None,
    known: Twin | None = None,
    farthest: float = np.inf,
) -> Refit:
    """Fit all parameters and terms jointly by Gauss–Newton, with noise levels estimated between the rounds.

    Args:
        problem: the data.
        model: where to start.
        short_term: noise of the sensors from sample to sample; None keeps the model's noise levels.
        known: a twin of the same problem, which saves a linearisation if its model differs by new terms only.
        farthest: prior standard deviations of a term's value from which the fit is given up.

    Raises:
        MagycError: a term with an unbounded effect on the readings, or a value beyond `farthest`.
    """
    converged = False
    twin = (known and known.beside(model)) or Twin.of(problem, model, known)
    covariance = np.zeros((0, 0))
    for _ in range(_ROUNDS if short_term is not None else 1):
        path: list[tuple[Array, Array]] = []
        for _ in range(_STEPS):
            base = twin.base_columns
            precision, value = prior_of(twin)
            gradient = base @ twin.residual().ravel() - twin.base_score_bias + precision * value
            information = base @ base.T + np.diag(precision)
            if not np.isfinite(information).all() or (np.sqrt(precision) * np.abs(value)).max() > farthest:
                raise MagycError(f"the model with {', '.join(t.name for t in model.terms)} has no possible fit")
            covariance = _inverse(information)
            step = -covariance @ gradient
            length = float(step @ information @ step)
            converged = length < _SETTLED
            if converged:
                break
            path = [*path[-_REMEMBERED:], (_values_of(model), step)]
            damped = (
                -_inverse(information + np.diag(damping * np.diag(information))) @ gradient for damping in _DAMPED
            )
            ahead = _advance(problem, twin, chain([_accelerated(path, information)], damped), twin.base_score_bias)
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
        twin = Twin.of(problem, model, twin)
        if np.abs(np.log(after / before)).max() < 3e-3:
            break
    return Refit(twin, covariance, converged)


def tempered(problem: Problem, result: Refit, short_term: SensorNoise) -> Refit:
    """Refit with a prior for every effect of many values, its deviation by maximum likelihood (empirical Bayes).

    Of a weak effect with many values those that the motion hardly determines are mostly noise, and applying them would
    do more harm than good.
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
    """Return the prior deviation of maximum likelihood of values estimated with a covariance that includes `prior`."""
    precision = np.linalg.pinv(covariance, hermitian=True)
    known, direction = np.linalg.eigh(precision - np.eye(len(value)) / prior**2)
    known = np.maximum(known, 0.0)
    score = direction.T @ (precision @ value)
    deviation = prior * np.logspace(-4, 0, _GRID)[:, None]
    widened = 1 + deviation**2 * known
    likelihood = 0.5 * (deviation**2 * score**2 / widened - np.log(widened)).sum(axis=1)
    return float(deviation[np.argmax(likelihood), 0])


def _advance(problem: Problem, twin: Twin, steps: Iterable[Array], score_bias: Array) -> Twin | None:
    """Return the twin after the first step with which the cost does not rise; None if no step helps."""
    for step in steps:
        try:
            ahead = Twin.of(problem, _stepped(twin.model, step), twin)
        except MagycError:
            continue  # the step is too long: the chain cannot be factorised
        # The step includes the score bias of the gyroscope's terms (`Twin.rate_score_bias`), which the cost does not.
        allowed = _cost(twin) + abs(float(score_bias @ step)) + _ROUNDING
        for _ in range(_FOLLOWING if twin.model.bends else 0):
            if not allowed < _cost(ahead) < _ASTRAY * allowed:
                break
            ahead = _followed(problem, ahead) or ahead
        if np.isfinite(ahead.reduced.cost) and _cost(ahead) <= allowed:
            return ahead
    return None


def _accelerated(path: Sequence[tuple[Array, Array]], information: Array) -> Array:
    """Return the next step (q,) of Anderson's acceleration from the points (q,) so far and their Gauss–Newton steps.

    Where the model does not explain the data, Gauss–Newton converges linearly, with steps that halve; the differences
    of successive steps show where they lead.
    """
    points, steps = (np.array(each) for each in zip(*path, strict=True))
    if len(path) == 1:
        return steps[-1]
    moved, changed = np.diff(points, axis=0), np.diff(steps, axis=0)
    gram = changed @ information @ changed.T
    share = np.linalg.lstsq(gram, changed @ information @ steps[-1], rcond=1e-10)[0]
    result: Array = steps[-1] - share @ (moved + changed)
    return result


def _values_of(model: Model) -> Array:
    """Return the values (q,) of the free parameters, then of the terms."""
    return np.concatenate([model.parameters[model.free], *(term.value for term in model.estimated)])


def _followed(problem: Problem, ahead: Twin) -> Twin | None:
    """Return the twin after one step of the twelve parameters with the terms fixed; None if the step fails.

    A non-linear term and the iron compensate each other almost completely, along a curve: on the straight line between
    two points of it the cost is higher than at both ends.
    """
    count = int(ahead.model.free.sum())
    base = ahead.base_columns[:count]
    step = np.zeros(len(ahead.base_columns))
    step[:count] = -_inverse(base @ base.T) @ (base @ ahead.residual().ravel())
    try:
        return Twin.of(problem, _stepped(ahead.model, step), ahead)
    except MagycError:
        return None


def _inverse(information: Array) -> Array:
    """Return the covariance of parameters in any units; large in directions that the data do not determine."""
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    weight, vector = np.linalg.eigh(information * scale * scale[:, None])
    result: Array = (vector / np.maximum(weight, 1e-13)) @ vector.T * scale * scale[:, None]
    return result


def prior_of(twin: Twin) -> tuple[Array, Array]:
    """Return the prior precision (q,) of the free parameters and terms, and the present values (q,), with prior mean 0.

    Values of a term that the motion does not determine stay near 0, as in a data sheet.
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
    """Return a model with one more term; a timing frees the delay."""
    free = model.free.copy()
    free[DELAY] |= term.name == "timing"
    return replace(model, free=free, terms=(*model.terms, term))


def without_term(model: Model, index: int) -> Model:
    """Return a model without one term; without a timing the delay is fixed at 0."""
    terms = tuple(t for i, t in enumerate(model.terms) if i != index)
    if model.terms[index].name != "timing":
        return replace(model, terms=terms)
    free, parameters = model.free.copy(), model.parameters.copy()
    free[DELAY], parameters[DELAY] = False, 0.0
    return replace(model, free=free, parameters=parameters, terms=terms)
