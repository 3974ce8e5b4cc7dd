"""The online smoother: the field chain of the batch method, with its past marginalised as the mission proceeds.

Windows are cut as the batch method cuts them. The chain falls into three parts:

    past   a marginal (`online.marginal`) of all windows whose samples were dropped;
    head   windows whose samples are kept; marginalised, and refitted from the samples from time to time;
    tail   the last 24 to 56 windows; fitted from the samples after every six windows.

Until the estimate has converged and an hour has passed there is no past. After every 25 % more windows (`online.refit`)
the whole chain is fitted as by the batch method, including noise levels and robust weights. Until it has converged, it
is also fitted without the estimate as a start after every 50 % more windows, so that a poor early estimate does not
persist. Then the head joins the past, linearised within a small part of a sigma, and an update takes constant time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.online.belief import Belief
from magyc_gtsam.online.buffers import IntegratedWindows
from magyc_gtsam.online.change_point import SMALLEST, find_step
from magyc_gtsam.online.engine import Change, Progress
from magyc_gtsam.online.random_walk import advance_filter
from magyc_gtsam.online.refit import SHORTEST_TAIL, on_one_clock, refit
from magyc_gtsam.online.report import changes_until, current_calibration, has_converged, progress_of
from magyc_gtsam.online.restart import restart
from magyc_gtsam.online.state import OnlineOptions, SmootherState, continued
from magyc_gtsam.recording import Array, Samples

_EVERY = 6  # windows between two fits of the tail
_LONGEST_TAIL, _LONGEST_UNDECIDED = 56, 168  # windows
_MOST_SAMPLES = 131072  # largest number of samples kept per sensor, for any horizon
_NO_WALK = 6.0  # sigmas of a random walk beyond which a change counts as a step
_MOST_WALKED = 400  # largest number of windows kept if parameters walk at random


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
        online.buffer.append(on_one_clock(online, magnetometer), gyroscope)
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
                restart(online, online.numbers(belief.tail), step)
                return
        if belief.front is None:
            belief.estimate = estimate._replace(parameters=fit.state.parameters, covariance=fit.covariance)
        else:
            advance_filter(online)
        count = len(fit.chain.windows)
        # A possible step stays in the tail until it is confirmed or dismissed.
        if count > (_LONGEST_UNDECIDED if belief.undecided else _LONGEST_TAIL):
            belief.undecided = belief.waiting = False
            self._shorten(fit, count - SHORTEST_TAIL)

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
        if belief.settled:
            online.close()

    def _give_up(self) -> None:
        """Limit the samples kept: move the head to the past once converged, otherwise drop the oldest quarter."""
        online, belief = self._online, self._online.belief
        mag, gyro = online.buffer.magnetometer.time, online.buffer.gyroscope.time
        full = gyro[-1] - gyro[0] > online.settings.horizon or max(len(mag), len(gyro)) > _MOST_SAMPLES
        walked = belief.front is not None and len(online.numbers()) >= _MOST_WALKED
        if belief.stable and (full or walked):
            belief.settled = True
            online.close()
        elif full:
            numbers = online.numbers()
            online.begin_at(int(numbers[len(numbers) // 4]))

    def calibration(self) -> Calibration | None:
        """See `Engine.calibration`."""
        if not self._fresh:
            self._read, self._fresh = current_calibration(self._online, self._integrated), True
        return self._read

    def converged(self) -> bool:
        """See `Engine.converged`."""
        return has_converged(self._online) and not self._online.belief.waiting

    def progress(self) -> Progress:
        """See `Engine.progress`."""
        return progress_of(self._online, self.calibration())

    def field(self) -> Array:
        """See `Engine.field`."""
        return self._online.buffer.magnetometer.value

    def changes(self) -> tuple[Change, ...]:
        """See `Engine.changes`."""
        return changes_until(self._online, self.calibration()) if self._online.belief.changes else ()

    def state(self) -> Mapping[str, Array]:
        """See `Engine.state`."""
        buffer = {f"buffer/{name}": value for name, value in self._online.buffer.state().items()}
        return buffer | {f"belief/{name}": value for name, value in self._online.belief.to_arrays().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """See `Engine.restore`."""
        online = self._online
        online.buffer.restore({k.removeprefix("buffer/"): v for k, v in state.items() if k.startswith("buffer/")})
        online.belief = Belief.from_arrays(
            {k.removeprefix("belief/"): v for k, v in state.items() if k.startswith("belief/")}
        )
