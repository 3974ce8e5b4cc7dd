"""One log of many: its model at the minimum, and the evidence of each effect beside it, which adds over logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS, sudden
from magyc_gtsam.gap.evidence.beside import LEAST, Beside
from magyc_gtsam.gap.evidence.candidates import COLOUR, Candidates, what_matters
from magyc_gtsam.gap.evidence.generic import families
from magyc_gtsam.gap.evidence.neighbours import neighbours
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.sample_effects import singles_of
from magyc_gtsam.gap.evidence.weighing import information_of, nats_by_scale, scales_of
from magyc_gtsam.gap.many.model import MODEL
from magyc_gtsam.gap.model.base import TooSmoothError, root
from magyc_gtsam.gap.model.field_variation import COMBINATIONS, FieldVariation, field_variation
from magyc_gtsam.gap.model.problem import Active
from magyc_gtsam.gap.model.refit import Refit, refit, with_term
from magyc_gtsam.gap.naming.steps import away_from_steps
from magyc_gtsam.gap.prepared import Prepared
from magyc_gtsam.gap.samples.first import First
from magyc_gtsam.gap.samples.noise_effects import NoiseScore, coloured_noise
from magyc_gtsam.recording import Recording
from magyc_gtsam.sensor_faults.full_scale import ClippedField

_FINER = 4  # rounds of finding the time of a sudden effect
_OF_THE_LOG = ("start", "end")  # settings that belong to one recording, as the references of channels do


@dataclass(frozen=True, eq=False)
class Test:
    """An effect at one setting, beside the model of a log.

    Attributes:
        setting: of the grid search.
        nats: (S,) gain in log evidence, at each scale of the values that is possible.
        information, score: (k, k) and (k,) of the values, SI: the estimate is information⁻¹ score.
        unit: (k,) smallest value that matters, SI.
    """

    setting: Mapping[str, float]
    nats: Array
    information: Array
    score: Array
    unit: Array

    @classmethod
    def of(cls, name: str, setting: Mapping[str, float], information: Array, score: Array, unit: Array) -> Test:
        """Return the test of an effect, or of a family without a name, from the information and score of its values."""
        weight, vector = np.linalg.eigh(information * np.outer(unit, unit))
        likely, along = scales_of(name), vector.T @ (score * unit)
        nats = nats_by_scale((name,), np.maximum(weight, 0.0)[None], along[None])[0, likely]
        return cls(setting, nats - np.log(len(likely) / likely.sum()), information, score, unit)

    @property
    def value(self) -> Array:
        """Return the estimate (k,), SI."""
        inverse = np.linalg.pinv(self.information * np.outer(self.unit, self.unit), rcond=LEAST, hermitian=True)
        result: Array = self.unit * (inverse @ (self.score * self.unit))
        return result

    @property
    def key(self) -> tuple[tuple[str, float], ...]:
        """Return the setting without what belongs to one log, which identifies the same test in another log."""
        return tuple(
            sorted(
                (k, float(f"{v:.6g}"))
                for k, v in self.setting.items()
                if k not in _OF_THE_LOG and not k.startswith("reference")
            )
        )


def strongest(tests: Sequence[Test]) -> Test | None:
    """Return the test that explains most; None without one."""
    return max(tests, key=lambda test: float(test.nats.max()), default=None)


@dataclass(frozen=True, eq=False)
class OneLog:
    """A log with its model.

    Attributes:
        name: of the log.
        recording: with its axes, rows and steps corrected.
        short_term: noise of the sensors from sample to sample.
        refitted: the model at its minimum, with this noise.
        variation: of the field of the place, if that is in the model.
        discrete: effects that were detected and corrected before the estimation.
        clipped: samples at the magnetometer's full scale, too many to be harmless.
        left_out: sentences on the rows that faulty sensors cost.
    """

    name: str
    recording: Recording
    short_term: SensorNoise
    refitted: Refit
    variation: FieldVariation | None = None
    discrete: tuple[NoiseScore, ...] = ()
    clipped: ClippedField | None = None
    left_out: tuple[str, ...] = ()

    @classmethod
    def of(cls, recording: Recording, names: Sequence[str], name: str) -> OneLog:
        """Fit the twelve parameters to a log.

        Raises:
            MagycError: no gyroscope, data that cannot be calibrated, or in which nothing can be tested; a stuck bit.
        """
        ready = Prepared.of(recording, names)
        reasons = ready.untestable()
        if reasons is not None:
            raise MagycError(reasons[0])
        if ready.usable.bits:
            raise MagycError(ready.usable.bits[0].sentence)
        steps, data, problem, short_term = First(ready.recording, ready.base).stepless(names, ready.short_term)
        try:
            start = root(problem, replace(ready.base.model, noise=short_term))
        except TooSmoothError:
            raise MagycError(ready.too_smooth()[0]) from None
        left_out = (*ready.usable.left_out, *ready.left_out)
        discrete = ready.discrete if steps is None else (*ready.discrete, steps)
        clipped = ready.usable.clipped
        return cls(name, data, short_term, start, discrete=discrete, clipped=clipped, left_out=left_out)

    def with_effect(self, name: str, setting: Mapping[str, float], value: Array) -> OneLog:
        """Return the log with one more effect in the model, after a joint refit.

        Raises:
            MagycError: an effect whose values are too large for the readings.
        """
        model, problem = self.refitted.model, self.refitted.twin.problem
        setting = dict(setting)
        fitted = refit(problem, with_term(model, Active(name, setting, value)), None)
        for _ in range(_FINER if sudden(name, setting) else 0):
            before, setting = setting, self._closer(name, setting)
            if setting == before:
                break
            ahead = refit(problem, with_term(model, Active(name, setting, value)), None)
            if ahead.twin.reduced.cost >= fitted.twin.reduced.cost:
                break
            fitted = ahead
        return replace(self, refitted=fitted, variation=self.variation and field_variation(fitted.twin))

    def _closer(self, name: str, setting: dict[str, float]) -> dict[str, float]:
        """Return the most probable setting of an effect near one of them."""
        twin = self.refitted.twin
        near = TERMS[name].refined(twin, setting)
        tests = self._tested(Candidates.at(twin, name, near))[name] if near else ()
        best = strongest(tests)
        return setting if best is None else dict(best.setting)

    @cached_property
    def beside(self) -> Beside:
        """The model, marginalised: parameters and terms without a prior, and the variation of the field."""
        return Beside.of_model(self.refitted.twin, self.variation)

    @cached_property
    def varying(self) -> tuple[float, FieldVariation | None]:
        """The gain in log evidence by a variation of the field that is not in the model, and the variation."""
        left, freedom = self.beside.left(), 3 * self.refitted.twin.n - len(self.refitted.twin.base_columns)
        misfit = float(left @ left) / freedom
        if self.variation is not None or misfit < 1 + PRIOR.misfit * np.sqrt(2 / freedom):
            return 0.0, None
        variation = field_variation(self.refitted.twin)
        return variation.gain - float(np.log(COMBINATIONS)), variation

    @property
    def of_field(self) -> float:
        """Return half the power that the variation of the field explains, nats at its level of noise."""
        if self.variation is None:
            return 0.0
        plain, left = Beside.of_model(self.refitted.twin).left() / self.beside.noise, self.beside.left()
        return 0.5 * max(float(plain @ plain - left @ left), 0.0)

    def power_of(self, name: str) -> float:
        """Return half the Wald statistic of an effect beside the rest of the model, nats; 0 if it is not there."""
        names = [term.name for term in self.refitted.model.terms]
        if name not in names:
            return 0.0
        rows = self.refitted.rows_of(names.index(name))
        value, covariance = self.refitted.value_of(names.index(name))[0], self.beside.solution()[1]
        return 0.5 * float(value @ np.linalg.pinv(covariance[np.ix_(rows, rows)], hermitian=True) @ value)

    def tests(self, names: Sequence[str]) -> dict[str, tuple[Test, ...]]:
        """Return {effect or generic family: its tests at all settings}."""
        twin = self.refitted.twin
        beside = [f for active in twin.model.terms for f in neighbours(active.name, active.setting)]
        among = (*families(twin), *{f.name: f for f in beside}.values())
        return self._tested(Candidates.of(twin, names, among))

    def tests_at(self, name: str, settings: Sequence[Mapping[str, float]]) -> tuple[Test, ...]:
        """Return the tests of an effect at settings of other logs, with this log's own references."""
        twin = self.refitted.twin
        own = [] if TERMS[name].missing(twin) else TERMS[name].settings(twin)
        if not own:
            return ()
        here = {k: v for k, v in own[0].items() if k in _OF_THE_LOG or k.startswith("reference")}
        asked = [{k: v for k, v in s.items() if not k.startswith("reference")} | here for s in settings]
        return self._tested(Candidates.at(twin, name, asked)).get(name, ())

    def _tested(self, candidates: Candidates) -> dict[str, tuple[Test, ...]]:
        twin, noise = self.refitted.twin, self.beside.noise
        seen = self.beside.see(candidates.columns, candidates.score_bias)
        tests: dict[str, tuple[Test, ...]] = {}
        for batch in candidates.batches:
            information = information_of(batch, noise, seen.reach)
            for i, name in enumerate(batch.names):
                score, setting = -seen.score[batch.rows[i]], batch.settings[i]
                unit = what_matters(twin, name, setting, len(score)) if name in TERMS else np.ones(len(score))
                own = Test.of(name, dict(setting), information[i] / np.outer(unit, unit), score / unit, unit)
                tests[name] = (*tests.get(name, ()), own)
        return tests

    def noise(self) -> dict[str, NoiseScore]:
        """Return {effect on the noise, or corrected before the estimation: its test} for the present model.

        Beside a varying field, which correlates the innovations, correlated noise cannot be tested.
        """
        model = self.refitted.model
        fine, singles = singles_of(away_from_steps(self.recording, model), model)
        scores = {score.name: score for score in self.discrete} | singles
        if self.variation is None:
            scores[COLOUR] = coloured_noise(fine.calm, fine.rate, fine.level, MODEL.alone)
        return scores
