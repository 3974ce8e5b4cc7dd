"""One log of many: its model at the minimum, and the score and information of each effect, which add over logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magyc_gtsam.estimators.smoother.fit import colour_of
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside, solved
from magyc_gtsam.gap.evidence.candidates import Candidates, at_settings, what_matters
from magyc_gtsam.gap.evidence.generic import families
from magyc_gtsam.gap.evidence.neighbours import neighbours
from magyc_gtsam.gap.evidence.weighing import information_of
from magyc_gtsam.gap.many.model import MODEL
from magyc_gtsam.gap.model.base import base_model, needs_gyroscope, problem_of
from magyc_gtsam.gap.model.problem import Active, Problem
from magyc_gtsam.gap.model.refit import Refit, refit, with_term
from magyc_gtsam.gap.preparation.channel_holes import without_channel_holes
from magyc_gtsam.gap.preparation.discrete import settled
from magyc_gtsam.gap.samples.fine import fine_innovations, noise_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.recording import Recording
from magyc_gtsam.sensor_faults.usable import without_faults

_LARGE = 1e3  # prior deviation in units of what matters, with which an effect explains all that it can
_OF_THE_LOG = ("start", "end")  # settings that belong to one recording, as the references of channels do


@dataclass(frozen=True, eq=False)
class Test:
    """The score test of an effect at one setting, after projection on the complement of the log's own calibration.

    Attributes:
        setting: of the grid search.
        statistic, rank: squared length of the score in its sigmas, and its number of values.
        information, score: (k, k) and (k,) of the values, SI: the estimate is information⁻¹ score.
    """

    setting: Mapping[str, float]
    statistic: float
    rank: int
    information: Array
    score: Array

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


@dataclass(frozen=True, eq=False)
class OneLog:
    """A log with its model.

    Attributes:
        name: of the log.
        recording: with its axes and rows corrected.
        problem: its data.
        short_term: noise of the sensors from sample to sample.
        refitted: the model at its minimum.
        discrete: effects that were detected and corrected before the estimation.
        notes: sentences on what was left out.
    """

    name: str
    recording: Recording
    problem: Problem
    short_term: SensorNoise
    refitted: Refit
    discrete: tuple[NoiseScore, ...] = ()
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, recording: Recording, names: Sequence[str], name: str) -> OneLog:
        """Fit the twelve parameters to a log.

        Raises:
            MagycError: no gyroscope, or data that cannot be calibrated.
        """
        needs_gyroscope(recording)
        usable = without_faults(recording, ("magnetic_field", "angular_rate"))
        data, unlogged = without_channel_holes(usable.recording)
        data, discrete = settled(data, names)
        short_term = short_term_noise(data)
        base = base_model(data, None, short_term)
        return cls(name, data, problem_of(data), short_term, base, discrete, (*usable.left_out, *unlogged))

    def with_effect(self, name: str, setting: Mapping[str, float], value: Array) -> OneLog:
        """Return the log with one more effect in the model, after a joint refit.

        Raises:
            MagycError: the refit does not converge.
        """
        model = with_term(self.refitted.model, Active(name, dict(setting), value))
        fitted = refit(self.problem, model, self.short_term)
        if not fitted.converged:
            raise MagycError(f"{self.name}: the model with {name} does not converge")
        return replace(self, refitted=fitted)

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
        return self._tested(Candidates.of_parts(twin, [at_settings(twin, name, asked)])).get(name, ())

    def _tested(self, candidates: Candidates) -> dict[str, tuple[Test, ...]]:
        """Return {name: its tests}; autocorrelation, without what the best named effect explains, widens variances."""
        twin, beside = self.refitted.twin, Beside.of_model(self.refitted.twin)
        seen = beside.see(candidates.columns, candidates.score_bias)
        best, most, made = beside, MODEL.much, []
        for batch in candidates.batches:
            information = information_of(batch, beside.noise, seen.reach)
            for i, name in enumerate(batch.names):
                rows = batch.rows[i]
                value, rank = solved(information[i], seen.score[rows], np.diag(batch.gram[i]))
                gain = float(seen.score[rows] @ value)
                if name in TERMS and gain - 2 * rank > most:
                    most, large = gain - 2 * rank, np.full(len(rows), _LARGE**2)
                    best = beside.with_effects(candidates.columns[rows], large, candidates.score_bias[rows])
                made.append((name, batch.settings[i], gain, rank, information[i], seen.score[rows]))
        colour = colour_of(best.left().reshape(3, -1))
        tests: dict[str, tuple[Test, ...]] = {}
        for name, setting, gain, rank, each, score in made:
            unit = what_matters(twin, name, setting, len(score)) if name in TERMS else np.ones(len(score))
            information, own = each / np.outer(unit, unit) / colour, -score / unit / colour
            tests[name] = (*tests.get(name, ()), Test(dict(setting), gain / colour, rank, information, own))
        return tests

    def noise(self) -> dict[str, NoiseScore]:
        """Return {effect on the noise, or corrected before the estimation: its test} for the present model."""
        fine = fine_innovations(self.recording, self.refitted.model)
        return {score.name: score for score in (*self.discrete, *noise_scores(self.recording, fine, MODEL.alone))}
