"""The clock of a magnetometer whose log repeats its values: when each sample was measured, by the rows that are new."""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.rotations import Array
from magyc_gtsam.recording import Recording

_ONE_ROW = 1.2  # rows by which the ages of held samples differ, if they come on a clock
_HOLE = 1.5  # steps of the rows from which rows are missing
_FEW = 10  # samples, from which a clock can be seen


def on_own_clock(recording: Recording) -> Recording:
    """With the samples that are held stamped by the magnetometer's own clock, where they show one.

    A sensor that measures every P s on a clock of its own is read in the first row after: the stamps of the rows are
    late by up to a row, in a sawtooth that would pass for a delay, a tone, or a lag. The stamps lie on a line in the
    number of the sample; the row that comes soonest after its sample says where. Where the two clocks beat, only few
    ages occur, and the soonest row comes up to the distance of two of them after its sample.
    """
    entries = recording.time[recording.magnetic_field_stamped]
    row = float(np.median(np.diff(entries)))
    time, field = recording.magnetometer
    stretch = np.concatenate([[0], np.cumsum(np.diff(entries) > _HOLE * row)])[np.searchsorted(entries, time)]
    seen = np.diff(stretch, prepend=-1) == 0  # how long the first of a stretch was held before is not
    time, field, stretch = time[seen], field[seen], stretch[seen]
    if len(time) < _FEW or (np.diff(stretch) != 0).all():
        return recording
    number = _numbered(time, stretch, row)
    slope, start = np.polyfit(number, time - time[0], 1)
    own = time[0] + start + slope * number
    age = time - own
    if slope < row or np.ptp(age) > _ONE_ROW * row:
        return recording  # no clock is seen
    ages = len(np.unique(np.round(age / row, 2)))
    own += float(age.min()) - 0.5 * row / ages
    return recording.with_samples((own, field), None if recording.angular_rate is None else recording.gyroscope)


def _numbered(time: Array, stretch: np.ndarray, row: float) -> Array:
    """(n,) number of each sample of one clock that was new in a row at `time` s, of stretches without missing rows.

    A sample may happen to repeat the one before, and is missed. Over a hole the ages at both ends leave open by one how
    many there were: the mean ages beside it do not.
    """
    between, same = np.diff(time), np.diff(stretch) == 0
    period = float(between[same].mean())
    missed = np.maximum(np.ceil((between - _ONE_ROW * row) / period), 1.0)
    number = np.concatenate([[0.0], np.cumsum(np.where(same, missed, 0.0))])
    piece = np.unique(stretch, return_inverse=True)[1]
    size = np.bincount(piece)

    def within(values: Array) -> tuple[Array, Array]:
        mean = np.bincount(piece, values) / size
        return mean, values - mean[piece]

    (mean_number, numbers), (mean_time, times) = within(number), within(time)
    period = float(times @ numbers / (numbers @ numbers))
    holes = np.diff(mean_time - period * mean_number) / period  # samples, but for those that were counted
    return number + np.concatenate([[0.0], np.cumsum(np.round(holes))])[piece]
