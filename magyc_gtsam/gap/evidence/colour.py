"""Noise that hangs together, beside a set of names: the likelihood of what the set leaves as an autoregression.

Alike in all directions it is a noise of the sensor, which has a name. Along one direction more than along the others it
is something that moves, and unknown.
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
from magyc_gtsam.gap.evidence.beside import Beside
from magyc_gtsam.gap.evidence.prior import PRIOR
from magyc_gtsam.gap.evidence.tree import Tree
from magyc_gtsam.gap.evidence.weighing import weigh

_ORDERS = (1, 2, 3, 4, 6)
_TIMES = (0.5, 1.0, 2.0, 4.0)  # windows, about s, in which colour beside white noise decays
_SHARES = (0.1, 0.2, 0.5, 1.0, 2.0)  # of its power, of the white noise's


class Colour(NamedTuple):
    """Nats of colour alike in all directions, and of one that is not; its filter A(z), and the sigma that it leaves."""

    alike: float
    one_way: float
    filter: Array
    sigma: float


def colour_of(innovation: Array) -> Colour:
    """Of (3n,) innovations, against white noise of the sensors' level (which may be less than thought)."""
    rows = innovation.reshape(3, -1)
    level = np.sqrt(min(float((rows**2).mean()), 1.0))
    rows = rows / level
    alike, polynomial, sigma = _autoregression(rows)
    alike = float(np.logaddexp(alike, _beside_white(rows))) - float(np.log(2))
    direction = np.linalg.eigh(rows @ rows.T)[1]
    one_way = sum(_autoregression(row[None])[0] for row in direction.T @ rows)
    return Colour(alike, one_way, polynomial, sigma * level)


def _autoregression(rows: Array) -> tuple[float, Array, float]:
    """(nats against white of unit variance by BIC, polynomial, sigma) of (k, n) rows that share one."""
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
    """Nats, against white of unit variance, of (k, n) rows being white with an Ornstein–Uhlenbeck process on top.

    By Whittle's likelihood: the cosine transform of either is independent, of the variance of its spectrum. Powers and
    times are averaged over; their sum is as large as the rows.
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
    """{names: their nats beside colour, and the colour}, added one by one as linearised at nothing."""
    root = tree.nodes[()]
    innovation, base = root.beside.left(), root.fit.twin.base_columns
    candidates = tree.candidates.only_names()
    result: dict[tuple[str, ...], tuple[float, Colour]] = {}
    names: tuple[str, ...] = ()
    log, left = 0.0, innovation
    soft, variance = candidates.columns[:0], np.zeros(0)
    for _ in range(PRIOR.names_beside + 1):
        colour = colour_of(left)
        result[names] = log, colour
        white = partial(filtered, colour=colour)
        none = np.zeros(len(base) + len(soft))
        beside = Beside(white(innovation), white(base), white(soft), variance, none)
        found = weigh(candidates.changed(white), beside)
        best = max((each for each in found.values() if each.name not in names), key=lambda each: each.log)
        if best.log + PRIOR.named < PRIOR.hardly_beside:
            break
        names, log = tuple(sorted((*names, best.name))), log + best.log
        own = candidates.of_setting(best.name, best.setting)
        soft = np.concatenate([soft, own])
        scale = PRIOR.scales[int(np.argmax(best.by_scale))]
        variance = np.concatenate([variance, np.full(len(own), scale**2)])
        value, _ = Beside(
            white(innovation), white(base), white(soft), variance, np.zeros(len(base) + len(soft))
        ).solution()
        left = innovation + value @ np.concatenate([base, soft])
    return result


def filtered(rows: Array, colour: Colour) -> Array:
    """Rows (…, 3n) made white."""
    if not len(rows):
        return rows  # which scipy does not filter
    shape = rows.shape
    n = shape[-1] // 3
    result: Array = lfilter(colour.filter, [1.0], rows.reshape(*shape[:-1], 3, n), axis=-1) / colour.sigma
    return result.reshape(shape)
