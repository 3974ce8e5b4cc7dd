"""`model_error`: the calibration error caused by effects that the model lacks, as a covariance and in words.

Every family of `families` that the innovations of a fit support gets an amplitude by restricted maximum likelihood
(`components`). The model itself is not extended, so the resulting parameter error is S β with known E[β βᵀ]: in
directions that the motion observes it follows from the data, in directions that coincide with a parameter from the
variance estimated for the rest of the family. Known sensor effects (`physical`) that the data neither show nor exclude
are added in proportion to their posterior probability.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from magyc_gtsam.estimators.model_error.alternating import alternating
from magyc_gtsam.estimators.model_error.component import Component, FamilyTest, shown_by, tested
from magyc_gtsam.estimators.model_error.families import FAMILIES
from magyc_gtsam.estimators.model_error.motion import WindowMotion
from magyc_gtsam.estimators.model_error.not_excluded import not_excluded
from magyc_gtsam.estimators.model_error.physical import COARSE, CROSS_AXIS, PHYSICAL
from magyc_gtsam.estimators.model_error.samples import coarse_step, one_sided
from magyc_gtsam.estimators.smoother.beside import ColumnProducts
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.preparation import Streams
from magyc_gtsam.factors.chain.rotations import Array

# Gain in log-likelihood from which a family counts; any of some twenty reaches it by chance in 1 of 600 logs.
_SIGNIFICANT = 7.0
# Gain of any family tested so far from which those of stage 1, then those of stage 2 are tested. Of 1,050 logs with a
# simulated fault that a family shows (gain above `_SIGNIFICANT`), stage 0 passes all but 5; of 864 that one of stage 2
# shows, the others pass all but 20 (17 with 3 nats). Clean logs exceed them in one of 6 and one of 100. A fit that is
# doubted by its own residuals (`_doubted`) needs no such gain.
_SUSPECT = (2.0, 4.0)
# Mean weight of windows or links below which a fit is doubted: 1 on clean logs, 0.9984 at worst in 300.
_ALL_TRUSTED = 0.995
# Standard deviations of the added autocorrelations (`Fit.slow`) from which a fit is doubted: at most -0.2 on 384 clean
# logs. A current of 0.45 µT that is switched every half minute has 3 to 5.
_SLOW = 0.0
_LEAST_WINDOWS = 8  # of a fit, too
_HARD_IRON = slice(6, 9)
_REPORTED_SHARE = 0.8  # probability above which an averaged effect is reported as present,
_REPORTED_GAIN = 1.0  # and gain in nats above which it is


@dataclass(frozen=True, eq=False)
class ModelError:
    """The parameter error of a fit caused by effects that the model lacks.

    Attributes:
        covariance: (P, P) of θ, to be added to that of the sensors' noise.
        components: effects that the data show.
        possible: effects that the data neither show nor exclude.
        of_terms: (P + T, T) covariance of θ and the T values of the model's terms with these values.
    """

    covariance: Array
    components: tuple[Component, ...] = ()
    possible: tuple[Component, ...] = ()
    of_terms: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def probable(self) -> Array:
        """(P, P) covariance without the effects that are merely possible."""
        return self.covariance - sum((c.covariance for c in self.possible), np.zeros_like(self.covariance))

    def only(self, names: Set[str]) -> ModelError:
        """Return the error by those effects that the data show which have one of the names."""
        kept = tuple(c for c in self.components if c.name in names)
        covariance = sum((c.covariance for c in kept), np.zeros_like(self.covariance))
        return replace(self, covariance=covariance, components=kept, possible=())

    def without(self, name: str) -> ModelError:
        """Return the error without an effect, whether the data show it or not.

        What is left is the sum over the other effects: those that the data show are correlated, so that the total less
        one of them may have negative variances.
        """
        components, possible = (
            tuple(c for c in each if c.name != name) for each in (self.components, self.possible)
        )
        if len(components) + len(possible) == len(self.components) + len(self.possible):
            return self
        covariance = sum((c.covariance for c in components + possible), np.zeros_like(self.covariance))
        return replace(self, covariance=covariance, components=components, possible=possible)

    def beside(self, other: Component) -> ModelError:
        """Return the error with another component, of the same parameters, or of more or fewer of them."""
        size = max(len(self.covariance), len(other.covariance))
        own = replace(other, covariance=_padded(other.covariance, size))
        probable = other.share > _REPORTED_SHARE
        components = (*self.components, own) if probable else self.components
        possible = self.possible if probable else (*self.possible, own)
        components, possible = (
            tuple(replace(c, covariance=_padded(c.covariance, size)) for c in each)
            for each in (components, possible)
        )
        covariance = _padded(self.covariance, size) + own.covariance
        return replace(self, covariance=covariance, components=components, possible=possible)

    @property
    def of_gyroscope_axes(self) -> Array:
        """(P, P) to be added to the covariance for the heading, which refers to the gyroscope's axes.

        They are never exactly at right angles, so that their error counts there as certain, and not by its share.
        """
        every = (c for c in self.components + self.possible if c.name == CROSS_AXIS)
        return sum(((1 / c.share - 1) * c.covariance for c in every), np.zeros_like(self.covariance))

    @property
    def field_variation(self) -> tuple[float, float | None] | None:
        """The variation of the ambient field along the way: T per axis, and its period in s; None if none was found."""
        found = [c for c in self.components if c.of_place]
        if not found:
            return None
        size = float(np.sqrt(sum(c.size**2 for c in found)))
        timed = [(c.size, c.period) for c in found if c.period is not None]
        return size, max(timed)[1] if timed else None

    def worst(self, rows: slice) -> tuple[Component, ...]:
        """Return all components, the largest variance in the given parameters first."""
        every = self.components + self.possible
        return tuple(sorted(every, key=lambda c: -float(np.trace(c.covariance[rows, rows]))))


def _padded(covariance: Array, size: int) -> Array:
    return np.pad(covariance, (0, size - len(covariance)))


def model_error(fit: Fit, recording: Streams | None = None) -> ModelError:
    """Return the model error of a fit at its minimum, with what the samples show within windows."""
    error = _of_windows(fit, 0.0 if recording is None else coarse_step(recording))
    if recording is None:
        return error
    found = [
        _of_hard_iron(name, each.sentence, each.size, each.gain, each.second, len(error.covariance))
        for name, each in (("outliers", one_sided(recording)), ("alternation", alternating(recording)))
        if each is not None
    ]
    covariance = error.covariance + sum((each.covariance for each in found), np.zeros_like(error.covariance))
    return replace(error, covariance=covariance, components=(*error.components, *found))


def _of_hard_iron(name: str, sentence: str, size: float, gain: float, second: Array, count: int) -> Component:
    """Return a component that moves the hard iron, one of `count` parameters, with the second moment (3, 3) T²."""
    covariance = np.zeros((count, count))
    covariance[_HARD_IRON, _HARD_IRON] = second
    return Component(name, sentence, size, gain, covariance)


def _of_windows(fit: Fit, step: float) -> ModelError:
    if len(fit.chain.windows) < _LEAST_WINDOWS:
        count = len(fit.free) + (0 if fit.terms is None else fit.terms.columns.size)
        return _of_theta(np.zeros((count, count)), fit)
    beside, motion = fit.beside, WindowMotion.of(fit, step)
    # A misalignment and gyroscope scales that the fit estimates are in its own covariance.
    estimated = {"skew"} if fit.skew is not None else set()
    estimated |= set(() if fit.terms is None else fit.terms.families)
    families = [family for family in FAMILIES if family.name not in estimated]
    physical = [family for family in (*PHYSICAL, *([COARSE] if step else [])) if family.name not in estimated]
    every = tested(beside, motion, [*physical, *(family for family in families if family.stage == 0)])
    doubted = _doubted(fit)
    for stage, suspect in enumerate(_SUSPECT, 1):
        if stage > doubted and max(each.gain for each in every) <= suspect:
            break
        every += tested(beside, motion, [family for family in families if family.stage == stage])
    every = [_of_likeliest_shape(beside, motion, each) if each.family.other_shapes else each for each in every]
    found = [each for each in every if each.gain > _SIGNIFICANT and not each.family.only_beside]
    found.sort(key=lambda each: -each.gain)
    shown = shown_by(beside, motion, found)
    averaged = not_excluded(beside, motion, every, shown)
    reported = tuple(c for c in averaged if c.share > _REPORTED_SHARE and c.gain > _REPORTED_GAIN)
    covariance = shown.covariance + sum((c.covariance for c in averaged), np.zeros_like(shown.covariance))
    return _of_theta(covariance, fit, shown.components + reported, [c for c in averaged if c not in reported])


def _doubted(fit: Fit) -> int:
    """Return the last stage that the fit by itself asks for, whatever the stages before it gain.

    Residuals that are not white, or partly rejected, come from something. Boards may be misaligned, but a field that
    varies with the attitude (stage 1) looks alike.
    """
    if fit.colour > 1 or fit.slow > _SLOW or min(fit.trusted_share, float(fit.weights.link.mean())) < _ALL_TRUSTED:
        return len(_SUSPECT)
    return 1 if fit.skew is not None and fit.skew.decided else 0


def _of_likeliest_shape(beside: ColumnProducts, motion: WindowMotion, shown: FamilyTest) -> FamilyTest:
    """Return the test of a family that the data show with the columns, of all that it may have, that gain most."""
    if shown.gain <= _SIGNIFICANT:
        return shown
    others = [replace(shown.family, columns=columns) for columns in shown.family.other_shapes]
    return max([shown, *tested(beside, motion, others)], key=lambda each: each.gain)


def _of_theta(
    covariance: Array, fit: Fit, components: Sequence[Component] = (), possible: Sequence[Component] = ()
) -> ModelError:
    """Return the model error by the covariance (p, p) of θ and the terms, and by components of the same size."""
    size = len(fit.free)
    if fit.terms is not None:
        components, possible = (
            [replace(c, covariance=c.covariance[:size, :size]) for c in each] for each in (components, possible)
        )
    return ModelError(covariance[:size, :size], tuple(components), tuple(possible), covariance[:, size:])
