"""A sweep: everything that is kept, fitted afresh as the batch method does it, noise levels and weights with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magyc_gtsam.estimators.chain_fit import Fit, begin
from magyc_gtsam.estimators.chain_search import refit_field_chain, short_term_noise
from magyc_gtsam.estimators.clock_drift import with_drift
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY
from magyc_gtsam.factors.preintegration import Preintegration
from magyc_gtsam.online.clocks import drift_of, testable
from magyc_gtsam.online.kept import Kept, continued, observable
from magyc_gtsam.online.memory import Estimate
from magyc_gtsam.online.restart import begin_later, restart
from magyc_gtsam.online.steps import find_step
from magyc_gtsam.online.summary import BIAS, ContinuedChain
from magyc_gtsam.online.walking import fit_walked, walk_through
from magyc_gtsam.online.whole import fit_whole, nothing_turned
from magyc_gtsam.recording import Recording

SHORTEST_TAIL = 24  # windows
SWEEP, _SEARCH = 1.25, 1.5  # growth between two sweeps, and between two searches for the start
_STILL = 1.5  # sigma of the sweep before by which a parameter may have moved for convergence
_LEAST_STABLE = 80  # windows, below which the noise levels are too uncertain to look for steps
_NOISE_WINDOWS = 60  # after a step, before the noise levels are estimated again
_MOST_LOOKED_BACK = 400  # windows that are searched for steps when the estimate has converged


def sweep(kept: Kept) -> None:
    """Fit everything that is kept; then head and tail anew."""
    m, buffer, settings = kept.memory, kept.buffer, kept.settings
    count = len(kept.numbers())
    search = m.past is None and (m.estimate is None or (not m.stable and count >= m.next_search))
    few = m.estimate is None or m.front is not None
    m.next_sweep = max(int((_SEARCH if few else SWEEP) * count), count + 8)
    if search:
        m.next_search = int(_SEARCH * count)
    if m.front is not None:
        _walk(kept)
        return
    later = search and settings.detect_changes and _LEAST_STABLE <= count <= _MOST_LOOKED_BACK
    recording = kept.recording(m.done)
    m.problem = nothing_turned(recording) if m.estimate is None else ""
    if m.problem:
        return
    try:
        fit, rival, samples = fit_kept(kept, recording, search)
    except MagycError as problem:  # axes that disagree, too little motion: said, and tried again with more data
        m.problem, m.head, m.estimate, m.stable = str(problem), None, None, False
        if later:
            begin_later(kept)
        return
    estimate = Estimate(fit.state.parameters, fit.covariance, fit.chain.noise, fit.colour, fit.noise_freedom)
    if settings.walks:  # what a walk leaves of them hangs together
        estimate = estimate._replace(colour=1.0)
    m.report = kept.result(recording, fit, rival, swept=estimate)
    if testable(kept, count):
        m.drift = drift_of(kept, recording, fit, m.report.converged)
        m.report = with_drift(m.report, m.drift)
    if later and not m.report.converged and m.drift is None and begin_later(kept):
        return
    if m.past is None and not observable(m.report):
        m.head, m.estimate, m.stable = None, None, False  # nothing to continue from
        return
    tail = max(SHORTEST_TAIL, len(kept.numbers(m.tail)) if m.undecided else 0)
    if (samples.length, samples.turn) != (buffer.length, buffer.turn):
        buffer.cut_windows(samples.length, samples.turn)
        m.done = int(buffer.numbers[len(samples.magnetometer_time) - 1])
    m.origin = np.append(fit.chain.windows.bias, fit.chain.windows.delay)
    numbers, chain = kept.numbers(), continued(fit)
    first = max(len(numbers) - tail, 2)
    m.head, m.tail = chain.condense(fit.state, fit.weights, first), int(numbers[first])
    m.estimate = estimate
    if settings.walks and count >= _LEAST_STABLE:
        _walk(kept)
        return
    was_stable, m.stable = m.stable, m.report.converged and count >= _LEAST_STABLE and _stood_still(kept)
    m.swept = np.array([m.estimate.parameters, np.sqrt(np.diag(m.estimate.covariance))])
    if settings.detect_changes and m.stable and not was_stable and len(numbers) <= _MOST_LOOKED_BACK:
        # Steps before the estimate was good enough to see them.
        step, _ = find_step(replace(fit, chain=chain), m.estimate.colour)
        if step is not None:
            restart(kept, numbers, step)


def fit_kept(kept: Kept, recording: Recording, search: bool) -> tuple[Fit, Fit | None, Preintegration]:
    """Fit all samples kept; from several starts or from the estimate."""
    m, settings = kept.memory, kept.settings
    if m.past is None:
        start = None if search or m.estimate is None else m.estimate.parameters
        return fit_whole(recording, start, settings.fit)
    parameters, noise = kept.last.parameters, kept.last.noise
    samples = kept.buffer.windows(int(kept.buffer.numbers[0]), m.done, kept.delay)
    fewer = len(samples.starts) < _NOISE_WINDOWS or settings.noise is not None
    short_term = None if fewer else short_term_noise(recording)
    windows = samples.integrate(parameters[BIAS], kept.delay)
    fit = begin(ContinuedChain(windows, short_term or noise, m.past), parameters, settings.free)
    return refit_field_chain(samples, fit, settings.reject, short_term), None, samples


def _walk(kept: Kept) -> None:
    """The same where parameters walk: everything is passed anew."""
    m = kept.memory
    walk_through(kept)
    fit = fit_walked(kept, m.done)
    m.estimate = kept.last._replace(parameters=fit.state.parameters, covariance=fit.covariance)
    m.report = kept.result(kept.recording(m.done, m.tail), fit, None, m.tail, kept.last)
    m.stable = m.report.converged and _stood_still(kept)
    m.swept = np.array([m.estimate.parameters, np.sqrt(np.diag(m.estimate.covariance))])


def _stood_still(kept: Kept) -> bool:
    """Whether no parameter moved by more than sigmas of the sweep before, and what it may walk."""
    m, estimate = kept.memory, kept.last
    if m.swept is None:
        return False
    factor = 2 if m.stable else 1  # convergence is not given up lightly
    variance = estimate.colour * m.swept[1] ** 2
    hours = (kept.buffer.magnetometer.time[-1] - kept.buffer.magnetometer.time[0]) / 3600
    for rows, walk in kept.settings.walks:
        variance[rows] += walk**2 * hours
    return bool((np.abs(estimate.parameters - m.swept[0]) <= factor * _STILL * np.sqrt(variance))[:DELAY].all())
