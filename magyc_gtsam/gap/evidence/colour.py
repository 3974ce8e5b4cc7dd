"""Coloured noise beside a set of effects: the likelihood of the set's residual as an autoregression.

Colour with the same power in all directions is sensor noise, an effect of the catalogue. Colour with more power along
one direction is an unknown effect.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.fft import dct
from scipy.special import logsumexp

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.model.colour import Autoregression

_TIMES = (0.5, 1.0, 2.0, 4.0)  # windows, about s: correlation times of colour on white noise
_SHARES = (0.1, 0.2, 0.5, 1.0, 2.0)  # power of the colour relative to the white noise
_CORRELATED = 3.0  # nats, from which neighbours along one direction are correlated


class Colour(NamedTuple):
    """Evidence of coloured noise, nats: equal in all directions, or different in each."""

    alike: float
    one_way: float


def colour_of(innovation: Array) -> Colour:
    """Test innovations (3n,) for colour, against white noise of the sensors' level or less."""
    rows = innovation.reshape(3, -1)
    rows = rows / np.sqrt(min(float((rows**2).mean()), 1.0))
    alike = float(np.logaddexp(_autoregression(rows), _beside_white(rows))) - float(np.log(2))
    along = np.linalg.eigh(rows @ rows.T)[1].T @ rows
    # The axes of a sensor may have unequal white noise: without correlation, more power along one is no colour.
    alone = sum(_autoregression(row[None] / np.sqrt(np.mean(row**2))) for row in along)
    return Colour(alike, sum(_autoregression(row[None]) for row in along) if alone > _CORRELATED else alone)


def _autoregression(rows: Array) -> float:
    """Return the nats by BIC of a common autoregression of rows (k, n), against unit white noise."""
    return Autoregression.of(rows, len(rows)).nats(rows, len(rows))


def _beside_white(rows: Array) -> float:
    """Return the nats of rows (k, n) as white noise plus an Ornstein–Uhlenbeck process, against unit white noise.

    By Whittle's likelihood: the components of the cosine transform are independent, with the variance of the spectrum.
    The nats are averaged over powers and times; the level of the sum is fitted to the rows.
    """
    n = rows.shape[1]
    power = (dct(rows, norm="ortho", axis=1) ** 2).mean(axis=0)
    angle = np.pi * np.arange(n) / n
    logs = []
    for time, share in product(_TIMES, _SHARES):
        decay = np.exp(-1 / time)
        spectrum = 1 + share * (1 - decay**2) / (1 - 2 * decay * np.cos(angle) + decay**2)
        level = float((power / spectrum).mean())
        logs.append(0.5 * len(rows) * float((power - np.log(level * spectrum) - 1).sum()))
    return float(logsumexp(logs) - np.log(len(logs)) - 0.5 * np.log(rows.size))
