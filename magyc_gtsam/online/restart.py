"""Restart after a change of hard iron, with or without the estimates from before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import NEAR, Fit, descend
from magyc_gtsam.estimators.smoother.search import fit_field_chain
from magyc_gtsam.factors.chain.chain_values import DELAY
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.change_point import NO_PLACE, EarlierChange, Step, find_earlier_change, find_step
from magyc_gtsam.online.engine import Change
from magyc_gtsam.online.marginal import BIAS, ContinuedChain, continued
from magyc_gtsam.online.report import observable, report_of
from magyc_gtsam.online.state import FIRST, SmootherState
from magyc_gtsam.recording import Array

SOFT_IRON = slice(0, 6)
# Smallest λ of a change: in 790 refits after jumps of the hard iron alone λ was 27 at most (58 in one refused log), in
# those after a change of the soft iron by 2 % it was 35 to 87 (docs/online.md).
_SOFT_IRON_LIMIT = 30.0


def restart(online: SmootherState, numbers: Array, step: Step) -> None:
    """Restart with a new hard iron after `step` in the windows `numbers`, keeping everything else."""
    belief, before = online.belief, _before(online, numbers, step)
    known = observable(before)
    # Without a calibration before, the step is no more certain than the hard iron was.
    sigma = step.sigma if known else np.hypot(step.sigma, before.sigma["hard_iron"])
    belief.changes.append(Change(step.time, step.time_sigma, step.value, sigma, before, None))
    if not known:
        online.begin_at(int(numbers[step.window]))
        return
    belief.head, belief.tail = step.past, int(numbers[step.window - 1])
    online.close()
    after = step.after
    belief.estimate = online.last._replace(parameters=after.state.parameters, covariance=after.covariance)
    belief.front, belief.undecided, belief.waiting = None, False, False
    belief.refitted, belief.stable, belief.settled, belief.next_refit = None, False, False, FIRST


def restart_at_convergence(online: SmootherState, fit: Fit, now: Calibration) -> None:
    """Look for a step from the time before the estimate was accurate enough to show it, and restart after it.

    Args:
        online: the state of the smoother.
        fit, now: fit and calibration of all windows kept.
    """
    belief, numbers = online.belief, online.numbers()
    held = online.settings.free(fit.state.parameters)
    step, undecided, _ = find_step(replace(fit, chain=continued(fit), free=held), online.last.colour)
    earlier = None
    if belief.past is None and (undecided or (step and not observable(_before(online, numbers, step)))):
        # The beginning is too short to lower the robust cost by the limit, or to have a calibration of its own.
        earlier = _change_before(online, fit)
    if earlier is not None and np.linalg.norm(earlier.step) > NO_PLACE * (now.field_strength or 0.0):
        _begin_after(online, earlier, now)
    elif step is not None:
        restart(online, numbers, step)


def _before(online: SmootherState, numbers: Array, step: Step) -> Calibration:
    """Return the calibration from the windows `numbers` before a step."""
    recording = online.recording(int(numbers[step.window]), int(numbers[0]))
    return report_of(online, recording, step.before, int(numbers[0]), online.last)


def restart_after_change(online: SmootherState) -> bool:
    """Restart where the log begins to fit, if its second half fits but the whole does not; return whether it
    restarted.

    The windows before are dropped: they have another hard iron, which is recorded as a change, or another field.
    """
    numbers, done = online.numbers(), online.belief.done
    recording = online.recording(done, int(numbers[len(numbers) // 2]))
    try:
        fit = fit_field_chain(recording, online.settings.without_prior)
        now = report_of(online, recording, fit)
        earlier = _change_before(online, fit) if now.converged else None
    except MagycError:
        return False  # the second half does not fit either: wait for more data
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


def soft_iron_changed(fit: Fit) -> bool:
    """Return whether the windows after a step contradict the soft iron estimated before it, as steel attached or a
    sensor mounted anew would cause.

    After a step the past marginal keeps its information on the soft iron; if that were wrong, the hard iron of the
    following windows would be biased. The test is the likelihood ratio λ, at the fit's weights and noise, of the fit
    with that information against the fit without it: χ² with 6 degrees of freedom if the soft iron did not change.

    Args:
        fit: at its minimum.
    """
    chain = fit.chain
    if not isinstance(chain, ContinuedChain) or chain.past is None or not chain.past.information[SOFT_IRON].any():
        return False
    information, gradient = chain.past.information[SOFT_IRON, SOFT_IRON], chain.past.gradient[SOFT_IRON]
    # The cost of the marginal without the soft iron is relative to its own minimum.
    least = -0.5 * float(gradient @ np.linalg.solve(information, gradient))
    without = replace(chain, past=chain.past.forget(SOFT_IRON))
    free = descend(replace(fit, chain=without, reduced=without.eliminate(fit.state, fit.weights)), NEAR)
    return 2 * (fit.reduced.cost - free.reduced.cost - least) > _SOFT_IRON_LIMIT * fit.colour
