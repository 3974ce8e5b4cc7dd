"""`smoother` online: the field chain of the batch method, its past eliminated as the mission goes on.

Windows are cut as the batch method cuts them. The chain falls into three parts:

    past   a marginal (`online.marginal`): the information of all windows that are given up;
    head   windows whose samples are still here; marginalised, and now and then fitted afresh from the samples;
    tail   the last 24 to 56 windows; fitted anew, from the samples, for every six windows.

Until the estimate has converged and an hour is over there is no past: every 25 % more windows (`online.refit`) the
whole chain is fitted as the batch method does, noise levels and robust weights with it, and until it has converged
every 50 % more the start is searched again, so that no early estimate decides a later one. Then the head joins the
past, linearised within a small part of a sigma, and the cost of an update depends no more on how long the mission is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.smoother.fit import Fit
from magyc_gtsam.online.buffers import IntegratedWindows
from magyc_gtsam.online.change_point import SMALLEST, find_step
from magyc_gtsam.online.engine import Change, Progress
from magyc_gtsam.online.options import OnlineOptions
from magyc_gtsam.online.random_walk import advance_filter
from magyc_gtsam.online.refit import SHORTEST_TAIL, on_one_clock, refit, restart
from magyc_gtsam.online.report import changes_until, current_calibration, has_converged, progress_of
from magyc_gtsam.online.state import Belief, SmootherState, continued
from magyc_gtsam.recording import Array, Samples

_EVERY = 6  # windows between two fits of the tail
_LONGEST_TAIL, _LONGEST_UNDECIDED = 56, 168  # windows
_MOST_SAMPLES = 131072  # kept of a sensor, whatever the horizon
_NO_WALK = 6.0  # sigmas of a walk that are taken to be a step
_MOST_WALKED = 400  # windows kept, where parameters walk


class OnlineSmoother:
    """The engine of `OnlineCalibrator(method="smoother")`.

    Args:
        field_strength, noise, robust, delay, window, turn: as `calibrate_smoother`.
        clock_drift: as there, from the first sample of the magnetometer on.
        hard_iron_walk: T per √h, by which the hard iron walks at random; likewise gyro_bias_walk, rad/s per √h.
        detect_changes: look for steps in hard iron.
        angular_rate_is: as `Recording`.
        horizon: s of samples that are kept to be fitted afresh.
        prior: an earlier calibration of the same instrument, with covariance (or what its `to_dict` gives); it holds
            until a step in hard iron is found.
        prior_walk: T, by which each axis of the hard iron may have changed since.
        field: (strength T, dip rad) at the place, as there; the dip says nothing here, where nothing says which way is
            up.
        misalignment: as there; asked at every refit, and whenever something is read.
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
        clock_drift: float = 0.0,
        hard_iron_walk: float = 0.0,
        gyro_bias_walk: float = 0.0,
        detect_changes: bool = True,
        angular_rate_is: Literal["instant", "interval-mean"] = "instant",
        horizon: float = 3600.0,
        prior: Calibration | Mapping[str, Any] | None = None,
        prior_walk: float = 0.0,
        misalignment: float | Literal["auto"] = "auto",
        field: Any = None,
    ) -> None:
        self._online = SmootherState(
            OnlineOptions(
                field_strength=field_strength,
                noise=noise,
                robust=robust,
                delay=delay,
                window=window,
                turn=turn,
                clock_drift=clock_drift,
                hard_iron_walk=hard_iron_walk,
                gyro_bias_walk=gyro_bias_walk,
                detect_changes=detect_changes,
                angular_rate_is=angular_rate_is,
                horizon=horizon,
                prior=prior,
                prior_walk=prior_walk,
                misalignment=misalignment,
                field=field,
            )
        )
        self._integrated = IntegratedWindows()
        self._read: Calibration | None = None
        self._fresh = False  # `_read` is the result of all samples

    def update(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """See `Engine.update`."""
        online, m = self._online, self._online.belief
        self._fresh = False
        online.buffer.append(on_one_clock(online, magnetometer), gyroscope)
        # What the motion has not determined yet has an infinite covariance, which is meant.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            while online.buffer.closed(online.delay) >= m.done + _EVERY:
                m.done += _EVERY
                self._advance()

    def _advance(self) -> None:
        """Six more windows."""
        m = self._online.belief
        if m.head is not None:
            self._follow()
        if not m.settled:
            if len(self._online.numbers()) >= m.next_refit:
                refit(self._online)
            self._give_up()

    def _follow(self) -> None:
        """Fit the tail; look for a step; hand the tail's beginning to the head."""
        online, m, estimate = self._online, self._online.belief, self._online.last
        fit = online.fit_tail(m.done)
        if online.settings.detect_changes and m.stable:
            step, m.undecided = find_step(fit, estimate.colour, self._smallest_step(fit))
            if step is not None:
                restart(online, online.numbers(m.tail), step)
                return
        if m.front is None:
            m.estimate = estimate._replace(parameters=fit.state.parameters, covariance=fit.covariance)
        else:
            advance_filter(online)
        count = len(fit.chain.windows)
        # What is undecided stays in the tail until it is known.
        if count > (_LONGEST_UNDECIDED if m.undecided else _LONGEST_TAIL):
            self._shorten(fit, count - SHORTEST_TAIL)

    def _smallest_step(self, fit: Fit) -> float:
        """T, beyond what the hard iron may walk within the tail."""
        elapsed = float(fit.chain.windows.time[-1] - fit.chain.windows.time[0])
        return max(SMALLEST, _NO_WALK * self._online.settings.hard_iron_walk * np.sqrt(elapsed / 3600))

    def _shorten(self, fit: Fit, first: int) -> None:
        """The tail begins with its window `first`; the head takes those before."""
        online, m, chain = self._online, self._online.belief, continued(fit)
        m.head = chain.marginalise(fit.state, fit.weights, first)
        m.tail = int(online.numbers(m.tail)[first])
        if m.front is not None:
            elapsed = float(chain.windows.time[first] - chain.windows.time[0])
            for rows, walk in online.settings.walks:
                m.head = m.head.widen(rows, walk * np.sqrt(elapsed / 3600))
        if m.settled:
            online.close()

    def _give_up(self) -> None:
        """Bound what is kept: to the past, once the estimate has converged; else the oldest quarter goes."""
        online, m = self._online, self._online.belief
        mag, gyro = online.buffer.magnetometer.time, online.buffer.gyroscope.time
        full = gyro[-1] - gyro[0] > online.settings.horizon or max(len(mag), len(gyro)) > _MOST_SAMPLES
        walked = m.front is not None and len(online.numbers()) >= _MOST_WALKED
        if m.stable and (full or walked):
            m.settled = True
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
        return has_converged(self._online)

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
