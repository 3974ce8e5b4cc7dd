"""What is checked before anything is estimated: the order and signs of the axes, and which rows are samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.estimators.axes import arrangements, check
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.naming import Found
from magyc_gtsam.gap.noise_effects import NoiseScore, quantisation, sample_hold
from magyc_gtsam.recording import Recording

_COARSE = 0.2  # step in sigmas from which values repeat by chance


def rearranged(recording: Recording) -> tuple[Recording, Found | None]:
    """The recording with its gyroscope in the magnetometer's axes, and the finding if they differed.

    Raises:
        MagycError: the unit of the gyroscope is wrong.
    """
    try:
        check(recording)
    except MagycError:
        best = arrangements(recording)[0]
        if best.unit:
            raise
        assert recording.angular_rate is not None
        turned = replace(recording, angular_rate=recording.angular_rate @ best.matrix.T)
        score = NoiseScore(
            "axis-order",
            1 - best.unexplained,
            0.5,
            1e6,
            True,
            best.matrix.ravel(),
            np.zeros(9),
            {"explained": 1 - best.unexplained},
        )
        return turned, Found("axis-order", score.statistic, score.threshold, score.evidence, noise=score)
    return recording, None


def unheld(recording: Recording, noise: float) -> Recording:
    """With all rows as samples, where the magnetometer's repeat because its steps are coarse (noise T per sample).

    To leave such repeats out would keep the first of each, and so make the magnetometer seem early.
    """
    if not recording.angular_rate_fresh.all() or sample_hold(recording).significant:
        return recording
    if quantisation(recording, noise).statistic < _COARSE:
        return recording
    return replace(recording, magnetic_field_fresh=np.ones(len(recording.time), dtype=bool))
