"""Displays of `magyc-gtsam online`: a live view on a terminal, plain lines in a pipe, JSON lines for programs."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from magyc_gtsam.cli.interrupts import explained
from magyc_gtsam.cli.online_session import EndReason, Session, judged_online
from magyc_gtsam.cli.online_text import change_sentence, counted_from, first_stamp, left_out_sentence, line, panel
from magyc_gtsam.cli.terminal import complain, concluded, console, show, show_calibration, show_left_out
from magyc_gtsam.foreign_text import printable
from magyc_gtsam.live.health import StreamMonitor
from magyc_gtsam.live.picture import Picture
from magyc_gtsam.option_names import as_options
from magyc_gtsam.report.words import parameter_rows

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.cli.online_feed import Feed
    from magyc_gtsam.live.source import LiveSource, NewSamples
    from magyc_gtsam.report.verdict import Verdict

# Between two updates of the display pass at least this time (s), and this many times the duration of an update.
_REFRESH = 0.5
_PAUSE_FACTOR = 10.0
_NOTES = 10  # notes that are shown; of the others only the number is
_INTERRUPTED = 130


class QuietView:
    """A display of only the omitted data, and of the reason for a result that must not be trusted."""

    def __init__(self, source: LiveSource, feed: Feed) -> None:
        self.source, self.feed, self.online = source, feed, feed.online
        self.monitor = StreamMonitor()
        self._notes = 0

    def take(self, batch: NewSamples) -> None:
        """Update the health of the source."""
        self.monitor.take(batch, time.monotonic(), getattr(self.source, "round_trip", None))

    def refresh(self) -> None:
        """Do nothing."""

    def report(self) -> None:
        """Do nothing."""

    def say(self, note: str) -> None:
        """Print one of the first notes on standard error; too many would hide other messages."""
        self._notes += 1
        if self._notes <= _NOTES:
            self.complain(note)

    def complain(self, text: str) -> None:
        """Print one line on standard error."""
        complain(text)

    def conclude(self, session: Session) -> int:
        """Show the result and return the exit code.

        It is 0 if the calibration converged, 1 if not or if no sample of this run was used, 2 if a file could not be
        written, a topic is missing, or the axes or units of the sensors disagree, 130 after an interrupt before a
        first result.
        """
        if self._notes > _NOTES:
            self.complain(f"{self._notes - _NOTES} more notes like these")
        unfinished = getattr(self.source, "unfinished", "")
        if session.end is EndReason.IDLE and unfinished:
            used = "" if self.source.waiting_for else "; what was read before is used"
            self.complain(f"{self.source.name}: {unfinished}{used}")
        code = self._conclude(session)
        feed = self.feed
        if feed.unused:
            self.complain(feed.before_state)
        elif feed.skipped:
            every = "" if feed.taken else "all "
            self.complain(f"{every}{feed.skipped} samples were in the saved state already")
        if session.problem:
            files = "another -o" if session.state is None else "another -o and --state"
            self.complain(f"{session.problem} (give it {files})")
        for problem in session.unwritten.values():
            self.complain(f"not written: {explained(problem)}")
        return 2 if session.unwritten else code or int(feed.nothing_new)

    def _conclude(self, session: Session) -> int:
        """Show the result, and return the exit code for it."""
        from magyc_gtsam.report.verdict import judged

        calibration = judged_online(self.online)
        if calibration is None:
            return self._no_calibration(session)
        verdict = judged(calibration)
        return concluded(verdict, shown=self.result(session, calibration, verdict))

    def _no_calibration(self, session: Session) -> int:
        """Show why there is no calibration, and return the exit code."""
        if session.end is EndReason.INTERRUPTED:
            self.complain("interrupted before there was a calibration")
            return _INTERRUPTED
        if self.source.waiting_for:
            complain(f"{self.source.name}: {self.source.waiting_for}")
            return 2
        progress = self.online.progress
        parts = [f"no calibration: {progress.sentence}"]
        if not progress.windows and progress.left_out:
            parts += [*left_out_sentence(progress), "if the stamps were never filled in, take --stamps log"]
        self.complain("; ".join(parts))
        return 2 if progress.disagree else 1

    def result(self, session: Session, calibration: Calibration, verdict: Verdict) -> bool:
        """Show the result, and return whether it is on standard output."""
        return False


class PlainView(QuietView):
    """A display with a line per report, and the result at the end."""

    def report(self) -> None:
        """Print the state in one line."""
        show(line(self.feed, self.source, self.monitor.health))

    def result(self, session: Session, calibration: Calibration, verdict: Verdict) -> bool:
        """Show the result, without numbers if it must not be trusted."""
        progress = self.online.progress
        show(
            verdict.sentence,
            f"{self.source.name}: {progress.duration:.1f} s, {calibration.method}; {session.end}"
            + ("; all samples are from the saved state" if self.feed.skipped and not self.feed.taken else ""),
            "",
        )
        if verdict.trusted:
            show_calibration(counted_from(calibration, first_stamp(self.online)))
        else:
            show_left_out(calibration)
        show(*left_out_sentence(self.online.progress))
        show(*(change_sentence(change, self.online) for change in self.online.changes))
        files = {"calibration": session.output, "state": session.state}
        written = (f"{what}: {file}" for what, file in files.items() if file not in {None, *session.unwritten})
        show("", *written)
        return True


class LiveView(PlainView):
    """A display on a terminal that is redrawn in place."""

    def __init__(self, source: LiveSource, feed: Feed) -> None:
        from rich.live import Live as Screen

        super().__init__(source, feed)
        self._console = console()
        self._screen = Screen(console=self._console, auto_refresh=False, transient=True)
        self._next, self._written = 0.0, ""
        self._screen.start()

    def refresh(self) -> None:
        """Redraw, but not too often, since the estimate can require a fit."""
        began = time.monotonic()
        if began < self._next:
            return
        shown = panel(self.feed, self.source, self.monitor.health, self._written)
        self._screen.update(shown, refresh=True)
        ended = time.monotonic()
        self._next = ended + max(_REFRESH, _PAUSE_FACTOR * (ended - began))

    def report(self) -> None:
        """Remember the time of the last write."""
        if self.online.calibration is not None:
            self._written = f"written {time.strftime('%H:%M:%S')}"

    def complain(self, text: str) -> None:
        """Print one line above the view."""
        self._console.print(printable(text), markup=False, highlight=False, soft_wrap=True)

    def stop(self) -> None:
        """Release the terminal."""
        self._screen.stop()


class JsonView(QuietView):
    """A display with a line of JSON per report; the last one has `"final": true`.

    Args:
        source: the source.
        feed: takes the samples to the calibrator.
        every: s between additional lines with the picture; None for none.
    """

    def __init__(self, source: LiveSource, feed: Feed, every: float | None = None) -> None:
        super().__init__(source, feed)
        self._every, self._next = every, 0.0
        self._picture = None if every is None else Picture(feed.online)

    def take(self, batch: NewSamples) -> None:
        """Update the health of the source and the picture."""
        super().take(batch)
        if self._picture is not None:
            self._picture.take(batch)

    def refresh(self) -> None:
        """Print a line with the picture, but not too often, since the estimate can require a fit."""
        began = time.monotonic()
        if self._every is None or began < self._next:
            return
        _write_line(self._values())
        ended = time.monotonic()
        self._next = ended + max(self._every, _PAUSE_FACTOR * (ended - began))

    def report(self) -> None:
        """Print the state as a line of JSON."""
        _write_line(self._values())

    def conclude(self, session: Session) -> int:
        """Print the final line, and return the exit code of `QuietView.conclude`."""
        code = super().conclude(session)
        final = {
            "final": True,
            "end": str(session.end),
            "problem": session.problem,
            "exit_code": code,
            "output": str(session.output),
        }
        _write_line(self._values() | final)
        return code

    def _values(self) -> dict[str, Any]:
        progress, calibration = self.feed.progress, self.online.calibration
        drawn: dict[str, Any] = {} if self._picture is None else {"picture": self._picture.to_dict(calibration)}
        if calibration is not None and self._picture is not None:
            drawn["rows"] = [[name, *values] for name, values in parameter_rows(calibration)]
        return drawn | {
            "source": self.monitor.health.to_dict()
            | {"name": self.source.name, "refused": self.source.lost, "waiting_for": self.source.waiting_for},
            "time": progress.time,
            "duration": progress.duration,
            "windows": progress.windows,
            "left_out": progress.left_out,
            "stuck": [stuck.where for stuck in progress.stuck],
            "clipped": None if progress.clipped is None else progress.clipped.where,
            "clipped_field": None if progress.clipped_field is None else progress.clipped_field.where,
            "coverage": progress.coverage,
            "converged": progress.converged,
            "sentence": progress.sentence,
            "changes": [
                {
                    "time": change.time,
                    "time_sigma": change.time_sigma,
                    "step": change.step.tolist(),
                    "step_sigma": change.step_sigma.tolist(),
                }
                for change in self.online.changes
            ],
            "calibration": None if calibration is None else calibration.to_dict(),
        }


@contextmanager
def view(source: LiveSource, feed: Feed, *, quiet: bool, json: bool, picture: float | None) -> Iterator[QuietView]:
    """Yield the display for the options and the terminal."""
    if json:
        yield JsonView(source, feed, picture)
    elif quiet:
        yield QuietView(source, feed)
    elif not console().is_terminal:
        yield PlainView(source, feed)
    else:
        live = LiveView(source, feed)
        try:
            yield live
        finally:
            live.stop()


def _write_line(values: dict[str, Any]) -> None:
    """Print one line of JSON at once."""
    typer.echo(as_options(json.dumps(values)))
