"""One log of many: its model at the minimum, and the score and information of each effect, which add over logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magyc_gtsam.estimators.smoother.fit import colour_of
from magyc_gtsam.estimators.smoother.preparation import short_term_noise
from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.many.model import MODEL
from magyc_gtsam.gap.model.base import base_model, needs_gyroscope, problem_of
from magyc_gtsam.gap.model.problem import Active, Problem
from magyc_gtsam.gap.model.refit import Refit, refit, with_term
from magyc_gtsam.gap.model.variants import Projector, Variant, variants
from magyc_gtsam.gap.preparation.channel_holes import without_channel_holes
from magyc_gtsam.gap.preparation.discrete import settled
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import fine_innovations, noise_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.score import candidates
from magyc_gtsam.recording import Recording
from magyc_gtsam.sensor_faults.usable import without_faults

_LEAST = 1e-10  # of the largest variance of a value, below which a direction is left out
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
        project, innovation = self._innovation
        found = {
            name: [one for one in many if len(one.unit)]
            for name, (_, many) in candidates(self.refitted.twin, project, tuple(names)).items()
        }
        colour = self._colour(found, innovation)
        return {name: tuple(_test(one, innovation, colour) for one in many) for name, many in found.items()}

    def tests_at(self, name: str, settings: Sequence[Mapping[str, float]]) -> tuple[Test, ...]:
        """Return the tests of an effect at settings of other logs, with this log's own references."""
        twin = self.refitted.twin
        project, innovation = self._innovation
        own = TERMS[name].settings(twin)
        if not own or TERMS[name].missing(twin):
            return ()
        here = {k: v for k, v in own[0].items() if k in _OF_THE_LOG or k.startswith("reference")}
        asked = [{k: v for k, v in s.items() if not k.startswith("reference")} | here for s in settings]
        made = [one for one in variants(twin, project, name, asked) if len(one.unit)]
        colour = self._colour({}, innovation)
        return tuple(_test(one, innovation, colour) for one in made)

    def noise(self) -> dict[str, NoiseScore]:
        """Return {effect on the noise, or corrected before the estimation: its test} for the present model."""
        fine = fine_innovations(self.recording, self.refitted.model)
        return {score.name: score for score in (*self.discrete, *noise_scores(self.recording, fine, MODEL.alone))}

    @property
    def _innovation(self) -> tuple[Projector, Array]:
        twin = self.refitted.twin
        project = Projector(twin.base_columns, twin.base_score_bias)
        return project, project(twin.residual().reshape(1, -1))[0]

    def _colour(self, found: Mapping[str, Sequence[Variant]], innovation: Array) -> float:
        """Return the factor by which autocorrelation widens variances, without what the best named effect explains."""
        named = [one for name, many in found.items() if name in TERMS for one in many]
        gains = [float(np.sum(one.score(innovation) ** 2)) - 2 * len(one.unit) for one in named]
        if gains and max(gains) > RULES.much:
            best = named[int(np.argmax(gains))]
            innovation = innovation - best.unit.T @ best.score(innovation)
        return colour_of(innovation.reshape(3, -1))


def _test(one: Variant, innovation: Array, colour: float) -> Test:
    """Return a test; the value is −back d with covariance back backᵀ, and autocorrelation reduces its weight."""
    d = one.score(innovation)
    information = _inverse(one.back @ one.back.T) / colour
    return Test(dict(one.setting), float(d @ d) / colour, len(d), information, -information @ (one.back @ d))


def _inverse(covariance: Array) -> Array:
    """Return the information of values in any units; zero in directions without covariance."""
    scale = 1 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    weight, vector = np.linalg.eigh(covariance * scale * scale[:, None])
    kept = weight > _LEAST * weight[-1]
    result: Array = (vector[:, kept] / weight[kept]) @ vector[:, kept].T * scale * scale[:, None]
    return result


def as_json(setting: Mapping[str, float]) -> dict[str, Any]:
    """Return a setting as JSON types."""
    return {k: float(v) for k, v in setting.items()}
