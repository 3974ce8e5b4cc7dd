"""The smallest strength at which effects on the noise are found, from noise and length of a recording alone.

It does not depend on the motion, and no other effect has their signature in the innovations sample by sample.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri, chndtr, ndtri

from magyc_gtsam.gap.effects import LABELS
from magyc_gtsam.gap.result import Isolability
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.gap.samples.fine import NOISE_LIMIT
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.held import HELD

_SHARE = 0.01  # of the samples that are spikes
_CORRELATION_TIME = 1.0  # s, correlation time of the coloured noise
_MATTERS = 0.5e-6  # T, of a tone and of coloured noise: half the noise of an ordinary magnetometer
_SPIKE_MATTERS = 3e-6  # T, of spikes: three times the noise


def noise_isolability(recording: Recording, noise: float) -> tuple[Isolability, ...]:
    """Return the rows of the table for a magnetometer with `noise` T per sample."""
    samples = len(recording.magnetometer.time)
    rate = (samples - 1) / recording.duration
    return (
        _row(
            "coloured-noise",
            _coloured(samples, rate) * noise,
            f"noise that is correlated over {_CORRELATION_TIME:.0f} s",
        ),
        _row("spikes", _spikes(samples) * noise, f"spikes on {_SHARE:.0%} of the samples", matters=_SPIKE_MATTERS),
        _row("tone", _tone(samples) * noise, "a tone above the motion's own frequencies"),
        _row("quantisation", RULES.coarse * noise, "steps of the magnetometer", matters=RULES.coarse * noise),
        _certain(
            "sample-hold",
            100 * HELD,
            "% of rows",
            f"from {HELD:.0%} of repeated rows on, by counting them",
        ),
        _certain("axis-order", 0.0, "", "always, by trying all 48 arrangements before anything is estimated"),
    )


def _row(name: str, smallest: float, what: str, matters: float = _MATTERS) -> Isolability:
    words = f"{what} from {smallest * 1e6:.2g} µT on, whatever the motion"
    return Isolability(
        name, LABELS[name], smallest * 1e6, "µT", matters * 1e6, 1.0, smallest <= matters, {}, words
    )


def _certain(name: str, smallest: float, unit: str, words: str) -> Isolability:
    return Isolability(name, LABELS[name], smallest, unit, smallest, 1.0, True, {}, words)


def _gain_needed() -> float:
    """Return the mean gain (nats) that is significant with probability 0.9; a gain G has a deviation of √(2 G)."""
    spread = np.sqrt(2) * float(ndtri(RULES.found_with))
    return float((0.5 * (spread + np.sqrt(spread**2 + 4 * (NOISE_LIMIT + RULES.chance)))) ** 2)


def _solved(gain: Callable[[float], float], needed: float) -> float:
    """Return the strength in sigmas at which the gain has the needed value."""
    return float(np.exp(brentq(lambda log: gain(np.exp(log)) - needed, np.log(1e-3), np.log(1e3))))


def _tone(samples: int) -> float:
    """Return the amplitude: twice the height of a line is χ² with 6 degrees of freedom, non-centrality n a² / 2."""
    level = float(chdtri(6, np.exp(-NOISE_LIMIT - RULES.unsure_line - 2 * np.log(samples / 2))))
    return _solved(lambda a: 1 - float(chndtr(level, 6, 0.5 * samples * a**2)), RULES.found_with)


def _coloured(samples: int, rate: float) -> float:
    """Return the standard deviation: mean gain in Whittle's likelihood, 3 Σ (ln mean spectrum − ln spectrum)."""
    frequency = np.arange(1, samples // 2) * rate / samples
    shape = 1 / (1 + (2 * np.pi * _CORRELATION_TIME * frequency) ** 2)
    shape = shape / shape.mean()
    return _solved(
        lambda s: float(3 * (np.log1p(s**2) - np.log1p(s**2 * shape)).sum()),
        _gain_needed(),
    )


def _spikes(samples: int) -> float:
    """Return the standard deviation: mean gain of a mixture over one normal distribution, by quadrature (χ²₃)."""
    quantile = chdtri(3, np.linspace(0.9995, 0.0005, 1000))

    def gain(height: float) -> float:
        wide = 1 + height**2
        scale = 1 - _SHARE + _SHARE * wide
        total = 0.0
        for share, variance in ((1 - _SHARE, 1.0), (_SHARE, wide)):
            square = variance * quantile
            mixture = np.logaddexp(
                np.log(1 - _SHARE) - 0.5 * square, np.log(_SHARE) - 1.5 * np.log(wide) - 0.5 * square / wide
            )
            total += share * float((mixture + 1.5 * np.log(scale) + 0.5 * square / scale).mean())
        return samples * total

    return _solved(gain, _gain_needed())
