"""The model without effects of a recording, with the tests of single samples beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.coarse import truncated_fit
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

    @cached_property
    def steps(self) -> tuple[NoiseScore, Refit]:
        """Return the test of readings in steps, and the model; of truncated readings that of their `centred` values."""
        rounded = quantisation(self.recording, self.fine.white)
        if rounded.statistic > RULES.truncated:
            nats, fitted = truncated_fit(self.recording, float(rounded.value[0]), self.refit)
            if nats > NOISE_LIMIT:
                return truncating(rounded), fitted
        return rounded, self.refit
