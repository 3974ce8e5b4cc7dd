"""Coloured noise beside a set of effects: the likelihood of the set's residual as an autoregression.

Colour with the same power in all directions is sensor noise, an effect of the catalogue. Colour with more power along
one direction is an unknown effect.
"""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.fft import dct
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.special import logsumexp

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.effects import TERMS
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.evidence.weighing import weigh

_ORDERS = (1, 2, 3, 4, 6)
_TIMES = (0.5, 1.0, 2.0, 4.0)  # windows, about s: correlation times of colour on white noise
_SHARES = (0.1, 0.2, 0.5, 1.0, 2.0)  # power of the colour relative to the white noise


class Colour(NamedTuple):
    """Coloured noise: nats if equal in all directions, nats otherwise, its filter A(z), and sigma after the filter."""

    alike: float
    one_way: float
    filter: Array
    sigma: float


def colour_of(innovation: Array) -> Colour:
    """Test innovations (3n,) for colour, against white noise of the sensors' level or less."""
    rows = innovation.reshape(3, -1)
    level = np.sqrt(min(float((rows**2).mean()), 1.0))
    rows = rows / level
    alike, polynomial, sigma = _autoregression(rows)
    alike = float(np.logaddexp(alike, _beside_white(rows))) - float(np.log(2))
    direction = np.linalg.eigh(rows @ rows.T)[1]
    one_way = sum(_autoregression(row[None])[0] for row in direction.T @ rows)
    return Colour(alike, one_way, polynomial, sigma * level)


def _autoregression(rows: Array) -> tuple[float, Array, float]:
    """Fit rows (k, n) with a common autoregression; return nats against unit white noise by BIC, polynomial, sigma."""
    k, n = rows.shape
    square = float((rows**2).sum())
    mean = max(square / (k * n), 1.0)
    best = (-np.inf, np.ones(1), 1.0)
    for order in _ORDERS:
        lagged = np.array([np.vdot(rows[:, lag:], rows[:, : n - lag]) for lag in range(order + 1)]) / (k * n)
        first = lagged[:-1].copy()
        first[0] *= 1 + 1e-9
        polynomial = np.concatenate([[1.0], -solve_toeplitz(first, lagged[1:])])
        left = lfilter(polynomial, [1.0], rows, axis=1)[:, order:]
        variance = float((left**2).mean())
        start = 0.5 * float((rows[:, :order] ** 2).sum()) / mean + 0.5 * k * order * np.log(mean)
        log = 0.5 * square - 0.5 * left.size * (np.log(variance) + 1) - start
        log -= 0.5 * (order + 1) * np.log(k * n)
        if log > best[0]:
            best = (log, polynomial, np.sqrt(variance))
    return best


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


def beside_colour(tree: Tree) -> dict[tuple[str, ...], tuple[float, Colour]]:
    """Return {names: (nats beside colour, colour)}, adding effects one by one, linearised at zero."""
    root = tree.nodes[()]
    innovation, base = root.beside.left(), root.fit.twin.base_columns
    candidates = tree.candidates.only(TERMS.__contains__)
    result: dict[tuple[str, ...], tuple[float, Colour]] = {}
    names: tuple[str, ...] = ()
    log, left = 0.0, innovation
    soft, variance = candidates.columns[:0], np.zeros(0)
    for _ in range(PRIOR.names_beside + 1):
        colour = colour_of(left)
        result[names] = log, colour
        white = partial(filtered, colour=colour)
        none = np.zeros(len(base) + len(soft))
        beside = Beside.of(white(innovation), white(base), white(soft), variance, none)
        found = weigh(candidates.changed(white), beside)
        best = max((each for each in found.values() if each.name not in names), key=lambda each: each.log)
        if best.log + PRIOR.named < PRIOR.hardly_beside:
            break
        names, log = tuple(sorted((*names, best.name))), log + best.log
        own = candidates.of_setting(best.name, best.setting)
        soft = np.concatenate([soft, own])
        scale = PRIOR.scales[int(np.argmax(best.by_scale))]
        variance = np.concatenate([variance, np.full(len(own), scale**2)])
        value, _ = Beside.of(
            white(innovation), white(base), white(soft), variance, np.zeros(len(base) + len(soft))
        ).solution()
        left = innovation + value @ np.concatenate([base, soft])
    return result


def filtered(rows: Array, colour: Colour) -> Array:
    """Whiten rows (…, 3n) with the filter of a colour."""
    if not len(rows):
        return rows  # scipy does not filter empty arrays
    shape = rows.shape
    n = shape[-1] // 3
    result: Array = lfilter(colour.filter, [1.0], rows.reshape(*shape[:-1], 3, n), axis=-1) / colour.sigma
    return result.reshape(shape)
