"""Gauss–Newton descent of a model of the gap: accelerated, and damped where a step fails."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from magyc_gtsam.estimators.smoother.fit import inverse_information
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.model.twin import Twin

_STEPS = 8  # steps at most
_STEPS_DOWN, _DOWN = 24, 0.1  # the same while each lowers the cost by this share, far from the minimum
_SETTLED = 1e-2  # squared length of a step, in sigmas by the residuals of the model, below which the descent ends
_REMEMBERED = 3  # earlier points of the acceleration
_DAMPED = (1e-2, 1e-1, 1.0, 10.0)  # Levenberg–Marquardt damping that is tried where a step fails
_DETERMINED = 1e-13  # of the information, below which a direction has this share: its step would be rounding
_ROUNDING = 0.5  # error of a cost, relative to the misfit, from second-order terms of the rotations
_FOLLOWING = 3  # steps of the twelve parameters after a step of a non-linear term
_NEARER = 0.5  # share of the missing cost that one of them leaves at most, if another is to follow
_ASTRAY = 100.0  # times the allowed cost, from which these steps are not made


def descended(twin: Twin, farthest: float = np.inf) -> tuple[Twin, Array, bool]:
    """Minimise the cost of a twin over its free parameters and terms.

    Args:
        twin: where to start.
        farthest: prior standard deviations of a term's value from which the fit is given up.

    Returns:
        The twin at its minimum, the covariance (q, q) there, and whether the last step was small.

    Raises:
        MagycError: a term with an unbounded effect on the readings, or a value beyond `farthest`.
    """
    covariance = np.zeros((0, 0))
    path: list[tuple[Array, Array]] = []
    fallen, stalled = 0.0, 0
    for done in range(_STEPS_DOWN):
        if done >= _STEPS and fallen < _DOWN:
            break
        base = twin.base_columns
        residual = twin.residual().ravel()
        misfit = max(1.0, float(residual @ residual) / len(residual))
        precision, value = prior_of(twin)
        gradient = base @ residual - twin.base_score_bias + precision * value
        information = base @ base.T + np.diag(precision)
        if not np.isfinite(information).all() or (np.sqrt(precision) * np.abs(value)).max() > farthest:
            raise MagycError(f"the model with {', '.join(t.name for t in twin.model.terms)} has no possible fit")
        covariance = _inverse(information)
        step = -covariance @ gradient
        if float(step @ information @ step) < _SETTLED * misfit:
            return twin, covariance, True
        terms = (term.value for term in twin.model.estimated)
        values = np.concatenate([twin.model.parameters[twin.model.free], *terms])
        path = [*path[-_REMEMBERED:], (values, step)]
        tried = islice(_steps(path, information, gradient), stalled, None)
        ahead, failed = _advance(twin, tried, _ROUNDING * misfit)
        if ahead is None:
            break
        fallen = 1 - _cost(ahead) / _cost(twin)
        # Where the model does not explain the data, longer steps than one that hardly helped fail again.
        stalled = stalled + failed if fallen <= 0 else 0
        twin = ahead
    return twin, covariance, False


def _steps(path: Sequence[tuple[Array, Array]], information: Array, gradient: Array) -> Iterator[Array]:
    """Yield the steps that are tried: the accelerated one, then shorter ones that turn towards the gradient."""
    yield _accelerated(path, information)
    for damping in _DAMPED:
        yield -_inverse(information + np.diag(damping * np.diag(information))) @ gradient


def _advance(twin: Twin, steps: Iterable[Array], rounding: float) -> tuple[Twin | None, int]:
    """Return the twin after the first step that does not raise the cost, None if there is none, and how many failed.

    Rounding and the score bias may make the cost rise a little.
    """
    failed = 0
    for failed, step in enumerate(steps):
        try:
            ahead = Twin.of(twin.problem, _stepped(twin.model, step), twin)
        except MagycError:
            continue  # the step is too long: the chain cannot be factorised
        # The step includes the score bias of the gyroscope's terms (`Twin.rate_score_bias`), which the cost does not.
        allowed = _cost(twin) + abs(float(twin.base_score_bias @ step)) + rounding
        missing = np.inf
        for _ in range(_FOLLOWING if twin.model.bends else 0):
            missing, before = _cost(ahead) - allowed, missing
            if not 0 < missing < min((_ASTRAY - 1) * allowed, _NEARER * before):
                break
            ahead = _followed(ahead) or ahead
        if np.isfinite(ahead.reduced.cost) and _cost(ahead) <= allowed:
            return ahead, failed
    return None, failed + 1


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


def _followed(ahead: Twin) -> Twin | None:
    """Return the twin after one step of the twelve parameters with the terms fixed; None if the step fails.

    A non-linear term and the iron compensate each other almost completely, along a curve: on the straight line between
    two points of it the cost is higher than at both ends.
    """
    of_terms = np.zeros(sum(len(term.value) for term in ahead.model.estimated))
    try:
        base = ahead.parameter_columns
        step = np.concatenate([-_inverse(base @ base.T) @ (base @ ahead.residual().ravel()), of_terms])
        return Twin.of(ahead.problem, _stepped(ahead.model, step), ahead)
    except MagycError:
        return None


def _inverse(information: Array) -> Array:
    return inverse_information(information, np.ones(len(information), dtype=bool), _DETERMINED)


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
    return float(twin.cost + 0.5 * precision @ value**2)


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
