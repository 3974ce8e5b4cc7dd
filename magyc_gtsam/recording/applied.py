"""The mark of a recording whose field is calibrated already, so that no calibration is applied to it again."""

from __future__ import annotations

from dataclasses import replace

from magyc_gtsam.recording.recording import Recording

CALIBRATED = (
    "the field is calibrated already: `magyc-gtsam apply` wrote it"  # a note, which writers and readers keep
)


def as_calibrated(recording: Recording) -> Recording:
    """Return a recording with the mark."""
    return replace(recording, notes=(CALIBRATED, *recording.notes))


def is_calibrated(recording: Recording) -> bool:
    """Return whether a recording has the mark."""
    return CALIBRATED in recording.notes
