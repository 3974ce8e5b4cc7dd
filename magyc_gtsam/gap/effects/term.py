"""`EffectTerm`: one interface for every effect that adds to a sensor's reading.

The joint refit uses its `prior`. The formulas are those of `factors.effects`, so that the effect that was tested is the
one that is applied.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.changes import Setting, beyond_reference, referenced
from magyc_gtsam.factors.effects.forms import FORMS, Form
from magyc_gtsam.factors.effects.signals import CHANNELS, rows_by_kind, stands_in
from magyc_gtsam.gap.model.twin import Twin
from magyc_gtsam.gap.rules import RULES

Settings = Callable[[Twin], list[dict[str, float]]]
Say = Callable[[Array, Array, Setting], str]
AXES = ("x", "y", "z")
NEARBY = (0.5, 0.7, 1.0, 1.4, 2.0)  # times a found level, lag or width, to be tried as well
_SHOWS = 3.0  # sigmas, from which one of several rows of a channel is mentioned


def plain(twin: Twin) -> list[dict[str, float]]:
    """Return the single setting of an effect without a grid search."""
    return [{}]


@dataclass(frozen=True)
class EffectTerm:
    """One effect of the catalogue.

    Attributes:
        name: row of the catalogue and of `factors.effects.FORMS`.
        label: the name in words.
        physics: what causes it, how it acts on the readings, and what resembles it, in three sentences.
        unit: of shown values; its prefix is the only factor between them and SI values.
        matters: the smallest value that matters, SI. For a value per unit of a channel, the effect of a change of the
            channel by its standard deviation in the recording.
        rivals: names with which it is known to be confused.
        say: function that returns a sentence for a navigator from value, sigma (shown units) and setting.
        motion: the motion that would distinguish it from its rivals, in words for the helmsman.
        parameters: name of each value; repeated for several rows of a channel.
        prior: prior standard deviation of the value, in the unit of `matters`; 1 of most is larger than any value.
        largest: largest possible value, in the unit of `matters`; None for `RULES.farthest` prior deviations.
        settings: function that returns the grid of settings to search.
        refined: function that returns settings near a found one, finer than the grid; empty if there is no grid.
        block: function that returns the longest block of the held-out test, s, for a setting.
        most: number of such effects that one model may contain.
        contains: names of which it is the general case, so that one model has one of them only.
        possible: function that returns whether the effect can have fitted values (SI) at a setting; if not, the cause
            is another effect.
        power: of the channel that a value multiplies.
        products: signals whose product with it is a neighbour to be distinguished from it; see
            `gap.evidence.neighbours`.
    """

    name: str
    label: str
    physics: str
    unit: str
    matters: float
    rivals: tuple[str, ...]
    say: Say
    motion: str
    parameters: tuple[str, ...] = AXES
    prior: float = 1.0
    largest: float | None = None
    settings: Settings = plain
    refined: Callable[[Twin, Setting], list[dict[str, float]]] = lambda twin, setting: []
    block: Callable[[Setting], float] = lambda setting: RULES.block
    most: int = 1
    contains: tuple[str, ...] = ()
    possible: Callable[[Twin, Array, Setting], bool] = lambda twin, value, setting: True
    power: int = 1
    products: tuple[str, ...] = ()

    @property
    def scale(self) -> float:
        """Return the shown value per SI value."""
        return {"%": 1e2, "‰": 1e3, "m": 1e3, "µ": 1e6}.get(self.unit[0], 1.0)

    @property
    def limit(self) -> float:
        """Return the largest possible value, in the unit of `matters`."""
        return RULES.farthest * self.prior if self.largest is None else self.largest

    @property
    def form(self) -> Form:
        """Return its formula."""
        return FORMS[self.name]

    @property
    def side(self) -> str:
        """Return the sensor that it affects, "magnetometer" or "gyroscope"."""
        return self.form.side

    @property
    def channels(self) -> tuple[str, ...]:
        """Return the channels that the recording needs beside the two sensors."""
        return tuple(n for n in self.form.needs if n in CHANNELS or n == "acceleration")

    @property
    def kind(self) -> str | None:
        """Return the kind of channel that its values multiply; None without one."""
        return next((channel for channel in self.channels if channel in CHANNELS), None)

    def missing(self, twin: Twin) -> tuple[str, ...]:
        """Return the channels that this recording lacks, or that do not change in it."""
        at = twin.windows
        return tuple(
            c for c in self.channels if (at.acceleration is None if c == "acceleration" else c not in at.channels)
        )

    def deviations(self, twin: Twin, setting: Setting) -> Array:
        """Return the deviation (k,) over the recording of what each value multiplies; (1,) one without a channel."""
        if self.kind is None:
            return np.ones(1)
        spread = (beyond_reference(twin.windows.need(self.kind), setting) ** self.power).std(axis=1)
        return np.repeat(np.where(spread > 0, spread, 1.0), len(self.parameters))

    def rows(self, twin: Twin, setting: Setting) -> tuple[str, ...]:
        """Return the names of the rows of its channel; empty without a channel."""
        if self.kind is None:
            return ()
        called = rows_by_kind(twin.problem.recording.channels)[self.kind]
        return tuple(called[row] for row in referenced(twin.windows.need(self.kind), setting))

    def sentence(self, value: Array, sigma: Array, setting: Setting, rows: Sequence[str] = ()) -> str:
        """Return the sentence for a navigator; with several rows of a channel, one part for each significant row.

        Args:
            value, sigma: in shown units.
            setting: of the grid search.
            rows: names of the rows of the channel.
        """
        if len(rows) < 2:
            said = self.say(value, sigma, setting)
            other = [row for row in rows if self.kind is not None and stands_in(row, self.kind)]
            return f"{said}; the channel is {other[0]}, for want of a {self.kind}" if other else said
        values, sigmas = value.reshape(len(rows), -1), sigma.reshape(len(rows), -1)
        shown = np.any(np.abs(values) > _SHOWS * sigmas, axis=1)
        return "; ".join(
            f"{row}: {self.say(values[i], sigmas[i], setting)}"
            for i, row in enumerate(rows)
            if shown[i] or not shown.any()
        )

    def names(self, count: int, rows: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the name of each value (count,), with the row of the channel if there are several."""
        base = self.parameters
        if len(rows) > 1:
            return tuple(f"{part} of {row}" for row in rows for part in base[: count // len(rows)])
        if count <= len(base):
            return base[:count]
        return tuple(f"{base[i % len(base)]} {i // len(base) + 1}" for i in range(count))


def measured(value: float, sigma: float) -> str:
    """Return "12.3 ± 0.4", with the digits that the sigma allows."""
    if not np.isfinite(sigma) or sigma <= 0:
        return f"{value:.3g}"
    if sigma < 1e-5:  # value per unit of a channel that is logged in small units
        return f"{value:.3g} ± {sigma:.2g}"
    digits = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 6)) if sigma < 10 else 0
    if sigma >= 2 * 10.0 ** (-digits + 1) and digits > 0:
        digits -= 1
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def at_time(setting: Setting) -> str:
    """Return "at 12.3 ± 0.4 s", the time of a step."""
    return f"at {measured(setting['time'], setting.get('time_sigma', 0.05))} s"


