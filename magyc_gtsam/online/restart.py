"""Beginning again after a step in hard iron."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY
from magyc_gtsam.online.kept import Kept, observable
from magyc_gtsam.online.memory import FIRST
from magyc_gtsam.online.retrospect import find_beginning
from magyc_gtsam.online.steps import Step
from magyc_gtsam.online.summary import BIAS, ContinuedChain
from magyc_gtsam.online.values import Change
from magyc_gtsam.online.whole import fit_whole
from magyc_gtsam.recording import Array


def restart(kept: Kept, numbers: Array, step: Step) -> None:
    """The hard iron is another one since `step` in the windows `numbers`; all else that is known still holds."""
    m = kept.memory
    recording = kept.recording(int(numbers[step.window]), int(numbers[0]))
    before = kept.result(recording, step.before, None, int(numbers[0]), kept.last)
    known = observable(before)
    # Where nothing was known before, the step is known no better than the hard iron was.
    sigma = step.sigma if known else np.hypot(step.sigma, before.sigma["hard_iron"])
    m.changes.append(Change(step.time, step.time_sigma, step.value, sigma, before, None))
    if not known:
        kept.begin_at(int(numbers[step.window]))
        return
    m.head, m.tail = step.past, int(numbers[step.window - 1])
    kept.close()
    after = step.after
    m.estimate = kept.last._replace(parameters=after.state.parameters, covariance=after.covariance)
    m.front, m.undecided = None, False
    m.swept, m.stable, m.settled, m.next_sweep = None, False, False, FIRST


def begin_later(kept: Kept) -> bool:
    """Begin afresh where the log begins to fit, if it does not as a whole but its second half does.

    What is before is left out: the hard iron was another one, which is a change, or the field of the place.
    """
    numbers, done, options = kept.numbers(), kept.memory.done, kept.settings.fit
    middle = int(numbers[len(numbers) // 2])
    recording = kept.recording(done, middle)
    try:
        fit, rival, _ = fit_whole(recording, None, options)
        now = kept.result(recording, fit, rival)
        parameters = fit.state.parameters
        windows = kept.buffer.windows(int(numbers[0]), done, parameters[DELAY])
        chain = ContinuedChain(windows.integrate(parameters[BIAS], parameters[DELAY]), fit.chain.noise)
        found = find_beginning(chain, parameters) if now.converged else None
    except MagycError:
        return False  # nor does the half; more data will tell
    if found is None:
        return False
    if found.in_sensor:
        sigma = np.hypot(found.sigma, now.sigma["hard_iron"])
        before = replace(
            now,
            hard_iron=now.hard_iron - found.step,
            converged=False,
            message="the soft iron and the bias since the step, and the hard iron that the field before it suggests",
        )
        kept.memory.changes.append(Change(found.time, found.time_sigma, found.step, sigma, before, None))
    kept.begin_at(int(numbers[found.window]))
    return True
