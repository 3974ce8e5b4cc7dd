"""Where a log does not fit as a whole but its end does: since when it fits, and what the hard iron was before."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magyc_gtsam.estimators.chain_fit import weigh
from magyc_gtsam.factors.field_chain import State, Weights
from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.factors.soft_iron import unvech
from magyc_gtsam.online.steps import NO_PLACE, TURNED, turned
from magyc_gtsam.online.summary import ContinuedChain

_REJECTED = 16.27  # χ² of 3 degrees of freedom at 99.9 %, what a window that does not fit counts
_UNKNOWN = 1e-6  # weight of windows whose field is left out, not quite zero so that all directions are determined
_ABOUT = 3  # windows before the edge at which the passage may begin


class Beginning(NamedTuple):
    """The first window since which a calibration holds; when the hard iron passed from its old value to that, and the
    step (3,) T, after less before, with their sigmas; and whether it was the hard iron, not the field of another
    place."""

    window: int
    time: float
    time_sigma: float
    step: Array
    sigma: Array
    in_sensor: bool


def find_beginning(chain: ContinuedChain, parameters: Array) -> Beginning | None:
    """Since when θ of the end explains the windows of `chain`; None if it always does, or never."""
    fit = weigh(chain, parameters)
    misfit, _ = chain.squares(chain.residuals(fit.state))
    # The split that costs least, a window before it counting as half rejected.
    gain = 0.5 * _REJECTED - np.minimum(misfit, _REJECTED)
    n = int(np.argmax(np.cumsum(gain[::-1])[::-1]))
    if not 3 <= n < len(misfit) - 3:
        return None
    # The directions before it follow from those after by the gyroscope alone.
    window, link = chain.unweighted()
    window[:n] = _UNKNOWN
    state = State(parameters, fit.state.direction.copy())
    state.direction[:, :n] = state.direction[:, n : n + 1]
    state, _ = chain.settle(state, Weights(window, link))
    # Not all before the split need be of one hard iron, with a hand at work: the middle of its samples.
    residual = chain.residuals(state).window[:, :n]
    before = residual.T.repeat(chain.windows.count[:n].astype(int), axis=0)
    step = np.median(before, axis=0)
    sigma = 1.4826 * np.median(np.abs(before - step), axis=0) + chain.window_sigma[n]
    when = _transition(residual, step, chain.windows.time[: n + 1])
    in_sensor = _stands_in_sensor(residual, chain.windows.rotation[:, :, :n])
    in_sensor |= bool(np.linalg.norm(step) > NO_PLACE * np.cbrt(abs(np.linalg.det(unvech(parameters[:6])))))
    return Beginning(n, *when, step, sigma, in_sensor)


def _stands_in_sensor(residual: Array, rotation: Array) -> bool:
    """Whether what is left (3, n) turned with the sensor, not with the world; no, where nothing turned."""
    in_world = np.einsum("ijn,in->jn", rotation, residual)
    spread = [np.abs(part - np.median(part, axis=1)[:, None]).sum() for part in (residual, in_world)]
    return turned(rotation) > TURNED and bool(spread[0] < spread[1])


def _transition(residual: Array, step: Array, time: Array) -> tuple[float, float]:
    """Mean time and duration (standard deviation), s, of the passage of `residual` (3, n) from `step` to none at
    time[n]: the first window that fits may come seconds after a magnet arrived, while a hand was still near it."""
    left = np.clip(step @ residual / (step @ step), 0.0, 1.0)
    # Two levels first, then what lies about their edge.
    edge = int(np.argmin(np.concatenate([[0.0], np.cumsum((1 - left) ** 2 - left**2)])))
    first = max(edge - _ABOUT, 0)
    level = np.concatenate([[1.0], np.minimum.accumulate(left[first:]), [0.0]])
    passed = -np.diff(level)  # between window k − 1 and k, for k from `first` to n
    before = time[max(first - 1, 0)]
    between = 0.5 * (time[first:] + np.concatenate([[before], time[first:-1]]))
    mean = float(passed @ between)
    spacing = (time[-1] - before) / len(passed)
    return mean, float(np.sqrt(passed @ (between - mean) ** 2 + spacing**2 / 12))
