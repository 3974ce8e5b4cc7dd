"""The online smoother: the field chain of the batch method, with its past marginalised as the mission proceeds.

Windows are cut as the batch method cuts them. The chain falls into three parts:

    past   a marginal (`estimators.smoother.marginal`) of all windows whose samples were dropped;
    head   windows whose samples are kept; marginalised, and refitted from the samples from time to time;
    tail   the last 24 to 56 windows; fitted from the samples after every six windows.

Until the estimate has converged and an hour has passed there is no past. After every 25 % more windows (`online.refit`)
the whole chain is fitted as by the batch method, including noise levels and robust weights. Until it has converged, it
is also fitted without the estimate as a start after every 50 % more windows, so that a poor early estimate does not
persist. Then the head joins the past, linearised within a small part of a sigma, and an update takes constant time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.model_error.component import Component
from magyc_gtsam.estimators.model_error.recent_change import recent_change
from magyc_gtsam.estimators.smoother.clock_drift import drift_is_significant, with_drift
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.estimators.smoother.marginal import continued
from magyc_gtsam.estimators.smoother.smoother import prior_contradictions
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.online.buffers import IntegratedWindows
from magyc_gtsam.online.change_point import LARGE, SMALLEST, find_step
from magyc_gtsam.online.engine import Change, Progress
from magyc_gtsam.online.random_walk import advance_filter, fit_random_walk
from magyc_gtsam.online.refit import REFIT_GROWTH, SHORTEST_TAIL, fit_samples, refit, refit_from_windows
from magyc_gtsam.online.report import drift_of, report_of, testable, with_doubt
from magyc_gtsam.online.restart import restart, restart_after_change
from magyc_gtsam.online.state import FIRST, LEAST_RESTARTED, Belief, OnlineOptions, SmootherState
from magyc_gtsam.recording import Array, Samples

_EVERY = 6  # windows between two fits of the tail
_LONGEST_TAIL, _LONGEST_UNDECIDED = 56, 168  # windows
_REJECTED, _MISFIT = 0.5, 0.5  # weight below which a window does not fit; share of the tail that does not
_RETRY = 1.5  # growth of the windows that do not fit between two restarts
_MOST_SAMPLES = 131072  # largest number of samples kept per sensor, for any horizon
_NO_WALK = 6.0  # sigmas of a random walk beyond which a change counts as a step
_MOST_WALKED = 400  # largest number of windows kept if parameters walk at random
_MOST_REFITTED = (
    2400  # largest number of windows fitted at reading; longer logs keep the last refit's noise levels
)
_LEAST_CONVERGED = 120  # fewest windows of the last refit; noise levels from fewer give no reliable covariance
_UNDECIDED = (
    f"the hard iron may have changed by more than {LARGE:.0%} of the field in the last seconds: "
    "keep turning until that is decided"
)


class OnlineSmoother:
    """The engine of `OnlineCalibrator(method="smoother")`; `chosen` are `OnlineOptions`."""

    options = OnlineOptions.names()

    def __init__(self, **chosen: Any) -> None:
        self._online = SmootherState(OnlineOptions(**chosen))
        self._integrated = IntegratedWindows()
        self._read: Calibration | None = None
        self._fresh = False  # whether `_read` is the result of all samples

    def update(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """See `Engine.update`."""
        online, belief = self._online, self._online.belief
        self._fresh = False
        online.append(magnetometer, gyroscope)
        # Parameters that the motion has not determined yet have an infinite covariance on purpose.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            while online.buffer.closed(online.delay) >= belief.done + _EVERY:
                belief.done += _EVERY
                self._advance()

    def _advance(self) -> None:
        """Take six more windows."""
        belief = self._online.belief
        if belief.head is not None:
            self._follow()
        if self._restarted():
            return
        if not belief.settled:
            # A fit of all windows has a single hard iron, so it waits until a possible large step is decided.
            if len(self._online.numbers()) >= belief.next_refit and not belief.waiting:
                refit(self._online)
            self._give_up()

    def _follow(self) -> None:
        """Fit the tail, look for a step, and move the beginning of a long tail to the head."""
        online, belief, estimate = self._online, self._online.belief, self._online.last
        fit = online.fit_tail(belief.done)
        if online.settings.detect_changes and belief.stable:
            step, belief.undecided, belief.waiting = find_step(fit, estimate.colour, self._smallest_step(fit))
            if step is not None:
                restart(online, fit, step, online.numbers(belief.tail))
                return
        self._note_misfit(fit)
        if belief.front is None:
            belief.estimate = estimate._replace(parameters=fit.state.parameters, covariance=fit.covariance)
        else:
            advance_filter(online)
        count = len(fit.chain.windows)
        # A possible step stays in the tail until it is confirmed or dismissed.
        if count > (_LONGEST_UNDECIDED if belief.undecided else _LONGEST_TAIL):
            belief.undecided = belief.waiting = False
            self._shorten(fit, count - SHORTEST_TAIL)

    def _note_misfit(self, fit: Fit) -> None:
        """Note since which window most of the tail do not fit, as after a sensor was replaced."""
        belief = self._online.belief
        rejected = fit.weights.window < _REJECTED
        rejected[1:] |= fit.weights.link < _REJECTED
        if rejected.mean() < _MISFIT:
            belief.misfit_from, belief.next_restart = None, LEAST_RESTARTED
        elif belief.misfit_from is None:
            belief.misfit_from = int(self._online.numbers(belief.tail)[np.argmax(rejected)])

    def _restarted(self) -> bool:
        """Restart if the windows since most do not fit are many, and fit by themselves; return whether it restarted."""
        online, belief = self._online, self._online.belief
        if belief.misfit_from is None or belief.front is not None or not online.settings.detect_changes:
            return False
        count = len(online.numbers(belief.misfit_from))
        if count < belief.next_restart:
            return False
        belief.next_restart = int(_RETRY * count)
        return restart_after_change(online, belief.misfit_from)

    def _smallest_step(self, fit: Fit) -> float:
        """Return the smallest step, T, that exceeds the random walk of the hard iron within the tail."""
        elapsed = float(fit.chain.windows.time[-1] - fit.chain.windows.time[0])
        return max(SMALLEST, _NO_WALK * self._online.settings.hard_iron_drift * np.sqrt(elapsed / 3600))

    def _shorten(self, fit: Fit, first: int) -> None:
        """Let the tail begin with its window `first`, and the head take those before."""
        online, belief, chain = self._online, self._online.belief, continued(fit)
        belief.head = chain.marginalise(fit.state, fit.weights, first)
        belief.tail = int(online.numbers(belief.tail)[first])
        if belief.front is not None:
            elapsed = float(chain.windows.time[first] - chain.windows.time[0])
            for rows, walk in online.settings.walks:
                belief.head = belief.head.widen(rows, walk * np.sqrt(elapsed / 3600))
        if belief.settled and (belief.misfit_from is None or self._is_full):
            online.close()

    @property
    def _is_full(self) -> bool:
        """Whether as many samples are kept as may be."""
        online = self._online
        mag, gyro = online.buffer.magnetometer.time, online.buffer.gyroscope.time
        return bool(gyro[-1] - gyro[0] > online.settings.horizon or max(len(mag), len(gyro)) > _MOST_SAMPLES)

    def _give_up(self) -> None:
        """Limit the samples kept: move the head to the past once converged, otherwise drop the oldest quarter."""
        online, belief = self._online, self._online.belief
        walked = belief.front is not None and len(online.numbers()) >= _MOST_WALKED
        if belief.stable and (self._is_full or walked):
            belief.settled = True
            online.close()
        elif self._is_full:
            numbers = online.numbers()
            online.begin_at(int(numbers[len(numbers) // 4]))

    def calibration(self) -> Calibration | None:
        """See `Engine.calibration`.

        It is that of all samples so far, or in a long log that of the tail given all windows before. While a large step
        is possible but not decided, it would mix the hard irons before and after it and is not trusted.
        """
        if not self._fresh:
            found = self._of_samples_so_far()
            if found is not None and found.converged and self._online.belief.waiting:
                found = replace(found, converged=False, message=_UNDECIDED)
            self._read, self._fresh = found, True
        return self._read

    def _of_samples_so_far(self) -> Calibration | None:
        online, belief = self._online, self._online.belief
        if belief.head is None:
            return self._undetermined()
        ending = online.recording(None, belief.tail)
        if belief.past is None and belief.front is None and len(online.numbers()) <= _MOST_REFITTED:
            recording, fit = ending, refit_from_windows(online, self._integrated)
            if fit is None:
                recording = online.recording(None)
                fit, _ = fit_samples(online, recording, False)
            doubts = []
            if online.prior_applies:
                doubts = prior_contradictions(online.recording(None), online.fit_options, fit)
            calibration = report_of(online, recording, fit, change=self._recent_change(fit), doubts=doubts)
            # The clock drift of the last refit, or of all windows if that found none.
            drift = belief.drift
            if drift is None and testable(online, len(fit.chain.windows)) and drift_is_significant(fit):
                drift = drift_of(online, online.recording(None), fit, calibration.converged)
            return with_drift(calibration, drift)
        stop = int(online.buffer.numbers[-1]) + 1
        fit = online.fit_tail(stop) if belief.front is None else fit_random_walk(online, stop)
        change = self._recent_change(fit, online.last.colour)
        calibration = report_of(online, ending, fit, belief.tail, online.last, change, belief.contradictions)
        return with_doubt(with_drift(calibration, belief.drift), fit)

    def _undetermined(self) -> Calibration | None:
        """Return the calibration of all samples so far where the last refit found too little motion to go on from.

        The next refit may be due long after the motion has become enough.
        """
        online, belief = self._online, self._online.belief
        if belief.report is None or belief.past is not None or len(online.numbers()) > _MOST_REFITTED:
            return belief.report
        recording = online.recording(None)
        try:
            fit, _ = fit_samples(online, recording, True)
            doubts = prior_contradictions(recording, online.fit_options, fit)
        except MagycError:  # the sensors' axes disagree, which the next refit tells
            return belief.report
        return with_drift(report_of(online, recording, fit, doubts=doubts), belief.drift)

    def _recent_change(self, fit: Fit, colour: float | None = None) -> Component | None:
        """Return the error by a recent change of the iron; None if it is not looked for, or walks at random."""
        settings = self._online.settings
        return recent_change(fit, colour) if settings.detect_changes and not settings.walks else None

    def converged(self) -> bool:
        """See `Engine.converged`: the last refit had enough windows and changed the estimate little."""
        belief = self._online.belief
        return belief.stable and belief.next_refit >= int(REFIT_GROWTH * _LEAST_CONVERGED) and not belief.waiting

    def progress(self) -> Progress:
        """See `Engine.progress`."""
        online, belief, calibration = self._online, self._online.belief, self.calibration()
        windows = belief.given_up + len(online.numbers())
        weak = calibration.observability.weak if calibration and calibration.observability else ()
        converged = self.converged() and calibration is not None and calibration.trusted
        if belief.problem:
            sentence = belief.problem
        elif calibration is None:
            sentence = f"collecting: {windows} of {FIRST} windows"
        elif not calibration.converged:
            sentence = calibration.message
        elif not converged:
            sentence = f"the estimate still changes: {weak[0].sentence if weak else 'keep turning'}"
        else:
            sentence = "converged"
        return Progress(None, 0.0, windows, converged, sentence, weak, disagree=belief.disagree)

    def field(self) -> Array:
        """See `Engine.field`."""
        return self._online.buffer.magnetometer.value

    def changes(self) -> tuple[Change, ...]:
        """See `Engine.changes`; each step has the calibration that followed it."""
        changes = self._online.belief.changes
        if not changes:
            return ()
        after = [*(change.before for change in changes[1:]), self.calibration()]
        return tuple(replace(change, after=now) for change, now in zip(changes, after, strict=True))

    def state(self) -> Mapping[str, Array]:
        """See `Engine.state`."""
        buffer = {f"buffer/{name}": value for name, value in self._online.buffer.state().items()}
        return buffer | {"belief": np.array(self._online.belief.to_json())}

    def restore(self, state: Mapping[str, Array]) -> None:
        """See `Engine.restore`."""
        online = self._online
        online.buffer.restore({k.removeprefix("buffer/"): v for k, v in state.items() if k.startswith("buffer/")})
        online.belief = Belief.from_json(str(state["belief"]))
