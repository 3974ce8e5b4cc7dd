"""Time 0 of a recording on the clock of its log, which readers state in a note."""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone

from magyc_gtsam.recording.recording import Recording

_SECOND = 1_000_000_000  # ns
_YEAR_2000 = 946_684_800 * _SECOND  # earlier stamps count from boot, not from 1970
_NOTE = re.compile(r"time 0 is (?:\S+ \()?(-?\d+\.\d{9}) s(?:\)| on the log's own clock)")


def time_zero_note(stamp: int) -> str:
    """Return the note that time 0 has this stamp (ns), with the date if the clock shows it."""
    if stamp < _YEAR_2000:
        return f"time 0 is {seconds_of(stamp)} s on the log's own clock"
    moment = datetime(1970, 1, 1, tzinfo=timezone.utc) + timedelta(seconds=stamp // _SECOND)
    return f"time 0 is {moment:%Y-%m-%dT%H:%M:%S}.{stamp % _SECOND:09d}Z ({seconds_of(stamp)} s)"


def time_zero_of(recording: Recording) -> int:
    """Return the stamp (ns) of the log's clock at the recording's time 0, by its note; 0 without one."""
    match = next(filter(None, map(_NOTE.fullmatch, recording.notes)), None)
    return int(match[1].replace(".", "")) if match else 0


def is_time_zero(note: str) -> bool:
    """Return whether a note of a recording is that of `time_zero_note`."""
    return _NOTE.fullmatch(note) is not None


def seconds_of(stamp: int) -> str:
    """Return a stamp in ns as text in s, exactly."""
    return f"{'-' * (stamp < 0)}{abs(stamp) // _SECOND}.{abs(stamp) % _SECOND:09d}"
