"""The joint refit of the twelve parameters, the delay and the terms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.estimators.smoother.noise_levels import adapt
from magyc_gtsam.factors.chain.chain_values import DELAY, SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech, vech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.descent import descended
from magyc_gtsam.gap.model.problem import Active, Model, Problem
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

_ROUNDS = 3  # of noise levels
_SAME_NOISE = 3e-3  # change of the noise levels, relative, below which a round is the last
_GRID = 81  # deviations that are tried


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
    term = result.model.terms[index]
    return largest < (RULES.determined_by_data * (term.prior or TERMS[term.name].prior)) ** 2


def possible(result: Refit, index: int) -> bool:
    """Return whether the value of the model's term `index` is physically possible for its effect."""
    value, _ = result.value_of(index)
    term = result.model.terms[index]
    effect = TERMS[term.name]
    size = float(np.abs(_standardised(result, index)[0]).max())
    return size < effect.limit and effect.possible(result.twin, value, term.setting)


def widened(result: Refit) -> Refit:
    """Return the refit with its covariance widened for the autocorrelation of the residuals, as in `smoother`."""
    return replace(result, covariance=result.twin.fit().colour * result.covariance)


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
    """Fit all parameters and terms jointly, with noise levels estimated between the rounds.

    Args:
        problem: the data.
        model: where to start.
        short_term: noise of the sensors from sample to sample; None keeps the model's noise levels.
        known: a twin of the same problem, which saves a linearisation if its model differs by new terms only.
        farthest: prior standard deviations of a term's value from which the fit is given up.

    Raises:
        MagycError: a term with an unbounded effect on the readings, or a value beyond `farthest`.
    """
    twin, covariance, converged = descended(
        (known and known.beside(model)) or Twin.of(problem, model, known), farthest
    )
    for _ in range(_ROUNDS if short_term is not None else 0):
        fit = adapt(twin.fit(free=np.zeros_like(model.free)), False, short_term)
        before, after = np.array(twin.model.noise), np.array(fit.chain.noise)
        twin = Twin.of(problem, replace(twin.model, noise=fit.chain.noise), twin)
        if np.abs(np.log(after / before)).max() < _SAME_NOISE:
            break
        twin, covariance, converged = descended(twin, farthest)
    return _upright(Refit(twin, covariance, converged), farthest)


def _upright(result: Refit, farthest: float) -> Refit:
    """Return a fit whose soft iron mirrors no axis, as that of no instrument does, if there is one.

    −A and −g explain all readings as A and g do, and a vehicle that hardly tilts tells little of the sign along z. All
    terms are added to the reading, and stay.
    """
    size, axes = np.linalg.eigh(unvech(result.model.parameters[:6]))
    if size[0] > 0:
        return result
    parameters = result.model.parameters.copy()
    parameters[:6] = vech(axes * np.abs(size) @ axes.T)
    try:
        other = Refit(
            *descended(Twin.of(result.twin.problem, replace(result.model, parameters=parameters)), farthest)
        )
    except MagycError:
        return result
    return other if np.linalg.eigvalsh(unvech(other.model.parameters[:6]))[0] > 0 else result


def tempered(problem: Problem, result: Refit, short_term: SensorNoise) -> Refit:
    """Refit with a prior for every effect of many values, its deviation by maximum likelihood (empirical Bayes).

    Of a weak effect with many values those that the motion hardly determines are mostly noise, and applying them would
    do more harm than good.
    """
    terms = list(result.model.terms)
    for index, term in enumerate(terms):
        if len(term.value) > RULES.one_vector:
            value, covariance = _standardised(result, index)
            terms[index] = replace(term, prior=spread(value, covariance, term.prior or TERMS[term.name].prior))
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


def with_term(model: Model, term: Active) -> Model:
    """Return a model with one more term; a timing frees the delay."""
    free = model.free.copy()
    free[DELAY] |= term.name == "timing"
    return replace(model, free=free, terms=(*model.terms, term))


def without_term(model: Model, index: int) -> Model:
    """Return a model without one term; without a timing the delay is fixed at 0."""
    less = replace(model, terms=tuple(t for i, t in enumerate(model.terms) if i != index))
    return without_delay(less) if model.terms[index].name == "timing" else less


def without_delay(model: Model) -> Model:
    """Return a model with the delay fixed at 0."""
    free, parameters = model.free.copy(), model.parameters.copy()
    free[DELAY], parameters[DELAY] = False, 0.0
    return replace(model, free=free, parameters=parameters)


def with_free_delay(model: Model) -> Model:
    """Return a model with named effects with a free delay, unless one of them contains the delay.

    At a constant spin a delay is a rotation about its axis, as a misalignment is. Fixed at 0, it would be taken for one
    of the named effects with sigmas that do not hold; `calibrate` estimates it in any case, too. A model without any
    effect remains without a delay: the misalignment that is then estimated beside it includes the rotation by a delay.
    """
    if not model.terms or any(_contains_delay(term.name) for term in model.terms):
        return model
    free = model.free.copy()
    free[DELAY] = True
    return replace(model, free=free)


def _contains_delay(name: str) -> bool:
    return name == "timing" or any(_contains_delay(special) for special in TERMS[name].contains)
