"""One run of `magyc-gtsam online`: read, update, write on a schedule, and stop without loss."""

from __future__ import annotations

import time
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from magyc_gtsam.cli.files import refuse_unwritable
from magyc_gtsam.cli.interrupts import explained, noted_interrupts
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.live.source import LiveSource, NewSamples
from magyc_gtsam.online.intake import ClockSetBack

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.cli.online_feed import Feed
    from magyc_gtsam.online import OnlineCalibrator

_WAIT = 0.2  # s that reading may wait, and so the delay until an interrupt is noticed


class EndReason(str, Enum):
    """Why a run ended."""

    COMPLETE = "the input is complete"
    IDLE = "no new data"
    INTERRUPTED = "interrupted"
    CLOCK = "a clock went back"

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
        feed: takes the samples to the calibrator.
        output: file of the calibration.
        state: file of the state; None for none.
        every: s between two writes of the files.
        idle: s without new data after which the run ends; None for no limit.
        view: the display.

    Attributes:
        end: why the run has ended.
        problem: why no further samples could be taken; "" if they could.
        unwritten: the files that could not be written at the end, and why.
    """

    def __init__(
        self,
        source: LiveSource,
        feed: Feed,
        *,
        output: Path,
        state: Path | None,
        every: float,
        idle: float | None,
        view: RunView,
    ) -> None:
        self.source, self.feed, self.output, self.state = source, feed, output, state
        self.end, self.problem = EndReason.COMPLETE, ""
        self.unwritten: dict[Path, Exception] = {}
        self._every, self._idle, self._view = every, idle, view

    def run(self) -> None:
        """Run until the source ends or is idle for too long, or an interrupt; the files are written in any case.

        Raises:
            MagycError: the source cannot be read, a unit is wrong, or a file cannot be written before the run.
        """
        for file in (self.output, self.state):
            if file is not None:
                refuse_unwritable(file)  # before the run, which may be long
        with noted_interrupts() as interrupts:
            try:
                self._loop(interrupts)
            except ClockSetBack as problem:
                self.end, self.problem = EndReason.CLOCK, str(problem)
                self._finish()
            except BaseException:
                self._finish()
                self._say_unwritten()
                raise
            else:
                self._finish()

    def _finish(self) -> None:
        try:
            self._show_notes()
        finally:  # also if standard output is closed
            self.unwritten = self.write()

    def _say_unwritten(self) -> None:
        for problem in self.unwritten.values():
            self._view.say(f"not written: {explained(problem)}")

    def _loop(self, interrupts: list[int]) -> None:
        received, grown = -1, time.monotonic()
        written = grown
        while True:
            batch = self.source.read(_WAIT)
            self._show_notes()
            self._view.take(batch)
            self.feed.take(batch)
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
                self.unwritten = self.write()  # a full disk may have space at the next write
                self._say_unwritten()
                self._view.report()
                written = time.monotonic()

    def _show_notes(self) -> None:
        """Pass the notes of the source to the display."""
        notes = list(self.source.notes)
        self.source.notes.clear()
        for note in notes:
            self._view.say(note)

    def write(self) -> dict[Path, Exception]:
        """Write the calibration, the one before each change of the hard iron, and the state, each file in one step.

        Returns:
            The files that could not be written, and why; one does not keep the others from being written.
        """
        online = self.feed.online
        calibration = judged_online(online)
        results = {} if calibration is None else {self.output: calibration}
        for number, change in enumerate(online.changes, 1):
            if change.before is not None:
                file = self.output.with_name(f"{self.output.stem}-before-change-{number}{self.output.suffix}")
                results[file] = change.before
        if getattr(self.source, "calibrated", False):  # they give no parameters
            results = {file: _of_the_rest(result) for file, result in results.items()}
        saves = [(file, result.save) for file, result in results.items()]
        if self.state is not None:
            saves.append((self.state, online.save))
        unwritten: dict[Path, Exception] = {}
        for file, save in saves:
            try:
                save(file)
            except (OSError, MagycError) as problem:
                unwritten[file] = problem
        return unwritten


def judged_online(online: OnlineCalibrator) -> Calibration | None:
    """Return the calibration so far; it is not trusted while the estimate still changes, whatever its covariance."""
    calibration = online.calibration
    if calibration is None or online.converged or not calibration.trusted:
        return calibration
    return replace(calibration, converged=False, message=online.progress.sentence)


def _of_the_rest(calibration: Calibration) -> Calibration:
    """Return the calibration with the mark that its field was calibrated before."""
    return replace(calibration, configuration={**calibration.configuration, "calibrated_before": True})
