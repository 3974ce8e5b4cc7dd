"""Restart after a change of hard iron, with or without the estimates from before it.

The window that contains a step is left out of the fits before and after it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.marginal import BIAS, HARD_IRON, ContinuedChain, Marginal, continued, fitted
from magyc_gtsam.estimators.smoother.noise_levels import weigh
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.chain_values import DELAY, ChainState, Weights
from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.chain.vech import unvech
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.change_point import NO_PLACE, TURNED, Step, find_step, turned
from magyc_gtsam.online.engine import Change
from magyc_gtsam.online.report import observable, report_of
from magyc_gtsam.online.state import FIRST, SmootherState

_EMPTY_COUNT = 1e-6  # sample count given to a window whose field is left out
_REJECTED = 16.27  # χ² of 3 degrees of freedom at 99.9 %, the cost of a window that does not fit
_UNKNOWN = 1e-6  # weight of windows whose field is left out; not zero, so that all directions are determined
_ABOUT = 3  # windows before the edge at which the transition may begin


def restart(online: SmootherState, fit: Fit, step: Step, numbers: Array) -> None:
    """Restart with a new hard iron after a step inside a fit of the windows `numbers`, keeping everything else."""
    belief, chain = online.belief, fit.chain
    assert isinstance(chain, ContinuedChain)
    fit_before, before = _before(online, fit, step, numbers)
    known = observable(before)
    # Without a calibration before, the step is no more certain than the hard iron was.
    sigma = step.sigma if known else np.hypot(step.sigma, before.sigma["hard_iron"])
    belief.changes.append(Change(step.time, step.time_sigma, step.value, sigma, before, None))
    if not known:
        online.begin_at(int(numbers[step.window + 1]))
        return
    belief.head = _marginal_before(chain, fit_before).forget(HARD_IRON)
    belief.tail = int(numbers[step.window])
    online.close()
    parameters = fit_before.state.parameters.copy()
    parameters[HARD_IRON] += step.value
    following = chain.windows.part(step.window, len(chain.windows))
    after = fitted(replace(chain, windows=following, past=belief.head, facts=()), parameters, fit.free)
    belief.estimate = online.last._replace(parameters=after.state.parameters, covariance=after.covariance)
    belief.front, belief.undecided, belief.waiting = None, False, False
    belief.refitted, belief.stable, belief.settled, belief.next_refit = None, False, False, FIRST
    belief.iron_change = None


def restart_at_convergence(online: SmootherState, fit: Fit, now: Calibration) -> None:
    """Look for a step from the time before the estimate was accurate enough to show it, and restart after it.

    Args:
        online: the state of the smoother.
        fit, now: fit and calibration of all windows kept.
    """
    belief, numbers = online.belief, online.numbers()
    fit = replace(fit, chain=continued(fit), free=online.settings.free(fit.state.parameters))
    step, undecided, _ = find_step(fit, online.last.colour)
    earlier = None
    if belief.past is None and (undecided or (step and not observable(_before(online, fit, step, numbers)[1]))):
        # The beginning is too short to lower the robust cost by the limit, or to have a calibration of its own.
        earlier = _change_before(online, fit)
    if earlier is not None and np.linalg.norm(earlier.step) > NO_PLACE * (now.field_strength or 0.0):
        _begin_after(online, earlier, now)
    elif step is not None:
        restart(online, fit, step, numbers)


def _before(online: SmootherState, fit: Fit, step: Step, numbers: Array) -> tuple[Fit, Calibration]:
    """Return fit and calibration from those of the windows `numbers` that precede a step."""
    preceding = replace(fit.chain, windows=fit.chain.windows.part(0, step.window))
    before = fitted(preceding, fit.state.parameters, fit.free)
    recording = online.recording(int(numbers[step.window + 1]), int(numbers[0]))
    return before, report_of(online, recording, before, int(numbers[0]), online.last)


def _marginal_before(chain: ContinuedChain, before: Fit) -> Marginal:
    """Return the marginal of `before` at the window that follows it, whose field is left out."""
    step_window = len(before.chain.windows)
    windows = chain.windows.part(0, step_window + 1)
    count = windows.count.copy()
    count[step_window] = _EMPTY_COUNT
    parameters, direction = before.state
    state = ChainState(parameters, np.column_stack([direction, direction[:, -1]]))
    weights = Weights(np.append(before.weights.window, 1.0), np.append(before.weights.link, 1.0))
    return replace(chain, windows=replace(windows, count=count)).marginalise(state, weights, step_window)


def restart_after_change(online: SmootherState, first: int) -> bool:
    """Restart where the log begins to fit, if the windows from number `first` on fit by themselves but those before do
    not fit with them; return whether it restarted.

    The windows before are dropped: they have another hard iron, which is recorded as a change, or another field.
    """
    recording = online.recording(online.belief.done, first)
    try:
        fit = fit_field_chain(recording, online.settings.without_prior)
        now = report_of(online, recording, fit)
        earlier = _change_before(online, fit) if now.converged else None
    except MagycError:
        return False  # these windows do not fit either: wait for more data
    if earlier is None:
        return False
    _begin_after(online, earlier, now)
    return True


def _change_before(online: SmootherState, fit: Fit) -> EarlierChange | None:
    """Return the change before the windows that a fit explains, of all windows kept; None if it explains all."""
    parameters = fit.state.parameters
    windows = online.buffer.windows(int(online.numbers()[0]), online.belief.done, parameters[DELAY])
    chain = ContinuedChain(windows.integrate(parameters[BIAS], parameters[DELAY]), fit.chain.noise)
    return find_earlier_change(chain, parameters)


def _begin_after(online: SmootherState, earlier: EarlierChange, now: Calibration) -> None:
    """Drop the windows before a change; record the change if the hard iron changed, to that of `now`."""
    number = int(online.numbers()[earlier.window])
    if earlier.in_sensor:
        sigma = np.hypot(earlier.sigma, now.sigma["hard_iron"])
        before = replace(
            now,
            hard_iron=now.hard_iron - earlier.step,
            converged=False,
            message="the soft iron and the bias since the step, and the hard iron that the field before it suggests",
        )
        online.belief.changes.append(Change(earlier.time, earlier.time_sigma, earlier.step, sigma, before, None))
    online.begin_at(number)


class EarlierChange(NamedTuple):
    """A change before the windows that a calibration explains.

    Attributes:
        window: first window from which the calibration holds.
        time, time_sigma: s, when the hard iron changed.
        step, sigma: (3,) T, hard iron after the change minus before.
        in_sensor: whether the hard iron changed, not the field with the place.
    """

    window: int
    time: float
    time_sigma: float
    step: Array
    sigma: Array
    in_sensor: bool


def find_earlier_change(chain: ContinuedChain, parameters: Array) -> EarlierChange | None:
    """Find the window from which θ explains a chain; return None if it explains all windows or too few."""
    fit = weigh(chain, parameters)
    misfit, _ = chain.squares(chain.residuals(fit.state))
    # The split of least cost, where a window before it counts as half rejected.
    gain = 0.5 * _REJECTED - np.minimum(misfit, _REJECTED)
    n = int(np.argmax(np.cumsum(gain[::-1])[::-1]))
    if not 3 <= n < len(misfit) - 3:
        return None
    # The directions before the split follow from those after it by the gyroscope alone.
    window, link = chain.unweighted()
    window[:n] = _UNKNOWN
    state = ChainState(parameters, fit.state.direction.copy())
    state.direction[:, :n] = state.direction[:, n : n + 1]
    state = chain.settled(state, Weights(window, link))
    # The hard iron before the split need not be constant while a hand moves iron, hence the median of the samples.
    residual = chain.residuals(state).window[:, :n]
    before = residual.T.repeat(chain.windows.count[:n].astype(int), axis=0)
    step = np.median(before, axis=0)
    sigma = 1.4826 * np.median(np.abs(before - step), axis=0) + chain.window_sigma[n]
    when = _transition(residual, step, chain.windows.time[: n + 1])
    in_sensor = _stands_in_sensor(residual, chain.windows.rotation[:, :, :n])
    in_sensor |= bool(np.linalg.norm(step) > NO_PLACE * np.cbrt(abs(np.linalg.det(unvech(parameters[:6])))))
    return EarlierChange(n, *when, step, sigma, in_sensor)


def _stands_in_sensor(residual: Array, rotation: Array) -> bool:
    """Return whether a residual (3, n) is fixed in the sensor rather than the world; False without turning."""
    in_world = np.einsum("ijn,in->jn", rotation, residual)
    spread = [np.abs(part - np.median(part, axis=1)[:, None]).sum() for part in (residual, in_world)]
    return turned(rotation) > TURNED and bool(spread[0] < spread[1])


def _transition(residual: Array, step: Array, time: Array) -> tuple[float, float]:
    """Return mean time and duration (standard deviation), s, of the change of `residual` (3, n) from `step` to zero.

    The first window that fits, at time[n], may follow seconds after a magnet arrived, while a hand was still near it.
    """
    left = np.clip(step @ residual / (step @ step), 0.0, 1.0)
    # Find the edge between two levels first, then the transition near it.
    edge = int(np.argmin(np.concatenate([[0.0], np.cumsum((1 - left) ** 2 - left**2)])))
    first = max(edge - _ABOUT, 0)
    level = np.concatenate([[1.0], np.minimum.accumulate(left[first:]), [0.0]])
    passed = -np.diff(level)  # between window k − 1 and k, for k from `first` to n
    before = time[max(first - 1, 0)]
    between = 0.5 * (time[first:] + np.concatenate([[before], time[first:-1]]))
    mean = float(passed @ between)
    spacing = (time[-1] - before) / len(passed)
    return mean, float(np.sqrt(passed @ (between - mean) ** 2 + spacing**2 / 12))
