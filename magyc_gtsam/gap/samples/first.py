"""The model without effects of a recording, with the tests of single samples beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from magyc_gtsam.factors.chain.chain_values import SensorNoise
from magyc_gtsam.gap.model.base import problem_of
from magyc_gtsam.gap.model.problem import Model, Problem
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.coarse import centred, truncated_fit, without_steps
from magyc_gtsam.gap.samples.fine import NOISE_LIMIT, Fine, fine_innovations, single_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore, coloured_noise, quantisation, truncating
from magyc_gtsam.recording import Recording


@dataclass(frozen=True, eq=False)
class First:
    """The fitted model without effects of a recording, and the tests of single samples beside it."""

    recording: Recording
    refit: Refit

    @cached_property
    def fine(self) -> Fine:
        """Return the innovations sample by sample."""
        return fine_innovations(self.recording, self.refit.model)

    @cached_property
    def noise(self) -> list[NoiseScore]:
        """Return the tests of the effects on single samples."""
        fine = self.fine
        return [
            *single_scores(self.recording, fine, NOISE_LIMIT),
            coloured_noise(fine.calm, fine.rate, fine.level, NOISE_LIMIT),
            self.steps[0],
        ]

    def stepless(
        self, names: Sequence[str], short_term: SensorNoise
    ) -> tuple[NoiseScore | None, Recording, Problem, SensorNoise]:
        """Return the test of steps that are corrected, and the recording, its windows and its noise without them.

        Args:
            names: candidates; steps that are not one of them, or not there, are not corrected: None, and all as it is.
            short_term: noise of the sensors between neighbouring samples, which steps that are wider hide.
        """
        steps = self.steps[0]
        if not steps.significant or steps.name not in names:
            return None, self.recording, self.refit.twin.problem, short_term
        recording, white = self.without_steps()
        noise = short_term._replace(magnetometer=max(short_term.magnetometer, white))
        return steps, recording, problem_of(recording), noise

    def without_steps(self, model: Model | None = None) -> tuple[Recording, float]:
        """Return the recording without the mean error of its steps, and the white noise of its readings before, T.

        Args:
            model: that predicts the readings; None for the one without effects.
        """
        steps, fitted = self.steps
        step, truncated = float(steps.value[0]), "truncated" in steps.setting
        model = model or fitted.model
        fine = fine_innovations(centred(self.recording, step) if truncated else self.recording, model)
        return without_steps(self.recording, model, step, fine.level, truncated), fine.white

    @cached_property
    def steps(self) -> tuple[NoiseScore, Refit]:
        """Return the test of readings in steps, and the model; of truncated readings that of their `centred` values."""
        rounded = quantisation(self.recording, self.fine.white)
        if rounded.statistic > RULES.truncated:
            nats, fitted = truncated_fit(self.recording, float(rounded.value[0]), self.refit)
            if nats > NOISE_LIMIT:
                return truncating(rounded), fitted
        return rounded, self.refit
