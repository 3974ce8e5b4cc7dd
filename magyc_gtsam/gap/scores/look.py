"""The score tests of one model, with the tests of single samples: what each candidate would explain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import NAMES, TERMS
from magyc_gtsam.gap.model.refit import Refit
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import Fine, fine_innovations, noise_scores
from magyc_gtsam.gap.samples.noise_effects import NoiseScore
from magyc_gtsam.gap.scores.score import Score, scan
from magyc_gtsam.recording import Recording

NOISE_LIMIT = float(np.log(len(NAMES) / RULES.family_wise))


@dataclass(frozen=True, eq=False)
class ScoreTests:
    """The score tests of a model, strongest first. Tests of single samples are computed on demand."""

    recording: Recording
    refit: Refit
    scores: list[Score]
    innovation: Array

    @property
    def tested(self) -> tuple[str, ...]:
        """Return the effects of the catalogue that were tested."""
        return tuple(score.name for score in self.scores if score.name in TERMS)

    @cached_property
    def fine(self) -> Fine:
        """Return the innovations sample by sample."""
        return fine_innovations(self.recording, self.refit.model)

    @cached_property
    def noise(self) -> list[NoiseScore]:
        """Return the scores of the effects on single samples."""
        return noise_scores(self.recording, self.fine, NOISE_LIMIT)


def look(recording: Recording, refitted: Refit, names: tuple[str, ...], random: np.random.Generator) -> ScoreTests:
    """Test all candidates against a model."""
    scores, innovation, _ = scan(refitted.twin, names, random)
    return ScoreTests(recording, refitted, scores, innovation)
