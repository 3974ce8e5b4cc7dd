"""`calibrate_many`: calibrate all logs of one instrument together."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from magyc_gtsam.estimators import check_options
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.factors.one_thread import one_thread
from magyc_gtsam.history.history import History
from magyc_gtsam.history.log_factor import LogFactor, factor_of
from magyc_gtsam.history.model import HistoryModel
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.expected import expect_progress, expect_recording
from magyc_gtsam.recording.stamps import moment

Progress = Callable[[float], None]


@one_thread
def calibrate_many(
    recordings: Iterable[Recording],
    *,
    times: Sequence[Any] | None = None,
    model: HistoryModel | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> History:
    """Calibrate all logs of one instrument together.

    Args:
        recordings: the logs; those of `read_many` are in memory one at a time.
        times: s since 1970 of each log, or calendar stamps; None takes them from the recordings, if these have a date.
        model: assumptions about the instrument between the logs; None for the defaults.
        progress: called with the share done, 0 to 1.
        options: options of `calibrate` for every log.

    Raises:
        MagycError: there are no logs, the number of times differs or one is none, an option of `calibrate` is unknown
            or out of range, or no log has a trusted calibration.
    """
    if isinstance(recordings, str | os.PathLike):
        raise MagycError(
            f"calibrate_many: {os.fspath(recordings)!r} is a path; pass mg.read_many({os.fspath(recordings)!r})"
        )
    if isinstance(recordings, Recording) or not isinstance(recordings, Iterable):
        raise MagycError(
            f"calibrate_many: several recordings are needed, got a {type(recordings).__name__}; pass a list of them"
        )
    expect_progress(progress)
    logs = recordings if isinstance(recordings, Sequence) else list(recordings)
    if not len(logs):
        raise MagycError("calibrate_many: there are no recordings; pass at least one")
    if times is not None and len(times) != len(logs):
        raise MagycError(f"times: {len(times)} for {len(logs)} recordings; pass one for each")
    if model is not None and not isinstance(model, HistoryModel):
        raise MagycError(f"model: a HistoryModel is needed, got {type(model).__name__}")
    dates = None if times is None else [moment("times", time) for time in times]
    check_options(**options)
    factors = []
    for i in range(len(logs)):
        factors.append(_read_factor(logs, i, None if dates is None else dates[i], options))
        if progress is not None:
            progress((i + 1) / len(logs))
    return History(factors, model=model, options=options)


def _read_factor(logs: Sequence[Recording], i: int, time: float | None, options: dict[str, Any]) -> LogFactor:
    """Return the factor of one log, which is read here, or the reason why it cannot be read."""
    try:
        recording = logs[i]
    except MagycError as problem:
        return LogFactor(f"log {i + 1}", time, None, None, problem=str(problem))
    expect_recording("mg.calibrate_many", recording)
    return factor_of(recording, time, options)