def behind(setting: Setting, what: str, digits: int = 0) -> str:
    """Return ", 20 s behind the thermometer", the lag of an effect behind `what` drives it; "" without a lag."""
    return f", {setting['lag']:.{digits}f} s behind {what}" if setting.get("lag") else ""


def course(what: str, unit: str, value: Array, sigma: Array, setting: Setting) -> str:
    """Return the course of a drift of `what` as text: a line, that of a part that warms up, or modes (3k,)."""
    if setting["order"]:
        by = vector(np.sqrt((value.reshape(-1, 3) ** 2).sum(axis=0) / 2))
        return f"{what}, by {by} {unit} (standard deviation) over the recording"
    said = f"{what} by {vector(value, sigma)} {unit} over the recording"
    if "constant" not in setting:
        return said
    return f"{said}, like a part that warms up, with a time constant of {setting['constant']:.2g} s"


def vector(value: Sequence[float] | Array, sigma: Sequence[float] | Array | None = None) -> str:
    """Return "(1.2, −0.3, 4.0)", or "(1.2 ± 0.1, …)" with sigmas."""
    array = np.asarray(value, dtype=float)
    if sigma is not None:
        each = [measured(float(v), float(s)) for v, s in zip(array, sigma, strict=True)]
        return "(" + ", ".join(each).replace("-", "−") + ")"
    largest = float(np.abs(array).max(initial=0.0))
    digits = int(np.clip(2 - np.floor(np.log10(largest)), 0, 4)) if largest > 0 else 1
    return "(" + ", ".join(f"{v:.{digits}f}".replace("-", "−") for v in array) + ")"
