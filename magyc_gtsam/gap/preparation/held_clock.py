"""The clock of a magnetometer whose log repeats its values: sampling times from the rows with new values.

A sample is recorded in the first row after it. Its age, the time from the sample to that row, is uncertain by one row;
it is determined more closely because the ages of all samples of one clock lie within one row. If the clock is
independent of the rows, hardly any uncertainty remains. If it is synchronous with them (a sample in every fifth row, or
two in every three), the part that is common to all ages remains unknown, and cannot be distinguished from a delay.
"""

from __future__ import annotations

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.gap.rules import RULES
from magyc_gtsam.recording import Recording
from magyc_gtsam.recording.held import with_equal_samples


def on_own_clock(recording: Recording) -> Recording:
    """Return the recording with held samples stamped by the magnetometer's own clock, if they show one.

    A sensor that measures every P s on a clock of its own is recorded in the first row after each sample. The stamps
    of the rows are therefore late by up to a row, in a sawtooth that would be taken for a delay, a tone or a lag. The
    stamps lie on a line over the number of the sample; the smallest age determines its offset. If the two clocks beat,
    only few ages occur, and the smallest one lies between 0 and the distance of two ages: half of it is assumed.

    If the magnetometer is synchronous with the rows, this distance is a quarter of a row or more, and one clock drives
    both: the smallest age is taken as 0. With a sample in every so many rows all samples keep the stamps of their rows,
    as in `calibrate`; a constant age is then part of the delay.
    """
    entries = recording.time[recording.magnetic_field_stamped]
    row = float(np.median(np.diff(entries)))
    stretches = np.concatenate([[0], np.cumsum(np.diff(entries) > RULES.clock_hole * row)])
    time, field = recording.magnetometer
    stretch = stretches[np.searchsorted(entries, time)]
    seen = np.diff(stretch, prepend=-1) == 0  # the age of the first sample of a stretch is unknown
    time, field, stretch = time[seen], field[seen], stretch[seen]
    if len(time) < RULES.clock_samples or (np.diff(stretch) != 0).all():
        return recording
    number, rows = _numbered(time, stretch, row), _numbered(entries, stretches, row)
    measured = _in_step(number, rows[np.searchsorted(entries, time)])
    own = _on_a_line(number, time, row) if measured is None else np.interp(measured, rows, entries)
    if own is None:
        return recording
    result = recording.with_samples((own, field), None if recording.angular_rate is None else recording.gyroscope)
    return with_equal_samples(result)


def _in_step(number: Array, rows: Array) -> Array | None:
    """Return the rows (n,), with fractions, in which samples were measured by a clock synchronous with the rows.

    With b samples in every r rows, r · number − b · rows takes b adjacent values and no others, however long the
    recording is. Each sample gets the latest time that its row allows.

    Args:
        number: (n,) of the samples.
        rows: (n,) in which they are new.

    Returns:
        None if the two clocks are independent.
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
    """Return the times (n,) s of samples that are new in rows at `time` s, `row` s apart; None if they fit no clock."""
    slope, start = np.polyfit(number, time - time[0], 1)
    own: Array = time[0] + start + slope * number
    age = time - own
    spread = float(np.ptp(age))
    if slope < row or spread > RULES.clock_age * row:
        return None
    open_by = min(row / len(np.unique(np.round(age / row, 2))), max(row - spread, 0.0))
    return own + float(age.min()) - 0.5 * open_by


def _numbered(time: Array, stretch: np.ndarray, row: float) -> Array:
    """Return the number (n,) of each sample of one clock, from the rows in which the samples are new.

    A sample that happens to repeat the one before is missed. Across a gap, the ages at its two ends leave the number of
    samples uncertain by one; the mean ages of the stretches on both sides determine it.

    Args:
        time: (n,) s, of the rows.
        stretch: (n,) index of the stretch without missing rows that a row belongs to.
        row: s between rows.
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
    holes = np.diff(mean_time - period * mean_number) / period  # samples in each gap, not yet counted in `number`
    return number + np.concatenate([[0.0], np.cumsum(np.round(holes))])[piece]
