"""MAGYC-IFG online: windows of one second from incoming samples, each added to the factor graph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from magyc_gtsam.calibration import Calibration
from magyc_gtsam.calibration.noted import as_mounted
from magyc_gtsam.estimators.magyc.derivative_windows import (
    LEAST_WINDOWS,
    form_windows,
    window_index,
)
from magyc_gtsam.estimators.magyc.graph import MagycGraph
from magyc_gtsam.estimators.magyc.options import IncrementalOptions
from magyc_gtsam.estimators.magyc.state import limits_about
from magyc_gtsam.online.engine import Change, Progress
from magyc_gtsam.recording import Array, Recording, Samples
from magyc_gtsam.recording.axes import OWN_AXES
from magyc_gtsam.recording.growing_rows import GrowingRows

_WAITING = 60.0  # s of samples of one sensor that are kept while the other is silent
_VISITED = 512  # samples kept as representatives of the whole mission
_STILL = 0.5  # share of the limits by which a settled estimate may differ from the mean of the last fifth


class IncrementalMagyc:
    """The engine of `OnlineCalibrator(method="magyc-ifg")`; `chosen` are `IncrementalOptions`, `gyroscope_axes` those
    of `mg.read`.

    With `compressed=False` time and memory grow with the mission.
    """

    options = frozenset(IncrementalOptions.__dataclass_fields__) | {"gyroscope_axes"}

    def __init__(self, gyroscope_axes: str = OWN_AXES, **chosen: Any) -> None:
        self._gyroscope_axes = gyroscope_axes
        self._graph = MagycGraph(IncrementalOptions(**chosen))
        self._window = self._graph.options.window
        self._waiting = (GrowingRows(4), GrowingRows(4))  # samples of windows still open: time, value
        self._begun, self._last = np.full(2, np.nan), np.full(2, -np.inf)  # first and last stamp of each sensor
        self._closed = -np.inf  # number of the first window still open
        self._visited = np.empty((0, 4))  # representative magnetometer samples of the mission: time, field
        self._every, self._windows = 1, 0  # one representative per `_every` windows; number of windows
        self._cached: Calibration | None = None
        self._fresh = False

    def update(self, magnetometer: Samples, gyroscope: Samples) -> None:
        """See `Engine.update`."""
        self._fresh = False
        for index, (rows, new) in enumerate(zip(self._waiting, (magnetometer, gyroscope), strict=True)):
            if len(new.time):
                rows.append(np.column_stack(new))
                self._last[index] = new.time[-1]
                if np.isnan(self._begun[index]):
                    self._begun[index] = new.time[0]
        start = float(self._begun.max())  # NaN until both have begun
        # A window is complete when both sensors have passed it, or one has been silent for too long.
        complete = max(float(self._last.min()), float(self._last.max()) - _WAITING)
        if np.isnan(start):
            for rows in self._waiting:
                rows.cut(int(np.searchsorted(rows.rows[:, 0], complete)))
            return
        closed = float(window_index(complete, start, self._window))
        if closed <= self._closed:
            return
        self._closed = closed
        done: list[Samples] = []
        for rows in self._waiting:
            count = int(np.searchsorted(window_index(rows.rows[:, 0], start, self._window), closed))
            done.append(Samples(rows.rows[:count, 0].copy(), rows.rows[:count, 1:].copy()))
            rows.cut(count)
        self._remember(done[0], start)
        for sample in zip(*form_windows(done[0], done[1], start, self._window).in_gauss(), strict=True):
            self._graph.add(*sample)

    def _remember(self, magnetometer: Samples, start: float) -> None:
        """Add the first sample of one in `_every` windows to the representatives of the mission."""
        _, first = np.unique(window_index(magnetometer.time, start, self._window), return_index=True)
        for row in np.column_stack(magnetometer)[first]:
            if self._windows % self._every == 0:
                self._visited = np.vstack([self._visited, row])
            if len(self._visited) > _VISITED:
                self._visited, self._every = self._visited[::2], 2 * self._every
            self._windows += 1

    def calibration(self) -> Calibration | None:
        """See `Engine.calibration`."""
        if not self._fresh:
            self._cached, self._fresh = self._calibration(), True
        return self._cached

    def _calibration(self) -> Calibration | None:
        graph = self._graph
        parameters = graph.estimate()
        if parameters is None or len(self._visited) < LEAST_WINDOWS:
            return None
        recording = Recording(self._visited[:, 0], self._visited[:, 1:], gyroscope_axes=self._gyroscope_axes)
        calibration = graph.calibration(parameters, recording, windows=len(graph))
        return as_mounted(calibration, recording)

    def converged(self) -> bool:
        """See `Engine.converged`: observable, and near the mean over the last fifth of the estimates."""
        calibration = self.calibration()
        return calibration is not None and calibration.converged and self._settled()

    def _settled(self) -> bool:
        current, mean = self._graph.current(), self._graph.mean()
        if current is None or mean is None:
            return False
        limits = limits_about(current, self._visited[:, 1:])
        return bool((np.abs(current - mean) <= _STILL * limits).all())

    def progress(self) -> Progress:
        """See `Engine.progress`."""
        calibration = self.calibration()
        if calibration is None:
            return Progress(None, 0.0, len(self._graph), False, f"collecting: {self._graph.message}")
        converged = self.converged()
        if converged:
            sentence = "converged"
        elif calibration.converged:
            sentence = "the estimate still changes: keep turning"
        else:
            sentence = calibration.message
        weak = calibration.observability.weak if calibration.observability else ()
        return Progress(None, 0.0, len(self._graph), converged, sentence, weak)

    def field(self) -> Array:
        """See `Engine.field`."""
        return self._visited[:, 1:]

    def changes(self) -> tuple[Change, ...]:
        """See `Engine.changes`; this method does not look for any."""
        return ()

    def state(self) -> Mapping[str, Array]:
        """See `Engine.state`."""
        return {
            "magnetometer": self._waiting[0].rows.copy(),
            "gyroscope": self._waiting[1].rows.copy(),
            "stamps": np.array([self._begun, self._last]),
            "closed": np.array(self._closed),
            "visited": self._visited,
            "counts": np.array([self._every, self._windows]),
            **{f"graph/{name}": value for name, value in self._graph.saved().items()},
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """See `Engine.restore`."""
        for rows, name in zip(self._waiting, ("magnetometer", "gyroscope"), strict=True):
            rows.append(state[name])
        (self._begun, self._last), self._closed = state["stamps"].copy(), float(state["closed"])
        self._visited = state["visited"]
        self._every, self._windows = (int(count) for count in state["counts"])
        self._graph.restore({k.removeprefix("graph/"): v for k, v in state.items() if k.startswith("graph/")})
