"""A complete log as a live source: read as `calibrate` reads it, and passed on in the order of its stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.io import read
from magyc_gtsam.io.request import Request
from magyc_gtsam.live.source import MEANS, NewSamples, nothing
from magyc_gtsam.recording import Array, Recording, Samples
from magyc_gtsam.recording.applied import is_calibrated
from magyc_gtsam.recording.time_zero import is_time_zero, time_zero_of
from magyc_gtsam.storage.files import size_of

_PIECE = 30.0  # s of samples that are returned together, so that catching up with a long log shows progress
_SECOND = 10**9  # ns


class CompleteLog:
    """The magnetometer and gyroscope samples of a complete log; a `LiveSource`.

    Stamps are seconds on the clock of the log, not counted from its first row.

    Attributes:
        calibrated: whether the field is that of `magyc-gtsam apply`.

    Args:
        path: a log that `magyc_gtsam.io.read` reads, such as the folder of a ROS 2 bag.
        request: topics, units, stamps, and options of the format.

    Raises:
        MagycError: the log cannot be read, has no gyroscope, or has a field in unknown units.
    """

    lost = 0
    waiting_for = ""

    def __init__(self, path: Path, request: Request) -> None:
        recording = read(
            path,
            magnetic_field=request.sensors.get("magnetic_field"),
            angular_rate=request.sensors.get("angular_rate"),
            magnetic_unit=request.units.get("magnetic_field"),
            angular_unit=request.units.get("angular_rate"),
            stamps=request.stamps,
            channels=(),
            **request.options,
        )
        if recording.magnetic_field_unit != "T":
            raise MagycError(f"{path}: the unit of the field is unknown; give --magnetic-unit")
        self.name, self.calibrated = path.name, is_calibrated(recording)
        self.ended = False
        self.received = size_of(path)
        self.notes = [note for note in recording.notes if not is_time_zero(note)]
        self.notes += [MEANS] * (recording.angular_rate_is == "interval-mean")
        gyroscope, self._zero = recording.gyroscope, time_zero_of(recording)
        self._samples = _with_repeats(recording), gyroscope
        self._next, self._end = float(recording.time[0]), float(recording.time[-1])

    def read(self, wait: float = 0.0) -> NewSamples:
        """Return the samples of the next seconds; see `LiveSource.read`. It never waits."""
        while not self.ended:
            until = self._next + _PIECE
            batch = NewSamples(*(self._between(each, until) for each in self._samples))
            self._next, self.ended = until, until > self._end
            if batch:
                return batch
        return nothing()

    def _between(self, samples: Samples, until: float) -> Samples:
        rows = slice(*np.searchsorted(samples.time, [self._next, until]))
        return Samples(self._on_the_log(samples.time[rows]), samples.value[rows])

    def _on_the_log(self, time: Array) -> Array:
        """Return stamps of the recording (n,) s on the clock of the log, rounded as those of a file that grows."""
        stamps: Array = (np.rint(time * _SECOND).astype(np.int64) + self._zero) / _SECOND
        return stamps

    def close(self) -> None:
        """Do nothing: the log has been read."""


def _with_repeats(recording: Recording) -> Samples:
    """Return the magnetometer's samples with those that it repeated, which the calibrator counts itself."""
    stamped = recording.magnetic_field_stamped
    return Samples(recording.time[stamped], recording.magnetic_field[stamped])
