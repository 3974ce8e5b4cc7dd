"""Innovations sample by sample, which show fast effects and noise that the means over windows suppress."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.smoother.preparation import preintegrate
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import NAMES, TERMS
from magyc_gtsam.gap.model.problem import Model, Problem, added_by
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.motion_lines import follows_channels, follows_motion
from magyc_gtsam.gap.samples.noise_effects import NoiseScore, lines
from magyc_gtsam.gap.samples.wrong_samples import spikes
from magyc_gtsam.recording import Recording

NOISE_LIMIT = float(np.log(len(NAMES) / RULES.family_wise))  # nats


class Fine(NamedTuple):
    """Innovations of single samples.

    Attributes:
        innovation: (3, m), scaled to unit variance.
        level: their standard deviation, T.
        rate: Hz.
        time: (m,) s.
        edge: Hz, upper limit of the field's own changes; a spectral line below it may be due to the motion.
        of_channels: (3, m) T, what effects of logged channels add to the readings.
    """

    innovation: Array
    level: float
    rate: float
    time: Array
    edge: float
    of_channels: Array

    @property
    def white(self) -> float:
        """Return the standard deviation of their white part, T, to which a slow misfit does not add."""
        return self.level * min(1.0, float(np.sqrt(0.5 * (np.diff(self.innovation, axis=1) ** 2).mean())))

    @property
    def calm(self) -> Array:
        """Return the innovations with outliers clipped, which would otherwise add a comb of lines and hide colour."""
        length = np.sqrt((self.innovation**2).sum(axis=0))
        calm = self.innovation * np.minimum(1.0, 4.0 / np.maximum(length, 1e-12))
        result: Array = calm / np.sqrt((calm**2).mean())
        return result


def fine_innovations(recording: Recording, model: Model) -> Fine:
    """Return the innovations of a model on a recording, with one window per magnetometer sample."""
    twin = fine_twin(recording, model)
    v = twin.residual()[:, 1:]
    time = twin.time[1:]
    scale = float(np.sqrt((v**2).mean()))
    rate = (len(time) - 1) / float(time[-1] - time[0])
    edge = _edge(twin.windows.need("field"), rate)
    read = [term for term in model.on("magnetometer") if TERMS[term.name].kind is not None]
    return Fine(v / scale, scale * model.noise.magnetometer, rate, time, edge, added_by(read, twin.windows)[:, 1:])


def fine_twin(recording: Recording, model: Model) -> Twin:
    """Return the twin with one window per magnetometer sample, at a cost that grows as the number of samples."""
    return Twin.of(Problem.of(recording, preintegrate(recording, window=1e-9)), model)


def _edge(field: Array, rate: float) -> float:
    power = (np.abs(np.fft.rfft(field - field.mean(axis=1)[:, None], axis=1)[:, 1:]) ** 2).sum(axis=0)
    held = np.cumsum(power) / max(float(power.sum()), 1e-300)
    return float(RULES.motion_harmonics * (np.searchsorted(held, RULES.motion_held) + 1) * rate / field.shape[1])


def single_scores(recording: Recording, fine: Fine, limit: float) -> tuple[NoiseScore, NoiseScore]:
    """Return the tests of a recording's innovations for wrong samples and for a tone.

    A line of the motion is none, nor one of a channel that effects of the model read.
    """
    first = None
    for line in lines(fine.calm, fine.time, fine.level, limit, fine.edge):
        first, at = first or line, (line.setting["frequency"], float(line.value[0]))
        if not line.significant:
            line = replace(first, significant=False)
            break
        if not (follows_motion(recording, *at) or follows_channels(fine.time, fine.of_channels, *at)):
            break
    return spikes(fine.innovation, fine.level, limit), line
