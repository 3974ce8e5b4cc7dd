"""One run of `magyc-gtsam online`: read, update, write on a schedule, and stop without losing anything."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from enum import Enum
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Protocol

import numpy as np

from magyc_gtsam.cli.files import refuse_unwritable
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.live.source import LiveSource, NewSamples
from magyc_gtsam.recording import Array, Samples

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.online import OnlineCalibrator

_WAIT = 0.2  # s for which reading may wait: within it an interrupt is heeded


class End(str, Enum):
    """Why a run ended."""

    COMPLETE = "the input is complete"
    IDLE = "no growth"
    INTERRUPTED = "interrupted"

    __str__ = str.__str__


class RunView(Protocol):
    """What a run shows while it goes on."""

    def take(self, batch: NewSamples) -> None:
        """Called with all that is read, before it is learnt from."""

    def refresh(self) -> None:
        """Called after every read."""

    def report(self) -> None:
        """Called whenever files were written."""

    def say(self, note: str) -> None:
        """Something was left out, or could not be written."""


class Session:
    """Feed a calibrator from a source.

    Args:
        source, online: from where and into what.
        output: the calibration's file.
        state: the state's file; None saves none.
        every: s between two writings.
        idle: s without growth after which it ends; None waits for ever.
        axes: (3, 3) that brings the gyroscope into the magnetometer's axes.
        view: what is shown.
    """

    def __init__(
        self,
        source: LiveSource,
        online: OnlineCalibrator,
        *,
        output: Path,
        state: Path | None,
        every: float,
        idle: float | None,
        axes: Array | None,
        view: RunView,
    ) -> None:
        self.source, self.online, self.output, self.state = source, online, output, state
        self.end = End.COMPLETE
        self.skipped = self.taken = 0
        self._every, self._idle, self._axes, self._view = every, idle, axes, view
        self._until = online.taken_until  # what an earlier run has taken

    def run(self) -> None:
        """Until the source ends, is idle for too long, or the user has enough; files are written in any case.

        Raises:
            MagycError: a source that cannot be read, a clock that was set back, or files that cannot be written.
        """
        for file in (self.output, self.state):
            if file is not None:
                refuse_unwritable(file)  # now, not after an hour
        with _stoppable() as stopped:
            try:
                self._loop(stopped)
            finally:
                try:
                    self._tell()
                finally:  # whoever listened may be gone
                    self.write()

    def _loop(self, stopped: list[int]) -> None:
        received, grown = -1, time.monotonic()
        written = grown
        while True:
            batch = self.source.read(_WAIT)
            self._tell()
            self._view.take(batch)
            self._take(batch)
            self._view.refresh()
            now = time.monotonic()
            if self.source.received != received:
                received, grown = self.source.received, now
            if stopped:
                self.end = End.INTERRUPTED
                return
            if not batch and self.source.ended:
                return
            if not batch and self._idle is not None and now - grown >= self._idle:
                self.end = End.IDLE
                return
            if now - written >= self._every:
                try:
                    self.write()
                except (OSError, MagycError) as problem:  # a disk that is full now may have space later
                    self._view.say(f"not written: {problem}")
                self._view.report()
                written = time.monotonic()

    def _take(self, batch: NewSamples) -> None:
        """Both sensors in one call: neither is ahead of the other by a block."""
        magnetometer, gyroscope = (
            Samples(samples.time[new], samples.value[new])
            for samples, until in zip(batch, self._until, strict=True)
            for new in (samples.time > until,)
        )
        count = len(magnetometer.time) + len(gyroscope.time)
        self.skipped += sum(len(samples.time) for samples in batch) - count
        self.taken += count
        if not count:
            return
        rate = gyroscope.value if self._axes is None else gyroscope.value @ self._axes.T
        absent = np.full((len(magnetometer.time), 3), np.nan), np.full((len(gyroscope.time), 3), np.nan)
        self.online.update(
            np.concatenate([magnetometer.time, gyroscope.time]),
            np.vstack([magnetometer.value, absent[1]]),
            np.vstack([absent[0], rate]),
        )

    def _tell(self) -> None:
        notes = list(self.source.notes)
        self.source.notes.clear()
        for note in notes:
            self._view.say(note)

    def write(self) -> None:
        """State, calibration, and those before each change of the hard iron; each file is replaced in one step."""
        if self.state is not None:
            self.online.save(self.state)
        calibration = judged_online(self.online)
        if calibration is not None:
            calibration.save(self.output)
        for number, change in enumerate(self.online.changes, 1):
            file = self.output.with_name(f"{self.output.stem}-before-change-{number}{self.output.suffix}")
            if change.before is not None:
                change.before.save(file)


def judged_online(online: OnlineCalibrator) -> Calibration | None:
    """The calibration so far; not to be trusted while the estimate still changes, whatever its covariance is."""
    calibration = online.calibration
    if calibration is None or online.converged or not calibration.trusted:
        return calibration
    return replace(calibration, converged=False, message=online.progress.sentence)


@contextmanager
def _stoppable() -> Iterator[list[int]]:
    """A list that the first SIGINT or SIGTERM fills; the second does what it always does."""
    stopped: list[int] = []
    signals = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.getsignal(number) for number in signals}

    def stop(number: int, frame: FrameType | None) -> None:
        stopped.append(number)
        restore()

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    for number in signals:
        signal.signal(number, stop)
    try:
        yield stopped
    finally:
        restore()
