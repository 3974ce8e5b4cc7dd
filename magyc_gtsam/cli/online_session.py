"""One run of `magyc-gtsam online`: read, update, write on a schedule, and stop without loss."""

from __future__ import annotations

import time
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from magyc_gtsam.cli.files import refuse_unwritable
from magyc_gtsam.cli.interrupts import noted_interrupts
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.live.source import LiveSource, NewSamples
from magyc_gtsam.recording import Array, Samples

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.online import OnlineCalibrator

_WAIT = 0.2  # s that reading may wait, and so the delay until an interrupt is noticed


class EndReason(str, Enum):
    """Why a run ended."""

    COMPLETE = "the input is complete"
    IDLE = "no new data"
    INTERRUPTED = "interrupted"

    __str__ = str.__str__


class RunView(Protocol):
    """The display of a run, which the run calls."""

    def take(self, batch: NewSamples) -> None:
        """Receive the samples of a read, before the calibrator does."""

    def refresh(self) -> None:
        """Update the display; called after every read."""

    def report(self) -> None:
        """Show a report; called after files were written."""

    def say(self, note: str) -> None:
        """Show a remark on data that was left out or files that could not be written."""


class Session:
    """A run that feeds a calibrator from a source and writes its files.

    Args:
        source: where the samples come from.
        online: the calibrator.
        output: file of the calibration.
        state: file of the state; None for none.
        every: s between two writes of the files.
        idle: s without new data after which the run ends; None for no limit.
        axes: (3, 3) from the gyroscope's axes to the magnetometer's.
        view: the display.
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
        self.end = EndReason.COMPLETE
        self.skipped = self.taken = 0
        self._every, self._idle, self._axes, self._view = every, idle, axes, view
        self._until = online.taken_until  # the last stamps that an earlier run has used

    def run(self) -> None:
        """Run until the source ends or is idle for too long, or an interrupt; the files are written in any case.

        Raises:
            MagycError: the source cannot be read, its clock went back, or a file cannot be written.
        """
        for file in (self.output, self.state):
            if file is not None:
                refuse_unwritable(file)  # before the run, which may be long
        with noted_interrupts() as interrupts:
            try:
                self._loop(interrupts)
            finally:
                try:
                    self._show_notes()
                finally:  # also if standard output is closed
                    self.write()

    def _loop(self, interrupts: list[int]) -> None:
        received, grown = -1, time.monotonic()
        written = grown
        while True:
            batch = self.source.read(_WAIT)
            self._show_notes()
            self._view.take(batch)
            self._take(batch)
            self._view.refresh()
            now = time.monotonic()
            if self.source.received != received:
                received, grown = self.source.received, now
            if interrupts:
                self.end = EndReason.INTERRUPTED
                return
            if not batch and self.source.ended:
                return
            if not batch and self._idle is not None and now - grown >= self._idle:
                self.end = EndReason.IDLE
                return
            if now - written >= self._every:
                try:
                    self.write()
                except (OSError, MagycError) as problem:  # a full disk may have space at the next write
                    self._view.say(f"not written: {problem}")
                self._view.report()
                written = time.monotonic()

    def _take(self, batch: NewSamples) -> None:
        """Give the new samples of both sensors to the calibrator in one call, so that neither is ahead by a batch."""
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

    def _show_notes(self) -> None:
        """Pass the notes of the source to the display."""
        notes = list(self.source.notes)
        self.source.notes.clear()
        for note in notes:
            self._view.say(note)

    def write(self) -> None:
        """Write the state, the calibration, and the one before each change of the hard iron, each file in one step."""
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
    """Return the calibration so far; it is not trusted while the estimate still changes, whatever its covariance."""
    calibration = online.calibration
    if calibration is None or online.converged or not calibration.trusted:
        return calibration
    return replace(calibration, converged=False, message=online.progress.sentence)
