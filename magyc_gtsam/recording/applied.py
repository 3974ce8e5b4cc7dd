"""The mark of a recording whose field is calibrated already.

No calibration is applied to it again, and a calibration of it is only the rest that the one before has left.
"""

from __future__ import annotations

from dataclasses import replace

from magyc_gtsam.recording.recording import Recording

CALIBRATED = (
    "the field is calibrated already: `magyc-gtsam apply` wrote it"  # a note, which writers and readers keep
)
ONLY_THE_REST = (
    "the calibration is of a log that `magyc-gtsam apply` wrote, and holds only the rest that the one before has left; "
    "use that one, or calibrate the log as it was recorded"
)


def as_calibrated(recording: Recording) -> Recording:
    """Return a recording with the mark."""
    return replace(recording, notes=(CALIBRATED, *recording.notes))


def is_calibrated(recording: Recording) -> bool:
    """Return whether a recording has the mark."""
    return CALIBRATED in recording.notes
