"""The clock of a magnetometer whose log repeats its values: when each sample was measured, by the rows that are new.

A sample is read in the first row after it. How long before that row it was measured, its age, is open by a row; that
the ages of all samples of one clock lie within a row narrows it down. A clock that is free of the rows leaves hardly
anything open. One that keeps step with them, with a sample in every fifth row as well as with two in every three,
leaves open what all ages have in common, and that cannot be told from a delay.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording


def on_own_clock(recording: Recording) -> Recording:
    """With the samples that are held stamped by the magnetometer's own clock, where they show one.

    A sensor that measures every P s on a clock of its own is read in the first row after: the stamps of the rows are
    late by up to a row, in a sawtooth that would pass for a delay, a tone, or a lag. The stamps lie on a line in the
    number of the sample; the row that comes soonest after its sample says where. Where the two clocks beat, only few
    ages occur, and the soonest row comes up to the distance of two of them after its sample: half of it is assumed.

    Where the magnetometer keeps step with the rows that distance is a quarter of a row or more, and one clock drives
    both: the soonest row is taken as the sample's own time. With a sample in every so many rows all keep their rows'
    stamps, as in `calibrate`; what was measured before is late by the stamps of the log, and a delay says so.
    """
    entries = recording.time[recording.magnetic_field_stamped]
    row = float(np.median(np.diff(entries)))
    stretches = np.concatenate([[0], np.cumsum(np.diff(entries) > RULES.clock_hole * row)])
    time, field = recording.magnetometer
    stretch = stretches[np.searchsorted(entries, time)]
    seen = np.diff(stretch, prepend=-1) == 0  # how long the first of a stretch was held before is not
    time, field, stretch = time[seen], field[seen], stretch[seen]
    if len(time) < RULES.clock_samples or (np.diff(stretch) != 0).all():
        return recording
    number, rows = _numbered(time, stretch, row), _numbered(entries, stretches, row)
    measured = _in_step(number, rows[np.searchsorted(entries, time)])
    own = _on_a_line(number, time, row) if measured is None else np.interp(measured, rows, entries)
    if own is None:
        return recording
    return recording.with_samples((own, field), None if recording.angular_rate is None else recording.gyroscope)


def _in_step(number: Array, rows: Array) -> Array | None:
    """(n,) rows, and parts of one, in which samples were measured that are new in `rows`, if their clock keeps step.

    With b samples in every r rows, r · number − b · rows takes b values next to each other and no others, however long
    the recording is. The latest time for each sample that its row allows. None where the two clocks are free of each
    other.
    """
    period = float(np.polyfit(number, rows, 1)[0])
    for beat in range(1, RULES.clock_beat + 1):
        every = round(period * beat)
        place = np.round(beat * rows - every * number).astype(int)
        first = place.min()
        count = np.concatenate([np.bincount(place - first), np.zeros(beat - 1)])
        within = np.convolve(count, np.ones(beat), "valid")
        if within.max() >= RULES.clock_in_step * len(number):
            measured: Array = (every * number + first + int(within.argmax())) / beat
            return measured
    return None


def _on_a_line(number: Array, time: Array, row: float) -> Array | None:
    """(n,) s, when samples were measured that are new in rows at `time` s, `row` s apart; None if on no clock."""
    slope, start = np.polyfit(number, time - time[0], 1)
    own: Array = time[0] + start + slope * number
    age = time - own
    spread = float(np.ptp(age))
    if slope < row or spread > RULES.clock_age * row:
        return None
    open_by = min(row / len(np.unique(np.round(age / row, 2))), max(row - spread, 0.0))
    return own + float(age.min()) - 0.5 * open_by


def _numbered(time: Array, stretch: np.ndarray, row: float) -> Array:
    """(n,) number of each sample of one clock that was new in a row at `time` s, of stretches without missing rows.

    A sample may happen to repeat the one before, and is missed. Over a hole the ages at both ends leave open by one how
    many there were: the mean ages beside it do not.
    """
    between, same = np.diff(time), np.diff(stretch) == 0
    period = float(between[same].mean())
    missed = np.maximum(np.ceil((between - RULES.clock_age * row) / period), 1.0)
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
