"""`smoother` online: the field chain of the batch method, its past eliminated as the mission goes on.

Windows are cut as the batch method cuts them. The chain falls into three parts:

    past   a summary (`online.summary`): the information of all windows that are given up;
    head   windows whose samples are still here; summarised, and now and then fitted afresh from the samples;
    tail   the last 24 to 56 windows; fitted anew, from the samples, for every six windows.

Until the estimate has converged and an hour is over there is no past: every 25 % more windows (a sweep) the whole
chain is fitted as the batch method does, noise levels and robust weights with it, and until it has converged every
50 % more the start is searched again, so that no early estimate decides a later one. Then the head joins the past,
linearised within a small part of a sigma, and the cost of an update depends no more on how long the mission is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.chain_fit import NEAR, Fit, adapt, begin, descend
from magyc_gtsam.estimators.chain_search import refit_field_chain, short_term_noise
from magyc_gtsam.estimators.smoother import calibration_of, check_options
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.field_chain import DELAY, PARAMETERS
from magyc_gtsam.factors.preintegration import Preintegration
from magyc_gtsam.online.buffers import SampleBuffer
from magyc_gtsam.online.coverage import coverage
from magyc_gtsam.online.memory import Estimate, Memory
from magyc_gtsam.online.retrospect import find_beginning
from magyc_gtsam.online.steps import Step, find_step
from magyc_gtsam.online.summary import BIAS, HARD_IRON, ContinuedChain
from magyc_gtsam.online.values import Change, Progress
from magyc_gtsam.online.whole import fit_whole, nothing_turned
from magyc_gtsam.recording import Array, Recording, Samples

_EVERY = 6  # windows between two fits of the tail
_SHORTEST_TAIL, _LONGEST_TAIL = 24, 56  # windows
_FIRST = 12  # windows before the first fit
_SWEEP, _SEARCH = 1.25, 1.5  # growth between two sweeps, and between two searches for the start
_STILL = 1.5  # sigma of the sweep before by which a parameter may have moved for convergence
_LEAST_STABLE = 80  # windows, below which the noise levels are too uncertain to look for steps
_LEAST_CONVERGED = 120  # windows of the last sweep, below which they are too uncertain for an honest covariance
_NOISE_WINDOWS = 60  # after a step, before the noise levels are estimated again
_MOST_SAMPLES = 131072  # kept of a sensor, whatever the horizon
_MOST_LOOKED_BACK = 400  # windows that are searched for steps when the estimate has converged
_LEAST_SETTLED = 400  # windows before a parameter is let walk


class OnlineSmoother:
    """The engine of `OnlineCalibrator(method="smoother")`.

    Args:
        field_strength, noise, robust, delay, window, turn: as `calibrate_smoother`.
        hard_iron_walk: T per √h, by which the hard iron walks at random; likewise gyro_bias_walk, rad/s per √h.
        detect_changes: look for steps in hard iron.
        angular_rate_is: as `Recording`.
        horizon: s of samples that are kept to be fitted afresh.
    """

    def __init__(
        self,
        *,
        field_strength: float | None = None,
        noise: tuple[float, float] | None = None,
        robust: bool | None = None,
        delay: float | None = None,
        window: float = 1.5,
        turn: float | None = None,
        hard_iron_walk: float = 0.0,
        gyro_bias_walk: float = 0.0,
        detect_changes: bool = True,
        angular_rate_is: Literal["instant", "interval-mean"] = "instant",
        horizon: float = 3600.0,
    ) -> None:
        check_options(noise, robust, delay, window, turn)
        if angular_rate_is not in ("instant", "interval-mean"):
            raise MagycError(f"angular_rate_is: {angular_rate_is!r} is neither 'instant' nor 'interval-mean'")
        for name, value, least in (
            ("hard_iron_walk", hard_iron_walk, 0.0),
            ("gyro_bias_walk", gyro_bias_walk, 0.0),
            ("horizon", horizon, 120.0),
        ):
            if isinstance(value, (bool, str)) or not least <= value < np.inf:
                raise MagycError(f"{name}: {value!r} is no number of {least:g} or more")
        self._fixed: dict[str, Any] = dict(noise=noise, robust=robust, delay=delay, window=window, turn=turn)
        self._field_strength, self._horizon = field_strength, horizon
        self._walk = ((HARD_IRON, hard_iron_walk), (BIAS, gyro_bias_walk))
        self._detect, self._rate_is = detect_changes, angular_rate_is
        self._free = np.ones(PARAMETERS, dtype=bool)
        self._free[DELAY] = delay is None
        self._buffer = SampleBuffer(window, turn or 0.4, angular_rate_is == "interval-mean")
        self._memory = Memory(next_sweep=_FIRST, next_search=_FIRST)
        self._read: Calibration | None = None
        self._fresh = False  # `_read` is the result of all samples

    # --- taking samples -------------------------------------------------------------------------------------------

    def update(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """See `Engine.update`."""
        self._fresh = False
        self._buffer.append(magnetometer, gyroscope)
        # What the motion has not determined yet has an infinite covariance, which is meant.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            while self._buffer.closed(self._delay) >= self._memory.done + _EVERY:
                self._memory.done += _EVERY
                self._advance()

    def _advance(self) -> None:
        """Six more windows."""
        m = self._memory
        if m.head is not None:
            self._follow()
        if not m.settled:
            count = len(self._kept())
            if count >= m.next_sweep:
                self._sweep(count)
            self._give_up()

    def _follow(self) -> None:
        """Fit the tail; look for a step; hand the tail's beginning to the head."""
        m, fit, estimate = self._memory, self._fit_tail(self._memory.done), self._last
        if self._detect and m.stable and (step := find_step(fit, estimate.colour)) is not None:
            self._restart(self._kept(m.tail), step)
            return
        m.estimate = estimate._replace(parameters=fit.state.parameters, covariance=fit.covariance)
        count = len(fit.chain.windows)
        if count > _LONGEST_TAIL:
            self._shorten(fit, count - _SHORTEST_TAIL)

    def _fit_tail(self, stop: int) -> Fit:
        """The tail at its minimum, given the head."""
        estimate = self._last
        samples = self._buffer.windows(self._memory.tail, stop, self._delay)
        windows = samples.integrate(estimate.parameters[BIAS], self._delay)
        chain = ContinuedChain(windows, estimate.noise, self._memory.head)
        fit = begin(chain, estimate.parameters, self._free)
        return adapt(descend(fit, NEAR), self._reject, None)

    def _shorten(self, fit: Fit, first: int) -> None:
        """The tail begins at its window `first`."""
        m, chain = self._memory, _continued(fit)
        m.head = chain.condense(fit.state, fit.weights, first)
        m.tail = int(self._kept(m.tail)[first])
        if m.settled:
            elapsed = float(chain.windows.time[first] - chain.windows.time[0])
            for rows, walk in self._walk:
                m.head = m.head.widen(rows, walk * np.sqrt(elapsed / 3600))
            self._close()

    def _sweep(self, count: int) -> None:
        """Fit everything that is kept afresh; then head and tail anew."""
        m, buffer = self._memory, self._buffer
        search = m.past is None and (m.estimate is None or (not m.stable and count >= m.next_search))
        m.next_sweep = max(int((_SEARCH if m.estimate is None else _SWEEP) * count), count + 8)
        if search:
            m.next_search = int(_SEARCH * count)
        recording = self._recording(m.done)
        m.problem = nothing_turned(recording) if m.estimate is None else ""
        if m.problem:
            return
        try:
            fit, rival, samples = self._fit_kept(recording, search)
        except (
            MagycError
        ) as problem:  # axes that disagree, too little motion: said, and tried again with more data
            m.problem, m.head, m.estimate, m.stable = str(problem), None, None, False
            self._begin_later(search)
            return
        m.report = self._result(recording, fit, rival, None)
        if not m.report.converged and self._begin_later(search):
            return
        if m.past is None and not _observable(m.report):
            m.head, m.estimate, m.stable = None, None, False  # nothing to continue from
            return
        if (samples.length, samples.turn) != (buffer.length, buffer.turn):
            buffer.cut_windows(samples.length, samples.turn)
            m.done = int(buffer.numbers[len(samples.magnetometer_time) - 1])
        numbers, chain = self._kept(), _continued(fit)
        first = max(len(numbers) - _SHORTEST_TAIL, 2)
        m.head, m.tail = chain.condense(fit.state, fit.weights, first), int(numbers[first])
        m.estimate = Estimate(fit.state.parameters, fit.covariance, fit.chain.noise, fit.colour, fit.noise_freedom)
        was_stable, m.stable = m.stable, m.report.converged and count >= _LEAST_STABLE and self._stood_still()
        m.swept = np.array([m.estimate.parameters, np.sqrt(np.diag(m.estimate.covariance))])
        if self._detect and m.stable and not was_stable and len(numbers) <= _MOST_LOOKED_BACK:
            # Steps before the estimate was good enough to see them.
            step = find_step(replace(fit, chain=chain), m.estimate.colour)
            if step is not None:
                self._restart(numbers, step)

    def _begin_later(self, search: bool) -> bool:
        """Begin afresh where the hard iron changed, if the log does not fit as a whole but its second half does."""
        kept = self._kept()
        if not (search and self._detect) or not _LEAST_STABLE <= len(kept) <= _MOST_LOOKED_BACK:
            return False
        middle, done, fixed = int(kept[len(kept) // 2]), self._memory.done, self._fixed
        recording = self._recording(done, middle)
        try:
            fit, rival, _ = fit_whole(recording, None, fixed)
            now = self._result(recording, fit, rival, None)
            parameters = fit.state.parameters
            windows = self._buffer.windows(int(kept[0]), done, parameters[DELAY])
            chain = ContinuedChain(windows.integrate(parameters[BIAS], parameters[DELAY]), fit.chain.noise)
            found = find_beginning(chain, parameters) if now.converged else None
        except MagycError:
            return False  # nor does the half; more data will tell
        if found is None:
            return False
        sigma = np.hypot(found.sigma, now.sigma["hard_iron"])
        before = replace(
            now,
            hard_iron=now.hard_iron - found.step,
            converged=False,
            message="the soft iron and the bias since the step, and the hard iron that the field before it suggests",
        )
        self._memory.changes.append(Change(found.time, found.time_sigma, found.step, sigma, before, None))
        self._begin_at(int(kept[found.window]))
        return True

    def _fit_kept(self, recording: Recording, search: bool) -> tuple[Fit, Fit | None, Preintegration]:
        """Fit all samples kept; from several starts or from the estimate."""
        m, fixed = self._memory, self._fixed
        if m.past is None:
            start = None if search or m.estimate is None else m.estimate.parameters
            return fit_whole(recording, start, fixed)
        parameters, noise = self._last.parameters, self._last.noise
        samples = self._buffer.windows(int(self._buffer.numbers[0]), m.done, self._delay)
        fewer = len(samples.starts) < _NOISE_WINDOWS or fixed["noise"] is not None
        short_term = None if fewer else short_term_noise(recording)
        windows = samples.integrate(parameters[BIAS], self._delay)
        fit = begin(ContinuedChain(windows, short_term or noise, m.past), parameters, self._free)
        return refit_field_chain(samples, fit, self._reject, short_term), None, samples

    def _stood_still(self) -> bool:
        """Whether no parameter moved by more than sigmas of the sweep before."""
        m, estimate = self._memory, self._last
        if m.swept is None:
            return False
        limit = _STILL * (2 if m.stable else 1) * np.sqrt(estimate.colour)  # convergence is not given up lightly
        return bool((np.abs(estimate.parameters - m.swept[0]) <= limit * m.swept[1])[:DELAY].all())

    def _give_up(self) -> None:
        """Bound what is kept: to the past, once the estimate has converged; else the oldest quarter goes."""
        m, mag, gyro = self._memory, self._buffer.magnetometer.time, self._buffer.gyroscope.time
        full = gyro[-1] - gyro[0] > self._horizon or max(len(mag), len(gyro)) > _MOST_SAMPLES
        walks = any(walk for _, walk in self._walk) and len(self._kept()) >= _LEAST_SETTLED
        if m.stable and (full or walks):
            m.settled = True
            self._close()
        elif full:
            kept = self._kept()
            self._begin_at(int(kept[len(kept) // 4]))

    def _close(self) -> None:
        """The head joins the past."""
        m = self._memory
        m.given_up += int(np.searchsorted(self._kept(), m.tail))
        m.past = m.head
        self._buffer.keep_from(m.tail, self._delay)

    def _begin_at(self, number: int) -> None:
        """As if the log began with this window."""
        m, buffer = self._memory, self._buffer
        m.given_up += int(np.searchsorted(self._kept(), number))
        last = buffer.magnetometer.time[int(np.searchsorted(buffer.numbers, m.done)) - 1]
        buffer.begin_at(number, self._fixed["window"])
        m.done = int(buffer.numbers[np.searchsorted(buffer.magnetometer.time, last)])
        m.past = m.head = m.estimate = m.swept = m.report = None
        m.next_sweep = m.next_search = _FIRST
        m.stable = m.settled = False

    def _restart(self, numbers: Array, step: Step) -> None:
        """The hard iron is another one since `step` in the windows `numbers`."""
        m = self._memory
        before = self._result(self._recording(int(numbers[step.window])), step.before, None, self._last)
        known = _observable(before)
        # Where nothing was known before, the step is known no better than the hard iron was.
        sigma = step.sigma if known else np.hypot(step.sigma, before.sigma["hard_iron"])
        m.changes.append(Change(step.time, step.time_sigma, step.value, sigma, before, None))
        if not known:
            self._begin_at(int(numbers[step.window]))
            return
        m.head, m.tail = step.past, int(numbers[step.window - 1])
        self._close()
        after = step.after
        m.estimate = self._last._replace(parameters=after.state.parameters, covariance=after.covariance)
        m.swept, m.stable, m.settled, m.next_sweep = None, False, False, _FIRST

    # --- saying how it is -----------------------------------------------------------------------------------------

    def calibration(self) -> Calibration | None:
        """See `Engine.calibration`. Until the first hour is over this is a fit of all samples so far."""
        if not self._fresh:
            self._read, self._fresh = self._calibration(), True
        return self._read

    def _calibration(self) -> Calibration | None:
        m = self._memory
        if m.head is None:
            return m.report
        recording = self._recording(None)
        if m.past is None:
            fit, rival, _ = self._fit_kept(recording, False)
            return self._result(recording, fit, rival, None)
        fit = self._fit_tail(self._buffer.closed(self._delay))
        return self._result(recording, fit, None, self._last)

    def _result(self, recording: Recording, fit: Fit, rival: Fit | None, swept: Estimate | None) -> Calibration:
        """Of a fit of all windows, or of the end of what was `swept`, from which its noise levels are."""
        colour = None if swept is None else swept.colour
        if swept is not None:
            fit = replace(fit, noise_freedom=swept.noise_freedom)
        configuration = {name: value for name, value in self._fixed.items() if value is not None}
        result = calibration_of(recording, fit, rival, self._field_strength, configuration, colour)
        windows = self._memory.given_up + len(fit.chain.windows)
        return replace(result, diagnostics={**result.diagnostics, "windows": windows})

    def converged(self) -> bool:
        """See `Engine.converged`."""
        swept_enough = self._memory.next_sweep >= int(_SWEEP * _LEAST_CONVERGED)
        return self._memory.stable and swept_enough

    def progress(self) -> Progress:
        """See `Engine.progress`."""
        m, calibration = self._memory, self.calibration()
        windows = m.given_up + len(self._kept())
        seen = 0.0 if calibration is None else coverage(calibration, self._buffer.magnetometer.value)
        weak = calibration.observability.weak if calibration and calibration.observability else ()
        if m.problem:
            sentence = m.problem
        elif calibration is None:
            sentence = f"collecting: {windows} of {_FIRST} windows"
        elif not calibration.converged:
            sentence = calibration.message
        else:
            sentence = "converged" if self.converged() else "the estimate still moves: go on turning"
        return Progress(None, 0.0, windows, self.converged(), sentence, weak, seen)

    def changes(self) -> tuple[Change, ...]:
        """See `Engine.changes`."""
        found = self._memory.changes
        if not found:
            return ()
        after = [change.before for change in found[1:]] + [self.calibration()]
        return tuple(replace(change, after=now) for change, now in zip(found, after, strict=True))

    # --- state ----------------------------------------------------------------------------------------------------

    def state(self) -> Mapping[str, Array]:
        """See `Engine.state`."""
        buffer = {f"buffer/{name}": value for name, value in self._buffer.state().items()}
        return buffer | {f"memory/{name}": value for name, value in self._memory.to_arrays().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """See `Engine.restore`."""
        self._buffer.restore({k.removeprefix("buffer/"): v for k, v in state.items() if k.startswith("buffer/")})
        self._memory = Memory.from_arrays(
            {k.removeprefix("memory/"): v for k, v in state.items() if k.startswith("memory/")}
        )

    # --- helpers --------------------------------------------------------------------------------------------------

    @property
    def _reject(self) -> bool:
        return self._fixed["robust"] is not False

    @property
    def _last(self) -> Estimate:
        assert self._memory.estimate is not None
        return self._memory.estimate

    @property
    def _delay(self) -> float:
        estimate = self._memory.estimate
        return float(self._fixed["delay"] or 0.0) if estimate is None else float(estimate.parameters[DELAY])

    def _kept(self, first: int = 0) -> Array:
        """Numbers, ascending, of the windows kept and taken, from `first` on."""
        numbers = self._buffer.numbers
        return np.unique(numbers[slice(*np.searchsorted(numbers, [first, self._memory.done]))])

    def _recording(self, stop: int | None, first: int | None = None) -> Recording:
        magnetometer, gyroscope = self._buffer.between(first, stop, self._delay)
        return Recording.from_streams(magnetometer, gyroscope, angular_rate_is=self._rate_is)


def _continued(fit: Fit) -> ContinuedChain:
    chain = fit.chain
    return chain if isinstance(chain, ContinuedChain) else ContinuedChain(chain.windows, chain.noise)


def _observable(calibration: Calibration) -> bool:
    return calibration.observability is not None and calibration.observability.observable
