"""The gap page's figures: the prediction error before and after over time and heading, and the misfit maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from magyc_gtsam.calibration.calibrated import calibrated_on_time
from magyc_gtsam.factors.errors import MagycError
from magyc_gtsam.gap.outcome.agreement import GapMap, Metrics, OpenLoop
from magyc_gtsam.gap.result import Gap
from magyc_gtsam.level_turn import vertical
from magyc_gtsam.metrics import heading_error
from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.report.analysis import summary
from magyc_gtsam.report.charts import MOST_BINS, Figure, Frame, Series, chart, origin, time_frame

_MICRO = 1e6
_SECTORS = 36
_SCALE = 1.05  # ratio of the upper limit of the common scale to the largest value


def shrinking(recording: Recording, gap: Gap) -> list[Figure]:
    """Draw the prediction error in µT over time and over heading, before and after, on one scale."""
    before, after = gap.before.open_loop, gap.after.open_loop
    if not len(before.time):
        return []  # the recording is shorter than the horizon
    caption = (
        f"Length of the difference between the measured field and its prediction {before.horizon:.0f} s ahead by the "
        "gyroscope alone. Grey: expected from noise alone."
    )
    loops = [("before", "raw", before)]
    if gap.after is not gap.before:
        loops.append(("after", "calibrated", after))
    tops = [float(np.quantile(_length(loop), 0.998)) for _, _, loop in loops]
    frame_limit = (0.0, _SCALE * max(tops))
    figures = [_over_time(recording, loops, after, caption, frame_limit)]
    heading = _headings(recording, gap)
    if heading is not None:
        figures.append(_over_heading(heading, recording, loops, after, frame_limit))
    return figures


def heading_shrinking(recording: Recording, gap: Gap) -> list[Figure]:
    """Draw the error of the magnetic heading against the reference, before and after; empty without a reference."""
    if recording.attitude is None or not np.isfinite(recording.attitude).any():
        return []
    values = [("before", "raw", gap.base)]
    if gap.after is not gap.before:
        values.append(("after", "calibrated", gap.calibration))
    series, middle = [], recording.time - origin(recording)
    for label, colour, calibration in values:
        try:
            corrected = calibrated_on_time(calibration, recording)
        except MagycError:  # a term needs a channel that this recording lacks: there is no curve
            continue
        assert corrected.attitude is not None
        rows = corrected.magnetic_field_fresh
        error = np.degrees(heading_error(corrected.magnetic_field[rows], corrected.attitude[rows]))
        middle, mean, low, high = summary(corrected.time[rows] - origin(recording), error, MOST_BINS)
        series.append(Series(label, colour, mean, low, high))
    frame = time_frame(middle, "Heading error (°)", levels=[0.0])
    return [chart("Heading against the reference", "The mean is removed.", middle, series, frame)]


def gap_map(recording: Recording, before: GapMap, after: GapMap) -> Figure:
    """Draw the misfit over one variable, before and after, with the band expected of the right model."""
    worst = "Within the band" if before.worst <= 1 else f"Up to {before.worst:.2f} times the band"
    closing = (
        "" if after is before else f", then {'within it' if after.worst <= 1 else f'{after.worst:.2f} times'}"
    )
    centre = before.centre - (origin(recording) if before.over == "time" else 0.0)
    series = [
        Series("", "soft", low=before.band[:, 0], high=before.band[:, 1]),
        Series("before", "raw", before.level, style="marked"),
    ]
    if after is not before and len(after.level) == len(before.level):
        series.append(Series("after", "calibrated", after.level, style="marked"))
    name = before.over[0].upper() + before.over[1:]
    label = f"{name} ({before.unit})" if before.unit else name
    frame = Frame(
        label, "Misfit (σ)", [1.0], logx=before.over == "frequency" and bool(before.centre[0] > 0), height=200
    )
    if before.over == "time":
        frame = time_frame(centre, "Misfit (σ)", levels=[1.0])
    return chart(f"Over {before.over}", f"{worst}{closing}.", centre, series, frame)


def maps(recording: Recording, before: Metrics, after: Metrics) -> list[Figure]:
    """Draw the misfit map over each variable."""
    later = {gap.over: gap for gap in after.maps}
    return [
        gap_map(recording, gap, gap if after is before else later.get(gap.over, gap))
        for gap in before.maps
        if len(gap.centre) > 1
    ]


def _over_time(
    recording: Recording,
    loops: Sequence[tuple[str, str, OpenLoop]],
    after: OpenLoop,
    caption: str,
    limits: tuple[float, float],
) -> Figure:
    start = origin(recording)
    expected = np.linalg.norm(after.sigma, axis=1) * _MICRO
    middle, floor, _, _ = summary(after.time - start, expected, MOST_BINS)
    series = [Series("", "soft", low=np.zeros(len(floor)), high=floor)]
    for label, colour, loop in loops:
        when, mean, _, _ = summary(loop.time - start, _length(loop), MOST_BINS)
        series.append(Series(label, colour, np.interp(middle, when, mean, np.nan, np.nan)))
    frame = time_frame(middle, "Prediction error (µT)")
    limited = Frame(frame.xlabel, frame.ylabel, ylim=limits, more={**frame.more, "strip": True})
    hint = "Drag over an interval to copy it for the command line."
    return chart("Over time", f"{caption} {hint}", middle, series, limited, wide=True)


def _over_heading(
    heading: Array,
    recording: Recording,
    loops: Sequence[tuple[str, str, OpenLoop]],
    after: OpenLoop,
    limits: tuple[float, float],
) -> Figure:
    centre = (np.arange(_SECTORS) + 0.5) * 360 / _SECTORS

    def level(time: Array, value: Array) -> Array:
        row = np.clip(np.searchsorted(recording.time, time), 0, len(heading) - 1)
        known = np.isfinite(heading[row])
        sector = (heading[row][known] * _SECTORS / 360).astype(np.int64) % _SECTORS
        count = np.bincount(sector, minlength=_SECTORS)
        square = np.bincount(sector, weights=value[known] ** 2, minlength=_SECTORS)
        return np.where(count > 0, np.sqrt(square / np.maximum(count, 1)), np.nan)

    floor = level(after.time, np.linalg.norm(after.sigma, axis=1) * _MICRO)
    series = [Series("", "soft", low=0 * floor, high=floor)]
    series += [
        Series(label, colour, level(loop.time, _length(loop)), style="marked") for label, colour, loop in loops
    ]
    frame = Frame("Heading (°)", "Prediction error (µT)", xlim=(0, 360), ylim=limits)
    return chart(
        "Over heading",
        "Root mean square of this error in sectors of 10°, on the same scale.",
        centre,
        series,
        frame,
    )


def _headings(recording: Recording, gap: Gap) -> Array | None:
    """Return the magnetic heading (N,) deg, 0 to 360, of the calibrated field; None without a vertical reference."""
    up = vertical(recording.attitude, recording.acceleration)
    if up is None:
        return None
    field = gap.base.corrected(recording)
    axis = np.eye(3)[int(np.nanmean(np.abs(up), axis=0).argmin())]
    ahead = axis - up * (up @ axis)[:, None]
    length = np.linalg.norm(ahead, axis=1)
    angle = np.degrees(np.arctan2((field * np.cross(up, ahead)).sum(axis=1), (field * ahead).sum(axis=1))) % 360
    return np.where(length > 0.2, angle, np.nan)


def _length(loop: OpenLoop) -> Array:
    return np.asarray(np.linalg.norm(loop.error, axis=1) * _MICRO)
