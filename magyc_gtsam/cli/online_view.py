"""What `magyc-gtsam online` shows: a live view on a terminal, plain lines in a pipe, JSON lines for programs."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

from magyc_gtsam.cli.online_session import End, Session, judged_online
from magyc_gtsam.cli.online_text import change_sentence, counted_from, first_stamp, line, panel
from magyc_gtsam.cli.terminal import concluded, console, show, show_calibration
from magyc_gtsam.foreign_text import printable
from magyc_gtsam.live.health import StreamMonitor
from magyc_gtsam.live.picture import Picture
from magyc_gtsam.report.words import parameter_rows

if TYPE_CHECKING:
    from magyc_gtsam.calibration import Calibration
    from magyc_gtsam.live.source import LiveSource, NewSamples
    from magyc_gtsam.online import OnlineCalibrator
    from magyc_gtsam.report.verdict import Verdict

_REFRESH = 0.5  # s between two looks at the estimate, and no more than a tenth of the time for them
_SHARE = 10.0
_NOTES = 10  # shown; of more, their number
_INTERRUPTED = 130


class QuietView:
    """Shows what was left out, and at the end what must not be trusted."""

    def __init__(self, source: LiveSource, online: OnlineCalibrator) -> None:
        self.source, self.online = source, online
        self.monitor = StreamMonitor()
        self._said = 0

    def take(self, batch: NewSamples) -> None:
        """As `RunView.take`."""
        self.monitor.take(batch, time.monotonic(), getattr(self.source, "round_trip", None))

    def refresh(self) -> None:
        """Nothing moves."""

    def report(self) -> None:
        """Nothing is said."""

    def say(self, note: str) -> None:
        """On standard error; many of one kind would bury the rest."""
        self._said += 1
        if self._said <= _NOTES:
            self.complain(note)

    def complain(self, text: str) -> None:
        """One line on standard error."""
        typer.echo(f"magyc-gtsam: {printable(text)}", err=True)

    def conclude(self, session: Session) -> int:
        """Say how it ended. The exit code: 0 converged, 1 not, 2 nothing to calibrate, 130 interrupted before."""
        if self._said > _NOTES:
            self.complain(f"{self._said - _NOTES} more notes like these")
        if session.skipped:
            every = "" if session.taken else "all "
            again = "" if session.taken else "; if this is another log with another clock, begin a new --state"
            self.complain(f"{every}{session.skipped} samples were in the saved state already{again}")
        from magyc_gtsam.report.verdict import judged

        calibration = judged_online(self.online)
        if calibration is None:
            return self._without(session)
        verdict = judged(calibration)
        return concluded(verdict, shown=self.result(session, calibration, verdict))

    def _without(self, session: Session) -> int:
        """There is no calibration."""
        if session.end is End.INTERRUPTED:
            self.complain("interrupted before there was a calibration")
            return _INTERRUPTED
        if self.source.waiting_for:
            from magyc_gtsam.factors.errors import MagycError

            raise MagycError(f"{self.source.name}: {self.source.waiting_for}")
        self.complain(f"no calibration: {self.online.progress.sentence}")
        return 1

    def result(self, session: Session, calibration: Calibration, verdict: Verdict) -> bool:
        """The result, as the files hold it; whether it is on standard output."""
        return False


class Plain(QuietView):
    """A line per report, and the result at the end."""

    def report(self) -> None:
        """As `RunView.report`."""
        show(line(self.online, self.source, self.monitor.health))

    def result(self, session: Session, calibration: Calibration, verdict: Verdict) -> bool:
        """As `QuietView.result`; no numbers of what must not be trusted."""
        progress = self.online.progress
        show(
            verdict.sentence,
            f"{self.source.name}: {progress.duration:.1f} s, {calibration.method}; {session.end}",
            "",
        )
        if verdict.trusted:
            show_calibration(counted_from(calibration, first_stamp(self.online)))
        show(*(change_sentence(change, self.online) for change in self.online.changes))
        show("", f"calibration: {session.output}")
        if session.state is not None:
            show(f"state: {session.state}")
        return True


class LiveView(Plain):
    """The view of a terminal, drawn in place."""

    def __init__(self, source: LiveSource, online: OnlineCalibrator) -> None:
        from rich.live import Live as Screen

        super().__init__(source, online)
        self._console = console()
        self._screen = Screen(console=self._console, auto_refresh=False, transient=True)
        self._next, self._written = 0.0, ""
        self._screen.start()

    def refresh(self) -> None:
        """As `RunView.refresh`; a look at the estimate can cost a fit, so it is not taken too often."""
        began = time.monotonic()
        if began < self._next:
            return
        shown = panel(self.online, self.source, self.monitor.health, self._written)
        self._screen.update(shown, refresh=True)
        ended = time.monotonic()
        self._next = ended + max(_REFRESH, _SHARE * (ended - began))

    def report(self) -> None:
        """As `RunView.report`."""
        if self.online.calibration is not None:
            self._written = f"written {time.strftime('%H:%M:%S')}"

    def complain(self, text: str) -> None:
        """As `QuietView.complain`, above the view."""
        self._console.print(printable(text), markup=False, highlight=False, soft_wrap=True)

    def stop(self) -> None:
        """Give the terminal back."""
        self._screen.stop()


class JsonView(QuietView):
    """A line of JSON per report; the last one says `"final": true`.

    Args:
        source, online: as of the others.
        every: s between lines that have the picture as well; None for none of those.
    """

    def __init__(self, source: LiveSource, online: OnlineCalibrator, every: float | None = None) -> None:
        super().__init__(source, online)
        self._every, self._next = every, 0.0
        self._picture = None if every is None else Picture(online)

    def take(self, batch: NewSamples) -> None:
        """As `RunView.take`."""
        super().take(batch)
        if self._picture is not None:
            self._picture.take(batch)

    def refresh(self) -> None:
        """As `RunView.refresh`; a look costs at most a tenth of the time, as on a terminal."""
        began = time.monotonic()
        if self._every is None or began < self._next:
            return
        typer.echo(json.dumps(self._values()))
        ended = time.monotonic()
        self._next = ended + max(self._every, _SHARE * (ended - began))

    def report(self) -> None:
        """As `RunView.report`."""
        typer.echo(json.dumps(self._values()))

    def conclude(self, session: Session) -> int:
        """As `QuietView.conclude`."""
        code = super().conclude(session)
        final = {"final": True, "end": str(session.end), "exit_code": code, "output": str(session.output)}
        typer.echo(json.dumps(self._values() | final))
        return code

    def _values(self) -> dict[str, Any]:
        progress, calibration = self.online.progress, self.online.calibration
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
def view(
    source: LiveSource, online: OnlineCalibrator, *, quiet: bool, json: bool, picture: float | None
) -> Iterator[QuietView]:
    """The view that fits the options and the terminal."""
    if json:
        yield JsonView(source, online, picture)
    elif quiet:
        yield QuietView(source, online)
    elif not console().is_terminal:
        yield Plain(source, online)
    else:
        live = LiveView(source, online)
        try:
            yield live
        finally:
            live.stop()
