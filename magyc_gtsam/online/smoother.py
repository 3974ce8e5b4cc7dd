"""`smoother` online: the field chain of the batch method, its past eliminated as the mission goes on.

Windows are cut as the batch method cuts them. The chain falls into three parts:

    past   a summary (`online.summary`): the information of all windows that are given up;
    head   windows whose samples are still here; summarised, and now and then fitted afresh from the samples;
    tail   the last 24 to 56 windows; fitted anew, from the samples, for every six windows.

Until the estimate has converged and an hour is over there is no past: every 25 % more windows (`online.sweep`) the
whole chain is fitted as the batch method does, noise levels and robust weights with it, and until it has converged
every 50 % more the start is searched again, so that no early estimate decides a later one. Then the head joins the
past, linearised within a small part of a sigma, and the cost of an update depends no more on how long the mission is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.estimators.chain_fit import Fit
from magyc_gtsam.online.clocks import on_one_clock
from magyc_gtsam.online.compressed import CompressedWindows
from magyc_gtsam.online.kept import Kept, continued
from magyc_gtsam.online.memory import Memory
from magyc_gtsam.online.reading import changes_until, current_calibration, has_converged, progress_of
from magyc_gtsam.online.restart import restart
from magyc_gtsam.online.settings import Settings
from magyc_gtsam.online.steps import SMALLEST, find_step
from magyc_gtsam.online.sweep import SHORTEST_TAIL, sweep
from magyc_gtsam.online.values import Change, Progress
from magyc_gtsam.online.walking import move_front
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
    ) -> None:
        self._kept = Kept(
            Settings(
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
            )
        )
        self._compressed = CompressedWindows()
        self._read: Calibration | None = None
        self._fresh = False  # `_read` is the result of all samples

    def update(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """See `Engine.update`."""
        kept, m = self._kept, self._kept.memory
        self._fresh = False
        kept.buffer.append(on_one_clock(kept, magnetometer), gyroscope)
        # What the motion has not determined yet has an infinite covariance, which is meant.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            while kept.buffer.closed(kept.delay) >= m.done + _EVERY:
                m.done += _EVERY
                self._advance()

    def _advance(self) -> None:
        """Six more windows."""
        m = self._kept.memory
        if m.head is not None:
            self._follow()
        if not m.settled:
            if len(self._kept.numbers()) >= m.next_sweep:
                sweep(self._kept)
            self._give_up()

    def _follow(self) -> None:
        """Fit the tail; look for a step; hand the tail's beginning to the head."""
        kept, m, estimate = self._kept, self._kept.memory, self._kept.last
        fit = kept.fit_tail(m.done)
        if kept.settings.detect_changes and m.stable:
            step, m.undecided = find_step(fit, estimate.colour, self._smallest_step(fit))
            if step is not None:
                restart(kept, kept.numbers(m.tail), step)
                return
        if m.front is None:
            m.estimate = estimate._replace(parameters=fit.state.parameters, covariance=fit.covariance)
        else:
            move_front(kept)
        count = len(fit.chain.windows)
        # What is undecided stays in the tail until it is known.
        if count > (_LONGEST_UNDECIDED if m.undecided else _LONGEST_TAIL):
            self._shorten(fit, count - SHORTEST_TAIL)

    def _smallest_step(self, fit: Fit) -> float:
        """T, beyond what the hard iron may walk within the tail."""
        elapsed = float(fit.chain.windows.time[-1] - fit.chain.windows.time[0])
        return max(SMALLEST, _NO_WALK * self._kept.settings.hard_iron_walk * np.sqrt(elapsed / 3600))

    def _shorten(self, fit: Fit, first: int) -> None:
        """The tail begins with its window `first`; the head takes those before."""
        kept, m, chain = self._kept, self._kept.memory, continued(fit)
        m.head = chain.condense(fit.state, fit.weights, first)
        m.tail = int(kept.numbers(m.tail)[first])
        if m.front is not None:
            elapsed = float(chain.windows.time[first] - chain.windows.time[0])
            for rows, walk in kept.settings.walks:
                m.head = m.head.widen(rows, walk * np.sqrt(elapsed / 3600))
        if m.settled:
            kept.close()

    def _give_up(self) -> None:
        """Bound what is kept: to the past, once the estimate has converged; else the oldest quarter goes."""
        kept, m = self._kept, self._kept.memory
        mag, gyro = kept.buffer.magnetometer.time, kept.buffer.gyroscope.time
        full = gyro[-1] - gyro[0] > kept.settings.horizon or max(len(mag), len(gyro)) > _MOST_SAMPLES
        walked = m.front is not None and len(kept.numbers()) >= _MOST_WALKED
        if m.stable and (full or walked):
            m.settled = True
            kept.close()
        elif full:
            numbers = kept.numbers()
            kept.begin_at(int(numbers[len(numbers) // 4]))

    def calibration(self) -> Calibration | None:
        """See `Engine.calibration`."""
        if not self._fresh:
            self._read, self._fresh = current_calibration(self._kept, self._compressed), True
        return self._read

    def converged(self) -> bool:
        """See `Engine.converged`."""
        return has_converged(self._kept)

    def progress(self) -> Progress:
        """See `Engine.progress`."""
        return progress_of(self._kept, self.calibration())

    def changes(self) -> tuple[Change, ...]:
        """See `Engine.changes`."""
        return changes_until(self._kept, self.calibration()) if self._kept.memory.changes else ()

    def state(self) -> Mapping[str, Array]:
        """See `Engine.state`."""
        buffer = {f"buffer/{name}": value for name, value in self._kept.buffer.state().items()}
        return buffer | {f"memory/{name}": value for name, value in self._kept.memory.to_arrays().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """See `Engine.restore`."""
        kept = self._kept
        kept.buffer.restore({k.removeprefix("buffer/"): v for k, v in state.items() if k.startswith("buffer/")})
        kept.memory = Memory.from_arrays(
            {k.removeprefix("memory/"): v for k, v in state.items() if k.startswith("memory/")}
        )
