"""`EffectTerm`: one interface for every effect that adds to a sensor's reading.

It drives the score test (`regressors`), the variable and factor of the joint refit (`residual`, `prior`), and the
twin. The formulas are those of `factors.effects`, so that what was tested is what is applied.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from magyc_gtsam.factors.chain.rotations import Array
from magyc_gtsam.factors.effects.forms import FORMS, Form, Setting, referenced
from magyc_gtsam.factors.effects.signals import CHANNELS, Signals, rows_by_kind
from magyc_gtsam.gap.model.twin import Columns, Twin
from magyc_gtsam.gap.rules import RULES

Settings = Callable[[Twin], list[dict[str, float]]]
Say = Callable[[Array, Array, Setting], str]
AXES = ("x", "y", "z")
_SHOWS = 3.0  # sigmas, from which one of several rows of a channel is spoken of


def plain(twin: Twin) -> list[dict[str, float]]:
    """Nothing to search over."""
    return [{}]


@dataclass(frozen=True)
class EffectTerm:
    """One effect of the catalogue.

    Attributes:
        name: row of the catalogue and of `factors.effects.FORMS`.
        label: in words.
        unit, scale: shown value = SI value · scale, in `unit`.
        matters: the smallest value that matters, SI; of a value per unit of a channel, for a change of the channel by
            its deviation in the recording, in whatever unit it is logged.
        least: norm of the values, likewise, below which a weak effect is given no name: of what a motion shows far
            below what matters, every other weak effect casts a shadow.
        prior: standard deviation of the value before anything was measured, likewise.
        rivals: names it is known to be confused with.
        parameters: what each value is; repeated over what it stands for.
        say: sentence for a navigator from value, sigma (shown units) and setting.
        motion: what would tell it from its rivals, in words for the helmsman.
        settings: grid of what must be searched over.
        refined: settings beside a found one, closer than the grid; empty where there is no grid.
        block: s, longest block of the held-out veto for a setting.
        most: how many of it one model may hold.
        possible: whether fitted values (SI) at a setting are any that it can have; what is not is some other effect.
        many_shapes: its values make many shapes, of which only those are tried that the motion determines.
        alike: generic families a narrow part of which may look like it, so that it must explain clearly more.
        products: signals whose product with it is a neighbour that must be told from it; see `gap.neighbours`.
        loose: share of its own nats by which a neighbour may be ahead of it, for its form is only the first order.
        slowest: s, the longest of its lags behind its channel; what drifts in less than twice that may be it.
        rough: its form is one of many that it takes, so that what it leaves is seen as soon as the model has it.
        between: share of its evidence by which a setting between those of the grid may be ahead of the best of them.
    """

    name: str
    label: str
    unit: str
    scale: float
    matters: float
    prior: float
    rivals: tuple[str, ...]
    parameters: tuple[str, ...]
    say: Say
    motion: str
    settings: Settings = plain
    refined: Callable[[Twin, Setting], list[dict[str, float]]] = lambda twin, setting: []
    block: Callable[[Setting], float] = lambda setting: RULES.block
    most: int = 1
    least: float = 0.0
    possible: Callable[[Twin, Array, Setting], bool] = lambda twin, value, setting: True
    many_shapes: bool = False
    alike: tuple[str, ...] = ()
    products: tuple[str, ...] = ()
    loose: float = 0.0
    slowest: float = 0.0
    rough: bool = False
    between: float = 0.0

    @property
    def form(self) -> Form:
        """Its formula."""
        return FORMS[self.name]

    @property
    def side(self) -> str:
        """ "magnetometer" or "gyroscope"."""
        return self.form.side

    @property
    def channels(self) -> tuple[str, ...]:
        """What the recording must hold beside the two sensors."""
        return tuple(n for n in self.form.needs if n in CHANNELS or n == "acceleration")

    def missing(self, twin: Twin) -> tuple[str, ...]:
        """The channels that this recording lacks (or that stand still in it)."""
        at = twin.windows
        return tuple(
            c for c in self.channels if (at.acceleration is None if c == "acceleration" else c not in at.channels)
        )

    def deviations(self, twin: Twin, setting: Setting) -> Array:
        """(k,) of the channel that each value is per unit of, over the recording; (1,) one where there is none."""
        kind = next((channel for channel in self.channels if channel in CHANNELS), None)
        if kind is None:
            return np.ones(1)
        channel = twin.windows.need(kind)
        spread = channel[referenced(channel, setting)].std(axis=1)
        return np.repeat(np.where(spread > 0, spread, 1.0), len(self.parameters))

    def regressors(self, twin: Twin, setting: Setting) -> Columns:
        """Columns per unit of value, on windows and links."""
        if self.side == "gyroscope" and "rate" not in self.form.needs:
            # What reads no rate has none of the gyroscope's noise in it, and is not pulled.
            return twin.on_gyroscope(self.form.columns(twin.gyroscope, setting))
        return twin.columns(self.name, setting)

    def residual(self, signals: Signals, value: Array, setting: Setting) -> Array:
        """(3, n) what it adds to the reading, T or rad/s."""
        return self.form.evaluate(signals, value, setting)

    def rows(self, twin: Twin, setting: Setting) -> tuple[str, ...]:
        """What the rows of the channel are called that its values are per unit of; empty where it reads none."""
        kind = next((channel for channel in self.channels if channel in CHANNELS), None)
        if kind is None:
            return ()
        called = rows_by_kind(twin.problem.recording.channels)[kind]
        return tuple(called[row] for row in referenced(twin.windows.need(kind), setting))

    def sentence(self, value: Array, sigma: Array, setting: Setting, rows: Sequence[str] = ()) -> str:
        """For a navigator, of a value and its sigma as shown; of several rows of a channel, each that shows."""
        if len(rows) < 2:
            return self.say(value, sigma, setting)
        values, sigmas = value.reshape(len(rows), -1), sigma.reshape(len(rows), -1)
        shown = np.any(np.abs(values) > _SHOWS * sigmas, axis=1)
        return "; ".join(
            f"{row}: {self.say(values[i], sigmas[i], setting)}"
            for i, row in enumerate(rows)
            if shown[i] or not shown.any()
        )

    def names(self, count: int, rows: Sequence[str] = ()) -> tuple[str, ...]:
        """(count,) what each value is, and of which of the channel's rows, where there are several."""
        base = self.parameters
        if len(rows) > 1:
            return tuple(f"{part} of {row}" for row in rows for part in base[: count // len(rows)])
        if count <= len(base):
            return base[:count]
        return tuple(f"{base[i % len(base)]} {i // len(base) + 1}" for i in range(count))


def measured(value: float, sigma: float) -> str:
    """ "12.3 ± 0.4", with as many digits as the sigma deserves."""
    if not np.isfinite(sigma) or sigma <= 0:
        return f"{value:.3g}"
    if sigma < 1e-5:  # per unit of a channel that is logged in small ones
        return f"{value:.3g} ± {sigma:.2g}"
    digits = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 6)) if sigma < 10 else 0
    if sigma >= 2 * 10.0 ** (-digits + 1) and digits > 0:
        digits -= 1
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def vector(value: Sequence[float] | Array, sigma: Sequence[float] | Array | None = None) -> str:
    """ "(1.2, −0.3, 4.0)", or "(1.2 ± 0.1, …)"."""
    array = np.asarray(value, dtype=float)
    if sigma is not None:
        each = [measured(float(v), float(s)) for v, s in zip(array, sigma, strict=True)]
        return "(" + ", ".join(each).replace("-", "−") + ")"
    largest = float(np.abs(array).max(initial=0.0))
    digits = int(np.clip(2 - np.floor(np.log10(largest)), 0, 4)) if largest > 0 else 1
    return "(" + ", ".join(f"{v:.{digits}f}".replace("-", "−") for v in array) + ")"
