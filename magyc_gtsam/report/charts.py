"""Figures as data for the browser, which draws charts with uPlot and a sphere that can be turned.

Arrays are encoded as base64 of little-endian 32-bit floats, thinned to the resolution of a screen.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup

from magyc_gtsam.recording import Array, Recording
from magyc_gtsam.report.analysis import Coverage, spread, summary, time_unit

MOST_BINS = 800  # largest number of bins per series of a chart over time
MOST_POINTS = 2500  # largest number of points per cloud of a sphere
_UNIX = 1e6  # s; times beyond this are from a clock that does not start with the log


@dataclass(frozen=True)
class Figure:
    """A figure with its title, caption and the data from which the browser draws it.

    Attributes:
        title, caption: text above and below the figure.
        spec: the input of charts.js or sphere.js.
        keys: (index of the series or "cells", colour, label) of each part that can be shown and hidden.
        wide: whether it takes the page's whole width.
    """

    title: str
    caption: str
    spec: Mapping[str, Any]
    keys: tuple[tuple[int | str, str, str], ...] = ()
    wide: bool = False

    @property
    def data(self) -> Markup:
        """The specification as JSON that is safe inside a script element."""
        return Markup(json.dumps(self.spec, ensure_ascii=False).replace("<", "\\u003c"))


@dataclass(frozen=True)
class Series:
    """One line of a chart: values, the range about them, or both.

    Attributes:
        label: "" for a series without a key.
        colour: a name of style.css: raw, calibrated, disturbed, ink, soft.
        y, low, high: (n,), NaN where there is no value.
        style: "line", "dashed", "dots", "marked", "bars", or "errors": large dots, with bars from low to high.
    """

    label: str
    colour: str
    y: Array | None = None
    low: Array | None = None
    high: Array | None = None
    style: str = "line"

    def to_dict(self) -> dict[str, Any]:
        """Return the series as charts.js expects it."""
        return {
            "label": self.label,
            "colour": self.colour,
            "style": self.style,
            "y": packed(self.y),
            "low": packed(self.low),
            "high": packed(self.high),
        }


@dataclass(frozen=True)
class Frame:
    """The axes and annotations of a chart: labels, dashed levels, shaded intervals, limits.

    `more` may hold "names" (n,), shown instead of x; "marks", x of vertical dashed lines; "dates", s since 1970 at x=0.
    """

    xlabel: str
    ylabel: str
    levels: Sequence[float] = ()
    spans: Sequence[tuple[float, float]] = ()
    ylim: tuple[float, float] | None = None
    xlim: tuple[float, float] | None = None
    logx: bool = False
    height: int = 230
    more: Mapping[str, Any] = field(default_factory=dict)


def packed(values: Array | None) -> str | None:
    """Return the values as base64 of little-endian 32-bit floats, or None."""
    if values is None:
        return None
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def chart(
    title: str, caption: str, x: Array, series: Sequence[Series], frame: Frame, *, wide: bool = False
) -> Figure:
    """Return a chart of lines, dots or bars over `x`."""
    spec = {
        "kind": "lines",
        "strip": False,
        "x": packed(x),
        "series": [each.to_dict() for each in series],
        "xlabel": frame.xlabel,
        "ylabel": frame.ylabel,
        "levels": [float(level) for level in frame.levels],
        "spans": [[float(start), float(end)] for start, end in frame.spans],
        "logx": frame.logx,
        "height": frame.height,
        **({} if frame.ylim is None else {"ylim": list(frame.ylim)}),
        **({} if frame.xlim is None else {"xlim": list(frame.xlim)}),
        **frame.more,
    }
    keys = tuple((k, each.colour, each.label) for k, each in enumerate(series) if each.label)
    return Figure(title, caption, spec, keys, wide)


def over_time(
    title: str,
    caption: str,
    time: Array,
    values: Sequence[tuple[str, str, Array]],
    ylabel: str,
    *,
    strip: bool = False,
    levels: Sequence[float] = (),
    spans: Sequence[tuple[float, float]] = (),
    wide: bool = False,
) -> Figure:
    """Return a chart over time: means as lines and ranges of the samples as bands, on one scale.

    Args:
        title, caption: text above and below the figure.
        time: (n,) s since `origin` of the recording.
        values: (label, colour, values (n,)) of each series.
        ylabel: label of the vertical axis.
        strip: whether an interval can be dragged and copied.
        levels: values at which a dashed line is drawn.
        spans: (start, end) of shaded intervals, s.
        wide: whether the figure takes the page's whole width.
    """
    series = []
    middle = time
    for label, colour, value in values:
        middle, mean, low, high = summary(time, value, MOST_BINS)
        series.append(Series(label, colour, mean, low, high))
    return chart(title, caption, middle, series, time_frame(middle, ylabel, levels, spans, strip), wide=wide)


def time_frame(
    time: Array,
    ylabel: str,
    levels: Sequence[float] = (),
    spans: Sequence[tuple[float, float]] = (),
    strip: bool = False,
) -> Frame:
    """Return the frame of a chart over time."""
    unit, label = time_unit(time)
    return Frame(label, ylabel, levels, spans, more={"time": True, "divide": unit, "strip": strip})


def origin(recording: Recording) -> float:
    """Return the page's zero of time, in s: the log's own zero, or its first row where the clock is absolute."""
    first = float(recording.time[0])
    return 0.0 if abs(first) < _UNIX else first


def sphere(
    title: str,
    caption: str,
    clouds: Sequence[tuple[str, str, Array]],
    radius: float,
    *,
    outlines: Sequence[tuple[Array, Array, str]] = (),
    coverage: Coverage | None = None,
) -> Figure:
    """Return a figure of points in three dimensions that can be turned.

    Args:
        title, caption: text above and below the figure.
        clouds: (label, colour, points (n, 3)) of each cloud.
        radius: radius of the sphere about zero.
        outlines: (matrix (3, 3), centre (3,), colour) of each ellipsoid {matrix u + centre}, drawn as great circles.
        coverage: time spent in each direction, painted on the sphere.
    """
    drawn = []
    for label, colour, points in clouds:
        thin = points[spread(points, radius / 40, MOST_POINTS)] if len(points) else points
        drawn.append({"label": label, "colour": colour, "points": packed(thin.ravel())})
    spec = {
        "kind": "sphere",
        "strip": False,
        "clouds": drawn,
        "radius": float(radius),
        "outlines": [
            {"matrix": matrix.tolist(), "centre": centre.tolist(), "colour": colour}
            for matrix, centre, colour in outlines
        ],
        "cells": None
        if coverage is None
        else {
            "latitudes": coverage.seconds.shape[0],
            "longitudes": coverage.seconds.shape[1],
            "seconds": packed(coverage.seconds.ravel()),
        },
    }
    keys: list[tuple[int | str, str, str]] = [(k, colour, label) for k, (label, colour, _) in enumerate(clouds)]
    if coverage is not None:
        keys.append(("cells", "visited", "directions visited"))
    return Figure(title, caption, spec, tuple(keys))
