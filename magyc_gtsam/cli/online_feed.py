"""The samples of a run of `magyc-gtsam online` on their way to the calibrator, which may continue a saved state."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from magyc_gtsam.foreign_text import counted
from magyc_gtsam.live.source import NewSamples
from magyc_gtsam.online.intake import ClockSetBack
from magyc_gtsam.recording import Samples
from magyc_gtsam.recording.fingerprint import RunningFingerprint, first_shared

if TYPE_CHECKING:
    from magyc_gtsam.online import OnlineCalibrator
    from magyc_gtsam.online.engine import Progress

_PIECE = (
    5  # samples of a sensor; a clock that was set back is noticed after more, so the samples before it are taken
)


class Feed:
    """Gives a calibrator the samples of a source that its saved state does not hold.

    Args:
        online: the calibrator.

    Attributes:
        taken: number of samples given to the calibrator.
        skipped: number of samples with stamps that the saved state holds.
        unused: number of those since the last sample that was given; 0 while they are samples of the state again, as
            where a growing file is read from its beginning.
    """

    def __init__(self, online: OnlineCalibrator) -> None:
        self.online = online
        self.taken = self.skipped = self._since = 0
        self._ignored = RunningFingerprint()  # of the samples before the first that is given
        self._until = online.taken_until  # the last stamps that an earlier run has used

    def take(self, batch: NewSamples) -> None:
        """Give the new samples of both sensors in one call, so that neither is ahead by a batch.

        Raises:
            ClockSetBack: a clock was set back; the samples before it are given.
            MagycError: a unit is wrong.
        """
        magnetometer, gyroscope = (
            Samples(samples.time[new], samples.value[new])
            for samples, until in zip(batch, self._until, strict=True)
            for new in (samples.time > until,)
        )
        count = len(magnetometer.time) + len(gyroscope.time)
        skipped = sum(len(samples.time) for samples in batch) - count
        self.skipped += skipped
        self._since = 0 if count else self._since + skipped
        self.taken += count
        if not self.taken:
            self._ignored.take(batch.magnetometer.value)
        if not count:
            return
        try:
            self._give(magnetometer, gyroscope)
        except ClockSetBack:
            pieces = -(-max(len(magnetometer.time), len(gyroscope.time)) // _PIECE)
            for one, other in zip(_pieces(magnetometer, pieces), _pieces(gyroscope, pieces), strict=True):
                self._give(one, other)

    def _give(self, magnetometer: Samples, gyroscope: Samples) -> None:
        absent = np.full((len(magnetometer.time), 3), np.nan), np.full((len(gyroscope.time), 3), np.nan)
        self.online.update(
            np.concatenate([magnetometer.time, gyroscope.time]),
            np.vstack([magnetometer.value, absent[1]]),
            np.vstack([absent[0], gyroscope.value]),
        )

    @property
    def unused(self) -> int:
        """See the class."""
        if self.taken or not self._since:
            return self._since
        of_state = first_shared(self._ignored.text, [self.online.fingerprint]) is not None
        return 0 if of_state else self._since

    @property
    def nothing_new(self) -> bool:
        """Whether samples have come, none of them is used, and they are not those of the saved state."""
        return bool(self.unused) and not self.taken

    @property
    def before_state(self) -> str:
        """Why the present samples are not used, and the remedy; "" if they are used."""
        unused = self.unused
        if not unused:
            return ""
        which = (
            f"the last {counted(unused, 'sample')} {'is' if unused == 1 else 'are'} not"
            if self.taken
            else f"none of the {unused} samples is"
        )
        return (
            f"{which} used: their stamps lie before the end of the saved state "
            f"({max(self._until):.3f} s); if this is another log or clock, begin a new --state"
        )

    @property
    def progress(self) -> Progress:
        """The calibrator's progress; not converged, with the reason, while the samples are not used."""
        progress = self.online.progress
        unused = self.unused
        if not unused:
            return progress
        left_out = progress.left_out + unused
        return replace(progress, converged=False, sentence=self.before_state, left_out=left_out)


def _pieces(samples: Samples, count: int) -> list[Samples]:
    """Return the samples in `count` consecutive pieces."""
    times, values = np.array_split(samples.time, count), np.array_split(samples.value, count)
    return [Samples(time, value) for time, value in zip(times, values, strict=True)]
