"""The model without effects, and the tests of single samples beside it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magyc_gtsam.gap.effects import NAMES
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import Fine, fine_innovations, noise_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.recording import Recording

NOISE_LIMIT = float(np.log(len(NAMES) / RULES.family_wise))


@dataclass(frozen=True, eq=False)
class First:
    """The fitted model without effects of a recording."""

    recording: Recording
    refit: Refit

    @cached_property
    def fine(self) -> Fine:
        """Return the innovations sample by sample."""
        return fine_innovations(self.recording, self.refit.model)

    @cached_property
    def noise(self) -> list[NoiseScore]:
        """Return the tests of the effects on single samples."""
        return noise_scores(self.recording, self.fine, NOISE_LIMIT)
