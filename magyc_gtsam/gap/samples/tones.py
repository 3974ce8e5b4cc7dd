"""A steady tone on the magnetometer: estimated sample by sample, because windows average it away, and removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.signals import Signals
from magyc_gtsam.factors.effects.term import Term
from magyc_gtsam.gap.model.problem import Model
from magyc_gtsam.gap.samples.fine import fine_twin
from magyc_gtsam.recording import Recording

_TRIED = 13  # frequencies within about a bin of the periodogram


def heard(recording: Recording, model: Model, frequency: float) -> Term:
    """Estimate the tone near a line of the periodogram, Hz, from the innovations of a model."""
    twin = fine_twin(recording, model)
    v = twin.residual().ravel()
    bin_width = 1 / twin.duration
    best: tuple[float, Array, Array, float] = -1.0, np.zeros(6), np.eye(6), frequency
    for tried in frequency + np.linspace(-0.6, 0.6, _TRIED) * bin_width:
        columns = twin.whiten(twin.columns("tone", {"frequency": float(tried)}))
        covariance = np.asarray(np.linalg.inv(columns @ columns.T), dtype=float)
        score = columns @ v
        gain = float(score @ covariance @ score)
        if gain > best[0]:
            best = gain, -covariance @ score, covariance, float(tried)
    _, value, covariance, frequency = best
    return Term("tone", value, float((v**2).mean()) * covariance, {"frequency": frequency})


def silenced(recording: Recording, tones: Sequence[Term]) -> Recording:
    """Return the recording with the tones subtracted."""
    if not tones:
        return recording
    signals = Signals(recording.time)
    together = np.sum([tone.evaluate(signals) for tone in tones], axis=0)
    return replace(recording, magnetic_field=recording.magnetic_field - together.T)
