"""`model_error`: by how much what the model lacks may have moved a calibration, as a covariance and in words.

Every family of `families` that the innovations of a fit ask for gets an amplitude by restricted maximum likelihood
(`components`). The model is left without it, so the error that it makes is S β, of which E[β βᵀ] is known: where the
motion shows the family, by what it is; where it has the shape of a parameter, by the variance that the rest of it has.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.model_error.components import fit_components, likeliest
from magyc_gtsam.estimators.model_error.families import FAMILIES, Family, Motion
from magyc_gtsam.estimators.model_error.samples import one_sided
from magyc_gtsam.estimators.smoother.beside import Beside, New
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.search import Streams
from magyc_gtsam.factors.chain.rotations import Array

_SIGNIFICANT = (
    7.0  # gain in log-likelihood from which a family counts; 15 of them reach it by chance in 1 of 600 logs
)
_SUSPECT = 3.0  # of a family of the first test, from which all the others are looked at
_LEAST_WINDOWS = 30
_HARD_IRON = slice(6, 9)


@dataclass(frozen=True, eq=False)
class Component:
    """One thing that the model lacks.

    Attributes:
        name: short; sentence: where it is and how large, in plain words.
        size: root mean square an axis: T of the field, rad/s or a share of the rate on the gyroscope.
        gain: of the log-likelihood, by itself.
        covariance: (P, P) of θ. Those of several need not add up to the whole, for they go together.
        period: s, of its variation in time; None where it is not one of time.
        of_place: whether it is the field of the place that varies.
    """

    name: str
    sentence: str
    size: float
    gain: float
    covariance: Array
    period: float | None = None
    of_place: bool = False


@dataclass(frozen=True, eq=False)
class ModelError:
    """By how much what the model lacks may have moved the parameters of a fit.

    Attributes:
        covariance: (P, P) of θ, to be added to the sensors' noise; zero where the innovations ask for nothing.
        components: the families that count.
    """

    covariance: Array
    components: tuple[Component, ...] = ()

    @property
    def field_variation(self) -> tuple[float, float | None] | None:
        """T and s: how much the field of the place varies along the way, an axis, and its period; None where not."""
        found = [c for c in self.components if c.of_place]
        if not found:
            return None
        size = float(np.sqrt(sum(c.size**2 for c in found)))
        timed = [(c.size, c.period) for c in found if c.period is not None]
        return size, max(timed)[1] if timed else None

    def worst(self, rows: slice) -> tuple[Component, ...]:
        """The components in the order of what they do to some of the parameters."""
        return tuple(sorted(self.components, key=lambda c: -float(np.trace(c.covariance[rows, rows]))))


class _Found(NamedTuple):
    family: Family
    new: New
    gain: float


def model_error(fit: Fit, recording: Streams | None = None) -> ModelError:
    """The model error of a fit at its minimum, and of what its recording's samples show within windows."""
    error = _of_windows(fit)
    outliers = None if recording is None else one_sided(recording)
    if outliers is None:
        return error
    covariance = np.zeros_like(error.covariance)
    covariance[_HARD_IRON, _HARD_IRON] = np.outer(outliers.shift, outliers.shift)
    size, gain = (
        float(np.linalg.norm(outliers.shift)),
        0.5 * float(np.square(outliers.shift / outliers.sigma).sum()),
    )
    found = Component("outliers", outliers.sentence, size, gain, covariance)
    return ModelError(error.covariance + covariance, (*error.components, found))


def _of_windows(fit: Fit) -> ModelError:
    nothing = ModelError(np.zeros_like(fit.reduced.information))
    if len(fit.chain.windows) < _LEAST_WINDOWS:
        return nothing
    beside, motion = Beside(fit), Motion.of(fit)
    # A skew that the fit was asked for is in its own covariance.
    families = [family for family in FAMILIES if fit.skew is None or family.name != "skew"]
    tested = _tested(beside, motion, (family for family in families if family.first))
    if max(found.gain for found in tested) < _SUSPECT:
        return nothing
    tested += _tested(beside, motion, (family for family in families if not family.first))
    found = sorted((each for each in tested if each.gain > _SIGNIFICANT), key=lambda each: -each.gain)
    if not found:
        return nothing
    normal = np.block([[one.new.across(other.new) for other in found] for one in found])
    moves = [beside.move(each.new) for each in found]
    edges = np.cumsum([0, *(len(each.new.score) for each in found)]).tolist()
    groups = [slice(*pair) for pair in pairwise(edges)]
    for each, own in zip(found, groups, strict=True):
        normal[own, own] = each.new.normal
    score = np.concatenate([each.new.score for each in found])
    most = [each.family.most for each in found]
    fitted = fit_components(normal, score, beside.square, groups, most, beside.freedom)
    components, varying = [], np.zeros_like(nothing.covariance)
    for each, own, move, amplitude in zip(found, groups, moves, fitted.amplitude, strict=True):
        if amplitude > 0:
            covariance = move @ fitted.second[own, own] @ move.T
            size, period = each.family.size(float(amplitude), motion), each.family.period(motion)
            family = each.family
            if family.of_iron:  # what is calibrated is its mean, what is used is its value then
                varying[_HARD_IRON, _HARD_IRON] += size**2 * np.eye(3)
                covariance[_HARD_IRON, _HARD_IRON] += size**2 * np.eye(3)
            words = family.sentence(size, period)
            components.append(Component(family.name, words, size, each.gain, covariance, period, family.of_place))
    every = np.concatenate(moves, axis=1)
    return ModelError(every @ fitted.second @ every.T + varying, tuple(components))


def _tested(beside: Beside, motion: Motion, families: Iterable[Family]) -> list[_Found]:
    """Each family by itself."""
    square, freedom = beside.square, beside.freedom
    result = []
    for family in families:
        new = beside.of(family.columns(motion))
        most = family.most**2 * freedom / square
        result.append(_Found(family, new, likeliest(new.normal, new.score, square, freedom, most).gain))
    return result
